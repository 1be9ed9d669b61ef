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
# The campaign of Abbiati & Marelli (17WCEE): a two-mass structure, its middle spring in the laboratory. The specimen loses
# stiffness, the model does not know it. Every experiment costs a specimen, so each next ground motion is chosen where it tells
# most about the discrepancy between the two.

# %%
import matplotlib.pyplot as plt

import hsed_jax as hx

study = hx.load_study("../configs/paper.yaml", ["design.iterations=10"])
study

# %% [markdown]
# Two parameters of the Bouc–Wen law are unknown, the stiffness A and the shape parameter β; two inputs of the ground motion can
# be chosen, the peak velocity and the period of a near-fault pulse.
#
# ## What can be asked

# %%
axes = hx.plot.ground_motions(study)

# %% [markdown]
# The period T_P moves the peak of the spectrum, the velocity V_P scales it.
#
# ## The specimen is not the model
#
# One experiment at the central inputs, with the same A and β in both:

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
# Three experiments to begin with, then ten that are chosen one after another: calibrate, fit a Kriging surrogate to the
# discrepancy, perform the experiment with the largest expected improvement. (The paper makes forty; leave out
# `design.iterations=10` above for the same.)

# %%
run = hx.run(study, output="runs/lesson_paper", force=True, progress=False, figures=False)
run.calibration

# %%
ax = hx.plot.exploration(run)

# %% [markdown]
# The numbers are the order of the experiments, squares the initial ones. Most of the chosen ones crowd at strong pulses with a
# period near 0.75 s.

# %%
ax = hx.plot.expected_improvement(run)

# %% [markdown]
# It falls, with setbacks: each new region may hold a surprise.
#
# ## What the model learns, and what it cannot

# %%
ax = hx.plot.error_map(run.calibration)

# %% [markdown]
# Where the experiments crowd, the calibrated model errs most: that is what the expected improvement looks for.

# %%
axes = hx.plot.estimates(run)

# %% [markdown]
# The bands are narrow and both estimates end below the dashed values of the specimen: more experiments make a wrong model sure,
# not right.

# %%
axes = hx.plot.posterior(run.calibration, truth=parameters)

# %% [markdown]
# The true pair lies far outside the posterior. What this model lacks, the lesson *A model that lacks something* finds from
# time histories.
