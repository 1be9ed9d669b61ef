"""A campaign folder: campaign.yaml, experiments.csv and the records."""

from pathlib import Path
from typing import Any, get_args

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.campaign import MOTION, Campaign
from hsed_jax.measurements.declaration import read_declaration
from hsed_jax.measurements.experiment import Experiment, Record, Split, Status, check_id, check_word
from hsed_jax.measurements.header import RESERVED_COLUMNS
from hsed_jax.measurements.records import read_columns, read_motion
from hsed_jax.measurements.tables import Table, read_experiment_table
from hsed_jax.physics.outputs import is_driver
from hsed_jax.plain import MOST, is_file, is_folder, shown

DEFAULT_ENDINGS = ("csv", "parquet", "mat", "h5", "txt")


def read_campaign(path: str | Path) -> Campaign:
    """Read a campaign from its folder.

    Arguments:
        path: The folder with campaign.yaml, experiments.csv and the records.

    Raises:
        UserError: The files are ambiguous or wrong: the message has file, row and column, the fault and the allowed
            values.  Nothing is repaired or left out.

    Example:
        >>> campaign = hx.read_campaign("my_campaign")
        >>> [experiment.id for experiment in campaign.train]
        ['wall']
    """
    folder = Path(path)
    if not is_folder(folder):
        raise UserError(f"{folder}: no such folder; a campaign is a folder with campaign.yaml and experiments.csv")
    header, columns = read_declaration(folder / "campaign.yaml")
    table = read_experiment_table(folder / "experiments.csv")
    numeric = [*header.inputs, *(q.column for q in header.quantities.values() if q.column in table.columns)]
    window = [c for c in ("from", "to") if c in table.columns]
    comma = table.uses_decimal_comma([*numeric, *window])
    rows: dict[str, int] = {}
    records: dict[tuple[Path, bool], Record] = {}
    experiments = []
    for row in range(len(table.rows)):
        id = table.text(row, "id")
        try:
            check_id(id)
        except UserError as error:
            raise UserError(f"{table.where(row, 'id')}: {error}") from None
        if id in rows:
            first = table.row_numbers[rows[id]]
            raise UserError(f"{table.where(row, 'id')}: {id!r} is also the id of row {first}; an id is unique")
        rows[id] = row
        experiments.append(_experiment(folder, header, columns, table, row, comma, records))
    try:
        return Campaign(
            header.name,
            header.protocol,
            header.inputs,
            header.channels,
            header.quantities,
            tuple(experiments),
            str(folder),
        )
    except UserError as error:
        raise UserError(f"{table.path}: {error}") from None


def _experiment(
    folder: Path,
    header: Campaign,
    columns: dict[str, str],
    table: Table,
    row: int,
    comma: bool,
    records: dict[tuple[Path, bool], Record],
) -> Experiment:
    id = table.text(row, "id")
    status = _word(table, row, "status", get_args(Status), "completed")
    quantities = {}
    for name, channel in header.quantities.items():
        value = _number(header, table, row, channel.column, name, comma)
        if value is not None:
            quantities[name] = value
    if header.quantities and not header.channels and status == "completed" and not quantities:
        cells = ", ".join(repr(q.column) for q in header.quantities.values())
        raise UserError(f"{table.where(row)}, columns {cells}: {id!r} is completed and has no value; give one")
    record = None
    if (file := _record_file(folder, header, table, row, status, bool(quantities))) is not None:
        motion_will_do = status != "completed" or bool(quantities)
        key = (file, motion_will_do)
        if key not in records:
            records[key] = _record(header, columns, file, motion_will_do)
        record = records[key]
    known = {*RESERVED_COLUMNS, *header.inputs, *(q.column for q in header.quantities.values())}
    fields: dict[str, Any] = {
        "record": record,
        "quantities": quantities,
        "status": status,
        "reason": table.text(row, "reason"),
        "split": _word(table, row, "split", get_args(Split), "train"),
        "window": _window(header, table, row, comma, record),
        "metadata": {c: table.text(row, c) for c in table.columns if c not in known},
    }
    inputs = {}
    for name in header.inputs:
        value = _number(header, table, row, name, name, comma)
        if value is None:
            raise UserError(
                f"{table.where(row, name)}: the cell is empty; every experiment has a number for each input"
            )
        inputs[name] = value
    try:
        return Experiment(id, inputs, **fields)
    except UserError as error:
        raise UserError(f"{table.where(row)}: {error}") from None


