r"""Measured and predicted outputs, channels and quantities: the only list of either.

A further quantity is one entry of `QUANTITIES`: symbol, unit and meaning, its formula from a record, and how the integration
keeps it.  Campaigns, studies and reports can then use it.

If a structure has several specimens, the name of a specimen precedes its outputs: `storey2.force`, `storey2.peak_force`.

Peaks in a simulation are those of the continuous response.  Between the ends of a step of length h, the work is the cubic
(Hermite) of the work e and the power $r\,\Delta\dot u$ at both ends.
"""

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hsed_jax.physics.names import SPECIMEN, named, own_name, owner_of

if TYPE_CHECKING:
    from hsed_jax.physics.steps import Step

Scalar = Any
Channels = Mapping[str, np.ndarray]
_FORCE, _ELONGATION = ("force_gain",), ("elongation_gain",)


@dataclass(frozen=True)
class Output:
    """A channel (a history) or a quantity (one number per experiment).

    Attributes:
        symbol: in LaTeX.
        unit: SI.
        meaning: in words.
        gains: slots of the test rig whose product multiplies it in the measurement.
        is_strength: whether a larger value means a stronger specimen instead of a larger motion.
        of_specimen: whether every specimen of a structure has one.
    """

    symbol: str
    unit: str
    meaning: str
    gains: tuple[str, ...] = ()
    is_strength: bool = False
    of_specimen: bool = True


class Kept(NamedTuple):
    """The computation of a quantity during an integration.

    Attributes:
        start: numbers that travel with the integration, at its start.
        after: those numbers after a step, from those before it.
        value: the quantity, from those numbers and the memory of its specimen at the end.
    """

    start: tuple[float, ...]
    after: Callable[[tuple[Scalar, ...], "Step"], tuple[Scalar, ...]]
    value: Callable[[tuple[Scalar, ...], Mapping[str, Scalar]], Scalar]


@dataclass(frozen=True)
class Quantity(Output):
    """One number per experiment.

    Attributes:
        channels: of a record that determine it, from the number of masses; empty if it cannot be determined.
        measured: from the time (n,) [s] and those channels, each (n,) [SI]; NaN if the record does not determine it.
        kept: its computation during an integration.
        is_signed: whether it may be negative, or zero; its error cannot be relative.
        until: least duration of the experiment [s].
        limit: its key in `design.limits`, where it has one.
    """

    _: KW_ONLY
    channels: Callable[[int], tuple[str, ...]]
    measured: Callable[[np.ndarray, Channels], float]
    kept: Kept
    is_signed: bool = False
    until: float = 0.0
    limit: str | None = None


def _largest(of: Callable[["Step"], Scalar]) -> Kept:
    """The largest magnitude."""

    def after(kept: tuple[Scalar, ...], step: "Step") -> tuple[Scalar, ...]:
        import jax.numpy as jnp  # imported here: reading a campaign needs no JAX

        # `maximum` would split the derivative at a tie, which costs time.  A NaN passes through here, too.
        largest, value = kept[0], jnp.abs(of(step))
        return (jnp.where(value <= largest, largest, value),)

    return Kept((0.0,), after, _number(0))


def _last(of: Callable[["Step"], Scalar]) -> Kept:
    """Its value at the end of the last step."""

    def after(kept: tuple[Scalar, ...], step: "Step") -> tuple[Scalar, ...]:
        return (of(step),)

    return Kept((0.0,), after, _number(0))


def _number(index: int) -> Callable[[tuple[Scalar, ...], Mapping[str, Scalar]], Scalar]:
    """One of the numbers that travelled with the integration."""

    def value(kept: tuple[Scalar, ...], end: Mapping[str, Scalar]) -> Scalar:
        return kept[index]

    return value


def _at_the_end(state: str) -> Kept:
    """A state of the specimen at the end; nothing travels with the integration."""

    def after(kept: tuple[Scalar, ...], step: "Step") -> tuple[Scalar, ...]:
        return ()

    def value(kept: tuple[Scalar, ...], end: Mapping[str, Scalar]) -> Scalar:
        return end[state]

    return Kept((), after, value)


