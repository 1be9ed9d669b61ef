r"""The hysteretic spring: Bouc–Wen with named slots that effects write to.

$$\dot z = h\,\frac{a A - \nu\,(\beta\,\mathrm{sign}(\Delta\dot u\,z)+\gamma)\,|z|^n}{\eta}\,\Delta\dot u,\qquad
  r = z + \sum \text{force},\qquad \dot e = r\,\Delta\dot u$$

With nothing in the slots (a = ν = η = h = 1) it is Eq. 15 of Abbiati & Marelli without the degradation, i.e. Bouc 1967,
Wen 1976.  The force z is in newtons, so A is a stiffness [N/m].
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.effects.base import AbstractEffect, SpringPoint, combine
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
    effects: tuple[AbstractEffect, ...] = ()
    scales: Scales = Scales()

    def start(self) -> Memory:
        """The states of a virgin spring: hysteretic force z [N] and absorbed energy e [J]."""
        return {"hysteretic": jnp.zeros(()), "energy": jnp.zeros(())}

    def force(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Scalar:
        """Restoring force r [N] at elongation Δu [m] and its rate [m/s]."""
        return memory["hysteretic"] + self._slots(elongation, rate, memory)("force")

    def rates(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Memory:
        """Time derivatives of the states."""
        slots = self._slots(elongation, rate, memory)
        z = memory["hysteretic"]
        magnitude = jnp.abs(z)
        # β sign(Δu̇ z)|z|ⁿ Δu̇ = β |Δu̇| z |z|ⁿ⁻¹: no sign, hence no jump where z passes zero.
        softening = self.beta * jnp.abs(rate) * z * _power(magnitude, self.n, -1)
        if not (isinstance(self.gamma, int | float) and self.gamma == 0):
            softening = softening + self.gamma * rate * _power(magnitude, self.n, 0)
        flow = slots("h") * (slots("a") * self.A * rate - slots("nu") * softening) / slots("eta")
        return {"hysteretic": flow, "energy": (z + slots("force")) * rate}

    def tangent(self, rate: Scalar, elongation: Scalar, memory: Memory) -> Scalar:
        """dz/dΔu [N/m] on the branch that `rate` is on; `rate` must not be zero."""
        return self.rates(elongation, rate, memory)["hysteretic"] / rate

    def _slots(self, elongation: Scalar, rate: Scalar, memory: Memory):
        point = SpringPoint(elongation, rate, memory["hysteretic"], memory, self.scales)
        return combine([effect.contribute(point) for effect in self.effects])


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