def _word(table: Table, row: int, column: str, allowed: tuple[str, ...], default: str) -> str:
    word = table.text(row, column).lower() or default
    check_word(word, allowed, table.where(row, column))
    return word


def _number(header: Campaign, table: Table, row: int, column: str, name: str, comma: bool) -> float | None:
    """Return a number in SI, or `None` where the cell is empty."""
    if not table.rows[row][table.position(column)].strip():
        return None
    value = header.unit(name).to_si(table.number(row, column, comma))
    if not abs(value) <= MOST:
        said = shown(table.text(row, column))
        raise UserError(f"{table.where(row, column)}: {said} is not finite or out of range; write a number")
    return float(value)


def _window(header: Campaign, table: Table, row: int, comma: bool, record: Record | None) -> tuple[float, float] | None:
    ends = []
    for column in ("from", "to"):
        ends.append(_number(header, table, row, column, "time", comma) if column in table.columns else None)
    if ends == [None, None]:
        return None
    if record is None:
        column = "from" if ends[0] is not None else "to"
        raise UserError(f"{table.where(row, column)}: there is no record to take a window of; leave the cell empty")
    first, last = float(np.min(record.time)), float(np.max(record.time))
    slack = 1e-9 * (last - first)
    for column, end in zip(("from", "to"), ends, strict=True):
        if end is not None and not first - slack <= end <= last + slack:
            unit = header.unit("time")
            runs = f"from {unit.from_si(first):g} to {unit.from_si(last):g}"
            runs = f"its time runs {runs} ({unit.text})" if header.has_time else f"its rows run {runs}"
            raise UserError(f"{table.where(row, column)}: {table.text(row, column)} is outside the record; {runs}")
    return first if ends[0] is None else ends[0], last if ends[1] is None else ends[1]


def _record_file(
    folder: Path, header: Campaign, table: Table, row: int, status: str, has_quantities: bool
) -> Path | None:
    """Find the record of an experiment, or `None` if it needs none."""
    id, said = table.text(row, "id"), table.text(row, "record")
    if said:
        column, files = "record", [folder / said.replace("\\", "/")]
    else:
        column, files = "id", [folder / "records" / f"{id}.{ending}" for ending in DEFAULT_ENDINGS]
    if said and not header.channels:
        raise UserError(
            f"{table.where(row, 'record')}: {said!r} is named, but campaign.yaml declares no channels to read"
        )
    if not header.channels or (status == "pending" and not said):
        return None  # the files of a pending experiment may still be incomplete
    found = [file for file in files if is_file(file)]
    if len(found) > 1:
        names = ", ".join(file.name for file in found)
        raise UserError(
            f"{table.where(row, 'id')}: {id!r} has several records ({names}); name one in a column 'record'"
        )
    if not found and status == "completed" and (said or not has_quantities):
        expected = files[0] if said else folder / "records" / f"{id}.<{'|'.join(DEFAULT_ENDINGS)}>"
        raise UserError(
            f"{table.where(row, column)}: the record of {id!r} is missing; expected {expected}, "
            "or set the status to pending, failed or abandoned"
        )
    return found[0] if found else None


def _record(header: Campaign, columns: dict[str, str], file: Path, motion_will_do: bool) -> Record:
    """Read a record in SI; a ground motion without response passes where `motion_will_do`."""
    if file.suffix.lower() == ".at2":
        if header.protocol != "ground_motion" or not set(MOTION) <= header.channels.keys():
            raise UserError(
                f"{file}: an .AT2 file is a ground motion; it needs protocol ground_motion and the channels "
                f"{' and '.join(MOTION)} in campaign.yaml"
            )
        if not motion_will_do and header.channels.keys() - MOTION:
            missing = ", ".join(sorted(header.channels.keys() - MOTION))
            raise UserError(f"{file}: an .AT2 file has no {missing}; a completed experiment has the declared channels")
        channels = read_motion(file)
    else:
        responses = {name for name in header.channels if not is_driver(name)}
        if not motion_will_do or header.channels.keys() - responses <= {"time"}:
            responses = set()
        units = {column: header.channels[name].unit for name, column in columns.items()}
        read = read_columns(file, columns.values(), [columns[name] for name in responses], units)
        channels = {name: header.unit(name).to_si(read[c]) for name, c in columns.items() if c in read}
    time = channels.pop("time", None)
    try:
        return Record(np.arange(len(next(iter(channels.values())))) if time is None else time, channels)
    except UserError as error:
        raise UserError(f"{file}: {error}") from None