def absorbed_energy(force: np.ndarray, elongation: np.ndarray) -> np.ndarray:
    """Work done on the specimen up to each sample [J], by the trapezoidal rule, (m,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(elongation))])


@functools.cache
def _energy_at(until: float) -> Quantity:
    """The work done until a time [s] after the start."""

    def measured(time: np.ndarray, channels: Channels) -> float:
        elapsed = time - time[0]
        if elapsed[-1] < until:
            return float("nan")
        return float(np.interp(until, elapsed, absorbed_energy(channels["force"], channels["elongation"])))

    def after(kept: tuple[Scalar, ...], step: "Step") -> tuple[Scalar, ...]:
        import jax.numpy as jnp

        time, energy = kept
        return time + step.length, jnp.where(time < until, step.energy(until - time), energy)

    return Quantity(
        rf"e({until:g}\,\mathrm{{s}})",
        "J",
        f"work done on the specimen within {until:g} s of the start",
        (*_FORCE, *_ELONGATION),
        channels=lambda masses: ("force", "elongation"),
        measured=measured,
        kept=Kept((0.0, 0.0), after, _number(1)),
        is_strength=True,
        until=until,
    )


QUANTITIES: dict[str, Quantity] = {
    "peak_force": Quantity(
        r"\max|r|",
        "N",
        "largest restoring force of the specimen",
        _FORCE,
        channels=lambda masses: ("force",),
        measured=lambda time, channels: float(np.max(np.abs(channels["force"]))),
        kept=_largest(lambda step: step.force),
        is_strength=True,
        limit="force",
    ),
    "peak_elongation": Quantity(
        r"\max|\Delta u|",
        "m",
        "largest elongation of the specimen",
        _ELONGATION,
        channels=lambda masses: ("elongation",),
        measured=lambda time, channels: float(np.max(np.abs(channels["elongation"]))),
        kept=_largest(lambda step: step.elongation),
        limit="stroke",
    ),
    "dissipated_energy": Quantity(
        r"e(t_{end})",
        "J",
        "work done on the specimen until the end",
        (*_FORCE, *_ELONGATION),
        channels=lambda masses: ("force", "elongation"),
        measured=lambda time, channels: float(np.trapezoid(channels["force"], channels["elongation"])),
        kept=_at_the_end("energy"),
        is_strength=True,
        limit="energy",
    ),
    "peak_energy": Quantity(
        r"\max e",
        "J",
        "largest work done on the specimen so far",
        (*_FORCE, *_ELONGATION),
        channels=lambda masses: ("force", "elongation"),
        measured=lambda time, channels: float(np.abs(absorbed_energy(channels["force"], channels["elongation"])).max()),
        kept=_largest(lambda step: step.peak_energy),
        is_strength=True,
    ),
    "residual_elongation": Quantity(
        r"\Delta u(t_{end})",
        "m",
        "elongation of the specimen at the end",
        _ELONGATION,
        channels=lambda masses: ("elongation",),
        measured=lambda time, channels: float(channels["elongation"][-1]),
        kept=_last(lambda step: step.last_elongation),
        is_signed=True,
    ),
    "peak_absolute_acceleration": Quantity(
        r"\max_i|\ddot u_i + a_g|",
        "m/s^2",
        "largest absolute acceleration of any mass",
        channels=lambda masses: tuple(f"acceleration_{i + 1}_absolute" for i in range(masses)),
        measured=lambda time, channels: float(max(np.max(np.abs(values)) for values in channels.values())),
        kept=_largest(lambda step: step.absolute_acceleration),
        limit="acceleration",
        of_specimen=False,
    ),
}
EQ_18 = ("peak_force", "peak_elongation", "dissipated_energy")
"""The quantities of the paper, Eq. 18: every response has them, and a study that names none observes them."""

CHANNELS: dict[str, Output] = {
    "time": Output("t", "s", "time", of_specimen=False),
    "ground_acceleration": Output("a_g", "m/s^2", "acceleration of the ground", of_specimen=False),
    "elongation": Output(r"\Delta u", "m", "elongation of the specimen", _ELONGATION),
    "elongation_rate": Output(r"\Delta\dot u", "m/s", "rate of the elongation of the specimen", _ELONGATION),
    "force": Output("r", "N", "restoring force of the specimen", _FORCE, is_strength=True),
    "energy": Output("e", "J", "work done on the specimen so far", (*_FORCE, *_ELONGATION)),
}
PER_MASS: dict[str, Output] = {
    "displacement": Output("u", "m", "displacement relative to the ground"),
    "velocity": Output(r"\dot u", "m/s", "velocity relative to the ground"),
    "acceleration": Output(r"\ddot u", "m/s^2", "acceleration relative to the ground"),
}
APPLIED_FORCE = Output("p", "N", "force applied to the structure", of_specimen=False)
DRIVERS = ("time", "ground_acceleration")
"""Channels that are not a response of a structure; forces on its masses are not responses, either (`is_driver`)."""
ALLOWED = ", ".join([*QUANTITIES, "energy_at_TIME (a whole number of s or ms: energy_at_5s, energy_at_500ms)"])
"""The names that a quantity may have, for messages."""


def output(name: str) -> Output:
    """Symbol, unit and meaning of a channel or quantity.

    Raises:
        KeyError: there is no such channel or quantity.
    """
    return quantity(name) if is_quantity(name) else channel(name)


def is_quantity(name: str) -> bool:
    """Whether this is the name of a quantity."""
    known = _quantity(own_name(name))
    return known is not None and _may_be(name, known)


@functools.cache
def quantity(name: str) -> Quantity:
    """The declaration of a quantity.

    Raises:
        KeyError: there is no such quantity.
    """
    owner, own = owner_of(name), own_name(name)
    known = _quantity(own)
    if known is None or not _may_be(name, known):
        raise KeyError(name)
    if not owner:
        return known

    def channels(masses: int) -> tuple[str, ...]:
        return tuple(named(owner, channel) for channel in known.channels(masses))

    def measured(time: np.ndarray, channels: Channels) -> float:
        return known.measured(time, {own_name(channel): values for channel, values in channels.items()})

    return replace(_of(owner, known), channels=channels, measured=measured)


def further(names: tuple[str, ...]) -> tuple[str, ...]:
    """The quantities that only some responses have."""
    return tuple(name for name in names if own_name(name) not in EQ_18)


def loops(channels: Iterable[str]) -> tuple[str, ...]:
    """The specimens whose force and elongation are both among these channels."""
    known = set(channels)
    owners = dict.fromkeys(owner_of(name) for name in channels)
    return tuple(o for o in owners if {named(o, "force"), named(o, "elongation")} <= known)


def _quantity(own: str) -> Quantity | None:
    if own in QUANTITIES:
        return QUANTITIES[own]
    match = re.fullmatch(r"energy_at_([1-9]\d{0,8})(m?)s", own)
    return None if match is None else _energy_at(int(match[1]) / (1000 if match[2] else 1))


def driven_mass(name: str) -> int | None:
    """The mass (from 1) that the force of this channel is applied to; None if it is not such a channel."""
    match = re.fullmatch(r"applied_force_([1-9]\d*)", name)
    return None if match is None else int(match[1])


def is_driver(name: str) -> bool:
    """Whether a channel is the excitation of a structure, or the time, instead of a response."""
    return name in DRIVERS or driven_mass(name) is not None


def channel(name: str) -> Output:
    """Symbol, unit and meaning of a channel.

    Raises:
        KeyError: there is no such channel.
    """
    owner, own = owner_of(name), own_name(name)
    known = CHANNELS.get(own) or _of_applied(own) or _of_mass(own)
    if known is None or not _may_be(name, known):
        raise KeyError(name)
    return _of(owner, known) if owner else known


def _of_applied(own: str) -> Output | None:
    mass = driven_mass(own)
    if mass is None:
        return None
    return replace(APPLIED_FORCE, symbol=f"p_{{{mass}}}", meaning=f"{APPLIED_FORCE.meaning}, mass {mass}")


def _of_mass(own: str) -> Output | None:
    match = re.fullmatch(r"(displacement|velocity|acceleration)_([1-9]\d*)(_absolute)?", own)
    if match is None:
        return None
    kind, mass, absolute = match.groups()
    of_mass = PER_MASS[kind]
    meaning = of_mass.meaning.replace("relative to the ground", "absolute") if absolute else of_mass.meaning
    mark = r",abs" if absolute else ""
    return Output(f"{of_mass.symbol}_{{{mass}{mark}}}", of_mass.unit, f"{meaning}, mass {mass}", of_specimen=False)


def _may_be(name: str, known: Output) -> bool:
    """Whether an output may have that of a specimen in its name, or has none."""
    return "." not in name or (known.of_specimen and SPECIMEN.fullmatch(owner_of(name)) is not None)


def _of[T: Output](owner: str, known: T) -> T:
    """An output of one of several specimens."""
    mark = owner.replace("_", r"\_")
    symbol = rf"{known.symbol}_{{\mathrm{{{mark}}}}}"
    return replace(known, symbol=symbol, meaning=known.meaning.replace("the specimen", owner))
