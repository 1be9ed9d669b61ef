"""Recognition of elongation, force and time among the columns of a file, by their names and units; open cases are asked.

No column is chosen by its numbers, and no column replaces an unreadable one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.found import Found
from hsed_jax.intake.words import STRONG, is_never, is_transverse, strength
from hsed_jax.measurements.spelled import spelled_unit, without_unit
from hsed_jax.measurements.units import ACCELERATION, FORCE, LENGTH, TIME, Dimension, dimension_of, measures, parse_unit
from hsed_jax.physics.pairs import PAIRS

CHANNELS = {
    "displacement": ("elongation", "force", "time"),
    "ground_motion": ("time", "ground_acceleration", "elongation", "force"),
}
"""Channels that a record of a kind of test may have; the last one of imposed cycles may be absent."""
_ROUNDED = 1e-6  # of the range of a column: digits that another unit has cut off
_BY_UNIT = 1  # score of a unit if the name has no information
_ELONGATIONS = {pair.elongation_unit for pair in PAIRS}
_FORCES = {pair.force_unit for pair in PAIRS}


@dataclass
class Recognised:
    """The meaning of the columns of a file.

    Attributes:
        columns: by channel, the column that is it.
        units: by channel, the unit that the file gives for it; absent where it gives none.
        candidates: by ambiguous channel, the possible columns; empty if no column is similar.
        notes: decisions between similar columns.
    """

    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    candidates: dict[str, list[str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def protocol(self) -> str:
        """The kind of the test: a record with time and ground motion belongs to a shaken structure."""
        return "ground_motion" if {"time", "ground_acceleration"} <= self.columns.keys() else "displacement"


def recognised(found: Found, given: Mapping[str, str] | None = None) -> Recognised:
    """Assign columns to the channels.

    Arguments:
        found: the columns.
        given: by channel, the column that the user gives; it is not asked.
    """
    given = dict(given or {})
    result = Recognised(dict(given))
    left = [name for name in found.names if name not in given.values()]
    units = {name: unit for name in found.names if (unit := unit_of(found, name)) is not None}
    if "ground_acceleration" not in given:
        grounds = _best(left, "ground_acceleration", units, ACCELERATION)
        if len(grounds) == 1:
            result.columns["ground_acceleration"] = grounds[0]
            left.remove(grounds[0])
    _pick_pair(found, left, units, result)
    if "time" not in given:
        times = _best([name for name in left if name not in result.columns.values()], "time", units, TIME)
        _settle("time", times, found, result)
    if result.protocol == "displacement" and "ground_acceleration" not in given:
        result.columns.pop("ground_acceleration", None)
    wanted = CHANNELS[result.protocol]
    result.columns = {**given, **{c: result.columns[c] for c in wanted if c in result.columns}}
    result.units = {c: units[name] for c, name in result.columns.items() if name in units}
    return result


def unit_of(found: Found, name: str) -> str | None:
    """The unit of a column as `parse_unit` reads it, from the file or from the column's name; None if neither has it."""
    said = found.units.get(name) or without_unit(name)[1]
    if said:
        return spelled_unit(said) or said
    # A header that is a unit, and no symbol of a channel, gives only the unit.
    is_symbol = any(strength(channel, name) for channel in ("elongation", "force", "time"))
    return None if is_symbol else spelled_unit(name)


def _best(names: Iterable[str], channel: str, units: Mapping[str, str], dimension: Dimension) -> list[str]:
    """Columns that are most like a channel: by a word of the name, by a symbol, by the unit alone."""
    ranked: dict[str, int] = {}
    for name in names:
        rank, unit = strength(channel, without_unit(name)[0]), units.get(name)
        if unit is not None and not measures(unit, dimension):
            continue  # a unit that contradicts the name
        if rank or (unit is not None and not is_never(name) and channel != "ground_acceleration"):
            ranked[name] = rank or _BY_UNIT
    return [name for name, rank in ranked.items() if rank == max(ranked.values())]


