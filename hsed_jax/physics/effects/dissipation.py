"""Forces against the motion: dampers and friction beside the hysteretic spring."""

from typing import Any, ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.bristles import AbstractBristledEffect
from hsed_jax.physics.effects.driven import AbstractWornEffect, heating, wearing
from hsed_jax.physics.effects.forms import FREE, bend_parameter, one_side, raised, saturated, sided
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_zero

# Friction turns over within this share of the characteristic rate: a jump would stall any integrator.
_STICKING = 0.02
# A force that takes a larger share of it to turn over follows the rate: that of a damper.
_SLOWEST = 0.1
# Friction falls at so many times the rate at which it turns over, or more.
_SLID = 3.0


def _sticking() -> Any:
    """The parameter of the transition of friction at a reversal."""
    return shape_parameter(
        "w", "rate at which the force changes sign, over characteristic rate", neutral=_STICKING, lower=0.005,
        upper=_SLOWEST, prior={"lognormal": [-3.5, 0.7]},
    )  # fmt: skip


def _length() -> Any:
    """The parameter that is the length of a bristle."""
    return shape_parameter(
        "b", "elongation at which it slides, over characteristic elongation", neutral=0.05, lower=0.0005,
        prior={"lognormal": [-3.0, 0.8]},
    )  # fmt: skip


def _whether_of_bristle() -> Any:
    return share_parameter("w_b", "whether the force is that of a bristle")


@register
@final
class ViscousDamping(AbstractWornEffect):
    r"""A linear dashpot in parallel: $\delta\,F_c\,\Delta\dot u/v_c$."""

    name: ClassVar[str] = "viscous_damping"
    family: ClassVar[str] = "damping"
    reference: ClassVar[str] = "Chopra 2017, section 1.4"
    needs_time: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear", r"\delta F_c\,\Delta\dot u/v_c"),
        Form("of elongation", r"\delta F_c\,(|\Delta u|/u_c)\,\Delta\dot u/v_c", "Inaudi & Kelly 1995",
             held={"of_elongation": 1.0}, in_units=False),
        Form("thinning", r"\delta F_c\frac{\Delta\dot u/v_c}{1 + b|\Delta\dot u|/v_c},\ b \le 1/2",
             "Cross 1965 (oil that thins)", free=("bend",)),
        Form("opening only", r"\delta F_c\max(\Delta\dot u, 0)/v_c", held={"side": 1.0}),
        Form("closing only", r"\delta F_c\min(\Delta\dot u, 0)/v_c", held={"side": -1.0}),
        Form(FREE, r"\delta F_c\left(1 - w_u + w_u|\Delta u|/u_c\right)\Delta\dot u/v_c,\ "
             r"\text{times } 1 - |w| \text{ one way}", free=("side", "of_elongation"), in_units=False),
        heating(r"\delta F_c(\Delta\dot u/v_c)", "Black & Makris 2007 (oil that warms)"),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_v",
        "1",
        "viscous force at the characteristic rate over the characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("c", "N*s/m", lambda scales: scales.force / scales.rate),
    )
    side: Scalar = one_side()
    bend: Scalar = shape_parameter(
        "b",
        "how soon the force grows more slowly than the rate",
        neutral=0.0,
        lower=0.0,
        # One that thins more is a power damper.
        upper=0.5,
        prior={"half_normal": 0.3},
    )
    of_elongation: Scalar = share_parameter("w_u", "whether the force is proportional to the elongation too")

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        rate = sided(saturated(point.rate / point.scales.rate, self.bend), self.side)
        if not is_zero(self.of_elongation):
            rate = rate * (1 + self.of_elongation * (jnp.abs(point.elongation) / point.scales.elongation - 1))
        return {"force": self.delta * point.scales.force * rate * self.lasting(point)}


