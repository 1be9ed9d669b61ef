"""Sheets of a workbook (.xlsx) as columns of numbers.

The cells are read one row at a time: a workbook of some kilobytes can hold a sheet of 1 048 576 rows and 16 384 columns.
"""

import datetime
import warnings
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile, is_zipfile

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.intake.cells import made
from hsed_jax.intake.found import Found
from hsed_jax.intake.words import is_channel
from hsed_jax.measurements.budget import ask, ask_of_file
from hsed_jax.measurements.layout import table_in
from hsed_jax.measurements.sheets import NUMBER, Sheet, is_missing, kind_of
from hsed_jax.plain import shown

# Largest size of a sheet; a damaged one may number its rows beyond it.
_LAST_ROW = 2**20


class Workbook(NamedTuple):
    """Tables by the title of their sheet, and the omissions."""

    tables: dict[str, Found]
    notes: list[str]


def read_workbook(path: Path) -> Workbook:
    """Read the visible sheets of a workbook that have a column of numbers.

    Raises:
        UserError: It cannot be read, goes beyond the budget, or has no such sheet; the message names sheet, row and column.
    """
    try:
        import openpyxl
    except ImportError:
        raise UserError(f"{path}: a workbook is read by openpyxl; install hsed_jax[files], or save it as CSV") from None
    ask_of_file(path, whole=True)
    found: dict[str, Found] = {}
    notes: list[str] = []
    faults: list[str] = []
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # for parts of a workbook without cells
            if not is_zipfile(file):
                raise UserError(f"{path}: this is not a workbook; if it is a text file, give it the extension .csv")
            with ZipFile(file) as archive:
                members = archive.infolist()
            ask(path, parts=len(members))
            # At most this much of a member is unpacked; pictures are not read.
            ask(path, bytes=sum(m.file_size for m in members if not m.filename.startswith("xl/media/")))
            with closing(openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)) as book:
                for sheet in book.worksheets:
                    if sheet.sheet_state != "visible":
                        notes.append(f"sheet {str(sheet.title)!r} is hidden and is left out")
                        continue
                    where = f"{path}, sheet {str(sheet.title)!r}"
                    rows = _rows(where, sheet)
                    try:
                        table = _found(path, str(sheet.title), rows)
                    except UserError as error:
                        faults.append(str(error).removeprefix(f"{path}, "))
                        continue
                    if table is not None:
                        found[str(sheet.title)] = table
                    elif rows:
                        said = _as_text(rows)
                        notes.append(f"sheet {str(sheet.title)!r} has no table of numbers{said} and is left out")
    except UserError:
        raise
    except Exception as error:  # openpyxl raises any exception on damaged bytes
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UserError(f"{path}: cannot be read as a workbook ({said})") from None
    if not found:
        said = f" ({'; '.join([*faults, *notes])})" if faults or notes else ""
        raise UserError(f"{path}: no sheet has a column of numbers{said}")
    return Workbook(found, [*faults, *notes])


def _rows(where: str, sheet: Any) -> list[tuple[int, tuple[Any, ...]]]:
    """The filled rows of a sheet, each with its number and without the empty cells behind."""
    sheet.reset_dimensions()  # the declared size of a sheet may be wrong
    rows, width = [], 0
    for number, cells in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > _LAST_ROW:
            raise UserError(f"{where}: it has rows beyond {_LAST_ROW:,}; a sheet ends there, so the file is damaged")
        if not cells:
            continue
        while cells and cells[-1] is None:
            cells = cells[:-1]
        if cells:
            width = max(width, len(cells))
            rows.append((number, cells))
            ask(where, cells=(number - rows[0][0] + 1) * width)
    return rows


def _found(path: Path, title: str, rows: list[tuple[int, tuple[Any, ...]]]) -> Found | None:
    """The columns of numbers of a sheet; None where it has none.

    Raises:
        UserError: it has rows of numbers, but no clear columns.
    """
    where = f"{path}, sheet {title!r}"
    cells = Sheet(where, [row for _, row in rows], [number for number, _ in rows], delimiter="\t", is_text=False)
    laid = table_in(cells, is_channel)
    if laid is None or len(laid.rows) < 2:
        return None
    columns: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    numbers = np.asarray([laid.sheet.numbers[k] for k in laid.rows])
    for position, name in enumerate(laid.names):
        if not name:
            continue
        column = [_cell(laid.sheet.rows[k], position) for k in laid.rows]
        seconds = _seconds(column)
        if seconds is not None:
            columns[name] = seconds
            laid.units[position] = "s"
            laid.notes.append(f"column {name!r} holds times of day; it is read as seconds since the first row")
            continue
        wrong = next((k for k, cell in enumerate(column) if not _is_number(cell) and not _is_blank(cell)), None)
        if wrong is None:
            try:
                columns[name] = np.array([np.nan if _is_blank(cell) else cell for cell in column], dtype=float)
                continue
            except OverflowError:
                wrong = 0
        fault = f"holds {shown(str(column[wrong]), 40)}"
        if isinstance(column[wrong], str) and column[wrong].strip()[:1].isdigit():
            fault = f"holds the text {shown(column[wrong], 40)}, which is no number; format the cell as a number"
        faults[name] = (
            f"sheet {title!r}, row {numbers[wrong]}, column {position + 1} {fault}; a number is wanted in every row"
        )
    return made(path, columns, faults, laid, numbers)


def _as_text(rows: list[tuple[int, tuple[Any, ...]]]) -> str:
    """The note on the first number that is stored as text; empty without one."""
    for number, cells in rows:
        for cell in cells:
            if isinstance(cell, str) and kind_of(cell) == NUMBER:
                return f" (row {number} holds {shown(cell)} as text; format the cells as numbers)"
    return ""


def _is_number(cell: Any) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def _is_blank(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and is_missing(cell))


def _seconds(column: list[Any]) -> np.ndarray | None:
    """Seconds since the first of dates or times of day; None if a cell is not a time, or if they do not increase."""
    if not column or not all(
        isinstance(cell, datetime.datetime | datetime.time | datetime.timedelta) for cell in column
    ):
        return None
    if len({type(cell) for cell in column}) > 1:
        return None
    if isinstance(column[0], datetime.time):
        midnight = datetime.datetime(2000, 1, 1)
        column = [datetime.datetime.combine(midnight, cell) for cell in column]
    seconds = np.round([(cell - column[0]).total_seconds() for cell in column], 6)
    return seconds if (np.diff(seconds) > 0).all() else None


def _cell(cells: Any, position: int) -> Any:
    return cells[position] if position < len(cells) else None
