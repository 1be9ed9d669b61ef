"""The peak-oriented law of reinforced concrete: Takeda's unloading, Clough's reloading."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractYieldingLaw, Memory, Scalar, Slots, still
from hsed_jax.physics.parameters import parameter
from hsed_jax.physics.powers import power
from hsed_jax.physics.scales import is_zero
from hsed_jax.registry import register


@final
@register
class Takeda(AbstractYieldingLaw):
    r"""Reloading aims at the furthest point of the loaded side.  Unloading softens with the elongation of this point.

    $$F(u) = \frac{\min(k u,\ F_y + b k (u-u_y))}{\nu},\qquad
      k_u = k\,\Big(\frac{u_m}{u_y}\Big)^{-\alpha},\qquad
      f = \min\Big(f_c + k_u\,(\Delta u-u_c),\ F(u_m)\frac{\Delta u-u_z}{u_m-u_z}\Big)$$

    for loading towards the positive side.  F is the backbone, $(u_c, f_c)$ the committed point, $u_m$ the furthest elongation
    of that side (at least $u_y = F_y/k$), and $u_z$ the elongation at which the force last passed zero upwards.  Beyond
    $u_m$ the second term of the minimum is the backbone.  From a negative force the law first unloads with the $k_u$ of the
    negative side to zero, at $u_z = u_c - f_c/k_u$.  The negative side is the mirror image.  A step commits its end.

    Reloading that starts from a non-zero force has the stiffness $k_u$ until it meets the line to the furthest point (Mahin &
    Bertero 1976).  α = 0 is Clough's law; Takeda, Sozen & Nielsen use 0.4 and a trilinear backbone.  In OpenSees the law is
    Hysteretic without pinching and damage.
    """

    name: ClassVar[str] = "takeda"
    title: ClassVar[str] = "a peak-oriented spring of Takeda's kind"
    reference: ClassVar[str] = "Clough 1966; Takeda, Sozen & Nielsen 1970; Mahin & Bertero 1976"
    slots: ClassVar[tuple[str, ...]] = ("nu",)

    b: Scalar = parameter(
        "b", "1", "stiffness after yielding over initial stiffness", neutral=0.0, lower=0.0, upper=0.95,
        prior={"uniform": [0.0, 0.2]},
    )  # fmt: skip
    alpha: Scalar = parameter(
        r"\alpha", "1", "exponent with which unloading softens", neutral=0.0, lower=0.0, upper=1.0,
        prior={"uniform": [0.0, 0.6]},
    )  # fmt: skip

    def start(self) -> Memory:
        """At rest; the furthest points of a virgin element are those of yielding."""
        u_y = jnp.asarray(self.yield_elongation)
        rest = still("hysteretic", "elongation", "zero_up", "zero_down")
        return {**rest, "highest": u_y, "lowest": -u_y}

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """Force on the path from the committed state [N]."""
        return self._way(elongation, memory, slots)[0]

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The point, the furthest points, and the elongation at which the force passes zero on this path."""
        force, zero = self._way(elongation, memory, slots)
        goes_up = elongation >= memory["elongation"]
        return {
            "hysteretic": force,
            "elongation": elongation,
            "zero_up": jnp.where(goes_up, zero, memory["zero_up"]),
            "zero_down": jnp.where(goes_up, memory["zero_down"], zero),
            "highest": jnp.maximum(memory["highest"], elongation),
            "lowest": jnp.minimum(memory["lowest"], elongation),
        }

    def _way(self, elongation: Scalar, memory: Memory, slots: Slots) -> tuple[Scalar, Scalar]:
        """Force [N], and the elongation at which it passes zero on this path [m]."""
        goes_up = elongation >= memory["elongation"]
        sign = jnp.where(goes_up, 1.0, -1.0)
        # The negative direction is the mirror image of the positive one.
        u, u_c, f_c = sign * elongation, sign * memory["elongation"], sign * memory["hysteretic"]
        ahead = jnp.where(goes_up, memory["highest"], -memory["lowest"])
        behind = jnp.where(goes_up, -memory["lowest"], memory["highest"])
        k_ahead, k_behind = self._unloading(ahead), self._unloading(behind)
        unloads = f_c < 0
        zero = jnp.where(
            unloads, u_c - f_c / k_behind, sign * jnp.where(goes_up, memory["zero_up"], memory["zero_down"])
        )
        elastic = jnp.where(unloads, k_ahead * (u - zero), f_c + k_ahead * (u - u_c))
        # The furthest point is ahead by at least its own unloading; the bound applies only to impossible states.
        reach = jnp.maximum(ahead - zero, 1e-6 * self.yield_elongation)
        strength = 1 / slots("nu")
        line = jnp.where(u < ahead, strength * self._yielded(ahead) * (u - zero) / reach, strength * self._yielded(u))
        force = jnp.where(unloads & (u < zero), f_c + k_behind * (u - u_c), jnp.minimum(elastic, line))
        return sign * force, sign * zero

    def _yielded(self, elongation: Scalar) -> Scalar:
        """The backbone beyond yielding [N]."""
        return self.F_y + self.b * (self.k * elongation - self.F_y)

    def _unloading(self, furthest: Scalar) -> Scalar:
        """Stiffness of unloading from a side [N/m]."""
        if is_zero(self.alpha):
            return self.k
        return self.k * power(furthest / self.yield_elongation, -self.alpha)
