r"""The hysteretic spring: Bouc–Wen with named slots that effects write to.

$$\dot z = h\,\frac{a A - \nu\,(\beta\,\mathrm{sign}(\Delta\dot u\,z)+\gamma)\,|z|^n}{\eta}\,\Delta\dot u,\qquad
  r = z + \sum \text{force},\qquad \dot e = r\,\Delta\dot u$$

An element in series with compliance c turns the slope $dz/d\Delta u = g$ into $g/(1+cg)$; inside a slack there is no force.
With nothing in the slots (a = ν = η = h = 1) it is Eq. 15 of Abbiati & Marelli without the degradation, i.e. Bouc 1967,
Wen 1976.  The force z is in newtons, so A is a stiffness [N/m].
"""

from collections.abc import Callable
from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.effects.base import AbstractSpringEffect, SpringPoint, combine
from hsed_jax.physics.parameters import parameter
from hsed_jax.physics.scales import Scales

Scalar = Float[Array, ""] | float
Memory = dict[str, Scalar]


@final
class BoucWen(eqx.Module):
    """A Bouc–Wen spring with any number of effects.

    A parameter given as a Python number is a constant of the compiled program (n = 1 needs no power, γ = 0 no term); one
    given as an array is an input of it.
    """

    A: Scalar = parameter("A", "N/m", "initial stiffness", lower=0.0)
    beta: Scalar = parameter(r"\beta", "N^(1-n)/m", "shape of the loop: dissipation", lower=0.0)
    gamma: Scalar = parameter(r"\gamma", "N^(1-n)/m", "shape of the loop: softening against pinching", neutral=0.0)
    n: Scalar = parameter("n", "1", "sharpness of yielding", neutral=1.0, lower=0.5)
    effects: tuple[AbstractSpringEffect, ...] = ()
    scales: Scales = Scales()

    @property
    def is_bounded(self) -> Array | bool:
        """Whether the force has a bound, which β + γ < 0 takes away: on loading the stiffness grows with the force.

        At β + γ = 0 the element is elastic on loading, the limit of a large strength.
        """
        return self.beta + self.gamma >= 0

    def start(self) -> Memory:
        """The states of a virgin spring: hysteretic force z [N] and absorbed energy e [J]."""
        further = {state for effect in self.effects for state in (*effect.needs, *effect.states)}
        names = ("hysteretic", "energy", *sorted(further))
        return {name: jnp.zeros(()) for name in names}

    def force(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Scalar:
        """Restoring force r [N] at elongation Δu [m] and its rate [m/s]."""
        slots = self._slots(elongation, rate, memory)
        return self._carried(elongation, memory, slots) + slots("force")

    def rates(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Memory:
        """Time derivatives of the states."""
        slots = self._slots(elongation, rate, memory)
        z = memory["hysteretic"]
        magnitude = jnp.abs(z)
        share = slots("gamma")
        gamma = self.gamma if _is_zero(share) else self.gamma + share * self.beta
        # β sign(Δu̇ z)|z|ⁿ Δu̇ = β |Δu̇| z |z|ⁿ⁻¹: no sign, hence no jump where z passes zero.
        softening = self.beta * jnp.abs(rate) * z * _power(magnitude, self.n, -1)
        if not _is_zero(gamma):
            softening = softening + gamma * rate * _power(magnitude, self.n, 0)
        if not _is_zero(sharper := slots("n")):
            # (|z|/z_u)^δ leaves the strength z_u where it is: sharpness alone changes.
            softening = softening * _power(magnitude / self._strength(), sharper, 0)
        # h/η first: rates at one η then share one division.
        flow = slots("h") / slots("eta") * (slots("a") * self.A * rate - slots("nu") * softening)
        if not _is_zero(compliance := slots("compliance")):
            moving = jnp.where(rate == 0, 1.0, rate)
            flow = flow / (1 + compliance * flow / moving)
        if not _is_zero(slack := slots("slack")):
            flow = jnp.where(jnp.abs(elongation) >= slack, flow, 0.0)
        force = self._carried(elongation, memory, slots) + slots("force")
        rates = {name: jnp.zeros_like(value) for name, value in memory.items()}
        rates |= {"hysteretic": flow, "energy": force * rate}
        if "travel" in memory:
            rates["travel"] = jnp.abs(rate)
        point = self._point(elongation, rate, memory)
        for effect in self.effects:
            rates |= effect.flow(point)
        return rates

    def settle(self, elongation: Scalar, memory: Memory) -> Memory:
        """The states after a step that reached this elongation [m]: the largest one is kept here, not integrated."""
        if "largest_elongation" not in memory:
            return memory
        return {**memory, "largest_elongation": jnp.maximum(memory["largest_elongation"], jnp.abs(elongation))}

    def steepness(self) -> Scalar:
        """n A/z_u [1/m], |γ| for γ: how fast, along the elongation, the force of the virgin element comes to its limit."""
        softening = self.beta + jnp.abs(self.gamma)
        if isinstance(self.n, int | float) and self.n == 1:
            return softening
        return self.n * self.A ** (1 - 1 / self.n) * softening ** (1 / self.n)

    def _carried(self, elongation: Scalar, memory: Memory, slots: Callable[[str], Scalar]) -> Scalar:
        """The force of the hysteretic element, none inside a slack."""
        slack = slots("slack")
        z = memory["hysteretic"]
        return z if _is_zero(slack) else jnp.where(jnp.abs(elongation) >= slack, z, 0.0)

    def _slots(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Callable[[str], Scalar]:
        point = self._point(elongation, rate, memory)
        return combine([effect.contribute(point) for effect in self.effects])

    def _point(self, elongation: Scalar, rate: Scalar, memory: Memory) -> SpringPoint:
        return SpringPoint(elongation, rate, memory["hysteretic"], memory, self.scales, self._strength())

    def _strength(self) -> Scalar:
        """Ultimate force of the virgin element [N]; where it is elastic, a large number stands for none."""
        strength = self.A / jnp.maximum(self.beta + self.gamma, 1e-12)
        return strength if isinstance(self.n, int | float) and self.n == 1 else strength ** (1 / self.n)


def _is_zero(value: Scalar) -> bool:
    """Whether a value is the number zero, known while the program is compiled."""
    return isinstance(value, int | float) and value == 0


def _power(magnitude: Scalar, n: Scalar, offset: int) -> Scalar:
    """|z|^(n+offset) with its right derivative at z = 0, free of `pow` where n is a Python number that needs none."""
    if isinstance(n, int | float):
        exponent = n + offset
        if exponent == 0:
            return 1.0
        if exponent == 1:
            return magnitude
        if exponent == 2:
            return magnitude * magnitude
    else:
        exponent = n + offset
    # The logarithm of zero would poison the derivative in n; a spring never works at 1e-12 N.
    return jnp.exp(exponent * jnp.log(jnp.maximum(magnitude, 1e-12)))