@register
@final
class QuadraticDamping(AbstractSpringEffect):
    r"""Drag, quadratic in the rate: $\delta\,F_c\,|\Delta\dot u|\Delta\dot u/v_c^2$."""

    name: ClassVar[str] = "quadratic_damping"
    family: ClassVar[str] = "damping"
    reference: ClassVar[str] = "Nayfeh & Mook 1979"
    needs_time: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("quadratic", r"\delta F_c|\Delta\dot u|\Delta\dot u/v_c^2"),
        Form("power", r"\delta F_c|\Delta\dot u/v_c|^p\,\mathrm{sign}\,\Delta\dot u,\ p > 1", "Symans & Constantinou 1998",
             free=("power",), in_units=False),
        Form("opening only", r"\delta F_c\max(\Delta\dot u, 0)^2/v_c^2", held={"side": 1.0}),
        Form("closing only", r"-\delta F_c\min(\Delta\dot u, 0)^2/v_c^2", held={"side": -1.0}),
        Form(FREE, r"\delta F_c\,x\,(1 + b\,x)^{(1-r)(1/p-1)}\,\mathrm{sign}\,\Delta\dot u,\ x = |\Delta\dot u/v_c|^p,\ "
             r"\text{times } 1 - |w| \text{ one way}", free=("power", "bend", "passing", "side"), in_units=False),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_d",
        "1",
        "drag at the characteristic rate over the characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("c2", "N*s^2/m^2", lambda scales: scales.force / scales.rate**2),
    )
    power: Scalar = shape_parameter(
        "p", "power of the rate", neutral=2.0, lower=1.1, upper=6.0, prior={"lognormal": [0.6, 0.4]}
    )
    bend: Scalar = bend_parameter()
    passing: Scalar = share_parameter("r", "growth after saturation: linear (0), or as before (1)")
    side: Scalar = one_side()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.rate / point.scales.rate
        drag = ratio * raised(jnp.abs(ratio), self.power - 1)
        # Its power is nowhere less than one: a damper that flattens is another effect.
        going_on = self.passing + (1 - self.passing) / self.power
        drag = sided(saturated(drag, self.bend, going_on), self.side)
        return {"force": self.delta * point.scales.force * drag}


@register
@final
class PowerDamping(AbstractWornEffect):
    r"""A fluid damper in parallel: $\delta\,F_c\,|\Delta\dot u/v_c|^\alpha\,\mathrm{sign}\,\Delta\dot u$.

    Below $10^{-3} v_c$ it is linear, because the power has no derivative at rest.
    """

    name: ClassVar[str] = "power_damping"
    family: ClassVar[str] = "damping"
    reference: ClassVar[str] = "Symans & Constantinou 1998"
    needs_time: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("power"),
        Form(FREE, r"\delta F_c\,x\left[r + (1 - r)\left(1 + (b\,x)^m\right)^{-1/m}\right]\mathrm{sign}\,\Delta\dot u,\ "
             r"x = |\Delta\dot u/v_c|^\alpha,\ \text{times } 1 - |w| \text{ one way}",
             "JSSI 2005 (oil dampers whose valve opens)", free=("bend", "passing", "abruptness", "side"), in_units=False),
        heating(r"\delta F_c|\Delta\dot u/v_c|^\alpha\,\mathrm{sign}\,\Delta\dot u\,", "Black & Makris 2007 (oil that warms)"),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_\alpha",
        "1",
        "force at the characteristic rate over the characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )
    alpha: Scalar = parameter(
        r"\alpha", "1", "exponent of the rate", neutral=0.5, lower=0.1, upper=2.0, prior={"uniform": [0.1, 1.0]}
    )
    bend: Scalar = bend_parameter()
    passing: Scalar = share_parameter("r", "share that grows as before after saturation")
    abruptness: Scalar = shape_parameter(
        "m", "how abruptly the growth saturates", neutral=1.0, lower=0.5, upper=12.0, prior={"lognormal": [0.4, 0.7]}
    )
    side: Scalar = one_side()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.rate / point.scales.rate
        # |v|^α has no derivative at rest; below this rate it is linear.
        size = jnp.maximum(jnp.abs(ratio), 1e-3)
        drag = jnp.exp((self.alpha - 1) * jnp.log(size)) * ratio
        if not is_zero(self.bend):
            bent = jnp.exp(-jnp.log1p(raised(self.bend * jnp.abs(drag), self.abruptness)) / self.abruptness)
            drag = drag * (self.passing + (1 - self.passing) * bent)
        drag = sided(drag, self.side)
        return {"force": self.delta * point.scales.force * drag * self.lasting(point)}


