"""Degradation: stiffness, strength or both decrease with a driver."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.driven import AbstractDamagedEffect
from hsed_jax.physics.effects.forms import FREE, raised
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_zero

# Far beyond anything that is left of a specimen.
_GONE = 30.0
# What takes more than a hundred times the characteristic driver does not saturate.
_SOON = 0.01


class AbstractDegradation(AbstractDamagedEffect):
    r"""A factor that grows from one with a driver x: $1 + [e^{\kappa y} - 1]/\kappa$, $y = \delta\max(x - x_0, 0)^p$.

    κ = g − s is zero for linear growth, one for exponential, and where it is negative the factor ends at 1 + 1/|κ|.
    """

    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear", r"1 + \delta x", "Baber & Wen 1981"),
        Form("exponential", r"e^{\delta x}", "Sucuoglu & Erberik 2004", held={"growth": 1.0}),
        Form("saturating", r"1 + (1 - e^{-s\delta x})/s", "FEMA P-440A 2009 (what remains)",
             free=("saturation",)),
        Form("power", r"1 + \delta x^p", "Park & Ang 1985; Kunnath, Mander & Fang 1997", free=("power",),
             in_units=False),
        Form("threshold", r"1 + \delta\max(x - x_0, 0)", "Ibarra, Medina & Krawinkler 2005 (onset)", free=("onset",)),
        Form(FREE, r"1 + \delta\,\frac{1 - e^{-(qy)^p}}{1 - e^{-q^p}},\ y = \max(x - x_0, 0);\ "
             r"1 + \delta y^p\text{ for }q < 0.01",
             free=("soonness", "power", "onset"), in_units=False),
    )  # fmt: skip

    growth: Scalar = share_parameter("g", "whether the growth is exponential")
    saturation: Scalar = shape_parameter(
        "s", "inverse of the largest gain", neutral=0.0, lower=0.0, prior={"half_normal": 1.5}
    )
    power: Scalar = shape_parameter("p", "power of the driver", neutral=1.0, lower=0.1, upper=6.0,
                                    prior={"truncated_normal": {"loc": 1.0, "scale": 1.0, "low": 0.1, "high": 6.0}})  # fmt: skip
    soonness: Scalar = shape_parameter(
        "q", "inverse of the driver at which two thirds are reached", neutral=0.0, lower=0.0, upper=50.0,
        prior={"half_normal": 3.0},
    )  # fmt: skip
    onset: Scalar = shape_parameter(
        "x_0", "driver at which the effect begins", neutral=0.0, lower=0.0, prior={"half_normal": 0.4}
    )

    def factor(self, delta: Scalar, point: SpringPoint) -> Scalar:
        """The factor of an amplitude δ at one instant."""
        x, curvature = self.driven(point), self.growth - self.saturation
        if not is_zero(self.onset):
            # Energy can dip below zero by elastic energy given back; there the onset changes nothing.
            x = jnp.maximum(x - self.onset, 0.0) + jnp.minimum(x, 0.0)
        y = delta * self._come(x)
        if is_zero(curvature):
            return 1 + y
        is_straight = jnp.abs(curvature) < 1e-6
        bent = jnp.where(is_straight, 1.0, curvature)
        return 1 + jnp.where(is_straight, y, (jnp.exp(jnp.minimum(bent * y, _GONE)) - 1) / bent)

    def _come(self, x: Scalar) -> Scalar:
        """The growth at a driver x over that at x = 1: a power that may saturate."""
        power = raised(x, self.power)
        if is_zero(self.soonness):
            return power
        soon = jnp.maximum(self.soonness, _SOON)
        come, at_one = (-jnp.expm1(-raised(soon * at, self.power)) for at in (x, 1.0))
        return jnp.where(self.soonness < _SOON, power, come / at_one)


@register
@final
class StiffnessDegradation(AbstractDegradation):
    r"""Stiffness falls with absorbed energy: $\eta = 1 + \delta\,e/E_c$, and $\dot z \propto 1/\eta$.

    In the units of the paper $\eta_{ref} = \delta/E_c$ [1/J] (Eq. 15), with e = ∫ r dΔu, the total work of the spring.
    """

    name: ClassVar[str] = "stiffness_degradation"
    family: ClassVar[str] = "stiffness"
    reference: ClassVar[str] = "Baber & Wen 1981; Abbiati & Marelli, Eq. 15"

    delta: Scalar = parameter(
        r"\delta_\eta",
        "1",
        "relative loss of stiffness at the characteristic energy",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("eta", "1/J", lambda scales: 1 / scales.energy),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `eta`."""
        return {"eta": self.factor(self.delta, point)}


@register
@final
class StrengthDegradation(AbstractDegradation):
    r"""Strength falls with absorbed energy: $\nu = 1 + \delta\,e/E_c$ multiplies β and γ.

    The ultimate force of the element is $[A/(\nu(\beta+\gamma))]^{1/n}$.
    """

    name: ClassVar[str] = "strength_degradation"
    family: ClassVar[str] = "strength"
    reference: ClassVar[str] = "Baber & Wen 1981"

    delta: Scalar = parameter(
        r"\delta_\nu",
        "1",
        "relative growth of β and γ at the characteristic energy",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("nu", "1/J", lambda scales: 1 / scales.energy),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `nu`."""
        return {"nu": self.factor(self.delta, point)}


@register
@final
class PeakSoftening(AbstractDegradation):
    r"""Stiffness and strength fall with the largest elongation reached: $a = 1/(1+\delta\max|\Delta u|/u_c)$."""

    name: ClassVar[str] = "peak_softening"
    family: ClassVar[str] = "stiffness"
    reference: ClassVar[str] = "Park & Ang 1985"
    drivers: ClassVar[tuple[str, ...]] = ("largest_elongation", "excursion")

    delta: Scalar = parameter(
        r"\delta_p",
        "1",
        "relative loss of stiffness at the characteristic elongation",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("softening", "1/m", lambda scales: 1 / scales.elongation),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `a`."""
        return {"a": 1 / self.factor(self.delta, point)}
