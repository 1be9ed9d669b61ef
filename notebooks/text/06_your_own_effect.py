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
# Perhaps the catalogue does not have the effect that you suspect. Write it as a class. Then simulation, calibration and
# diagnosis use it like any other effect.
#
# The example is a bumper on one side of the frame. The specimen touches it when it moves far enough to that side.

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
# The first parameter is the amplitude. At zero, its neutral value, the effect is absent. The effect writes to a slot of the
# law; here it adds a force [N]. `point.scales` holds the characteristic values that make the parameters dimensionless.


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
# The catalogue shows it like this:

# %%
print(entry("bumper", EFFECTS.joined([Bumper]), curves_of))

# %% [markdown]
# ## Is it correct?
#
# Tell a study of the effect; the study may then name it. At the neutral value, the response is equal to the plain one in every
# digit:

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
# The derivative that the calibration uses agrees with a finite difference:


# %%
def peak_force(delta):
    """Largest force [N] over the stiffness of the bumper."""
    present = {"bumper.delta": delta, "bumper.clearance": 0.5}
    return hx.simulate(suspected, inputs, law | present, channels=()).quantities["peak_force"]


_, derivative = jax.jvp(peak_force, (0.5,), (1.0,))
low, high = peak_force(np.array([0.499, 0.501]))
print(f"derivative {derivative:.5g} N, finite difference {(high - low) / 0.002:.5g} N")

# %% [markdown]
# ## Does the diagnosis find it?
#
# The virtual specimen has a bumper, and the model does not:

# %%
truth = "experiments.virtual.effects={bumper: {delta: 1.0, clearance: 0.4}}"
study = hx.load_study(CONFIG, [truth, "experiments.virtual.test=2", "design.initial=4"]).with_own_effects(Bumper)
fit = hx.calibrate(study)
axes = hx.plot.loops(fit)

# %% [markdown]
# The measured force turns up at large positive elongations. The model can only choose a stiffness in between.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
ax = hx.plot.ranking(diagnosis)

# %% [markdown]
# The bumper is named before every effect of the catalogue. The quadratic spring is second: it is one-sided, too, but has no
# clearance. (δ is relative to the characteristic force and elongation of these measurements.)
#
# For a study of your own, put the class into a file such as `bumper.py`, and decorate it with
# `hsed_jax.physics.effects.base.register`. Name the file in the study: `model: {own_effects: [bumper.py]}`. Then the command
# line knows the effect, too ([more](../docs/effects.md)).
