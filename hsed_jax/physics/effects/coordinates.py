"""The coordinates of a free function: variables of the instant, and measures of the past of a test."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp

from hsed_jax.physics.effects.base import SpringPoint
from hsed_jax.physics.effects.forms import DRIVERS
from hsed_jax.physics.scales import Scalar, Scales
from hsed_jax.physics.states import LARGEST_ELONGATION, LAST_REVERSAL, TIME, TRAVEL, SharedState

# A direction turns over within this share of the characteristic rate: a jump would stall any integrator.
_TURNING = 0.02


@dataclass(frozen=True)
class Coordinate:
    """One variable of a free function.

    Attributes:
        words: its name in a sentence.
        text: the dimensionless coordinate as plain text.
        symbol: the same in LaTeX.
        unit: SI unit of the variable.
        scale: characteristic value, SI.
        value: the variable over its characteristic value.
        state: the state of the spring that it needs; None if every spring has it.
        fades: whether it fades with a time constant; it then has its own state.
        needs_time: whether it requires a time scale.
    """

    words: str
    text: str
    symbol: str
    unit: str
    scale: Callable[[Scales], Scalar]
    value: Callable[[SpringPoint], Scalar]
    state: SharedState | None = None
    fades: bool = False
    needs_time: bool = False


def direction(point: SpringPoint) -> Scalar:
    r"""The sign of the motion, $\tanh(\Delta\dot u/0.02\,v_c)$."""
    return jnp.tanh(point.rate / (_TURNING * point.scales.rate))


COORDINATES: Mapping[str, Coordinate] = {
    "elongation": Coordinate(
        "the elongation", "u/u_c", r"\Delta u/u_c", "m", lambda s: s.elongation, lambda p: p.elongation / p.scales.elongation
    ),
    "rate": Coordinate(
        "the rate of elongation", "v/v_c", r"\Delta\dot u/v_c", "m/s", lambda s: s.rate, lambda p: p.rate / p.scales.rate,
        needs_time=True,
    ),
    "direction": Coordinate("the direction of motion", "sign(v)", r"\mathrm{sign}\,\Delta\dot u", "1", lambda s: 1.0, direction),
    "force": Coordinate(
        "the force of the element", "z/F_c", "z/F_c", "N", lambda s: s.force, lambda p: p.hysteretic / p.scales.force
    ),
    "force_along_motion": Coordinate(
        "the force of the element along its motion", "z sign(v)/F_c", r"z\,\mathrm{sign}\,\Delta\dot u/F_c", "N",
        lambda s: s.force, lambda p: p.hysteretic / p.scales.force * direction(p),
    ),
    "energy": Coordinate(
        "absorbed energy", "e/E_c", "e/E_c", "J", lambda s: s.energy, lambda p: DRIVERS["energy"].value(p)
    ),
    "path": Coordinate(
        "the length of the path of the elongation", "s F_c/E_c", "sF_c/E_c", "m", lambda s: s.energy / s.force,
        lambda p: DRIVERS["path"].value(p), TRAVEL,
    ),
    "largest_elongation": Coordinate(
        "the largest elongation reached", "max|u|/u_c", r"\max|\Delta u|/u_c", "m", lambda s: s.elongation,
        lambda p: DRIVERS["largest_elongation"].value(p), LARGEST_ELONGATION,
    ),
    "time": Coordinate(
        "time", "t v_c/u_c", "t\\,v_c/u_c", "s", lambda s: s.elongation / s.rate,
        lambda p: p.memory["time"] * (p.scales.rate / p.scales.elongation), TIME, needs_time=True,
    ),
    "since_reversal": Coordinate(
        "the distance from the last reversal", "|u - u_r|/u_c", r"|\Delta u-\Delta u_r|/u_c", "m", lambda s: s.elongation,
        lambda p: jnp.abs(p.elongation - p.memory["last_reversal"]) / p.scales.elongation, LAST_REVERSAL,
    ),
    "recent_path": Coordinate(
        "the path of the elongation, fading with time", "q/u_c", "q/u_c", "m", lambda s: s.elongation,
        lambda p: p.memory["recent_path"], fades=True, needs_time=True,
    ),
    "lagged_elongation": Coordinate(
        "the elongation with a first-order time lag", "l/u_c", "l/u_c", "m", lambda s: s.elongation,
        lambda p: p.memory["lagged_elongation"], fades=True, needs_time=True,
    ),
}  # fmt: skip
"""The coordinates by name."""


def within(name: str, point: SpringPoint, low: float, high: float) -> Scalar:
    """A coordinate, dimensionless and clipped to its reach."""
    return jnp.clip(COORDINATES[name].value(point), low, high)


def states_of(names: Sequence[str]) -> tuple[str, ...]:
    """The own states of a function of these coordinates."""
    return tuple(name for name in names if COORDINATES[name].fades)


def needs_of(names: Sequence[str]) -> tuple[SharedState, ...]:
    """Shared states that a function of these coordinates needs."""
    return tuple(state for name in names if (state := COORDINATES[name].state) is not None)


def fading(names: Sequence[str], point: SpringPoint, fade: Scalar) -> dict[str, Scalar]:
    r"""Rates of the states that fade within $\tau u_c/v_c$, dimensionless.

    The recent path has $\dot q = |\Delta\dot u|/u_c - q/\tau'$, the delayed elongation $\dot l = (\Delta u/u_c - l)/\tau'$.
    """
    pace = point.scales.rate / point.scales.elongation / fade
    scale = point.scales.elongation
    found: dict[str, Scalar] = {}
    for name in states_of(names):
        value = point.memory[name]
        if name == "recent_path":
            found[name] = jnp.abs(point.rate) / scale - pace * value
        else:
            found[name] = pace * (point.elongation / scale - value)
    return found
