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
# This is the campaign of Abbiati & Marelli (17WCEE). The structure has two masses, and its middle spring is the specimen in the
# laboratory. The specimen loses stiffness, and the model does not know this. Every experiment costs a specimen. So each next
# ground motion is the one that tells most about the discrepancy between specimen and model.

# %%
import matplotlib.pyplot as plt

import hsed_jax as hx

study = hx.load_study("../configs/paper.yaml", ["design.iterations=10"])
study

# %% [markdown]
# Two parameters of the Bouc–Wen law are unknown: the stiffness A and the shape parameter β. The experimenter chooses two inputs
# of the ground motion: the peak velocity and the period of a near-fault pulse.
#
# ## The possible experiments

# %%
axes = hx.plot.ground_motions(study)

# %% [markdown]
# The period T_P moves the peak of the spectrum. The velocity V_P scales the spectrum.
#
# ## The specimen differs from the model
#
# This is one experiment at the central inputs, with the same A and β in both:

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
# The specimen softens as it absorbs energy: it moves further than the model under a smaller force.
#
# ## The campaign
#
# The campaign begins with three experiments and then chooses ten, one after another. Each step calibrates the model, fits a
# Kriging surrogate to the discrepancy, and performs the experiment with the largest expected improvement. The paper makes forty
# steps; leave out `design.iterations=10` above to do the same.

# %%
run = hx.run(study, output="runs/lesson_paper", force=True, progress=False, figures=False)
run.calibration

# %%
ax = hx.plot.exploration(run)

# %% [markdown]
# The numbers are the order of the experiments, and squares are the initial ones. Most of the chosen experiments have strong
# pulses with a period near 0.75 s.

# %%
ax = hx.plot.expected_improvement(run)

# %% [markdown]
# The expected improvement falls with setbacks, because a new region can show a larger discrepancy.
#
# ## What the model learns, and what it cannot learn

# %%
ax = hx.plot.error_map(run.calibration)

# %% [markdown]
# The calibrated model errs most where the experiments crowd. The expected improvement looks for such places.

# %%
axes = hx.plot.estimates(run)

# %% [markdown]
# The bands are narrow, and both estimates end below the dashed values of the specimen. More experiments make a wrong model more
# certain, but not more correct.

# %%
axes = hx.plot.posterior(run.calibration, truth=parameters)

# %% [markdown]
# The true pair lies far outside the posterior. The notebook *A model with a missing effect* finds the missing effect from time
# histories.
