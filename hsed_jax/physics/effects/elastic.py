"""Elastic springs beside the hysteretic one: post-yield stiffness of several shapes, and contact."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.driven import AbstractWornEffect, heating
from hsed_jax.physics.effects.forms import FREE, bend_parameter, one_side, passing_parameter, raised, saturated, sided
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter
from hsed_jax.physics.scales import is_number, is_zero
from hsed_jax.physics.states import LARGEST_COMPRESSION, LARGEST_TENSION, SharedState

# A spring of any power, which may level off or pass to a lower power, and act to one side.
_BENT = Form(
    FREE,
    r"\delta F_c\frac{|x|^p}{(1 + b|x|^p)^{1-r}}\mathrm{sign}\,x,\ x = \Delta u/u_c,\ "
    r"\text{times } 1 - |w| \text{ on the side opposite to the sign of } w",
    free=("power", "bend", "passing", "side"),
    in_units=False,
)
# What takes more than this power of the way beyond a clearance to close is no stop, but a spring that stiffens.
_BLUNTEST = 2.5


@register
@final
class Hardening(AbstractWornEffect):
    r"""A linear spring in parallel: $\delta\,\frac{F_c}{u_c}\,\Delta u$; a negative δ is P-Δ."""

    name: ClassVar[str] = "hardening"
    family: ClassVar[str] = "post-yield"
    reference: ClassVar[str] = "Wen 1976"
    negative: ClassVar[str] = "softening, as by P-Delta"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear", r"\delta\,\frac{F_c}{u_c}\,\Delta u"),
        Form("tension only", r"\delta\,\frac{F_c}{u_c}\max(\Delta u, 0)", held={"side": 1.0}),
        Form("compression only", r"\delta\,\frac{F_c}{u_c}\min(\Delta u, 0)", held={"side": -1.0}),
        Form(
            "power",
            r"\delta F_c|\Delta u/u_c|^p\,\mathrm{sign}\,\Delta u",
            "Ludwik 1909",
            free=("power",),
            in_units=False,
        ),
        Form("saturating", r"\delta\,\frac{F_c}{u_c}\frac{\Delta u}{1 + b|\Delta u|/u_c}", free=("bend",)),
        heating(r"\delta\,\frac{F_c}{u_c}\,\Delta u\,", "Mullins 1969 (rubber that softens)", "wearing of energy"),
        _BENT,
    )

    delta: Scalar = parameter(
        r"\delta_k",
        "1",
        "post-yield stiffness over characteristic stiffness",
        neutral=0.0,
        lower=-1.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )
    side: Scalar = one_side()
    power: Scalar = shape_parameter(
        "p", "power of the elongation", neutral=1.0, lower=0.2, upper=1.5, prior={"lognormal": [-0.4, 0.4]}
    )
    bend: Scalar = bend_parameter()
    passing: Scalar = passing_parameter()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = raised(point.elongation / point.scales.elongation, self.power)
        pulled = sided(saturated(ratio, self.bend, self.passing), self.side)
        return {"force": self.delta * point.scales.force * pulled * self.lasting(point)}


@register
@final
class CubicStiffness(AbstractSpringEffect):
    r"""A cubic spring in parallel (Duffing): $\delta\,F_c\,(\Delta u/u_c)^3$."""

    name: ClassVar[str] = "cubic_stiffness"
    family: ClassVar[str] = "post-yield"
    reference: ClassVar[str] = "Duffing 1918"
    negative: ClassVar[str] = "a spring that softens"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("cubic", r"\delta F_c(\Delta u/u_c)^3"),
        Form("power", r"\delta F_c|\Delta u/u_c|^p\,\mathrm{sign}\,\Delta u", free=("power",), in_units=False),
        _BENT,
    )

    delta: Scalar = parameter(
        r"\delta_3",
        "1",
        "cubic force at the characteristic elongation over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("k3", "N/m^3", lambda scales: scales.force / scales.elongation**3),
    )
    power: Scalar = shape_parameter(
        "p", "power of the elongation", neutral=3.0, lower=1.2, upper=12.0, prior={"lognormal": [1.1, 0.5]}
    )
    bend: Scalar = bend_parameter()
    passing: Scalar = passing_parameter()
    side: Scalar = one_side()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.elongation / point.scales.elongation
        bent = ratio * ratio * ratio
        if not is_number(self.power, 3):
            bent = jnp.sign(ratio) * raised(jnp.abs(ratio), self.power)
        return {"force": self.delta * point.scales.force * sided(saturated(bent, self.bend, self.passing), self.side)}


@register
@final
class QuadraticStiffness(AbstractSpringEffect):
    r"""A quadratic spring in parallel with the same sign of force on both sides: $\delta\,F_c\,(\Delta u/u_c)^2$."""

    name: ClassVar[str] = "quadratic_stiffness"
    family: ClassVar[str] = "asymmetry"
    reference: ClassVar[str] = "Nayfeh & Mook 1979"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("quadratic", r"\delta F_c(\Delta u/u_c)^2"),
        Form("power", r"\delta F_c|\Delta u/u_c|^p", free=("power",), in_units=False),
        Form(
            FREE,
            r"\delta F_c\frac{|x|^p}{(1 + b|x|^p)^{1-r}},\ x = \Delta u/u_c",
            free=("power", "bend", "passing"),
            in_units=False,
        ),
    )

    delta: Scalar = parameter(
        r"\delta_2",
        "1",
        "quadratic force at the characteristic elongation over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("k2", "N/m^2", lambda scales: scales.force / scales.elongation**2),
    )
    power: Scalar = shape_parameter(
        "p", "power of the elongation", neutral=2.0, lower=0.5, upper=8.0, prior={"lognormal": [0.5, 0.5]}
    )
    bend: Scalar = bend_parameter()
    passing: Scalar = passing_parameter()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.elongation / point.scales.elongation
        bent = ratio * ratio if is_number(self.power, 2) else raised(jnp.abs(ratio), self.power)
        return {"force": self.delta * point.scales.force * saturated(bent, self.bend, self.passing)}


@register
@final
class ContactStiffening(AbstractSpringEffect):
    r"""A stop behind a clearance: $\delta\,\frac{F_c}{u_c}\,\mathrm{sign}(\Delta u)\max(|\Delta u| - c\,u_c, 0)$.

    A crushed stop keeps a share k of the deepest dent, and later contact starts at a larger elongation.
    """

    name: ClassVar[str] = "contact_stiffening"
    family: ClassVar[str] = "contact"
    reference: ClassVar[str] = "Anagnostopoulos 1988 (pounding)"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear", r"\delta F_c\,b,\ b = \max(|\Delta u|/u_c - c, 0)"),
        Form("hertz", r"\delta F_c\,b^{3/2}", "Hertz 1882", held={"power": 1.5}, in_units=False),
        Form("power", r"\delta F_c\,b^p", free=("power",), in_units=False),
        Form("tension only", r"\delta F_c\,b\ (\Delta u > 0)", held={"side": 1.0}),
        Form("compression only", r"\delta F_c\,b\ (\Delta u < 0)", held={"side": -1.0}),
        Form(
            "crushed",
            r"\delta F_c\,b,\ c = c_0 + k\max(\max(\pm\Delta u)/u_c - c_0, 0)",
            "Walton & Braun 1986",
            free=("kept",),
        ),
        Form(
            FREE,
            r"\delta F_c\,b^p,\ \text{times } 1 - |w| \text{ on the side opposite to the sign of } w",
            free=("power", "side"),
            in_units=False,
        ),
    )

    delta: Scalar = parameter(
        r"\delta_c",
        "1",
        "stiffness of the stop over characteristic stiffness",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )
    clearance: Scalar = parameter(
        "c",
        "1",
        "clearance over characteristic elongation",
        neutral=0.5,
        lower=0.0,
        # Without a clearance it is no stop.
        prior={"uniform": [0.1, 1.0]},
        physical=PhysicalForm("gap", "m", lambda scales: scales.elongation),
    )
    power: Scalar = shape_parameter(
        "p",
        "power of the elongation beyond the clearance",
        neutral=1.0,
        lower=0.3,
        upper=_BLUNTEST,
        prior={"lognormal": [0.3, 0.5]},
    )
    side: Scalar = one_side()
    kept: Scalar = shape_parameter(
        "k",
        "share of the deepest dent that is permanent",
        neutral=0.0,
        lower=0.0,
        upper=0.95,
        prior={"uniform": [0.0, 0.95]},
    )

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation to each side, where a dent stays."""
        return () if is_zero(self.kept) else (LARGEST_TENSION, LARGEST_COMPRESSION)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        scales, touched = point.scales, self.clearance * point.scales.elongation
        if not is_zero(self.kept):
            reached = jnp.where(
                point.elongation > 0, point.memory["largest_tension"], point.memory["largest_compression"]
            )
            touched = touched + self.kept * jnp.maximum(reached - touched, 0.0)
        beyond = jnp.maximum(jnp.abs(point.elongation) - touched, 0.0)
        bent = jnp.sign(point.elongation) * raised(beyond / scales.elongation, self.power)
        return {"force": self.delta * scales.force * sided(bent, self.side)}
