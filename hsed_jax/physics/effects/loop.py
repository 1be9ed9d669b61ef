"""The shape of the loop: sharpness, fullness, asymmetry, growth of strength, dependence on rate, pinching."""

from typing import Any, ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.driven import AbstractDamagedEffect, AbstractDrivenEffect
from hsed_jax.physics.effects.forms import FREE, raised
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_number, is_zero
from hsed_jax.physics.states import LARGEST_ELONGATION, SharedState

# Within so little of the strength a side goes over into the other at once.
_SHARP = 1e-9


def _whether(place: str, symbol: str, neutral: float = 1.0) -> Any:
    return share_parameter(symbol, f"share of the change in {place}", neutral)


@register
@final
class YieldSharpness(AbstractSpringEffect):
    r"""The exponent differs from the assumed one: $|z|^n \to |z|^n(|z|/z_u)^\delta$; a larger one yields more sharply.

    The strength $z_u$ of the element stays the same; with $|z|^{n+\delta}$ and the same β it would fall.  The form `free` uses at
    least $10^{-3}$ for $|z|/z_u$.
    """

    name: ClassVar[str] = "yield_sharpness"
    family: ClassVar[str] = "hysteresis"
    reference: ClassVar[str] = "Wen 1976"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("power"),
        Form(
            FREE, r"|z|^n\left[1 - w + w\max(|z|/z_u, 10^{-3})^\delta\right]", held={"of_power": 0.0}, free=("of_part",)
        ),
    )

    delta: Scalar = parameter(
        r"\delta_n",
        "1",
        "exponent minus the assumed one",
        neutral=0.0,
        lower=-0.5,
        prior={"truncated_normal": {"loc": 0.0, "scale": 1.0, "low": -0.5, "high": 6.0}},
    )

    of_power: Scalar = _whether("the power", "w_n")
    of_part: Scalar = _whether("a part with another power", "w", 1.0)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `n`: the power of |z|/z_u; or a factor on `nu`, of two powers."""
        if is_number(self.of_power, 1):
            return {"n": self.delta}
        # Below this share of the strength nothing yields.
        over = jnp.maximum(jnp.abs(point.hysteretic) / point.strength, 1e-3)
        other = (1 - self.of_power) * self.delta
        found: dict[str, Scalar] = {"nu": 1 + self.of_part * jnp.expm1(other * jnp.log(over))}
        return found if is_zero(self.of_power) else {**found, "n": self.of_power * self.delta}


@register
@final
class LoopShape(AbstractSpringEffect):
    r"""γ differs from the assumed one: $\gamma + \delta\beta$; δ > 0 makes the loop thinner on loading, δ < 0 fuller."""

    name: ClassVar[str] = "loop_shape"
    family: ClassVar[str] = "hysteresis"
    reference: ClassVar[str] = "Wen 1976"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("constant", r"\gamma + \delta\beta"),
        Form(
            FREE,
            r"\frac{\gamma + \delta\beta\,g}{1 + w_s\delta g},\ \frac{\beta}{1 + w_s\delta g},\ "
            r"g = \frac{1 - e^{-(|z|/w z_u)^p}}{1 - e^{-w^{-p}}}",
            "Sivaselvan & Reinhorn 2000 (of unloading alone)",
            free=("power", "width", "kept"),
        ),
    )

    delta: Scalar = parameter(
        r"\delta_\gamma",
        "1",
        "γ minus the assumed one, over β",
        neutral=0.0,
        lower=-0.95,
        # Up to what hardly yields on loading more than on unloading: a law of Ramberg and Osgood's kind.
        upper=20.0,
        prior={"truncated_normal": {"loc": 0.0, "scale": 1.0, "low": -0.95, "high": 20.0}},
    )

    power: Scalar = shape_parameter(
        "p", "power of the force", neutral=0.0, lower=0.0, upper=6.0, prior={"half_normal": 1.5}
    )
    width: Scalar = shape_parameter(
        "w",
        "force at which most of the change is reached, over strength",
        neutral=1.0,
        lower=0.05,
        prior={"lognormal": [0.0, 1.0]},
    )
    kept: Scalar = share_parameter("w_s", "whether the strength stays, so that only unloading changes")

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `gamma`, in units of β; where the strength is kept, a factor on `nu` as well."""
        grown = self.delta * self._grown(point)
        return {"gamma": grown} if is_zero(self.kept) else {"gamma": grown, "nu": 1 / (1 + self.kept * grown)}

    def _grown(self, point: SpringPoint) -> Scalar:
        """Its value at a force over its value at the strength."""
        if is_zero(self.power):
            return 1.0
        # The power of zero is one, at no force as well, where no γ matters.
        over = jnp.maximum(jnp.abs(point.hysteretic) / point.strength, 1e-9)
        here, at_strength = (jnp.expm1(-jnp.exp(self.power * jnp.log(x / self.width))) for x in (over, 1.0))
        return here / at_strength


