"""The meaning of the columns of tables, as recognised and as the user states it, and the resulting campaign."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.found import Found
from hsed_jax.intake.recognition import CHANNELS, Recognised, recognised, unit_of
from hsed_jax.measurements import Campaign, Channel, Experiment, Record, parse_unit
from hsed_jax.measurements.header import Protocol
from hsed_jax.measurements.spelled import spelled_unit, without_unit
from hsed_jax.plain import shown

HELD_OUT = 1 / 3
"""Share of a record, its end, that is not fitted."""
# Values that loggers write for a missing measurement; they count as such if they lie far beyond all other samples.
_SENTINELS = (999.0, 7999.0, 8888.0, 9999.0, 32767.0, 32768.0, 99999.0, 999999.0, 9999999.0)
_BEYOND, _FAR = 1e29, 5.0


@dataclass(frozen=True)
class Choice:
    """The meaning of the columns.

    Attributes:
        protocol: kind of test.
        columns: column of each channel that was measured, or columns that are added and subtracted, such as `d1 - d0`.
        units: unit of each of these.
        turned: channels whose sign is turned.
        tests: records that are never fitted.
        held_out: share of every other record, its end, that is not fitted, either.
        missing: numbers that mark a missing sample; `None` if the user has not stated whether they exist.
        drops_missing: whether samples that lack a channel inside the record are left out.
    """

    protocol: Protocol
    columns: Mapping[str, str]
    units: Mapping[str, str]
    turned: frozenset[str] = frozenset()
    tests: frozenset[str] = frozenset()
    held_out: float = 0.0
    missing: tuple[float, ...] | None = None
    drops_missing: bool = False


@dataclass(frozen=True)
class Made:
    """A campaign from tables, and the changes of its records."""

    campaign: Campaign
    notes: list[str] = field(default_factory=list)


def chosen(found: Found, given: Mapping[str, str] | None = None) -> tuple[Choice, Recognised]:
    """The meaning of a table's columns; unknown channels and units are absent.

    Arguments:
        found: the table.
        given: by channel, the column that the user gives.
    """
    told = recognised(found, given)
    protocol: Protocol = "ground_motion" if told.protocol == "ground_motion" else "displacement"
    return Choice(protocol, told.columns, told.units), told


def column_named(found: Found, said: str) -> str:
    """The column that a user means, by its name with or without unit; columns that are added or subtracted, as `d1 - d0`.

    Raises:
        UserError: there is no such column, or there are several.
    """
    name = _one_column(found, said)
    if name is not None:
        return name
    if terms := _terms(said):
        named = [(sign, _one_column(found, term)) for sign, term in terms]
        if all(term is not None for _, term in named):
            text = " ".join(f"{sign} {term}" for sign, term in named)
            return text.removeprefix("+ ")
    raise UserError(f"there is no column {shown(said)}; the columns are {', '.join(map(repr, found.names))}")


def _one_column(found: Found, said: str) -> str | None:
    if said in found.names:
        return said
    if not found.is_named and said.isdecimal() and said in found.names:
        return said
    bare = [name for name in found.names if without_unit(name)[0].casefold() == without_unit(said)[0].casefold()]
    if len(bare) > 1:
        unit = without_unit(said)[1]
        bare = [name for name in bare if unit and unit_of(found, name) == (spelled_unit(unit) or unit)] or bare
    if len(bare) > 1:
        raise UserError(f"{shown(said)} may be {' or '.join(map(repr, bare))}; write the whole name")
    return bare[0] if bare else None


def _terms(said: str) -> list[tuple[str, str]]:
    """The terms of a sum or difference, each with its sign; none where it is one column without a sign."""
    parts = re.split(r"(?:^|\s)([+-])\s", said.strip())
    first = [("+", parts[0].strip())] if parts[0].strip() else []
    terms = first + [(sign, term.strip()) for sign, term in zip(parts[1::2], parts[2::2], strict=True)]
    return terms if len(parts) > 1 and all(term for _, term in terms) else []


def unit_of_columns(found: Found, column: str) -> str | None:
    """The unit of a column, or of added columns, if the file has it and it is the same for all."""
    if column in found.names:
        return unit_of(found, column)
    units = {unit_of(found, name) for _, name in _terms(column)}
    return units.pop() if len(units) == 1 else None


def campaign_of(name: str, tables: Mapping[str, Found], choice: Choice) -> Made:
    """The campaign from tables and a choice.

    Raises:
        UserError: a column or unit is missing, a column holds something other than numbers, lacks samples inside the record,
            or is used for two channels, or the units do not belong together.
    """
    needed = CHANNELS[choice.protocol]
    order = [*needed, *(channel for channel in choice.columns if channel not in needed)]
    for channel in needed[:2]:
        if channel not in choice.columns:
            raise UserError(f"choose the column of the {channel.replace('_', ' ')}")
    if not choice.columns.keys() - {"time", "ground_acceleration"}:
        raise UserError(
            "choose the column of elongation or force: the ground motion alone has no information on the specimen"
        )
    for id, table in tables.items():
        ask_of_faults(f"record {id!r}", table, choice)
    named = [channel for channel in order if channel in choice.columns]
    for channel in named:
        if not choice.units.get(channel):
            raise UserError(f"choose the unit of the {channel.replace('_', ' ')}: the file does not give it")
    columns = list(choice.columns.values())
    if twice := next((column for column in columns if columns.count(column) > 1), None):
        raise UserError(f"column {twice!r} is chosen twice")
    channels = {channel: Channel(channel, choice.units[channel]) for channel in named}
    header = Campaign(name, choice.protocol, channels=channels)
    experiments: list[Experiment] = []
    notes: list[str] = []
    for id, table in tables.items():
        record, said = _record(header, id, table, choice)
        experiments += _parts(id, record, choice)
        notes += said
    if not any(e.split == "train" for e in experiments):
        raise UserError("every record is kept for testing; leave one to fit")
    return Made(Campaign(name, choice.protocol, channels=channels, experiments=tuple(experiments)), notes)


def _record(header: Campaign, id: str, table: Found, choice: Choice) -> tuple[Record, list[str]]:
    raw = {channel: _numbers(id, table, choice, channel) for channel in header.channels}
    kept, notes = _kept(id, table, choice, raw)
    values: dict[str, Any] = {}
    for channel, numbers in raw.items():
        sign = -1.0 if channel in choice.turned else 1.0
        values[channel] = sign * header.unit(channel).to_si(numbers[kept])
    time = values.pop("time", None)
    count = len(next(iter(values.values())))
    if count < 2:
        raise UserError(f"record {id!r}: it has one row of numbers; a record has two samples at least")
    try:
        return Record(np.arange(count) if time is None else time, values), notes
    except UserError as error:
        raise UserError(f"record {id!r}: {error}") from None


def _numbers(id: str, table: Found, choice: Choice, channel: str) -> np.ndarray:
    """The numbers of a channel in the file's unit, nan where a sample is missing."""
    said = choice.columns[channel]
    terms = [("+", said)] if said in table.names else _terms(said) or [("+", said)]
    total = 0.0
    for sign, column in terms:
        if column not in table.columns:
            raise UserError(f"record {id!r} has no column {column!r}; its columns are {', '.join(table.columns)}")
        numbers = table.columns[column]
        _ask_of_sentinels(id, table, choice, column)
        missing = np.isin(numbers, choice.missing or ())
        numbers = np.where(missing, np.nan, numbers)
        total = total + numbers if sign == "+" else total - numbers
    return np.asarray(total, dtype=float)


