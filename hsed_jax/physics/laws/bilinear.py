"""The bilinear law with kinematic hardening."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractYieldingLaw, Memory, Scalar, Slots, still
from hsed_jax.physics.parameters import parameter
from hsed_jax.registry import register


@final
@register
class Bilinear(AbstractYieldingLaw):
    r"""An elastic spring parallel to an elastic-perfectly plastic one, by return mapping.

    $$f = b k\,\Delta u + f_p,\qquad f_p = \mathrm{clip}\big((1-b)k\,(\Delta u-u_p),\ \pm(1-b)F_y/\nu\big)$$

    with the committed plastic elongation $u_p$.  A step commits $u_p + [(1-b)k(\Delta u-u_p) - f_p]/((1-b)k)$.
    The law yields at $F_y$ and then has the stiffness b k.  The elastic range is $2F_y$ after any history.
    """

    name: ClassVar[str] = "bilinear"
    title: ClassVar[str] = "a bilinear spring with kinematic hardening"
    reference: ClassVar[str] = "Prager 1956; Simo & Hughes 1998, box 1.5"
    slots: ClassVar[tuple[str, ...]] = ("nu",)

    b: Scalar = parameter(
        "b", "1", "stiffness after yielding over initial stiffness", neutral=0.0, lower=0.0, upper=0.95,
        prior={"uniform": [0.0, 0.2]},
    )  # fmt: skip

    def start(self) -> Memory:
        """No force, no plastic elongation."""
        return still("hysteretic", "plastic_elongation")

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """By return mapping [N]."""
        return self.b * self.k * elongation + self._mapped(elongation, memory, slots)[1]

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The force and the plastic elongation."""
        trial, force = self._mapped(elongation, memory, slots)
        plastic = memory["plastic_elongation"] + (trial - force) / ((1 - self.b) * self.k)
        return {"hysteretic": self.b * self.k * elongation + force, "plastic_elongation": plastic}

    def _mapped(self, elongation: Scalar, memory: Memory, slots: Slots) -> tuple[Scalar, Scalar]:
        """Force of the plastic spring [N], elastic and actual."""
        trial = (1 - self.b) * self.k * (elongation - memory["plastic_elongation"])
        bound = (1 - self.b) * self.F_y / slots("nu")
        return trial, jnp.clip(trial, -bound, bound)
