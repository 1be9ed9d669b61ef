"""Effects with a memory other than absorbed energy: the largest elongation, the length of the path, a relaxing force."""

from typing import ClassVar, final

import jax
import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.driven import AbstractDrivenEffect, index_share, power_of
from hsed_jax.physics.effects.forms import FREE, near_no_force, raised
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_zero
from hsed_jax.physics.states import LARGEST_ELONGATION, SharedState

# Creep is activated between these, as arguments of its hyperbolic sine.
_LINEAR, _FASTEST = 1e-4, 6.0


@register
@final
class Slip(AbstractDrivenEffect):
    r"""A slip-lock element in series, whose slip grows with the largest elongation.

    Its compliance is $c(z) = \sqrt{2/\pi}\,\frac{\delta\max|\Delta u|}{\sigma}e^{-z^2/2\sigma^2}$ with $\sigma = w z_u$ and the
    strength $z_u$ of the element.  δ max|Δu| is the length of slip near zero force, or $\delta u_c x$ with another driver x.
    Each form is another distribution of this length over the force.
    """

    name: ClassVar[str] = "slip"
    family: ClassVar[str] = "pinching"
    reference: ClassVar[str] = "Baber & Noori 1985; Madan, Reinhorn, Mander & Valles 1997"
    drivers: ClassVar[tuple[str, ...]] = (
        "largest_elongation",
        "energy",
        "damage_index",
        "reversals",
        "path_and_elongation",
        "excursion",
    )
    forms: ClassVar[tuple[Form, ...]] = (
        Form("gaussian"),
        Form("window", r"c(z) \propto \delta\max|\Delta u|\,e^{-|z/\sigma|^6/6}",
             "Sivaselvan & Reinhorn 2000", held={"abruptness": 6.0}),
        Form(FREE, r"c(z) \propto \delta\max(x - x_0, 0)^p\,e^{-|z/\sigma|^m/m}",
             free=("abruptness", "onset", "power")),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_{sl}",
        "1",
        "length of slip over the largest elongation reached",
        neutral=0.0,
        lower=0.0,
        upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )
    width: Scalar = parameter(
        "w", "1", "force that locks, over strength", neutral=0.1, lower=0.01, prior={"lognormal": [-2.3, 0.7]}
    )

    # Below one it has tails, and little by little locks.
    abruptness: Scalar = shape_parameter(
        "m", "how abruptly the slip locks", neutral=2.0, lower=0.5, upper=8.0, prior={"lognormal": [0.7, 0.6]}
    )
    onset: Scalar = shape_parameter(
        "x_0", "driver at which the effect begins", neutral=0.0, lower=0.0, prior={"half_normal": 0.2}
    )
    # One that hardly grows is play, from the first reversal on.
    power: Scalar = shape_parameter(
        "p", "power of the driver", neutral=1.0, lower=0.3, upper=6.0, prior={"lognormal": [0.0, 0.5]}
    )
    driver_3: Scalar = share_parameter("w_3", "share of another driver")
    driver_4: Scalar = share_parameter("w_4", "share of another driver")
    driver_5: Scalar = share_parameter("w_5", "share of another driver")
    driver_share: Scalar = index_share()
    driver_power: Scalar = power_of("p_s", "the path")
    driver_other: Scalar = power_of("p_u", "the largest elongation")

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `compliance`."""
        shape = near_no_force(point.hysteretic, self.width * point.strength, self.abruptness)
        length = raised(jnp.maximum(self.driven(point) - self.onset, 0.0), self.power) * point.scales.elongation
        return {"compliance": self.delta * length * shape}


@register
@final
class Scragging(AbstractSpringEffect):
    r"""A spring in parallel that is stiff only on first loading: $\delta F_c x\,|x/x_m|^p$, $x = \Delta u/u_c$.

    $x_m$ is the largest elongation reached on either side.  A cycle within earlier elongations has a softer spring.
    """

    name: ClassVar[str] = "scragging"
    family: ClassVar[str] = "stiffness"
    reference: ClassVar[str] = "Mullins 1969; Grant, Fenves & Whittaker 2004"

    delta: Scalar = parameter(
        r"\delta_s",
        "1",
        "stiffness on the first way over characteristic stiffness",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.5},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )
    power: Scalar = parameter(
        "p", "1", "how much softer the spring is within earlier elongations", neutral=1.0, lower=0.1, upper=8.0,
        prior={"lognormal": [0.0, 0.7]},
    )  # fmt: skip

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation."""
        return (LARGEST_ELONGATION,)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        size = jnp.abs(point.elongation)
        reached = jnp.maximum(jnp.maximum(point.memory["largest_elongation"], size), 1e-9 * point.scales.elongation)
        softened = raised(size / reached, self.power)
        return {"force": self.delta * point.scales.force * (point.elongation / point.scales.elongation) * softened}


