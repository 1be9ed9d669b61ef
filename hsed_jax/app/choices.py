"""What the columns of dropped tables are: guessed from their names, chosen by the user, made into a campaign."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Channel, Experiment, Found, Record, parse_unit
from hsed_jax.measurements.campaign import Protocol

KINDS: dict[str, Protocol] = {"cycles imposed on the specimen": "displacement", "shaken by the ground": "ground_motion"}
"""Kinds of test as the page says them."""
CHANNELS = {
    "displacement": ("elongation", "force", "time"),
    "ground_motion": ("time", "ground_acceleration", "elongation", "force"),
}
"""Channels that a record of a kind of test may have; the last one of imposed cycles may be absent."""
UNITS = {
    "time": ["s", "ms", "min"],
    "ground_acceleration": ["g", "m/s^2", "cm/s^2", "mm/s^2"],
    "elongation": ["mm", "cm", "m", "inch", "rad", "mrad", "deg", "%", "-", "mm/m"],
    "force": ["kN", "N", "MN", "kip", "lbf", "kN*m", "N*m", "kip*inch", "MPa", "Pa", "GPa", "ksi"],
}
"""Units that are offered; those of elongation and force also say whether these are rotation and moment, strain and stress."""
_WORDS = {
    "time": r"t|time|zeit|temps|seconds?",
    "ground_acceleration": r"a_?g|ground.*|.*acc.*",
    "force": r"f|p|q|v|m|r|force|.*load.*|.*force.*|.*shear|.*moment.*|stress|sigma|kraft",
    "elongation": r"u|d|x|du|delta|disp.*|.*displ.*|.*elong.*|.*drift.*|.*rot.*|theta|.*strain.*|eps.*|.*def.*|weg|slip",
}
_HELD_OUT = 2 / 3


@dataclass(frozen=True)
class Choice:
    """What the columns are.

    Attributes:
        protocol: kind of test.
        columns: column of each channel that was measured.
        units: unit of each of these.
        turned: channels whose sign is turned.
        tests: records that are never fitted.
        holds_out: whether the last third of every other record is not fitted, either.
    """

    protocol: Protocol
    columns: Mapping[str, str]
    units: Mapping[str, str]
    turned: frozenset[str] = frozenset()
    tests: frozenset[str] = frozenset()
    holds_out: bool = False


def guess(table: Found) -> Choice:
    """A first choice for a table, by the names of its columns; of two that say nothing, the second is the force.

    A column whose name fits and that holds something else than numbers is chosen all the same: another one in its place would be
    fitted without a word.
    """
    left, found = list(table.names), {}
    for channel, words in _WORDS.items():
        for name in left:
            if re.fullmatch(words, _bare(name), re.IGNORECASE):
                found[channel] = name
                left.remove(name)
                break
    left = [name for name in left if name in table.columns]
    for channel in ("elongation", "force"):
        if channel not in found and left:
            found[channel] = left.pop(0)
    protocol: Protocol = "ground_motion" if {"time", "ground_acceleration"} <= found.keys() else "displacement"
    found = {channel: found[channel] for channel in CHANNELS[protocol] if channel in found}
    units = {channel: _unit(channel, found.get(channel, "")) for channel in UNITS}
    return Choice(protocol, found, units)


def campaign_of(name: str, tables: Mapping[str, Found], choice: Choice) -> Campaign:
    """The campaign that a choice makes of tables.

    Raises:
        UserError: a column is missing, holds something else than numbers or stands for two things, or the units do not belong
            together.
    """
    channels = {
        channel: Channel(channel, choice.units[channel])
        for channel in CHANNELS[choice.protocol]
        if channel in choice.columns
    }
    for needed in CHANNELS[choice.protocol][:2]:
        if needed not in channels:
            raise UserError(f"choose the column of the {needed.replace('_', ' ')}")
    if not channels.keys() & {"elongation", "force"}:
        raise UserError("choose the column of elongation or force: the ground alone says nothing of the specimen")
    chosen = list(choice.columns.values())
    if twice := next((column for column in chosen if chosen.count(column) > 1), None):
        raise UserError(f"column {twice!r} is chosen twice")
    header = Campaign(name, choice.protocol, channels=channels)
    experiments = [e for id, table in tables.items() for e in _experiments(header, id, table, choice)]
    if not any(e.split == "train" for e in experiments):
        raise UserError("every record is kept for testing; leave one to fit")
    return Campaign(name, choice.protocol, channels=channels, experiments=tuple(experiments))


def _experiments(header: Campaign, id: str, table: Found, choice: Choice) -> list[Experiment]:
    values: dict[str, Any] = {}
    for channel in header.channels:
        column = choice.columns[channel]
        if column in table.faults:
            raise UserError(f"record {id!r}: {table.faults[column]}")
        if column not in table.columns:
            raise UserError(f"record {id!r} has no column {column!r}; its columns are {', '.join(table.columns)}")
        sign = -1.0 if channel in choice.turned else 1.0
        values[channel] = sign * header.unit(channel).to_si(table.columns[column])
    time = values.pop("time", None)
    try:
        record = Record(np.arange(len(next(iter(values.values())))) if time is None else time, values)
    except UserError as error:
        raise UserError(f"record {id!r}: {error}") from None
    if id in choice.tests:
        return [Experiment(id, record=record, split="test")]
    if not choice.holds_out:
        return [Experiment(id, record=record)]
    begin, split, end = (float(record.time[k]) for k in (0, round(_HELD_OUT * (len(record) - 1)), -1))
    return [
        Experiment(id, record=record, window=(begin, split)),
        Experiment(f"{id}_end", record=record, window=(split, end), split="test"),
    ]


def _bare(name: str) -> str:
    """A column's name without its unit."""
    return re.sub(r"[\[(].*", "", name).strip().partition("_")[0].strip() or name


def _unit(channel: str, column: str) -> str:
    """The unit that a column's name ends in, such as Force [kN] or disp_mm; else the first that is offered."""
    said = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", column) or re.search(r"[_\s]([A-Za-z%/^0-9]+)$", column)
    offered = UNITS[channel]
    if said is None:
        return offered[0]
    if said[1] in offered:
        return said[1]
    for unit in offered:
        try:
            if (given := parse_unit(said[1])).si == parse_unit(unit).si and given.factor == parse_unit(unit).factor:
                return unit
        except UserError:
            return offered[0]
    return offered[0]
