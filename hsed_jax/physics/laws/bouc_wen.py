"""The Bouc–Wen law, with slots for the effects of the literature."""

from collections.abc import Callable, Mapping
from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractSpringLaw, Memory, Scalar, Slots, Turn, still
from hsed_jax.physics.laws.reversal import mended_force
from hsed_jax.physics.parameters import parameter
from hsed_jax.physics.powers import power
from hsed_jax.physics.scales import is_number, is_zero
from hsed_jax.registry import register


@final
@register
class BoucWen(AbstractSpringLaw):
    r"""The force z of the element follows a differential equation along the elongation.

    $$\dot z = h\,\frac{a A - \nu\,(\beta\,\mathrm{sign}(\Delta\dot u\,z)+\gamma)\,|z|^n}{\eta}\,\Delta\dot u$$

    An element in series with compliance c turns the slope $dz/d\Delta u = g$ into $g/(1+cg)$.  Without effects
    (a = ν = η = h = 1) it is Eq. 15 of Abbiati & Marelli without the degradation.  The force z is in newtons, so A is a
    stiffness; the force tends to the strength $[A/(\beta+\gamma)]^{1/n}$.

    **With β + γ < 0 the law hardens**: the stiffness grows on loading, to $A + |\beta+\gamma||z|^n$, and the law has no strength.
    The force is still finite at any elongation: from zero force and for n = 1 it is at most
    $\frac{A}{|\beta+\gamma|}(e^{|\beta+\gamma|\Delta u} - 1)$ after Δu.  With β ≥ 0 the law dissipates energy.  Effects whose
    formulas have a strength z_u use the force $[A/|\beta+\gamma|]^{1/n}$ instead, at which the stiffness on loading has doubled.
    It tends to infinity where β + γ tends to zero, as the strength does from the other side.
    """

    name: ClassVar[str] = "bouc_wen"
    title: ClassVar[str] = "the Bouc–Wen spring"
    reference: ClassVar[str] = "Bouc 1967; Wen 1976"
    slots: ClassVar[tuple[str, ...]] = ("a", "nu", "eta", "h", "n", "gamma", "compliance")
    steepest: ClassVar[Mapping[str, float]] = {"A": 0.999, "beta": 0.999}

    A: Scalar = parameter("A", "N/m", "initial stiffness", lower=0.0)
    beta: Scalar = parameter(r"\beta", "N^(1-n)/m", "shape of the loop: dissipation", lower=0.0)
    gamma: Scalar = parameter(r"\gamma", "N^(1-n)/m", "shape of the loop: softening against pinching", neutral=0.0)
    n: Scalar = parameter("n", "1", "sharpness of yielding", neutral=1.0, lower=0.5)

    @property
    def stiffness(self) -> Scalar:
        """A [N/m]."""
        return self.A

    @property
    def strength(self) -> Scalar:
        """Ultimate force of the virgin element [N]; infinite where β + γ ≤ 0, and it is elastic on loading or hardens."""
        return jnp.where(self.beta + self.gamma > 0, self.yardstick, jnp.inf)

    @property
    def yardstick(self) -> Scalar:
        """The strength, or for a hardening law the force at which its stiffness on loading has doubled [N]. If it is elastic
        on loading, the value is a large number, so that derivatives are finite.
        """
        # β scales as a force to the power of −n.
        force = self.A / jnp.maximum(jnp.abs(self.beta + self.gamma), 1e-12 * self.beta + 1e-300)
        return force if is_number(self.n, 1) else force ** (1 / self.n)

    @property
    def steepness(self) -> Scalar:
        """n A/z_u [1/m], |γ| for γ."""
        softening = self.beta + jnp.abs(self.gamma)
        if is_number(self.n, 1):
            return softening
        return self.n * self.A ** (1 - 1 / self.n) * softening ** (1 / self.n)

    def start(self) -> Memory:
        """No force."""
        return still("hysteretic")

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """The state z."""
        return memory["hysteretic"]

    def flow(self, elongation: Scalar, rate: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The rate of z [N/s]."""
        z = memory["hysteretic"]
        magnitude = jnp.abs(z)
        share = slots("gamma")
        gamma = self.gamma if is_zero(share) else self.gamma + share * self.beta
        # β sign(Δu̇ z)|z|ⁿ Δu̇ = β |Δu̇| z |z|ⁿ⁻¹: this form has no sign, and no jump where z passes zero.
        softening = self.beta * jnp.abs(rate) * z * _power(magnitude, self.n, -1)
        if not is_zero(gamma):
            softening = softening + gamma * rate * _power(magnitude, self.n, 0)
        if not is_zero(sharper := slots("n")):
            # (|z|/z_u)^δ does not change the strength z_u or its substitute: only the sharpness changes.
            softening = softening * _power(magnitude / self.yardstick, sharper, 0)
        # h/η first, so that rates with the same η share one division.
        flow = slots("h") / slots("eta") * (slots("a") * self.A * rate - slots("nu") * softening)
        if not is_zero(compliance := slots("compliance")):
            moving = jnp.where(rate == 0, 1.0, rate)
            flow = flow / (1 + compliance * flow / moving)
        return {"hysteretic": flow}

    def mended(
        self,
        turn: Turn,
        before: Memory,
        flow: Memory,
        after: Memory,
        rates: Callable[[Scalar, Scalar, Memory], Memory],
    ) -> tuple[Memory, Memory]:
        """z at the turn, and z at the end corrected for its kink there (`hsed_jax.physics.laws.reversal`)."""
        return mended_force(turn, before, flow, after, rates)


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
    # The logarithm of zero would make the derivative in n a NaN; a spring never works at 1e-12 N.
    return power(jnp.maximum(magnitude, 1e-12), exponent)
