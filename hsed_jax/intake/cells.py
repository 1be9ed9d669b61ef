"""Cells of a table, of a text or of a workbook, as columns of numbers."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.found import Found
from hsed_jax.measurements.layout import Laid
from hsed_jax.measurements.sheets import EITHER, STAMP, is_missing
from hsed_jax.measurements.tables import Table
from hsed_jax.plain import shown


def found_in_cells(path: Path, laid: Laid) -> Found:
    """The columns of a table of texts, as numbers.

    Raises:
        UserError: no column has numbers, or the decimal mark is ambiguous.
    """
    sheet = laid.sheet
    width = len(laid.names)
    rows = [[*sheet.rows[k][:width], *[""] * (width - len(sheet.rows[k]))] for k in laid.rows]
    numbers = [sheet.numbers[k] for k in laid.rows]
    columns, faults = {}, {}
    names = [name for name in laid.names if name]
    table = Table(path, tuple(laid.names), rows, numbers, sheet.delimiter != ",", True)
    for name in names:
        position = table.position(name)
        for row in rows:
            if is_missing(row[position]):
                row[position] = "nan"
    comma = table.uses_decimal_comma(names)
    for name in names:
        position = table.position(name)
        _ask_of_thousands(table, position, name)
        try:
            columns[name] = table.vector(name, comma)
        except UserError as error:
            cells = [row[position].strip() for row in rows]
            seconds = _seconds_of(cells)
            if seconds is None:
                faults[name] = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}, ")
            else:
                columns[name] = seconds
                laid.notes.append(f"column {name!r} holds times of day; it is read as seconds since the first row")
                laid.units[laid.names.index(name)] = "s"
    return made(path, columns, faults, laid, np.asarray(numbers))


def made(where: object, columns: dict[str, Any], faults: dict[str, str], laid: Laid, rows: np.ndarray | None) -> Found:
    """The columns found, without empty ones.

    Raises:
        UserError: there is no column of numbers; the message has the fault of the first one.
    """
    if len(columns) > 1 and rows is not None:
        is_empty = np.all([np.isnan(values) for values in columns.values()], axis=0)
        if is_empty.any() and not is_empty.all():
            places = Found(columns, {}, [], rows=rows).places(is_empty)
            laid.notes.append(f"{places} hold no number in any column and are left out")
            columns, rows = {name: values[~is_empty] for name, values in columns.items()}, rows[~is_empty]
    for name in [name for name, values in columns.items() if np.isnan(values).all()]:
        del columns[name]
        faults[name] = f"column {name!r} holds no number"
    if not columns:
        raise UserError(f"{where}, {next(iter(faults.values()))}")
    names = [name for name in laid.names if name]
    units = {name: unit for name, unit in zip(laid.names, laid.units, strict=True) if name and unit}
    return Found(columns, faults, names, units, tuple(laid.notes), rows, laid.is_named)


def _seconds_of(cells: list[str]) -> np.ndarray | None:
    """Seconds since the first of some times of day; None if a cell is not a time, or if they do not increase."""
    if not cells or not all(STAMP.fullmatch(cell) for cell in cells):
        return None
    whole = [cell.replace(",", ".").replace("T", " ").split(" ") for cell in cells]
    if len({len(parts) for parts in whole}) > 1:
        return None
    dates = {parts[0] for parts in whole} if len(whole[0]) == 2 else set()
    seconds = np.zeros(len(cells))
    for k, parts in enumerate(whole):
        hours, minutes, rest = parts[-1].split(":")
        seconds[k] = 3600 * int(hours) + 60 * int(minutes) + float(rest)
        if len(dates) > 1:  # within one day the date does not matter
            day = _day_of(parts[0])
            if day is None:
                return None
            seconds[k] += 86400.0 * day
    seconds = np.round(seconds - seconds[0], 6)
    return seconds if (np.diff(seconds) > 0).all() else None


def _day_of(date: str) -> int | None:
    """Number of a day written as 2024-05-31 or 31.5.2024; None of other dates, such as 5/4/2024, which has two readings."""
    try:
        if "." in date:
            day, month, year = map(int, date.split("."))
            return datetime.date(year + (2000 if year < 100 else 0), month, day).toordinal()
        return datetime.date.fromisoformat(date).toordinal()
    except ValueError:
        return None


def _ask_of_thousands(table: Table, position: int, name: str) -> None:
    """Refuse a column in which a mark may separate thousands: 1.288 beside 964, without a number that is certainly a decimal.

    Raises:
        UserError: with the first such cell.
    """
    marked = []
    for k, row in enumerate(table.rows):
        if "." in (cell := row[position].strip()) or "," in cell:
            if not EITHER.fullmatch(cell):
                return  # a number that is certainly a decimal
            marked.append((k, cell))
    if not marked:
        return
    plain = [cell for row in table.rows if (cell := row[position].strip()).lstrip("+-").isdigit() and cell.strip("+-0")]
    if plain:
        k, cell = marked[0]
        raise UserError(
            f"{table.where(k, name)}: {shown(cell)} beside {shown(plain[0])} may be a number with thousands separators; write "
            "all numbers without thousands separators, or all with the same number of decimals"
        )
