"""Sheets of a workbook (.xlsx) as columns of numbers.

The cells are read one row at a time: a workbook of some kilobytes can hold a sheet of 1 048 576 rows and 16 384 columns.
"""

import warnings
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.budget import ask, ask_of_file
from hsed_jax.measurements.records import Found

WORKBOOKS = ("xlsx", "xlsm")
# What a sheet can have; a damaged one may number its rows beyond.
_LAST_ROW = 2**20


class Workbook(NamedTuple):
    """Sheets with columns of numbers by title, and titles of the sheets that are hidden, which are not read."""

    sheets: dict[str, Found]
    hidden: list[str]


def read_workbook(path: Path) -> Workbook:
    """Read the sheets of a workbook that are shown.

    A table on a sheet is where two columns of numbers or more stand side by side; above them the last row is their names, and one
    below it their units.

    Raises:
        UserError: It cannot be read, goes beyond the budget, or has no such sheet; the message names sheet, row and column.
    """
    try:
        import openpyxl
    except ImportError:
        raise UserError(f"{path}: a workbook is read by openpyxl; install hsed_jax[app], or save it as CSV") from None
    ask_of_file(path, whole=True)
    found, hidden = {}, []
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of parts of a workbook that hold no cells
            with ZipFile(file) as archive:
                members = archive.infolist()
            ask(path, parts=len(members))
            # No more than this is unpacked of a member, whatever is in it; pictures are not read.
            ask(path, bytes=sum(m.file_size for m in members if not m.filename.startswith("xl/media/")))
            with closing(openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)) as book:
                for sheet in book.worksheets:
                    if sheet.sheet_state != "visible":
                        hidden.append(str(sheet.title))
                    elif table := _found(f"sheet {sheet.title!r}", _rows(f"{path}, sheet {sheet.title!r}", sheet)):
                        found[str(sheet.title)] = table
    except UserError:
        raise
    except Exception as error:  # openpyxl raises whatever the damaged bytes lead to
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UserError(f"{path}: cannot be read as a workbook ({said})") from None
    if not any(table.columns for table in found.values()):
        notes = [fault for table in found.values() for fault in table.faults.values()][:1]
        notes += [f"sheet {title!r} is hidden" for title in hidden]
        said = f" ({'; '.join(notes)})" if notes else ""
        raise UserError(f"{path}: no sheet has two columns of numbers side by side{said}")
    return Workbook({title: table for title, table in found.items() if table.columns}, hidden)


def _rows(where: str, sheet: Any) -> list[tuple[int, tuple[Any, ...]]]:
    """The filled rows of a sheet, each with its number and without the empty cells behind."""
    sheet.reset_dimensions()  # what a sheet says of its size may be anything
    rows, width = [], 0
    for number, cells in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > _LAST_ROW:
            raise UserError(
                f"{where}: it has rows beyond {_LAST_ROW:,}; a sheet has none there, so that the file is damaged"
            )
        if not cells:
            continue
        while cells and cells[-1] is None:
            cells = cells[:-1]
        if cells:
            width = max(width, len(cells))
            rows.append((number, cells))
            ask(where, cells=(number - rows[0][0] + 1) * width)
    return rows


def _is_number(cell: Any) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool) and cell == cell


def _found(where: str, rows: list[tuple[int, tuple[Any, ...]]]) -> Found | None:
    """Columns of numbers of a sheet, and what is wrong with others; None where fewer than two stand side by side."""
    filled = [k for k, (_, cells) in enumerate(rows) if sum(map(_is_number, cells)) >= 2]
    if not filled:
        return None
    first, last = rows[filled[0]][0], rows[filled[-1]][0]
    above = dict(rows[: filled[0]])
    table = {number: cells for number, cells in rows if first <= number <= last}
    columns: dict[str, np.ndarray] = {}
    faults: dict[str, str] = {}
    names: list[str] = []
    for position in range(max(len(cells) for cells in table.values())):
        cells = [_cell(table.get(number, ()), position) for number in range(first, last + 1)]
        heads = [said for k in (first - 2, first - 1) if (said := str(_cell(above.get(k, ()), position) or "").strip())]
        if not heads and not any(map(_is_number, cells)):
            continue
        name = heads[0] + (f" [{heads[1].strip('[]()')}]" if len(heads) > 1 else "") if heads else str(position + 1)
        if name in names:
            name = f"{name} ({position + 1})"
        names.append(name)
        wrong = next((k for k, cell in enumerate(cells) if not _is_number(cell)), None)
        if wrong is None:
            try:
                columns[name] = np.array(cells, dtype=float)
                continue
            except OverflowError:
                wrong = 0
        said = "is empty" if cells[wrong] is None else f"holds {str(cells[wrong])[:40]!r}"
        faults[name] = f"{where}, row {first + wrong}, column {position + 1} {said}; a number is wanted in every row"
    return Found(columns, faults, names)


def _cell(cells: tuple[Any, ...], position: int) -> Any:
    return cells[position] if position < len(cells) else None
