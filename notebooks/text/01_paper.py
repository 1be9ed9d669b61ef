# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3 (ipykernel)
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Which experiment next?
#
# This notebook repeats the numerical study of Abbiati & Marelli (17WCEE). The structure has two masses. The spring between
# them is the specimen, which is tested in the laboratory. The specimen loses stiffness, but the stiffness of the model is
# constant. Every experiment costs a specimen, so only a few are possible. The design therefore searches for the ground motion
# with the largest discrepancy between specimen and model.

# %%
import matplotlib.pyplot as plt

import hsed_jax as hx

study = hx.load_study("../configs/paper.yaml", ["design.iterations=10"])
study

# %% [markdown]
# Two parameters of the Bouc–Wen law are unknown: the stiffness A and the shape parameter β. The ground motion is a near-fault
# pulse. The experimenter chooses its two inputs: the peak velocity V_P and the period T_P.
#
# ## The possible experiments

# %%
axes = hx.plot.ground_motions(study)

# %% [markdown]
# The period T_P shifts the peak of the response spectrum. The velocity V_P scales the spectrum.
#
# ## The specimen differs from the model
#
# The next cell simulates one experiment at the central inputs. Specimen and model have the same A and β:

# %%
degradation = "model.effects={stiffness_degradation: {eta: 2.0e-5}}"
specimen = hx.load_study("../configs/paper.yaml", [degradation])
inputs, parameters = {"V_P": 2.25, "T_P": 1.0}, {"A": 5.0e5, "beta": 1.0}
figure, ax = plt.subplots()
for name, one in {"specimen": specimen, "model": study}.items():
    channels = hx.simulate(one, inputs, parameters).channels
    ax.plot(1e3 * channels["elongation"], 1e-3 * channels["force"], label=name)
ax.legend()
_ = ax.set(xlabel="Elongation [mm]", ylabel="Force [kN]")
# %% [markdown]
# The specimen loses stiffness as it absorbs energy. Its largest elongation is larger than that of the model, and its largest
# force is smaller.
#
# ## The campaign
#
# The design starts with three experiments and then chooses ten more, one after another. Each step has three parts:
#
# - It calibrates the model with all experiments so far.
# - It fits a Kriging surrogate to the discrepancy.
# - It performs the experiment with the largest expected improvement. The improvement is the excess of the discrepancy over
#   the largest one so far.
#
# The paper chooses forty experiments. To do the same, remove `design.iterations=10` from the first code cell.

# %%
run = hx.run(study, output="runs/lesson_paper", force=True, progress=False, figures=False)
run.calibration

# %%
ax = hx.plot.exploration(run)

# %% [markdown]
# The numbers give the order of the experiments. Squares mark the initial experiments. Seven of the ten chosen experiments
# combine a strong pulse (V_P above 2.4 m/s) with a period between 0.5 s and 1 s.

# %%
ax = hx.plot.expected_improvement(run)

# %% [markdown]
# The expected improvement falls from more than 0.3 to less than 0.01. It rises slightly twice, because each new experiment
# changes the calibrated parameters and the surrogate.
#
# ## The error and the estimates

# %%
ax = hx.plot.error_map(run.calibration)

# %% [markdown]
# The colours show the squared error of the calibrated model. The error is largest for strong pulses with a period near
# 0.75 s. Most of the experiments are in or near this region, because the expected improvement searches for large
# discrepancies.

# %%
axes = hx.plot.estimates(run)

# %% [markdown]
# The bands become narrower with more experiments. At the end, both estimates are below the true values (dashed), and the
# bands do not contain the true values. More experiments make the estimates of a wrong model more precise, but not more
# correct.

# %%
axes = hx.plot.posterior(run.calibration, truth=parameters)

# %% [markdown]
# The true values of A and β are far outside the posterior. The notebook *A model with a missing effect* uses time histories
# to find the missing effect.