def _pick_pair(found: Found, left: list[str], units: Mapping[str, str], result: Recognised) -> None:
    """Elongation and force, which belong together: of several pairs the one with the most significant names, and of
    equal ones mm and kN.
    """
    elongations = _ranked(left, "elongation", "force", units, _ELONGATIONS, result.columns)
    forces = _ranked(left, "force", "elongation", units, _FORCES, result.columns)
    options = {
        (e, f): a + b
        for e, a in elongations.items()
        for f, b in forces.items()
        if e != f and _belong(units.get(e), units.get(f))
    }
    if not options:
        for channel, ranks in (("elongation", elongations), ("force", forces)):
            if channel not in result.columns:
                best = [name for name, rank in ranks.items() if rank == max(ranks.values())]
                _settle(channel, best, found, result, is_needed=True)
        return
    best = [option for option, worth in options.items() if worth == max(options.values())]
    if len({f for _, f in best}) == 1:
        # A drift beside a displacement, with one force: the displacement.  Stress and strain beside them are asked about.
        best = [(e, f) for e, f in best if _is_usual(units.get(e), units.get(f))] or best
    for channel, names in (("elongation", [e for e, _ in best]), ("force", [f for _, f in best])):
        if channel not in result.columns:
            _settle(channel, list(dict.fromkeys(names)), found, result, is_needed=True)


def _ranked(
    left: list[str], channel: str, other: str, units: Mapping[str, str], si: set[str], known: Mapping[str, str]
) -> dict[str, int]:
    """The scores of the possible columns of a channel."""
    if channel in known:
        return {known[channel]: STRONG}
    ranked = {}
    for name in left:
        bare, unit = without_unit(name)[0], units.get(name)
        rank = strength(channel, bare)
        fits = unit is not None and any(_measures(unit, one) for one in si)
        if unit is not None and not fits:
            continue
        # A unit that serves for both channels (such as %) is decided by a word for the other channel.
        if is_never(bare) or strength("time", bare) == STRONG or (strength(other, bare) == STRONG and rank != STRONG):
            continue
        if rank or fits:
            ranked[name] = rank or _BY_UNIT
    named = [name for name, rank in ranked.items() if rank == STRONG]
    if named and all(map(is_transverse, named)) and len(named) < len(ranked):
        # The vertical load of a wall beside a column in kN with any name: the user is asked which one is meant.
        ranked = dict.fromkeys(ranked, _BY_UNIT)
    return ranked


def _measures(unit: str, si: str) -> bool:
    return measures(unit, dimension_of(si))


def _belong(elongation: str | None, force: str | None) -> bool:
    """Whether a unit of an elongation and one of a force are those of a pair; an unknown one may be any."""
    return any(
        (elongation is None or _measures(elongation, pair.elongation_unit))
        and (force is None or _measures(force, pair.force_unit))
        for pair in PAIRS
    )


def _is_usual(elongation: str | None, force: str | None) -> bool:
    return elongation is not None and force is not None and measures(elongation, LENGTH) and measures(force, FORCE)


def _settle(channel: str, names: list[str], found: Found, result: Recognised, is_needed: bool = False) -> None:
    """Choose the only candidate, or the first of several with the same numbers; otherwise the user is asked."""
    if not names:
        if is_needed:
            result.candidates[channel] = []
        return
    first = names[0]
    alike = [n for n in names[1:] if _are_equal(found, first, n)]
    if len(names) == 1 + len(alike):
        result.columns[channel] = first
        if alike:
            said = ", ".join(repr(name) for name in alike)
            result.notes.append(f"{said} holds the same numbers as {first!r}, which is used as the {channel}")
        return
    result.candidates[channel] = names


def _are_equal(found: Found, one: str, other: str) -> bool:
    """Whether two columns have the same numbers, also with different units."""
    if one not in found.columns or other not in found.columns:
        return False
    first, second = found.columns[one], found.columns[other]
    if (units := [unit_of(found, name) for name in (one, other)])[0] != units[1]:
        try:
            first, second = (
                np.asarray(parse_unit(unit or "").to_si(v)) for unit, v in zip(units, (first, second), strict=True)
            )
        except UserError:
            return False
        spread = np.nanmax(first) - np.nanmin(first) if np.isfinite(first).any() else 0.0
        return bool(np.allclose(first, second, rtol=0, atol=_ROUNDED * spread, equal_nan=True))
    return np.array_equal(first, second, equal_nan=True)
