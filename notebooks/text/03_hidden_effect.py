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
# # A model with a missing effect
#
# How wrong is the model? Where does it fail? Which effect does it lack? How much does the error fall with that effect? In this
# notebook you know the truth, and the package does not: a virtual laboratory tests a specimen with an effect that the model
# does not have.
#
# Change the truth and the noise, and run everything again.

# %%
import hsed_jax as hx

TRUTH = {"stiffness_degradation": {"eta": 2.0e-5}}  # 1/J
NOISE = 0.05  # of the RMS of each sensor

# %% [markdown]
# Try other truths: `{"pinching": {"zeta": 0.8}}`, `{"strength_degradation": {"delta": 1.0}}`, two at a time, or `{}` for a
# specimen that the model describes. [The catalogue](../docs/effects.md) has all effects with their parameters. An effect with
# many parameters takes some minutes longer.

# %%
study = hx.load_study(
    "../configs/hidden_effect.yaml",
    [
        f"experiments.virtual.effects={TRUTH}",
        f"experiments.virtual.noise={{relative: {NOISE}}}",
        "experiments.virtual.test=2",
        "design.initial=4",
    ],
)
campaign = hx.campaign_of(study)
campaign

# %% [markdown]
# ## How wrong is the model?

# %%
fit = hx.calibrate(study, campaign)
fit

# %%
hx.compare(fit)

# %% [markdown]
# The error is five times the noise, on the fitted experiments and on the held-out ones. The model is wrong, and more
# experiments of the same kind do not correct it.

# %%
axes = hx.plot.loops(fit)

# %% [markdown]
# In the strongest experiments the measured loops lean over, and the predicted loops keep their slope.
#
# ## Where does it fail?

# %%
hx.locate(fit)

# %%
axes = hx.plot.where(fit)

# %% [markdown]
# It fails in the strongest experiment, after much energy has been absorbed. So the specimen changes during the test.
#
# ## Which effect is missing?
#
# Every effect of the catalogue is fitted to the training experiments, in all its usual forms. The evidence, summed over the
# forms, ranks the effects.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
ax = hx.plot.ranking(diagnosis)

# %% [markdown]
# Bold effects are named. Pinching explains the data almost as well as the named effect, within the noise. The evidence prefers
# the named effect, because it needs a single parameter. (If no effect is named, the notebook ends here.)
#
# The form is in brackets. These experiments cannot distinguish whether the stiffness falls with the absorbed energy, the path
# or the largest elongation, nor the formula by which it falls:

# %%
diagnosis.ranking[0].forms

# %% [markdown]
# ## How much does the error fall?

# %%
better = hx.improve(fit, diagnosis)
better

# %%
ax = hx.plot.error_fall(better)

# %% [markdown]
# The error falls to the noise, also on the experiments that were never used.

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The next figure shows the parameters. The true values of the specimen are dashed.

# %%
axes = hx.plot.posterior(better.calibration, before=better.original, truth=study.experiments.virtual.parameters)

# %% [markdown]
# The first model (red) was certain of a wrong stiffness A, because it took the softening for a soft specimen. With the effect
# (blue), the true values of A and β lie among the draws.
#
# `better.write("improved.yaml")` keeps the improved study, ready to run or to improve again.
