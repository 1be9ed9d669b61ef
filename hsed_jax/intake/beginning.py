"""A campaign from a laboratory's files: each decision is stated, and the user is asked about open ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.choice import (
    HELD_OUT,
    Choice,
    ask_of_faults,
    campaign_of,
    chosen,
    column_named,
    unit_of_columns,
    with_units,
)
from hsed_jax.intake.drifts import height_doubts
from hsed_jax.intake.found import Found
from hsed_jax.intake.opening import Gathered, gathered
from hsed_jax.measurements import Campaign, Finding
from hsed_jax.plain import shown, stem_of

_FLAGS = {"elongation": "--elongation", "force": "--force", "time": "--time"}


@dataclass(frozen=True)
class Said:
    """The user's statements on the files.

    Attributes:
        columns: by channel, its column.
        units: unit by column or channel.
        sheet: of workbooks, the only one to read.
        held_out: share of each record, its end, that is never fitted.
        missing: numbers that mark a missing sample; None without a statement.
        drops_missing: whether samples that lack a channel inside a record are left out.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sheet: str | None = None
    held_out: float = HELD_OUT
    missing: tuple[float, ...] | None = None
    drops_missing: bool = False


@dataclass(frozen=True)
class Begun:
    """A campaign made of files.

    Attributes:
        campaign: the measurements.
        taken: the columns of elongation, force, time and further channels, a line for each.
        notes: omissions and decisions.
        doubts: from columns of the files that are not channels.
    """

    campaign: Campaign
    taken: list[str]
    notes: list[str]
    doubts: list[Finding]


def read_files(
    *files: str | Path,
    elongation: str | None = None,
    force: str | None = None,
    time: str | None = None,
    units: Mapping[str, str] | None = None,
    held_out: float = HELD_OUT,
) -> Campaign:
    """Read the record files of one specimen as a campaign, as `hsed init FILE` does.

    Arguments:
        files: of the laboratory: csv, txt, xlsx, mat, parquet, ... .
        elongation, force, time: the columns, if their names do not determine them.
        units: by column, if the file does not have them.
        held_out: share of each record, its end, that is never fitted.

    Raises:
        UserError: a file cannot be read, or a column or unit is ambiguous; the message asks for the missing statement.

    Example:
        >>> campaign = hx.read_files("wall.csv")  # or units={"d": "mm", "F": "kN"}, where the file does not tell them
        >>> len(campaign.train), len(campaign.test)
        (1, 1)
    """
    columns = {"elongation": elongation, "force": force, "time": time}
    said = Said({c: name for c, name in columns.items() if name is not None}, dict(units or {}), held_out=held_out)
    return begun([Path(file) for file in files], said).campaign


def begun(files: Sequence[Path], said: Said | None = None) -> Begun:
    """Make a campaign of the files of one specimen.

    Raises:
        UserError: a file cannot be read, a column or unit is ambiguous, or a required column has a fault; the message asks
            for the missing statement.
    """
    said = said or Said()
    found = gathered(files, said.sheet)
    if found.refused:
        raise UserError(found.refused[0])
    _ask_of_sheets(files, found, said)
    first, table = next(iter(found.records.items()))
    where = ", ".join(map(str, files[:3])) + (" ..." if len(files) > 3 else "")
    choice, notes = _choice(where, files, table, said)
    for id, other in found.records.items():
        _ask_of_others(id, other, first, choice, said)
    choice = replace(choice, held_out=said.held_out, missing=said.missing, drops_missing=said.drops_missing)
    made = campaign_of(stem_of(files[0].name), found.records, choice)
    unused = [name for name in table.columns if not _is_used(name, choice)]
    left_out = [f"not used: {', '.join(map(repr, unused))}"] if unused else []
    faulty = [note for note in found.notes if "is left out: " not in note or ": column " not in note]
    faults = [f"{name!r}: {fault}" for name, fault in table.faults.items()]
    left_out += [f"not used, since they hold something other than numbers: {'; '.join(faults)}"] if faults else []
    doubts = [doubt for id, other in found.records.items() for doubt in height_doubts(id, other, choice)]
    return Begun(made.campaign, _taken(table, choice, made.campaign), [*faulty, *notes, *made.notes, *left_out], doubts)


