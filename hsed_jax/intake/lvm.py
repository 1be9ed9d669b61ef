"""LabVIEW measurement files (.lvm): their header gives separator, decimal mark, units and time step of the channels."""

import re
from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.cells import found_in_cells
from hsed_jax.intake.found import Found
from hsed_jax.measurements.layout import Laid
from hsed_jax.measurements.sheets import Sheet

_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ",", "space": " "}


def found_in_lvm(path: Path, text: str) -> Found:
    """The channels of a file, with the time from its header.

    Raises:
        UserError: the header is not that of such a file, or the file contains several measurements.
    """
    lines = text.splitlines()
    ends = [k for k, line in enumerate(lines) if line.strip().startswith(_END)]
    if len(ends) < 2:
        raise UserError(f"{path}: a LabVIEW measurement has two lines {_END}; this file has {len(ends)}")
    if len(ends) > 2:
        raise UserError(f"{path}, row {ends[2] + 1}: a second measurement begins; keep one in the file")
    about = _settings(lines[: ends[0]], "\t")
    separator = _SEPARATORS.get(about.get("separator", ["tab"])[0].casefold(), "\t")
    if separator != "\t":
        about = _settings(lines[: ends[0]], separator)
    of_channels = _settings(lines[ends[0] + 1 : ends[1]], separator)
    head = ends[1] + 1
    names = [name.strip() for name in lines[head].split(separator)]
    rows = [[cell.strip() for cell in line.split(separator)] for line in lines[head + 1 :]]
    numbers = [k for k, row in enumerate(rows) if any(row)]
    width = len(names) - (names[-1].casefold() == "comment")
    count = int(of_channels.get("channels", [str(width)])[0])
    columns_of_x = about.get("x_columns", ["One"])[0].casefold()
    units = of_channels.get("y_unit_label", [])
    x_unit = "s" if of_channels.get("x_dimension", ["Time"])[0].casefold() == "time" else ""
    said = ["" for _ in range(width)]
    xs = [k for k, name in enumerate(names[:width]) if re.fullmatch(r"x_value( \(\d+\))?", name.casefold())]
    for number, k in enumerate(k for k in range(width) if k not in xs):
        said[k] = units[number].strip() if number < min(len(units), count) else ""
    for k in xs:
        said[k] = x_unit
        names[k] = "X_Value" if k == xs[0] else f"X_Value ({k + 1})"
    sheet = Sheet(str(path), rows, [head + 2 + k for k in range(len(rows))], delimiter=separator)
    if columns_of_x == "no":
        names, said, sheet = _without_x(names[:width], said, sheet, xs)
        width = len(names)
    sheet.rows = [[cell for cell in row[:width]] for row in sheet.rows]
    names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names[:width], said, strict=True)]
    found = found_in_cells(path, Laid(names, said, True, numbers, sheet, []))
    step = of_channels.get("delta_x", [""])[0].replace(about.get("decimal_separator", ["."])[0], ".")
    if columns_of_x != "no" or x_unit != "s" or not re.fullmatch(r"[\d.eE+-]+", step) or not float(step) > 0:
        return found
    time = np.arange(len(sheet.rows) if not found.columns else len(next(iter(found.columns.values())))) * float(step)
    note = f"the time is that of the header: a sample every {float(step):g} s"
    names = ["X_Value [s]", *found.names]
    columns, units_of = {"X_Value [s]": time, **found.columns}, {"X_Value [s]": "s", **found.units}
    return Found(columns, found.faults, names, units_of, (*found.notes, note), found.rows)


def _settings(lines: list[str], separator: str) -> dict[str, list[str]]:
    """The lines of the header by their first words."""
    cells = [line.split(separator) for line in lines if line.strip()]
    return {row[0].strip().casefold(): [cell.strip() for cell in row[1:]] or [""] for row in cells}


def _without_x(names: list[str], said: list[str], sheet: Sheet, xs: list[int]) -> tuple[list[str], list[str], Sheet]:
    """The table without the column of X, which is empty if the header has the time step."""
    keep = [k for k in range(len(names)) if k not in xs]
    sheet.rows = [[row[k] for k in keep if k < len(row)] for row in sheet.rows]
    return [names[k] for k in keep], [said[k] for k in keep], sheet