@register
@final
class CoulombFriction(AbstractBristledEffect, AbstractWornEffect):
    r"""Dry friction in parallel: $\delta\,F_c\,\tanh(\Delta\dot u/v_s)$, $v_s = 0.02\,v_c$.

    The form of a bristle is $\delta F_c q$, $dq/d\Delta u = (1 - q\,\mathrm{sign}\,\Delta\dot u)/b u_c$: a spring until it
    slides.
    """

    name: ClassVar[str] = "coulomb_friction"
    family: ClassVar[str] = "friction"
    reference: ClassVar[str] = "Coulomb 1785"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("sharp"),
        Form("regularised", r"\delta F_c\tanh(\Delta\dot u/w v_c)", free=("sticking",)),
        Form("bristle", r"\delta F_c q,\ dq/d\Delta u = (1 - q\,\mathrm{sign}\,\Delta\dot u)/b u_c", "Dahl 1968",
             held={"of_bristle": 1.0}, free=("bristle",)),
        Form(FREE, r"\delta F_c\tanh(|\Delta\dot u/w v_c|^p)\,\mathrm{sign}\,\Delta\dot u", free=("sticking", "roundness")),
        wearing(r"\delta F_c\tanh(\Delta\dot u/v_s)", "Mokha, Constantinou & Reinhorn 1990"),
        heating(r"\delta F_c\tanh(\Delta\dot u/v_s)", "Lomiento, Bonessio & Benzoni 2013"),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_f",
        "1",
        "friction force over characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )
    sticking: Scalar = _sticking()
    roundness: Scalar = shape_parameter(
        "p",
        "power of the rate in this change of sign",
        neutral=1.0,
        lower=0.6,
        upper=3.0,
        prior={"lognormal": [0.0, 0.4]},
    )
    bristle: Scalar = _length()
    of_bristle: Scalar = _whether_of_bristle()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        slid = jnp.tanh(raised(point.rate / (self.sticking * point.scales.rate), self.roundness))
        if not is_zero(self.of_bristle):
            slid = slid + self.of_bristle * (self.bent(point) - slid)
        return {"force": self.delta * point.scales.force * slid * self.lasting(point)}


@register
@final
class StribeckFriction(AbstractBristledEffect):
    r"""Friction that falls with speed: $\delta\,F_c\,[\mu + (1-\mu)e^{-|\Delta\dot u|/v_r}]\tanh(\Delta\dot u/v_s)$.

    $v_s = 0.02\,v_c$ and $v_r = 0.2\,v_c$; the share μ remains at high speed.  The form of a bristle is $\delta F_c q$; at
    constant speed q tends to the expression in brackets.
    """

    name: ClassVar[str] = "stribeck_friction"
    family: ClassVar[str] = "friction"
    reference: ClassVar[str] = "Constantinou, Mokha & Reinhorn 1990"
    needs_time: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("exponential"),
        Form("of any speed", r"v_r = \max(r, 0.06)\,v_c", free=("falling",)),
        Form(
            "bristle",
            r"\delta F_c q,\ dq/d\Delta u = (1 - q\,\mathrm{sign}\,\Delta\dot u/[\ldots])/b u_c,\ v_r = \max(r, 0.06)\,v_c",
            "Canudas de Wit, Olsson, Åström & Lischinsky 1995 (LuGre)",
            held={"of_bristle": 1.0},
            free=("falling", "bristle"),
        ),
        Form(
            FREE,
            r"\delta F_c\left[\mu + (1-\mu)e^{-(|\Delta\dot u|/r v_c)^m}\right]\tanh(\Delta\dot u/w v_c),\ r \ge 3w",
            "Bo & Pavelescu 1982",
            free=("falling", "steepness", "sticking"),
        ),
    )

    delta: Scalar = parameter(
        r"\delta_s",
        "1",
        "friction force at low speed over characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )
    remaining: Scalar = parameter(
        r"\mu",
        "1",
        "share that remains at high speed",
        neutral=0.5,
        lower=0.0,
        upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )
    falling: Scalar = shape_parameter(
        "r", "speed at which the force falls, over characteristic rate", neutral=0.2, lower=0.02,
        prior={"lognormal": [-1.6, 0.8]},
    )  # fmt: skip
    steepness: Scalar = shape_parameter(
        "m", "power of the speed in the fall", neutral=1.0, lower=0.3, upper=4.0, prior={"lognormal": [0.0, 0.5]}
    )
    sticking: Scalar = _sticking()
    bristle: Scalar = _length()
    of_bristle: Scalar = _whether_of_bristle()

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        slid = self.slides_at(point) * jnp.tanh(point.rate / (self.sticking * point.scales.rate))
        if not is_zero(self.of_bristle):
            slid = slid + self.of_bristle * (self.bent(point) - slid)
        return {"force": self.delta * point.scales.force * slid}

    def slides_at(self, point: SpringPoint) -> Scalar:
        """The share of the static friction that remains."""
        # What falls before it slides is friction that turns over slowly.
        falling = jnp.maximum(self.falling, _SLID * self.sticking)
        speed = jnp.abs(point.rate) / point.scales.rate
        return self.remaining + (1 - self.remaining) * jnp.exp(-raised(speed / falling, self.steepness))
