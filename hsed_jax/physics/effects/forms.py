"""Forms of an effect: the published formulas of one kind of physics, which share its place in the specimen.

A place is a slot and a driver.  Every form of an effect is the same expression with some parameters fixed, so one compiled
program serves all forms.  A parameter that is fixed at its neutral number is folded at compile time.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from hsed_jax.physics.effects.base import (
    AbstractEffect,
    AbstractSetupEffect,
    AbstractSpringEffect,
    Form,
    Setup,
    SpringPoint,
)
from hsed_jax.physics.parameters import shape_parameter, share_parameter
from hsed_jax.physics.scales import Scalar, Scales, is_number, is_zero
from hsed_jax.physics.states import (
    FATIGUE,
    LARGEST_COMPRESSION,
    LARGEST_ELONGATION,
    LARGEST_TENSION,
    REVERSALS,
    TRAVEL,
    SharedState,
)

FREE = "free"
"""The form with several free shape parameters: the same physics in a formula that is not published."""
# The characteristic number of reversals, which corresponds to the characteristic value of another driver: five cycles.
_REVERSALS = 10.0


class Driver(NamedTuple):
    """A measure of the past of a test, on which an effect depends: of order one, and not decreasing except for elastic energy.

    Attributes:
        words: its name in a sentence.
        measure: LaTeX of the dimensionless measure, the x of the equations.
        value: the measure at one instant, from the point and its own parameters.
        states: states of the spring that it reads, in addition to the absorbed energy, which every spring has.
        free: its own parameters, if it combines two measures.
    """

    words: str
    measure: str
    value: Callable[..., Scalar]
    states: tuple[SharedState, ...] = ()
    free: tuple[str, ...] = ()


def _energy(point: SpringPoint) -> Scalar:
    return point.memory["energy"] / point.scales.energy


def _dissipated(point: SpringPoint) -> Scalar:
    return (point.memory["energy"] - 0.5 * point.hysteretic**2 / point.stiffness) / point.scales.energy


def _path(point: SpringPoint) -> Scalar:
    return point.memory["travel"] * (point.scales.force / point.scales.energy)


def _largest(point: SpringPoint) -> Scalar:
    return point.memory["largest_elongation"] / point.scales.elongation


def _to_this_side(point: SpringPoint) -> Scalar:
    tension, compression = point.memory["largest_tension"], point.memory["largest_compression"]
    return jnp.where(point.hysteretic > 0, tension, compression) / point.scales.elongation


def _damage(point: SpringPoint, share: Scalar) -> Scalar:
    energy = _energy(point)
    return energy + share * (_largest(point) - energy)


def _worn_and_stretched(point: SpringPoint, share: Scalar, power: Scalar, other: Scalar) -> Scalar:
    worn = raised(_path(point), power)
    return worn + share * (raised(_largest(point), other) - worn)


def _fatigue(point: SpringPoint) -> Scalar:
    return point.memory["fatigue"] * (point.scales.force / (point.scales.energy * point.scales.elongation))


def _reversals(point: SpringPoint) -> Scalar:
    return point.memory["reversals"] / _REVERSALS


DRIVERS = {
    "energy": Driver("absorbed energy", "e/E_c", _energy),
    "path": Driver("length of the path of the elongation", "sF_c/E_c", _path, (TRAVEL,)),
    "largest_elongation": Driver(
        "largest elongation reached on either side", r"\max|\Delta u|/u_c", _largest, (LARGEST_ELONGATION,)
    ),
    "hysteretic_energy": Driver(
        "absorbed energy minus the elastic energy of the virgin element", r"(e - z^2/2k_0)/E_c", _dissipated
    ),
    "reversals": Driver("number of reversals", rf"N/{_REVERSALS:.0f}", _reversals, (REVERSALS,)),
    "fatigue": Driver(
        "sum of the squares of the elongations passed through (Coffin 1954; Miner 1945, with an exponent of two)",
        r"\int|\Delta u|\,|d\Delta u|\,F_c/E_c u_c",
        _fatigue,
        (FATIGUE,),
    ),
    "damage_index": Driver(
        "largest elongation and absorbed energy together (Park & Ang 1985)",
        r"(1-w_d)\,e/E_c + w_d\max|\Delta u|/u_c",
        _damage,
        (LARGEST_ELONGATION,),
        ("driver_share",),
    ),
    "path_and_elongation": Driver(
        "length of the path and largest elongation together, each with its own power",
        r"(1-w_d)(sF_c/E_c)^{p_s} + w_d(\max|\Delta u|/u_c)^{p_u}",
        _worn_and_stretched,
        (TRAVEL, LARGEST_ELONGATION),
        ("driver_share", "driver_power", "driver_other"),
    ),
    "excursion": Driver(
        "largest elongation on the side of the force; each side has its own damage (Lowes & Altoontash 2003)",
        r"\max(\pm\Delta u)/u_c",
        _to_this_side,
        (LARGEST_TENSION, LARGEST_COMPRESSION),
    ),
}


def raised(value: Scalar, power: Scalar) -> Scalar:
    r"""Value to a power, $|x|^p \mathrm{sign}\,x$; linear below $|x| = 10^{-9}$, because a power has no derivative at zero."""
    if is_number(power, 1):
        return value
    # What multiplies the value is one at the power of one: the same number then, whether that is known or traced.
    return value * jnp.exp((power - 1) * jnp.log(jnp.maximum(jnp.abs(value), 1e-9)))


def near_no_force(force: Scalar, width: Scalar, abruptness: Scalar = 2.0) -> Scalar:
    r"""A profile around zero force, $e^{-|z/\sigma|^m/m}/[\sigma m^{1/m}\Gamma(1 + 1/m)]$, with unit area on each side; it is
    normal for m = 2."""
    if is_number(abruptness, 2):
        return jnp.sqrt(2 / jnp.pi) * jnp.exp(-0.5 * (force / width) ** 2) / width
    m = jnp.asarray(abruptness, dtype=float)
    area = jnp.exp(jnp.log(m) / m + jax.lax.lgamma(1 + 1 / m))
    return jnp.exp(-raised(jnp.abs(force / width), abruptness) / m) / (width * area)


def one_side() -> Any:
    """The parameter that restricts a force to one direction."""
    return shape_parameter(
        "w", "to both sides (0), or in tension (1) or compression (−1) only", neutral=0.0, lower=-1.0, upper=1.0,
        prior={"uniform": [-1.0, 1.0]},
    )  # fmt: skip


def sided(value: Scalar, side: Scalar) -> Scalar:
    """A value on both sides; for ±1 on the positive or negative side only; in between, larger on one side."""
    if is_zero(side):
        return value
    share = 1 + side * jnp.sign(value)
    return value * jnp.minimum(share, 1.0)


def bend_parameter() -> Any:
    """The parameter of the saturation of a force."""
    return shape_parameter(
        "b", "how soon the growth saturates", neutral=0.0, lower=0.0, upper=50.0, prior={"half_normal": 3.0}
    )


def passing_parameter() -> Any:
    """The parameter of the growth of a force beyond its saturation."""
    return share_parameter("r", "power after saturation over the first power")


def saturated(value: Scalar, bend: Scalar, passing: Scalar = 0.0) -> Scalar:
    r"""A value that saturates, $x/(1 + b|x|)^{1-r}$: it tends to $1/b$, or grows with the power r if r > 0.

    A power $|x|^p$ becomes a power $rp$ for large x.
    """
    if is_zero(bend):
        return value
    bent = 1 + bend * jnp.abs(value)
    return value / bent if is_zero(passing) else value * jnp.exp((passing - 1) * jnp.log(bent))


@cache
def forms_of(effect: type[AbstractEffect]) -> dict[str, Form]:
    """The forms of an effect by their labels, the default one first: every shape with every driver."""
    shapes = effect.forms or (Form(),)
    drivers = effect.drivers or ("",)
    found: dict[str, Form] = {}
    for number, driver in enumerate(drivers):
        # Which driver is a parameter each, but for the first.
        held = {} if number == 0 else {chosen(number): 1.0}
        own = DRIVERS[driver].free if driver else ()
        for first, shape in enumerate(shapes):
            # One that has powers of its own needs none of the shape.
            if "driver_power" in own and "power" in shape.free:
                continue
            form = replace(
                shape,
                driver=driver if number else "",
                held={**shape.held, **held},
                free=(*shape.free, *own),
                is_default=number == first == 0,
            )
            found[form.label] = form
    return found


def default_form(effect: type[AbstractEffect]) -> Form:
    """The default form."""
    return next(iter(forms_of(effect).values()))


def chosen(number: int) -> str:
    """The name of the parameter that selects driver k, counted from 1."""
    return f"driver_{number}"


@cache
def slots_of(effect: type[AbstractEffect], form: str | None = None) -> tuple[str, ...]:
    """The slots to which an effect writes in a form, by default in the default form; found by tracing, without a computation."""
    return _slots_of_shape(effect, (forms_of(effect)[form] if form is not None else default_form(effect)).name)


@cache
def _slots_of_shape(effect: type[AbstractEffect], shape: str) -> tuple[str, ...]:
    # A driver changes the values that are written, and not the slots: one form of each shape is traced.
    one = next(form for form in forms_of(effect).values() if form.name == shape)

    def contributions(value: Scalar) -> dict[str, Any]:
        values = dict.fromkeys(one.parameters(effect), value) | dict(one.held)
        made, scales = effect(**values), Scales(*[value] * 4)
        if isinstance(made, AbstractSetupEffect):
            return made.contribute(Setup(scales, 1, 1))
        assert isinstance(made, AbstractSpringEffect)
        return made.contribute(SpringPoint(value, value, value, defaultdict(lambda: value), scales, value, value))

    return tuple(jax.eval_shape(contributions, 1.0))


@cache
def slots_of_any(effect: type[AbstractEffect]) -> tuple[str, ...]:
    """The slots to which an effect writes in any of its forms."""
    return tuple(dict.fromkeys(slot for label in forms_of(effect) for slot in slots_of(effect, label)))


@cache
def is_of_sensors(effect: type[AbstractEffect]) -> bool:
    """Whether every specimen has such an effect in its sensors."""
    if not issubclass(effect, AbstractSetupEffect):
        return False
    return not set(slots_of(effect)) & {"mass", "support", "damping", "ground_motion"}
