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
# # An effect of your own
#
# The catalogue does not have the effect that you suspect. Write it down as a class, and it takes part in everything: simulation,
# calibration, diagnosis.
#
# The suspicion here: a bumper on one side of the frame, which the specimen touches when it moves far enough that way.

# %%
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np

import hsed_jax as hx
from hsed_jax.analysis.form_curves import curves_of
from hsed_jax.physics.effects import EFFECTS, AbstractSpringEffect
from hsed_jax.physics.parameters import parameter
from hsed_jax.reporting.catalogue import entry

# %% [markdown]
# ## The class
#
# The first parameter is the amplitude: at zero, its neutral value, the effect is absent. What it contributes goes to a slot
# of the law, here an addend to the force [N]; `point.scales` holds the characteristic values that make the parameters
# dimensionless.


# %%
@final
class Bumper(AbstractSpringEffect):
    r"""An elastic bumper on one side: $\delta\,\frac{F_c}{u_c}\max(\Delta u - c\,u_c, 0)$."""

    name: ClassVar[str] = "bumper"
    family: ClassVar[str] = "contact"
    reference: ClassVar[str] = "our own drawing of the frame"
    delta: float = parameter(r"\delta_b", "1", "stiffness", neutral=0.0, prior={"half_normal": 1.0})
    clearance: float = parameter("c", "1", "clearance", neutral=0.5, prior={"uniform": [0.0, 1.0]})

    def contribute(self, point):
        """An addend to the force."""
        beyond = jnp.maximum(point.elongation / point.scales.elongation - self.clearance, 0.0)
        return {"force": self.delta * point.scales.force * beyond}


# %% [markdown]
# As the catalogue shows it:

# %%
print(entry("bumper", EFFECTS.joined([Bumper]), curves_of))

# %% [markdown]
# ## Is it right?
#
# A study is told of it, and may then name it. Neutral means exactly nothing, to the last digit:

# %%
CONFIG, inputs = "../configs/hidden_effect.yaml", {"V_P": 2.25, "T_P": 1.0}
law = {"A": 5.0e5, "beta": 1.0}
plain = hx.load_study(CONFIG)
suspected = hx.load_study(CONFIG, ["model.effects={bumper: {}}"]).with_own_effects(Bumper)
absent = {"bumper.delta": 0.0, "bumper.clearance": 0.5}
forces = [
    hx.simulate(plain, inputs, law).channels["force"],
    hx.simulate(suspected, inputs, law | absent).channels["force"],
]
np.array_equal(*forces)

# %% [markdown]
# The derivative that the calibration will use agrees with a finite difference:


# %%
def peak_force(delta):
    """Largest force [N] over the stiffness of the bumper."""
    present = {"bumper.delta": delta, "bumper.clearance": 0.5}
    return hx.simulate(suspected, inputs, law | present, channels=()).quantities["peak_force"]


_, derivative = jax.jvp(peak_force, (0.5,), (1.0,))
low, high = peak_force(np.array([0.499, 0.501]))
print(f"derivative {derivative:.5g} N, finite difference {(high - low) / 0.002:.5g} N")

# %% [markdown]
# ## Is it found?
#
# A virtual specimen with a bumper, a model without one:

# %%
truth = "experiments.virtual.effects={bumper: {delta: 1.0, clearance: 0.4}}"
study = hx.load_study(CONFIG, [truth, "experiments.virtual.test=2", "design.initial=4"]).with_own_effects(Bumper)
fit = hx.calibrate(study)
axes = hx.plot.loops(fit)

# %% [markdown]
# The measured force turns up at large positive elongations; the model can only choose a stiffness in between.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
ax = hx.plot.ranking(diagnosis)

# %% [markdown]
# The bumper is named before everything in the catalogue. Second is the quadratic spring, which is as one-sided but has no
# clearance. (δ is relative to the characteristic force and elongation of these measurements.)
#
# For a study of your own, put the class into a file, say `bumper.py`, decorated with
# `hsed_jax.physics.effects.base.register`, and name it in the study: `model: {own_effects: [bumper.py]}`; then the command line
# knows it, too ([how](../docs/effects.md)).