@register
@final
class Asymmetry(AbstractSpringEffect):
    r"""Strength differs with the sign of the force: β and γ are multiplied by $\nu = 1 + \delta\,\mathrm{sign}\,z$."""

    name: ClassVar[str] = "asymmetry"
    family: ClassVar[str] = "asymmetry"
    reference: ClassVar[str] = "Wang & Wen 1998; Song & Der Kiureghian 2006"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("strength", r"\nu = 1 + \delta\,\mathrm{sign}\,z"),
        Form("loading", r"\gamma + \delta\beta\,(\mathrm{sign}\,z + \mathrm{sign}\,\Delta\dot u)/2", "Wang & Wen 1998",
             held={"of_strength": 0.0, "of_loading": 1.0}),
        Form("stiffness", r"1/\eta = 1 - \delta\,\mathrm{sign}\,z", "Dobson, Noori, Hou, Dimentberg & Baber 1997",
             held={"of_strength": 0.0, "of_stiffness": 1.0}),
        # Beside the element: a law of paths has no curve across a change of its stiffness at zero force.
        Form("stiffness and strength", r"r = z - \delta|z|", held={"of_strength": 0.0, "of_both": 1.0}),
        Form(FREE, r"\nu = 1 + \delta\sigma,\ 1/\eta = 1 - w_\eta\delta\sigma,\ "
             r"\gamma + w_\gamma\delta\beta\,(\sigma + \mathrm{sign}\,\Delta\dot u)/2,\ "
             r"\sigma = z/\sqrt{z^2 + (\rho z_u)^2}",
             free=("of_stiffness", "of_loading", "rounding")),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_a",
        "1",
        "relative growth of β and γ in tension, and fall in compression",
        neutral=0.0,
        lower=-0.95,
        upper=0.95,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.3, "low": -0.95, "high": 0.95}},
    )
    of_strength: Scalar = _whether("ν", r"w_\nu")
    of_loading: Scalar = _whether("γ on loading", r"w_\gamma", 0.0)
    of_stiffness: Scalar = _whether("η", r"w_\eta", 0.0)
    of_both: Scalar = _whether("the force of the element", "w_z", 0.0)
    rounding: Scalar = shape_parameter(
        r"\rho", "force over strength within which one side changes into the other", neutral=0.0, lower=0.0, upper=1.0,
        prior={"half_normal": 0.2},
    )  # fmt: skip

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `nu`, where its jump multiplies a z of zero; or an addend to `gamma` or `force`, or a factor on `eta`."""
        side = self.delta * self._side(point)
        found: dict[str, Scalar] = {}
        if not is_zero(self.of_strength):
            found["nu"] = 1 + self.of_strength * side
        if not is_zero(self.of_loading):
            found["gamma"] = self.of_loading * 0.5 * (side + self.delta * jnp.sign(point.rate))
        if not is_zero(self.of_stiffness):
            found["eta"] = 1 / (1 - self.of_stiffness * side)
        if not is_zero(self.of_both):
            found["force"] = -self.of_both * side * point.hysteretic
        return found

    def _side(self, point: SpringPoint) -> Scalar:
        """One in tension and minus one in compression."""
        if is_zero(self.rounding):
            return jnp.sign(point.hysteretic)
        return point.hysteretic / jnp.hypot(point.hysteretic, jnp.maximum(self.rounding, _SHARP) * point.strength)


@register
@final
class IsotropicHardening(AbstractDamagedEffect):
    r"""Strength grows with absorbed energy and saturates: $1/\nu = 1 + \delta\,(1-e^{-e/(wE_c)})$."""

    name: ClassVar[str] = "isotropic_hardening"
    family: ClassVar[str] = "hardening"
    reference: ClassVar[str] = "Chaboche 1986"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("saturating", r"1/\nu = 1 + \delta(1 - e^{-x/w})"),
        Form("linear", r"1/\nu = 1 + \delta x", "Hill 1950", held={"steady": 1.0, "width": 0.3}),
        Form("power", r"1/\nu = 1 + \delta x^p", "Swift 1952", held={"steady": 1.0, "width": 0.3}, free=("power",)),
        Form(FREE, r"1/\nu = 1 + \delta(1 - e^{-x^p/w})", free=("power",), in_units=False),
    )

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

    power: Scalar = shape_parameter("p", "power of the driver", neutral=1.0, lower=0.1, upper=6.0,
                                    prior={"truncated_normal": {"loc": 1.0, "scale": 1.0, "low": 0.1, "high": 6.0}})  # fmt: skip
    steady: Scalar = share_parameter("g", "whether the growth is steady")

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `nu`."""
        # Total work can dip below zero by elastic energy given back; hardening does not.
        x = raised(jnp.maximum(self.driven(point), 0.0), self.power)
        grown = -jnp.expm1(-x / self.width)
        if not is_zero(self.steady):
            grown = grown + self.steady * (x - grown)
        return {"nu": 1 / (1 + self.delta * grown)}