@register
@final
class Fracture(AbstractDrivenEffect):
    r"""Part of the element is lost at a critical path: $-\delta z\,\mathrm{logistic}((s-s_c)/0.02 s_c)$.

    With another driver x the loss is at $x_c = s_c F_c u_c/E_c$, with the number $s_c$ of the table.
    """

    name: ClassVar[str] = "fracture"
    family: ClassVar[str] = "strength"
    reference: ClassVar[str] = "Manson 1953; Coffin 1954; Miner 1945 (exponent one)"
    drivers: ClassVar[tuple[str, ...]] = (
        "path",
        "energy",
        "largest_elongation",
        "fatigue",
        "hysteretic_energy",
        "damage_index",
    )
    forms: ClassVar[tuple[Form, ...]] = (
        Form("sudden"),
        Form("gradual", r"-\delta z\,\mathrm{logistic}((x - x_c)/w x_c)", free=("width",)),
    )

    delta: Scalar = parameter(
        r"\delta_b",
        "1",
        "share of the element that is lost",
        neutral=0.0,
        lower=0.0,
        upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )
    life: Scalar = parameter(
        "s_c",
        "1",
        "path to fracture over characteristic elongation",
        neutral=10.0,
        lower=0.05,
        # Of a path some, of what grows to about one in a test a part of that.
        prior={"lognormal": [0.7, 1.2]},
        physical=PhysicalForm("path", "m", lambda scales: scales.elongation),
    )
    driver_3: Scalar = share_parameter("w_3", "share of another driver")
    driver_4: Scalar = share_parameter("w_4", "share of another driver")
    driver_5: Scalar = share_parameter("w_5", "share of another driver")
    driver_share: Scalar = index_share()
    width: Scalar = shape_parameter(
        "w",
        "share of the life that the loss takes",
        neutral=0.02,
        lower=0.005,
        # What takes most of a life to be lost does not break, but degrades.
        upper=0.2,
        prior={"lognormal": [-2.0, 0.8]},
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        scales = point.scales
        # A path of u_c is so much of the characteristic one, which other drivers are measured by, too.
        used = self.driven(point) / self.life * (scales.energy / (scales.force * scales.elongation))
        return {"force": -self.delta * point.hysteretic * jax.nn.sigmoid((used - 1) / self.width)}


@register
@final
class Relaxation(AbstractSpringEffect):
    r"""A Maxwell element in parallel: $\delta q$ with $\dot q = \frac{F_c}{u_c}\Delta\dot u - q/\tau$.

    Its time constant is $\tau = t\,u_c/v_c$; explicit integration needs steps below 2.7 τ.
    """

    name: ClassVar[str] = "relaxation"
    family: ClassVar[str] = "rate"
    reference: ClassVar[str] = "Maxwell 1867"
    needs_time: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear"),
        Form(
            "power",
            r"\dot q = \frac{F_c}{u_c}\Delta\dot u - \frac{q}{\tau}\left|\frac{q}{F_c}\right|^{p-1}",
            "Norton 1929",
            free=("power",),
            in_units=False,
        ),
        Form(
            "thermally activated",
            r"\dot q = \frac{F_c}{u_c}\Delta\dot u - \frac{q}{\tau}\frac{\sinh y}{y},\ y = \min\left(a\frac{|q|}{F_c}, 6\right)",
            "Eyring 1936",
            free=("activation",),
        ),
    )

    delta: Scalar = parameter(
        r"\delta_m",
        "1",
        "stiffness of the element over characteristic stiffness",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )
    time: Scalar = parameter(
        "t",
        "1",
        "time constant over characteristic time (elongation over rate)",
        neutral=1.0,
        lower=0.05,
        prior={"lognormal": [0.0, 0.7]},
        physical=PhysicalForm("tau", "s", lambda scales: scales.elongation / scales.rate),
    )

    power: Scalar = shape_parameter(
        "p",
        "power of the force in the creep rate",
        neutral=1.0,
        lower=0.3,
        upper=5.0,
        prior={"lognormal": [0.4, 0.5]},
    )
    activation: Scalar = shape_parameter(
        "a",
        "characteristic force over that which activates creep",
        neutral=0.0,
        lower=0.0,
        upper=50.0,
        prior={"half_normal": 3.0},
    )

    @property
    def states(self) -> tuple[str, ...]:
        """The element at δ = 1."""
        # Its force is linear in δ, so that δ = 0 contributes nothing whatever the state is.
        return ("relaxing",)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        return {"force": self.delta * point.memory["relaxing"]}

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """The rate of `relaxing` [N/s]."""
        scales = point.scales
        tau = self.time * scales.elongation / scales.rate
        share = point.memory["relaxing"] / scales.force
        creep = raised(share, self.power)
        if not is_zero(self.activation):
            creep = creep * _activated(self.activation * jnp.abs(share))
        return {"relaxing": scales.force * (point.rate / scales.elongation - creep / tau)}


def _activated(y: Scalar) -> Scalar:
    """sinh(y)/y, limited to a size that explicit steps can follow."""
    at = jnp.clip(y, _LINEAR, _FASTEST)
    return jnp.where(y < _LINEAR, 1.0, jnp.sinh(at) / at)
