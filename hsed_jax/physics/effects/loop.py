"""The shape of the loop: sharpness, fullness, asymmetry, growth of strength, dependence on rate, pinching."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import PhysicalForm, parameter


@register
@final
class YieldSharpness(AbstractSpringEffect):
    r"""The exponent differs from the assumed one: $|z|^n \to |z|^n(|z|/z_u)^\delta$; a larger one yields more sharply.

    $z_u$ is the strength of the element, which stays: with $|z|^{n+\delta}$ and the same β the strength would fall, too.
    """

    name: ClassVar[str] = "yield_sharpness"
    family: ClassVar[str] = "hysteresis"
    reference: ClassVar[str] = "Wen 1976"

    delta: Scalar = parameter(
        r"\delta_n",
        "1",
        "exponent less the assumed one",
        neutral=0.0,
        lower=-0.5,
        prior={"truncated_normal": {"loc": 0.0, "scale": 1.0, "low": -0.5, "high": 6.0}},
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `n`: the power of |z|/z_u."""
        return {"n": self.delta}


@register
@final
class LoopShape(AbstractSpringEffect):
    r"""γ differs from the assumed one: $\gamma + \delta\beta$; positive makes the loop thinner on loading, negative fuller."""

    name: ClassVar[str] = "loop_shape"
    family: ClassVar[str] = "hysteresis"
    reference: ClassVar[str] = "Wen 1976"

    delta: Scalar = parameter(
        r"\delta_\gamma",
        "1",
        "γ less the assumed one, over β",
        neutral=0.0,
        lower=-0.95,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.5, "low": -0.95, "high": 4.0}},
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `gamma`, in units of β."""
        return {"gamma": self.delta}


@register
@final
class Asymmetry(AbstractSpringEffect):
    r"""β and γ differ with the sign of the force: $\nu = 1 + \delta\,\mathrm{sign}\,z$."""

    name: ClassVar[str] = "asymmetry"
    family: ClassVar[str] = "asymmetry"
    reference: ClassVar[str] = "Wang & Wen 1998; Song & Der Kiureghian 2006"

    delta: Scalar = parameter(
        r"\delta_a",
        "1",
        "relative growth of β and γ in tension, and fall in compression",
        neutral=0.0,
        lower=-0.95,
        upper=0.95,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.3, "low": -0.95, "high": 0.95}},
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `nu`; where z passes zero it multiplies zero, so its jump does no harm."""
        return {"nu": 1 + self.delta * jnp.sign(point.hysteretic)}


@register
@final
class IsotropicHardening(AbstractSpringEffect):
    r"""Strength grows with absorbed energy and saturates: $1/\nu = 1 + \delta\,(1-e^{-e/(wE_c)})$."""

    name: ClassVar[str] = "isotropic_hardening"
    family: ClassVar[str] = "hardening"
    reference: ClassVar[str] = "Chaboche 1986"

    delta: Scalar = parameter(
        r"\delta_i",
        "1",
        "relative growth of strength at saturation",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.5},
    )
    width: Scalar = parameter(
        "w",
        "1",
        "energy of saturation over characteristic energy",
        neutral=0.3,
        lower=0.01,
        prior={"lognormal": [-1.2, 1.0]},
        physical=PhysicalForm("energy", "J", lambda scales: scales.energy),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `nu`."""
        # Total work can dip below zero by elastic energy given back; hardening does not.
        worked = jnp.maximum(point.memory["energy"], 0.0) / (self.width * point.scales.energy)
        return {"nu": 1 / (1 + self.delta * -jnp.expm1(-worked))}


@register
@final
class RateDependence(AbstractSpringEffect):
    r"""Stiffness, and with it strength, grows with speed: $a = 1 + \delta\ln(1+|\Delta\dot u|/v_c)$."""

    name: ClassVar[str] = "rate_dependence"
    family: ClassVar[str] = "rate"
    reference: ClassVar[str] = "Malvar & Crawford 1998"
    needs_time: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_r",
        "1",
        "relative growth of A at e − 1 times the characteristic rate",
        neutral=0.0,
        lower=-0.5,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.3, "low": -0.5, "high": 3.0}},
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `a`."""
        return {"a": 1 + self.delta * jnp.log1p(jnp.abs(point.rate) / point.scales.rate)}


@register
@final
class Pinching(AbstractSpringEffect):
    r"""The loop narrows near zero force, more so as energy is absorbed.

    $$h = 1-\zeta_1\exp\!\Big(-\frac{(z\,\mathrm{sign}\,\Delta\dot u - q z_u)^2}{\zeta_2^2 z_u^2}\Big),\quad
      \zeta_1 = \zeta_s(1-e^{-p e/E_c}),\quad \zeta_2 = (\psi_0+\delta_\psi e/E_c)(\lambda+\zeta_1)$$

    with $z_u$ the strength of the element; ζ₂ is made dimensionless by it.
    """

    name: ClassVar[str] = "pinching"
    family: ClassVar[str] = "pinching"
    reference: ClassVar[str] = "Baber & Noori 1985; Foliente 1995"

    zeta: Scalar = parameter(
        r"\zeta_s", "1", "severity of pinching", neutral=0.0, lower=0.0, upper=0.99, prior={"uniform": [0.0, 0.99]}
    )
    p: Scalar = parameter(
        "p",
        "1",
        "how soon it develops, per characteristic energy",
        neutral=5.0,
        lower=0.0,
        prior={"lognormal": [1.6, 1.0]},
    )
    q: Scalar = parameter(
        "q", "1", "centre over strength", neutral=0.0, lower=-0.5, upper=0.8, prior={"uniform": [-0.2, 0.5]}
    )
    psi: Scalar = parameter(r"\psi_0", "1", "width", neutral=0.3, lower=0.01, prior={"lognormal": [-1.2, 0.7]})
    spread: Scalar = parameter(
        r"\delta_\psi",
        "1",
        "growth of the width per characteristic energy",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.1},
    )
    ratio: Scalar = parameter(
        r"\lambda", "1", "share of the width that does not wait for the severity", neutral=0.5, lower=0.01,
        prior={"lognormal": [-0.7, 0.5]},
    )  # fmt: skip

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `h`."""
        worked = jnp.maximum(point.memory["energy"], 0.0) / point.scales.energy
        severity = self.zeta * -jnp.expm1(-self.p * worked)
        width = (self.psi + self.spread * worked) * (self.ratio + severity)
        place = point.hysteretic * jnp.sign(point.rate) / point.strength - self.q
        return {"h": 1 - severity * jnp.exp(-((place / width) ** 2))}