def ask_of_faults(where: str, table: Found, choice: Choice) -> None:
    """Refuse a required column that is not numeric; no other column replaces it.

    Raises:
        UserError: with the fault of the first one.
    """
    for said in choice.columns.values():
        for _, column in [("+", said)] if said in table.names else _terms(said):
            if column in table.faults:
                raise UserError(f"{where}: {table.faults[column]}")


def _ask_of_sentinels(id: str, table: Found, choice: Choice, column: str) -> None:
    """Refuse values that loggers write for missing samples, until the user has stated their meaning.

    Raises:
        UserError: with the value and its position.
    """
    if choice.missing is not None:
        return
    numbers = table.columns[column]
    sizes = np.abs(numbers)
    is_odd = np.isinf(numbers) | (sizes > _BEYOND) | np.isin(sizes, _SENTINELS)
    others = sizes[~is_odd & np.isfinite(sizes)]
    if not is_odd.any() or not others.size:
        return
    is_odd &= sizes > _FAR * others.max()
    if is_odd.any():
        value = float(numbers[np.argmax(is_odd)])
        raise UserError(
            f"record {id!r}: column {column!r} is {value:g} in {table.places(is_odd)}, far from all other samples; "
            f"loggers write such a number where nothing was measured: say --missing {value:g} (on the page, write it into the "
            "field) if this is the case here, or --missing none if it was measured"
        )


