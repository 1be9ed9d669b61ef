"""The answer of a program or a person in the folder of an experiment: `record.csv` and `quantities.json`, or similar files."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed, Measured
from hsed_jax.laboratories.request import Request
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.measurements import Record
from hsed_jax.measurements.records import FORMATS, read_columns

RECORD = tuple(f"record.{ending}" for ending in FORMATS if ending != "at2")
"""Names that a record may have."""
QUANTITIES = ("quantities.json", "quantities.csv")
"""Names that quantities may have."""


def is_answered(folder: Path) -> bool:
    """Whether a folder has an answer."""
    return any((folder / name).is_file() for name in (*RECORD, *QUANTITIES))


def read_answer(folder: Path, request: Request, sensors: Sensors) -> Measured:
    """The answer in a folder, in SI.

    Raises:
        ExperimentFailed: a declared channel or quantity is missing, or is not a measurement.
    """
    record, quantities = None, {}
    if sensors.channels:
        record = read_record(left(folder, RECORD), request, sensors)
    if sensors.quantities:
        quantities = read_quantities(left(folder, QUANTITIES), sensors)
    return Measured(quantities, record)


def read_record(file: Path, request: Request, sensors: Sensors, *, partial: bool = False) -> Record:
    """The record of a file, in SI; a partial record belongs to a failed experiment.

    Raises:
        ExperimentFailed: it cannot be read, lacks a channel, or is shorter than the compared duration.
    """
    wanted = {name: sensors.columns.get(name, channel.column) for name, channel in sensors.channels.items()}
    return sensors.record(request, columns_of(file, wanted), str(file), partial=partial)


def read_quantities(file: Path, sensors: Sensors) -> dict[str, float]:
    """The quantities of a file (JSON, or columns of one row), in SI.

    Raises:
        ExperimentFailed: it cannot be read, or one is missing or not finite.
    """
    wanted = {name: channel.column for name, channel in sensors.quantities.items()}
    return sensors.numbers(columns_of(file, wanted), str(file))


def left(folder: Path, names: Iterable[str]) -> Path:
    """The one file of these names in a folder.

    Raises:
        ExperimentFailed: there is none, or more than one.
    """
    first, *others = names
    found = [folder / name for name in (first, *others) if (folder / name).is_file()]
    if not found:
        raise ExperimentFailed(f"the laboratory left no {first} in {folder} (also read: {', '.join(others)})")
    if len(found) > 1:
        raise ExperimentFailed(
            f"the laboratory left {' and '.join(file.name for file in found)} in {folder}; only one is allowed"
        )
    return found[0]


def columns_of(file: Path, columns: Mapping[str, str]) -> dict[str, Any]:
    """The columns of a file by name; for JSON only the existing ones.

    Raises:
        ExperimentFailed: it cannot be read, or has no such column.
    """
    if file.suffix == ".json":
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, OSError) as error:
            raise ExperimentFailed(f"{file}: it is not valid JSON ({error})") from None
        if not isinstance(content, dict):
            raise ExperimentFailed(f"{file}: it must be a mapping of names to numbers")
        return {name: content[column] for name, column in columns.items() if column in content}
    try:
        read = read_columns(file, columns.values())
    except UserError as error:
        raise ExperimentFailed(str(error)) from None
    return {name: read[column] for name, column in columns.items()}
