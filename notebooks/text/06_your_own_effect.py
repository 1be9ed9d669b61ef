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
# Perhaps the catalogue does not contain the effect that you suspect. You can write this effect as a Python class. Simulation,
# calibration and diagnosis then use it like any other effect.
#
# The example is a bumper on one side of the frame. The specimen touches the bumper if it moves far enough to this side.

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
# ## Write the class
#
# The first parameter is the amplitude. At zero, its neutral value, the effect has no influence. The method `contribute`
# writes to a slot of the spring law. Here it adds a force [N]. `point.scales` contains the characteristic values that make
# the parameters dimensionless.


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
        """The force that the bumper adds to the law."""
        beyond = jnp.maximum(point.elongation / point.scales.elongation - self.clearance, 0.0)
        return {"force": self.delta * point.scales.force * beyond}


# %% [markdown]
# This is the entry of the effect in the catalogue:

# %%
print(entry("bumper", EFFECTS.joined([Bumper]), curves_of))

# %% [markdown]
# ## Is it correct?
#
# `with_own_effects` adds the class to a study. The study can then name the effect. At the neutral value, the response must
# equal the response without the effect in every digit:

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
# The calibration uses derivatives. The derivative of the peak force agrees with a finite difference:


# %%
def peak_force(delta):
    """Peak force [N] as a function of the stiffness of the bumper."""
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
# At large positive elongations, the measured force rises more steeply. The model has the same stiffness on both sides, so its
# fit is a compromise.

# %%
diagnosis = hx.diagnose(fit)
diagnosis

# %%
ax = hx.plot.ranking(diagnosis)

# %% [markdown]
# The diagnosis names the bumper with a probability of 0.851. The held-out error falls from 0.263 to 0.049. One effect of the
# catalogue remains in the ranking: `contact_stiffening` in the form `tension only` is the same formula. (δ is relative to the
# characteristic force and elongation of the measurements. The δ of the virtual specimen is relative to other values, so the two
# numbers differ.)
#
# For a study of your own, save the class in a file such as `bumper.py`, and decorate it with
# `hsed_jax.physics.effects.base.register`. Name the file in the study: `model: {own_effects: [bumper.py]}`. Then the command
# line uses the effect, too ([own effects](../docs/effects.md)).