def _kept(id: str, table: Found, choice: Choice, raw: Mapping[str, np.ndarray]) -> tuple[np.ndarray, list[str]]:
    """The samples of the record, (n,) bool: samples at both ends that lack a channel are removed.

    Raises:
        UserError: a channel lacks a sample inside, and the user has not chosen to leave such samples out.
    """
    lacks = np.any([np.isnan(numbers) for numbers in raw.values()], axis=0)
    kept = np.ones(len(lacks), dtype=bool)
    if not lacks.any():
        return kept, []
    if lacks.all():
        raise UserError(f"record {id!r}: in every row {' or '.join(choice.columns.values())} is missing")
    whole = np.flatnonzero(~lacks)
    first, last = int(whole[0]), int(whole[-1])
    notes = []
    at = np.arange(len(lacks))
    for is_end, where in ((at < first, "start"), (at > last, "end")):
        if is_end.any():
            said = ", ".join(repr(choice.columns[c]) for c, numbers in raw.items() if np.isnan(numbers[is_end]).any())
            are = "is" if is_end.sum() == 1 else "are"
            notes.append(f"record {id!r}: {table.places(is_end)} at the {where} {are} cut off, where {said} is missing")
    inside = lacks & (at > first) & (at < last)
    if inside.any():
        where = table.places(inside)
        said = ", ".join(repr(choice.columns[c]) for c, numbers in raw.items() if np.isnan(numbers[inside]).any())
        if not choice.drops_missing:
            raise UserError(
                f"record {id!r}: {said} is missing in {where}; say --drop-missing (on the page, tick its box) to leave these "
                "samples out, if the others show the loops"
            )
        notes.append(f"record {id!r}: {where} are left out, where {said} is missing")
    return ~lacks, notes


def _parts(id: str, record: Record, choice: Choice) -> list[Experiment]:
    """The experiments of a record: a held-out end is a separate experiment."""
    if id in choice.tests:
        return [Experiment(id, record=record, split="test")]
    split = round((1 - choice.held_out) * len(record))
    if not choice.held_out or not 0 < split < len(record) - 1:
        return [Experiment(id, record=record)]
    # The checks report backward times, so no window is made of them here.
    if not (np.diff(record.time) > 0).all():
        return [Experiment(id, record=record)]
    begin, last, first, end = (float(record.time[k]) for k in (0, split - 1, split, -1))
    return [
        Experiment(id, record=record, window=(begin, last)),
        Experiment(f"{id}_end", record=record, window=(first, end), split="test"),
    ]


def with_units(choice: Choice, units: Mapping[str, str]) -> Choice:
    """The choice with units that the user gave, by channel.

    Raises:
        UserError: a text is not a unit.
    """
    for unit in units.values():
        parse_unit(spelled_unit(unit) or unit)
    return replace(choice, units={**choice.units, **{c: spelled_unit(u) or u for c, u in units.items()}})