def _choice(where: str, files: Sequence[Path], table: Found, said: Said) -> tuple[Choice, list[str]]:
    """The meaning of the columns.

    Raises:
        UserError: it is ambiguous.
    """
    known = {"elongation", "force", "time", "ground_acceleration", *said.columns}
    try:
        given = {channel: column_named(table, column) for channel, column in said.columns.items()}
        units = {n if n in known else column_named(table, n): unit for n, unit in said.units.items()}
    except UserError as error:
        raise UserError(f"{where}: {error}") from None
    # A unit from the user has the same weight as one in the file.
    of_columns = {name: unit for name, unit in units.items() if name in table.names}
    choice, told = chosen(replace(table, units={**table.units, **of_columns}), given)
    of_channels = {c: unit for c, unit in units.items() if c in choice.columns}
    for channel, column in choice.columns.items():
        unit = unit_of_columns(replace(table, units={**table.units, **of_columns}), column)
        if channel not in of_channels and unit is not None:
            of_channels[channel] = unit
    try:
        choice = with_units(choice, of_channels)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None
    ask_of_faults(where, table, choice)
    # Any response identifies a shaken structure.  Imposed cycles need both channels, and a time only if there are several
    # candidates.
    responses = choice.columns.keys() - {"time", "ground_acceleration"}
    is_told = choice.protocol == "ground_motion" and responses
    asked = {c: names for c, names in told.candidates.items() if names or (c != "time" and not is_told)}
    missing = [c for c in choice.columns if c not in choice.units]
    if asked or missing:
        raise UserError(_question(where, files, table, choice, asked, missing))
    return choice, told.notes


def _question(
    where: str, files: Sequence[Path], table: Found, choice: Choice, asked: Mapping[str, list[str]], missing: list[str]
) -> str:
    """The open question, the possible columns, and the command that answers it."""
    parts, flags = [], []
    for channel, names in asked.items():
        likely = f" ({', '.join(map(repr, names))} may be it)" if names else ""
        parts.append(f"the column of the {channel}{likely}")
        flags.append(f"{_FLAGS.get(channel, '--channel ' + channel + '=')} COLUMN")
    for channel in missing:
        column = choice.columns[channel]
        parts.append(f"the unit of the {channel}, column {column!r}")
        flags.append(f"--unit {quote(f'{column}=UNIT')}")
    if asked and not table.is_named:
        flags += [f"--unit {channel}=UNIT" for channel in asked]
    lines = [f"{where}: the file does not determine {' and '.join(parts)}; give it:"]
    lines.append(f"  hsed init {' '.join(quote(str(file)) for file in files[:3])} {' '.join(dict.fromkeys(flags))}")
    if asked:
        lines.append(
            "The columns are:" if table.is_named else "The file has no column names; the columns by position are:"
        )
        lines += [f"  {name!r}: {_range(table, name)}" for name in table.names]
    return "\n".join(lines)


def _range(table: Found, name: str) -> str:
    if name in table.faults:
        return table.faults[name]
    values = table.columns[name]
    steps = np.diff(values[np.isfinite(values)])
    rises = ", rises throughout" if steps.size and (steps > 0).all() else ""
    unit = table.units.get(name, "")
    return f"{np.nanmin(values):.6g} to {np.nanmax(values):.6g}{' ' + unit if unit else ''}{rises}"


def _ask_of_sheets(files: Sequence[Path], found: Gathered, said: Said) -> None:
    """Refuse several sheets of one workbook without a choice of the user.

    Raises:
        UserError: with their names.
    """
    if len(found.records) > len(files) and said.sheet is None:
        raise UserError(
            f"{files[0]}: several sheets hold a table ({', '.join(found.records)}); say --sheet NAME, or save each "
            "record as a file"
        )


def _ask_of_others(id: str, other: Found, first: str, choice: Choice, said: Said) -> None:
    """Refuse a record whose units differ from those of the first record.

    Raises:
        UserError: with the record, the column and both units.
    """
    for channel, column in choice.columns.items():
        unit = unit_of_columns(other, column) if column in other.names else None
        if unit is not None and unit != choice.units[channel] and not said.units:
            raise UserError(
                f"record {id!r}: column {column!r} is in {unit!r}, that of {first!r} in {choice.units[channel]!r}; files of one "
                "campaign have the same units"
            )


def _is_used(name: str, choice: Choice) -> bool:
    return any(name == column or name in column for column in choice.columns.values())


def _taken(table: Found, choice: Choice, campaign: Campaign) -> list[str]:
    """A line for each channel: its column, its unit, its range."""
    lines = []
    records = [e.record for e in campaign if e.record is not None]
    width = max(len(channel) for channel in choice.columns) + 1
    for channel in campaign.channels:
        unit = campaign.unit(channel)
        values = [r.time if channel == "time" else r.channels[channel] for r in records]
        low, high = (float(unit.from_si(f([f(v) for v in values]))) for f in (min, max))
        of_file = table.units.get(choice.columns[channel], "")
        spelled = f" (the file's {shown(of_file)})" if of_file and of_file != unit.text else ""
        label = f"{channel}:".ljust(width)
        lines.append(f"{label} column {choice.columns[channel]!r}, {low:.6g} to {high:.6g} {unit.text}{spelled}")
    if "time" not in choice.columns:
        lines.append(f"{'time:'.ljust(width)} no column of the file; samples are numbered")
    return lines
