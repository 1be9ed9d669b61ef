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
# # A model that lacks something
#
# How wrong is the model, where does it fail, what does it lack, and what does adding that do? Here the truth is known, to you
# and not to the package: a virtual laboratory tests a specimen with an effect that the model does not have.
#
# Change the truth and the noise, and run everything again.

# %%
import hsed_jax as hx

TRUTH = {"stiffness_degradation": {"eta": 2.0e-5}}  # 1/J
NOISE = 0.05  # of the RMS of each sensor

# %% [markdown]
# Other truths: `{"pinching": {"zeta": 0.8}}`, `{"strength_degradation": {"delta": 1.0}}`, two at a time, or `{}` for a model that
# lacks nothing. [The catalogue](../docs/effects.md) has all effects with their parameters. One with many parameters takes some
# minutes longer.

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
# The error is five times the noise, on the experiments that were fitted and on those that were not: the model is wrong, and
# more experiments of the same kind would not mend it.

# %%
axes = hx.plot.loops(fit)

# %% [markdown]
# In the strongest experiments the measured loops lean over; the predicted ones keep their slope.
#
# ## Where does it fail?

# %%
hx.locate(fit)

# %%
axes = hx.plot.where(fit)

# %% [markdown]
# In the strongest experiment, where much energy has been absorbed: the specimen has changed on the way.
#
# ## What does it lack?
#
# Every effect of the catalogue is fitted to the training experiments, in the forms that textbooks have of it; the evidence,
# summed over the forms, ranks them.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
ax = hx.plot.ranking(diagnosis)

# %% [markdown]
# What is named is in bold. Pinching imitates it almost within the noise; the evidence prefers the one that needs a single
# parameter. (Where nothing is named, the lesson ends here.)
#
# In brackets stands the form. Of what makes stiffness fall, absorbed energy, path or largest elongation, and of how it falls,
# these experiments tell as much:

# %%
diagnosis.ranking[0].forms

# %% [markdown]
# ## What does adding it do?

# %%
better = hx.improve(fit, diagnosis)
better

# %%
ax = hx.plot.error_fall(better)

# %% [markdown]
# On the experiments that were never used, too, the error falls to the noise.

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# And the parameters? The specimen's own values are dashed.

# %%
axes = hx.plot.posterior(better.calibration, before=better.original, truth=study.experiments.virtual.parameters)

# %% [markdown]
# The model as it was (red) was sure of a wrong stiffness A: it took the softening for a soft specimen. With the effect (blue) the
# true values of A and β lie among the draws.
#
# `better.write("improved.yaml")` keeps the improved study, ready to run or to improve again.
