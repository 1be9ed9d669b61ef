"""The behaviour of a specimen in engineering quantities, and its sentences."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.physics import display
from hsed_jax.physics.names import own_name, owner_of
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, Pair
from hsed_jax.tables import Table, Tabular, cell

QUANTITIES = {
    "initial_stiffness": ("initial stiffness", "N/m"),
    "unloading_stiffness": ("unloading stiffness", "N/m"),
    "reloading_stiffness": ("reloading stiffness", "N/m"),
    "post_yield_stiffness": ("post-yield stiffness", "N/m"),
    "strength": ("strength", "N"),
    "sharpness": ("sharpness of yielding", "1"),
    "pinching_ratio": ("height of the loop in its middle over its largest height", "1"),
    "recentring": ("recentring", "1"),
    "play": ("play", "m"),
    "elastic_force": ("an elastic force", "N"),
    "rate_force": ("force that depends on the rate", "N"),
    "relaxation": ("relaxation", "1"),
}
"""Words and SI unit of each quantity."""

DRIVERS = {
    "absorbed_energy": "the absorbed energy",
    "path": "the path",
    "largest_elongation": "the largest elongation",
    "reversals": "the number of reversals",
    "rate": "the rate",
    "rest": "the time at rest",
    "elongation": "the elongation",
    "sign": "the sign of the rate",
}
"""Words of the drivers of a quantity."""

SIDES = {"+": "tension", "-": "compression"}
"""Words of the sides, by the sign at the end of the name of a curve."""


class Value(NamedTuple):
    """A number with its interval, SI.

    Attributes:
        mean: over the posterior.
        q05, q95: quantiles of 5 % and 95 %.
    """

    mean: float
    q05: float
    q95: float


@dataclass(frozen=True)
class Behaviour:
    """One property of the behaviour of a specimen.

    Attributes:
        quantity: a key of `QUANTITIES`.
        change: `falls`, `grows`, or `is there` where it is the same all the time; `differs` where it stays, and is not that of
            the same specimen without the named effects.
        drivers: the variables with which it changes, with the predictivity of each alone, from 0 to 1; the best first.
        before, after: of the virgin specimen and after the whole test; of a force that an effect adds, at the least and at the
            largest elongation or rate; where it differs, without the named effects and with them.
        unit: SI, of the pair that the specimen is measured in.
        sides: `both`, `tension` or `compression`.
        specimen: its name, where there are several.
        sentence: in words.
    """

    quantity: str
    change: str
    drivers: Mapping[str, float]
    before: Value
    after: Value
    unit: str
    sides: str = "both"
    specimen: str = ""
    sentence: str = ""

    def summary(self) -> dict[str, Any]:
        """An entry of `diagnosis.behaviour` in `summary.json`."""
        content: dict[str, Any] = {
            "quantity": self.quantity,
            "change": self.change,
            "with": dict(self.drivers),
            "from": self.before._asdict(),
            "to": self.after._asdict(),
            "unit": self.unit,
            "sides": self.sides,
            "sentence": self.sentence,
        }
        return content | ({"specimen": self.specimen} if self.specimen else {})


class ProbedCurve(NamedTuple):
    """A quantity along the test, SI.

    Attributes:
        before: of the first model, (places,).
        mean, q05, q95: of the model with the named effects, (places,).
    """

    before: Float[np.ndarray, " places"]
    mean: Float[np.ndarray, " places"]
    q05: Float[np.ndarray, " places"]
    q95: Float[np.ndarray, " places"]


@dataclass(frozen=True, repr=False)
class Behaviours(Tabular):
    """The behaviour of a specimen, with the curves behind it.

    Attributes:
        changes: in the order of `QUANTITIES`.
        steady: quantities that stay, with the largest relative change.
        curves: by quantity (with its side) and, where there are several, specimen; along `places`.
        places: shares of the path of the longest test.
        pair: that the specimens are measured in.
    """

    changes: Sequence[Behaviour] = ()
    steady: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, ProbedCurve] = field(default_factory=dict)
    places: Sequence[float] = ()
    pair: Pair = ELONGATION_AND_FORCE

    @property
    def sentence(self) -> str:
        """The main changes, and what stays, in one sentence."""
        main = [one for one in self.changes if one.quantity not in _FURTHER]
        is_told = any(one.quantity in ("initial_stiffness", "strength") for one in main)
        said = [one.sentence for one in (main if is_told else self.changes)[:_SAID]]
        return "; ".join([*said, *(self._stays(name, change) for name, change in self.steady.items())])

    def _stays(self, name: str, change: float) -> str:
        """What stays, in words, with its mean along the test; of each side if the sides differ by more than it changes."""
        words, si = QUANTITIES[own_name(name)]
        own = {key[len(name) :]: curve.mean for key, curve in self.curves.items() if key.rstrip("+-") == name}
        means = {in_side(sign): float(np.abs(mean).mean()) for sign, mean in own.items()}
        if np.ptp([*means.values()]) <= max(change, _ALIKE) * max(means.values()):
            means = {"": float(np.mean([*means.values()]))}
        divisor, unit = display.shown_in(self.pair, si, np.asarray([*means.values()]))
        values = " and ".join(f"{mean / divisor:.3g} {unit}{side}" for side, mean in means.items())
        return f"{_owned(owner_of(name))}{words} stays within {max(100 * change, 1):.0f} % of {values}"

    def _table(self) -> Table:
        rows = []
        for one in self.changes:
            divisor, unit = _shown(one, self.pair)
            first, last, low, high = (
                cell(value / divisor, ".3g")
                for value in (one.before.mean, one.after.mean, one.after.q05, one.after.q95)
            )
            side = "" if one.sides == "both" else f" in {one.sides}"
            by = ", ".join(f"{DRIVERS[driver]} ({share:.2f})" for driver, share in one.drivers.items())
            words = QUANTITIES[one.quantity][0] + side + (f" [{unit}]" if unit else "")
            rows.append((f"{_owned(one.specimen)}{words}", one.change, first, last, f"{low} to {high}", by or "–"))
        heads = ("quantity", "change", "virgin", "after the test", "90 %", "with")
        return Table(self.sentence or "no quantity changes", heads, rows, [])


# Changes of a sentence.
_SAID = 3
# A strength of more than so many times the largest measured force is an extrapolation.
_BEYOND = 1.2
# Two sides that differ by less have one value.
_ALIKE = 0.05
# Quantities without information beyond the initial stiffness and the strength, if these change.
_FURTHER = ("unloading_stiffness", "reloading_stiffness", "post_yield_stiffness", "sharpness")


def told(one: Behaviour, pair: Pair, largest: float = math.inf) -> str:
    """A behaviour in words, in the units in which the specimen is shown.

    Arguments:
        one: the behaviour.
        pair: that the specimen is measured in.
        largest: the largest measured force, SI.  A strength far beyond it is said to be an extrapolation.
    """
    words = QUANTITIES[one.quantity][0]
    side = "" if one.sides == "both" else f" in {one.sides}"
    owner = _owned(one.specimen)
    divisor, shown = _shown(one, pair)
    number = lambda value: f"{value / divisor:.3g}"  # noqa: E731
    by = f" with {DRIVERS[next(iter(one.drivers))]}" if one.drivers else ""
    unit_text = f" {shown}" if shown else ""
    most, beyond = max(one.before.mean, one.after.mean), ""
    if one.quantity == "strength" and most > _BEYOND * largest:
        beyond = f"; {number(most)}{unit_text} is an extrapolation, the largest measured force is {number(largest)}{unit_text}"
    interval = f"(90 %: {number(one.after.q05)} to {number(one.after.q95)}{beyond})"
    if one.quantity == "elastic_force":
        return f"{owner}{words} of {number(one.after.mean)}{unit_text} is added at the largest elongation {interval}"
    if one.change == "is there":
        return f"{owner}friction of {number(one.after.mean)}{unit_text}, the same at every speed, is added {interval}"
    if one.change == "differs":
        was = number(one.before.mean)
        now = f"{number(one.after.mean)}{unit_text} {interval}"
        return f"{owner}{words}{side} is {now}, without the named effects {was}{unit_text}"
    ends = f"from {number(one.before.mean)} to {number(one.after.mean)}{unit_text}"
    return f"{owner}{words}{side} {one.change} {ends}{by} {interval}"


def in_side(name: str) -> str:
    """The side of a curve in words, by the sign at the end of its name; empty where it has none."""
    side = SIDES.get(name[-1:])
    return f" in {side}" if side else ""


def _owned(specimen: str) -> str:
    """The beginning of a statement about one of several specimens."""
    return f"{specimen}: " if specimen else ""


def _shown(one: Behaviour, pair: Pair) -> tuple[float, str]:
    """Divisor and unit in which a behaviour is shown; no unit of a ratio."""
    unit = QUANTITIES[one.quantity][1]
    return (1.0, "") if unit == "1" else display.shown_in(pair, unit, np.asarray([*one.before, *one.after]))
