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
# This notebook answers four questions. How wrong is the model? Where does it fail? Which effect does it lack? How much does
# the error fall with this effect? A virtual laboratory tests a specimen with an effect that the model does not have. You know
# this effect, and the package does not.
#
# You can change the effect and the noise in the first code cell, and run all cells again.

# %%
import hsed_jax as hx

TRUTH = {"stiffness_degradation": {"eta": 2.0e-5}}  # 1/J
NOISE = 0.05  # standard deviation over the RMS of each channel

# %% [markdown]
# Other values of `TRUTH` are `{"pinching": {"zeta": 0.8}}`, `{"strength_degradation": {"delta": 1.0}}`, two effects together,
# or `{}` for a specimen without a hidden effect. [The catalogue](../docs/effects.md) lists all effects and their parameters.
# With an effect of many parameters, the notebook runs some minutes longer.

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
# The error is about five times the noise, on the fitted and on the held-out experiments. The model is wrong, and more
# experiments of the same kind do not correct it.

# %%
axes = hx.plot.loops(fit)

# %% [markdown]
# In the strongest experiments (E02 and E06), the measured loops are flatter than the predicted loops at large elongations. In
# the weakest ones (E03 and E05), they are steeper. No constant stiffness fits both.
#
# ## Where does it fail?

# %%
hx.locate(fit)

# %%
axes = hx.plot.where(fit)

# %% [markdown]
# 87 % of the squared error is in E02, the strongest of the fitted experiments. 74 % occurs after the specimen has absorbed
# 49 kJ. This suggests that the specimen changes during the test.
#
# ## Which effect is missing?
#
# The diagnosis compares the effects of the catalogue in all their forms. It fits the effects with the largest predicted gain
# to the training experiments. It then ranks them by their score, which is the log density of held-out measurements.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
ax = hx.plot.ranking(diagnosis)

# %% [markdown]
# The named effect is bold. Pinching lowers the error to the noise, too. However, it describes all measurements together worse,
# and its probability is below 0.001. (If the diagnosis names no effect, the notebook ends here.)
#
# The brackets after an effect contain its form. The next cell prints the probabilities of the forms. The two forms with the
# largest evidence are compared by their predictions, and the others have the probability zero. The linear form has the larger
# probability, but the measurements do not exclude the other one:

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
# The error falls to the noise, also on the held-out experiments.

# %%
axes = hx.plot.before_after(better)

# %% [markdown]
# The next figure shows the posterior of the parameters. Dashed lines are the true values of the specimen.

# %%
axes = hx.plot.posterior(better.calibration, before=better.original, truth=study.experiments.virtual.parameters)

# %% [markdown]
# The first model (red) has a narrow posterior at a wrong stiffness A, because its constant stiffness replaces a stiffness
# that falls. With the effect (blue), the true values of A and β lie among the draws.
#
# `better.write("improved.yaml")` saves the improved study. You can run this study, or improve it again.