@register
@final
class RateDependence(AbstractSpringEffect):
    r"""Stiffness and strength grow with speed: $a = 1 + \delta\ln(1+|\Delta\dot u|/v_c)$."""

    name: ClassVar[str] = "rate_dependence"
    family: ClassVar[str] = "rate"
    reference: ClassVar[str] = "Malvar & Crawford 1998"
    needs_time: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("logarithmic", r"a = 1 + \delta\ln(1 + |\Delta\dot u|/v_c)"),
        Form("power", r"a = 1 + \delta(|\Delta\dot u|/v_c)^p", "Cowper & Symonds 1957", held={"of_power": 1.0},
             free=("power",)),
        Form("strength", r"1/\nu = 1 + \delta\ln(1 + |\Delta\dot u|/v_c)", held={"of_both": 0.0, "of_strength": 1.0}),
        Form("sliding", r"1/\nu = 1 + \delta(1 - e^{-|\Delta\dot u|/r v_c})", "Constantinou, Mokha & Reinhorn 1990",
             held={"of_both": 0.0, "of_strength": 1.0, "of_sliding": 1.0}, free=("bounding",)),
        Form(FREE, r"a = 1 + w_a\delta(|\Delta\dot u|/v_c)^p,\ 1/\nu = 1 + w_\nu\delta(|\Delta\dot u|/v_c)^p",
             held={"of_power": 1.0}, free=("power", "of_both", "of_strength")),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_r",
        "1",
        "relative growth of A at e − 1 times the characteristic rate",
        neutral=0.0,
        lower=-0.5,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.3, "low": -0.5, "high": 3.0}},
    )

    power: Scalar = shape_parameter(
        "p", "power of the rate", neutral=0.3, lower=0.05, upper=2.0, prior={"lognormal": [-1.2, 0.7]}
    )
    bounding: Scalar = shape_parameter(
        "r", "rate over characteristic rate at which most of a bounded growth is reached", neutral=0.3, lower=0.01,
        prior={"lognormal": [-1.2, 1.0]},
    )  # fmt: skip
    of_power: Scalar = share_parameter("w_p", "whether the growth is a power")
    of_sliding: Scalar = share_parameter("w_b", "whether the growth has a bound")
    of_both: Scalar = _whether("a", "w_a")
    of_strength: Scalar = _whether("ν", r"w_\nu", 0.0)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `a`, or on `nu`."""
        speed = jnp.abs(point.rate) / point.scales.rate
        grown = jnp.log1p(speed)
        if not is_zero(self.of_power):
            grown = grown + self.of_power * (raised(speed, self.power) - grown)
        if not is_zero(self.of_sliding):
            grown = grown - self.of_sliding * (jnp.expm1(-speed / self.bounding) + grown)
        found: dict[str, Scalar] = {}
        if not is_zero(self.of_both):
            found["a"] = 1 + self.of_both * self.delta * grown
        if not is_zero(self.of_strength):
            found["nu"] = 1 / (1 + self.of_strength * self.delta * grown)
        return found


@register
@final
class Pinching(AbstractDrivenEffect):
    r"""The loop narrows near zero force, and more so as energy is absorbed.

    $$h = 1-\zeta_1\exp\!\Big(-\frac{(z\,\mathrm{sign}\,\Delta\dot u - q z_u)^2}{\zeta_2^2 z_u^2}\Big),\quad
      \zeta_1 = \zeta_s(1-e^{-p e/E_c}),\quad \zeta_2 = (\psi_0+\delta_\psi e/E_c)(\lambda+\zeta_1)$$

    with the strength $z_u$ of the element, which makes ζ₂ dimensionless, and the driver $x = e/E_c$.  In the form where the
    tangent drops around zero elongation, max|Δu| is increased by $10^{-3} u_c$, because it is zero in a virgin specimen.
    """

    name: ClassVar[str] = "pinching"
    family: ClassVar[str] = "pinching"
    reference: ClassVar[str] = "Baber & Noori 1985; Foliente 1995"
    drivers: ClassVar[tuple[str, ...]] = ("energy", "largest_elongation", "reversals", "excursion")
    forms: ClassVar[tuple[Form, ...]] = (
        Form("foliente"),
        Form("gaussian", r"h = 1 - \zeta_s(1 - e^{-px})\exp(-(z/\psi_0 z_u)^2)", "Baber & Noori 1985",
             held={"q": 0.0, "spread": 0.0, "ratio": 1.0, "widening": 0.0}),
        Form("window", r"h = 1 - \zeta_s(1 - e^{-px})\exp(-(z/\psi_0 z_u)^6)", "Sivaselvan & Reinhorn 2000",
             held={"q": 0.0, "spread": 0.0, "ratio": 1.0, "widening": 0.0, "flatness": 3.0}),
        Form("elongation", r"h = 1 - \zeta_s(1 - e^{-px})\exp(-(\Delta u/\psi_0 \max|\Delta u|)^2)",
             "Lowes & Altoontash 2003",
             held={"q": 0.0, "spread": 0.0, "ratio": 1.0, "widening": 0.0, "of_elongation": 1.0}),
        Form(FREE, r"h = 1 - \zeta_s(1 - e^{-px^k})\exp(-(y/\psi_0)^{2m}),\ "
             r"y = (1 - w_u)(z\,\mathrm{sign}\,\Delta\dot u/z_u - q) + w_u\Delta u/\max|\Delta u|",
             held={"spread": 0.0, "ratio": 1.0, "widening": 0.0}, free=("flatness", "of_elongation", "power")),
    )  # fmt: skip

    zeta: Scalar = parameter(
        r"\zeta_s", "1", "severity of pinching", neutral=0.0, lower=0.0, upper=0.99, prior={"uniform": [0.0, 0.99]}
    )
    p: Scalar = parameter(
        "p",
        "1",
        "how soon pinching develops, per characteristic energy",
        neutral=5.0,
        lower=0.0,
        prior={"lognormal": [1.6, 1.0]},
    )
    q: Scalar = parameter(
        "q", "1", "centre over strength", neutral=0.0, lower=-0.3, upper=0.3, prior={"uniform": [-0.2, 0.3]}
    )
    # What softens most of the loop is a loss of stiffness.
    psi: Scalar = parameter(
        r"\psi_0", "1", "width", neutral=0.3, lower=0.01, upper=0.4, prior={"lognormal": [-1.2, 0.7]}
    )
    spread: Scalar = parameter(
        r"\delta_\psi",
        "1",
        "growth of the width per characteristic energy",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.1},
    )
    ratio: Scalar = parameter(
        r"\lambda", "1", "share of the width that is independent of the severity", neutral=0.5, lower=0.01, upper=1.0,
        prior={"lognormal": [-0.7, 0.5]},
    )  # fmt: skip

    driver_3: Scalar = share_parameter("w_3", "share of another driver")
    widening: Scalar = share_parameter(r"w_\zeta", "whether the width grows with the severity", neutral=1.0)
    flatness: Scalar = shape_parameter(
        "m", "how flat and sharp the window is", neutral=1.0, lower=0.3, upper=4.0,
        prior={"truncated_normal": {"loc": 1.0, "scale": 1.0, "low": 0.3, "high": 4.0}},
    )  # fmt: skip
    power: Scalar = shape_parameter("k", "power of the driver", neutral=1.0, lower=0.2, upper=6.0,
                                    prior={"lognormal": [0.0, 0.5]})  # fmt: skip
    of_elongation: Scalar = share_parameter("w_u", "whether the tangent drops around zero elongation")

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The states of its driver, and the largest elongation where that is the measure of elongation."""
        return super().needs if is_zero(self.of_elongation) else (*super().needs, LARGEST_ELONGATION)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `h`."""
        worked = jnp.maximum(self.driven(point), 0.0)
        severity = self.zeta * -jnp.expm1(-self.p * raised(worked, self.power))
        width = (self.psi + self.spread * worked) * (self.ratio + self.widening * severity)
        place = point.hysteretic * jnp.sign(point.rate) / point.strength - self.q
        if not is_zero(self.of_elongation):
            largest = point.memory["largest_elongation"] + 1e-3 * point.scales.elongation
            place = place + self.of_elongation * (point.elongation / largest - place)
        return {"h": 1 - severity * jnp.exp(-raised((place / width) ** 2, self.flatness))}
