"""Tables as spreadsheets and data loggers write them: the result is numbers, and every fault has its row and column."""

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.budget import ask
from hsed_jax.measurements.heads import DELIMITERS, named_columns, row_of_units, titles_above
from hsed_jax.measurements.layout import table_in
from hsed_jax.measurements.sheets import (
    EITHER,
    NOT_FINITE,
    NUMBER_WITH_COMMA,
    NUMBER_WITH_POINT,
    THOUSANDS,
    is_comment,
    lines_of,
    read_text,
    sheet_of,
)
from hsed_jax.plain import shown

_SPREADSHEET_ERROR = re.compile(r"#([A-Z0-9/]+[!?]|N/A|NV|N/D|#+)")
_DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}.*|\d{1,2}[- ][A-Za-z]{3}.*|\d{1,2}:\d{2}.*")


@dataclass(frozen=True)
class Table:
    """Cells of a text table.

    Attributes:
        path: The file.
        columns: Header of each column, blank where the header cell is; the position from 1 without a header.
        rows: Cells by row, as many as there are columns.
        row_numbers: Row of each, from 1, as a spreadsheet shows it.
        decimal_comma: Whether numbers may have a decimal comma (the separator is not a comma).
        has_header: Whether the file names its columns.
        units: Unit by column of a row of units below the names, as it is written; empty without such a row.
    """

    path: Path
    columns: tuple[str, ...]
    rows: list[list[str]]
    row_numbers: list[int]
    decimal_comma: bool
    has_header: bool
    units: Mapping[str, str] = field(default_factory=dict)

    def where(self, row: int, column: str | None = None) -> str:
        """Return the position of the cell in `rows[row]`, for a message."""
        return f"{self.path}, row {self.row_numbers[row]}" + ("" if column is None else f", column {column!r}")

    def position(self, column: str) -> int:
        """Return the position of a column.

        Raises:
            UserError: It is missing or there are two.
        """
        count = self.columns.count(column)
        if count == 1:
            return self.columns.index(column)
        if not self.has_header and column.isdecimal() and 1 <= int(column) <= len(self.columns):
            return int(column) - 1
        if count > 1:
            raise UserError(
                f"{self.path}: the header names column {column!r} {count} times; names of columns must differ"
            )
        found = _named(self.columns)
        note = "" if self.has_header else " (the file has no header: give the position of the column)"
        if self.has_header and column.isdecimal():
            note = " (the file has a header: give the name of the column)"
        blank = "; a header cell is empty (a merged cell?)" if "" in self.columns else ""
        raise UserError(f"{self.path}: column {column!r} is missing; the columns are {found}{note}{blank}")

    def text(self, row: int, column: str) -> str:
        """Return a cell without blanks around it, empty where the table has no such column."""
        return self.rows[row][self.position(column)].strip() if column in self.columns else ""

    def uses_decimal_comma(self, columns: Iterable[str]) -> bool:
        """Return whether the numbers in these columns are written with a decimal comma.

        Raises:
            UserError: The mark in them may also separate thousands, and no number of the file decides.
        """
        if not self.decimal_comma:
            return False
        positions = [self.position(c) for c in columns]
        comma = any(
            "," in row[i] and NUMBER_WITH_COMMA.fullmatch(row[i].strip()) for row in self.rows for i in positions
        )
        mark, pattern = (",", NUMBER_WITH_COMMA) if comma else (".", NUMBER_WITH_POINT)
        doubtful = next(self._marked(positions, mark, EITHER), None)
        if doubtful is not None:
            every = range(len(self.columns))
            is_decimal = (not EITHER.fullmatch(cell) for *_, cell in self._marked(every, mark, pattern))
            if not any(is_decimal):
                row, position, cell = doubtful
                number = cell.replace(",", ".")
                raise UserError(
                    f"{self.where(row, self.columns[position])}: {shown(cell)} is {number} with a decimal "
                    f"{'comma' if comma else 'point'} and {number.replace('.', '')} with thousands separators, and no other "
                    "number of the file decides; write numbers without thousands separators, at least one of them with more or "
                    "fewer than three decimals"
                )
        return comma

    def _marked(self, positions: Iterable[int], mark: str, pattern: re.Pattern) -> Iterator[tuple[int, int, str]]:
        """Cells with a mark that are of a pattern: row, position, text."""
        for i, row in enumerate(self.rows):
            for position in positions:
                if mark in row[position] and pattern.fullmatch(cell := row[position].strip()):
                    yield i, position, cell

    def number(self, row: int, column: str, comma: bool) -> float:
        """Return a cell as a number; `comma` says that the decimal mark is a comma.

        Raises:
            UserError: The cell is not a number; the message describes its content.
        """
        return self._number(row, column, self.rows[row][self.position(column)].strip(), comma)

    def numbers(self, columns: Iterable[str]) -> dict[str, np.ndarray]:
        """Return whole columns as numbers, each (rows,).

        Raises:
            UserError: A column is missing, or a cell is not a number.
        """
        columns = list(columns)
        comma = self.uses_decimal_comma(columns)
        return {column: self.vector(column, comma) for column in columns}

    def vector(self, column: str, comma: bool) -> np.ndarray:
        """Return a whole column as numbers, (rows,); `comma` says that the decimal mark is a comma.

        Raises:
            UserError: The column is missing, or a cell is not a number.
        """
        position = self.position(column)
        cells = [row[position].strip() for row in self.rows]
        try:
            if comma or not set("".join(cells)) <= set("0123456789+-.eE"):
                raise ValueError
            return np.array([float(cell) for cell in cells])
        except ValueError:
            return np.array([self._number(i, column, cell, comma) for i, cell in enumerate(cells)])

    def _number(self, row: int, column: str, cell: str, comma: bool) -> float:
        if NOT_FINITE.fullmatch(cell):
            return float(cell)
        if NUMBER_WITH_POINT.fullmatch(cell) and not (comma and "." in cell):
            return float(cell.replace("d", "e").replace("D", "e"))
        if comma and NUMBER_WITH_COMMA.fullmatch(cell):
            return float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))
        raise UserError(f"{self.where(row, column)}: {self._fault(cell, comma)}")

    def _fault(self, cell: str, comma: bool) -> str:
        said = shown(cell)
        if not cell:
            return "the cell is empty; write a number, or nan where a sample is missing"
        if comma and NUMBER_WITH_POINT.fullmatch(cell):
            return f"{said} has a decimal point where other cells have a decimal comma; use one of them throughout"
        if _SPREADSHEET_ERROR.fullmatch(cell):
            return f"{said} is an error of the spreadsheet; correct its formula or write a number"
        if NUMBER_WITH_COMMA.fullmatch(cell) or THOUSANDS.fullmatch(cell):
            return (
                f"{said} has a decimal comma or thousands separators; write a decimal point and no thousands "
                "separators (a decimal comma is read where semicolons or tabs separate the columns)"
            )
        if _DATE.fullmatch(cell):
            return f"{said} is a date or a time of day; format the column as a number"
        return f"{said} is not a number; write digits, a decimal point and no unit"


# Columns that a message names; a damaged file may have thousands.
_NAMED = 25


def can_head_record(name: str) -> bool:
    """Return whether a text can be the name of a column: no number, comment or separator."""
    return any(c.isalnum() for c in name) and not is_number(name) and not name.startswith(("#", "%", "//", "sep="))


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, with either decimal mark; a row of such cells is not a header."""
    return any(pattern.fullmatch(cell) for pattern in (NUMBER_WITH_POINT, NUMBER_WITH_COMMA, NOT_FINITE))


def read_experiment_table(path: Path) -> Table:
    """Read experiments.csv: commas, semicolons or tabs, whichever the header with `id` shows.

    Raises:
        UserError: With file and row: not text, empty, ragged rows, unnamed or repeated columns.
    """
    text, skipped = _without_preamble(path, read_text(path))[:2]
    candidates = [_split(path, text, delimiter, skipped) for delimiter in ",;\t" if "id" in _header(text, delimiter)]
    if not candidates:
        found = _named(max((_header(text, d) for d in ",;\t"), key=len))
        raise UserError(f"{path}, row {skipped + 1}: column 'id' is missing; the columns are {found}")
    delimiter, rows, numbers = max(candidates, key=lambda c: len(c[1][0]))
    columns = _trimmed([cell.strip() for cell in rows[0]])
    filled = [i for i, row in enumerate(rows[1:], 1) if any(cell.strip() for cell in row)]
    for i in filled:
        rows[i] = _fitted(path, numbers[i], rows[i], len(columns))
    for i, column in enumerate(columns):
        if not column:
            raise UserError(
                f"{path}, row {numbers[0]}: the header of column {i + 1} is empty (a merged cell?); name it"
            )
        if columns.count(column) > 1:
            raise UserError(f"{path}, row {numbers[0]}: column {column!r} appears twice; names of columns must differ")
    return Table(path, tuple(columns), [rows[i] for i in filled], [numbers[i] for i in filled], delimiter != ",", True)


def read_record_table(path: Path, wanted: Iterable[str]) -> Table:
    """Read a record: commas, semicolons, tabs or blanks; comment lines, titles, a header or none, a row of units or none.

    Arguments:
        path: The file.
        wanted: Columns that the record should have: they determine the separator and the position of the header.

    Raises:
        UserError: With file and row: not text, empty, ragged rows, numbers above the header.
    """
    text, skipped, comment = _without_preamble(path, read_text(path))
    wanted = set(wanted)
    if above := titles_above(path, text, wanted, skipped, _cells):
        text, skipped = "".join(islice(lines_of(text), above, None)), skipped + above
    present = [d for d in DELIMITERS if len(_header(text, d)) > 1]
    head, *following = islice(lines_of(text), 2)
    meant = max([*present, ","], key=lambda d: named_columns(head, following, wanted, d, _cells))
    delimiter, rows, numbers = _split(path, text, meant, skipped)
    keep = [i for i, row in enumerate(rows) if row and not (i and is_comment(",".join(row)))]
    while keep and not any(cell.strip() for cell in rows[keep[-1]]):
        keep.pop()  # the empty rows that a spreadsheet leaves below the table
    rows, numbers = [rows[i] for i in keep], [numbers[i] for i in keep]
    first = _trimmed([cell.strip() for cell in rows[0]])
    has_header = not all(is_number(cell) for cell in first)
    units: dict[str, str] = {}
    if has_header:
        columns, rows, numbers = first, rows[1:], numbers[1:]
        _ask_of_names(path, columns, wanted)
        told = row_of_units(rows[0], [k for k, column in enumerate(columns) if column in wanted]) if rows else {}
        units = {columns[k]: unit for k, unit in told.items()}
        # A row of units and blank rows above the numbers are not samples.
        start = next((k for k in range(len(told) > 0, len(rows)) if any(map(str.strip, rows[k]))), len(rows))
        rows, numbers = rows[start:], numbers[start:]
    else:
        named = [c.strip() for c in _cells(comment, delimiter)]  # numpy.savetxt heads its columns in a comment
        columns = named if len(named) == len(first) else [str(i + 1) for i in range(len(first))]
    if not rows:
        raise UserError(f"{path}: there is a header and no data; a record has at least one sample")
    width = max(len(columns), *(len(row) for row in rows)) if "" in columns else len(columns)
    columns += [""] * (width - len(columns))
    fitted = [_fitted(path, n, row, width) for n, row in zip(numbers, rows, strict=True)]
    return Table(path, tuple(columns), fitted, numbers, delimiter in (";", "\t"), has_header, units)


def _ask_of_names(path: Path, columns: list[str], wanted: Set[str]) -> None:
    """Refuse a text in which no row names a wanted column, with the names that it has instead.

    Raises:
        UserError: with the names.
    """
    if not wanted or wanted & {*columns} or all(column.isdecimal() for column in wanted):
        return
    laid = table_in(sheet_of(path))
    names = columns if laid is None or not laid.is_named else laid.names
    missing = next(column for column in sorted(wanted) if not column.isdecimal())
    raise UserError(f"{path}: column {missing!r} is missing; the columns are {_named(names)}")


def _named(columns: Sequence[str]) -> str:
    """The names of columns in a message."""
    there = [shown(column) for column in columns if column]
    return ", ".join(there[:_NAMED]) + (f" and {len(there) - _NAMED} more" if len(there) > _NAMED else "")


def _without_preamble(path: Path, text: str) -> tuple[str, int, str]:
    """Return the text from the first row that is neither blank nor comment, the rows before it, the last comment."""
    comment, start = "", 0
    for skipped, line in enumerate(lines_of(text)):
        bare = line.strip()
        if is_comment(bare):
            comment = bare.lstrip("#%/ \t")
        elif bare.strip(",;") and not re.fullmatch(r"sep=.", bare):  # Excel's own first line names the separator
            return text[start:], skipped, comment
        start += len(line)
    raise UserError(f"{path}: the file has no data")


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:  # a cell beyond any length; `_split` finds the row
        return [line]


def _header(text: str, delimiter: str | None) -> list[str]:
    return [cell.strip() for cell in _cells(next(lines_of(text)).rstrip("\r\n"), delimiter)]


def _split(path: Path, text: str, delimiter: str | None, skipped: int) -> tuple[str | None, list[list[str]], list[int]]:
    """Return the delimiter, the cells by row, and the row numbers of a spreadsheet."""
    lines = text.count("\n") + text.count("\r")
    ask(path, cells=lines + (text.count(delimiter) if delimiter else sum(1 for _ in re.finditer(r"\S+", text))))
    if delimiter is None:
        rows = [line.split() for line in lines_of(text)]
    else:
        rows, reader = [], csv.reader(lines_of(text), delimiter=delimiter, strict=True)
        try:
            rows.extend(reader)
        except csv.Error as error:
            raise UserError(
                f"{path}, row {skipped + len(rows) + 1}: cannot be read ({error}); check the quotes"
            ) from None
    return delimiter, rows, list(range(skipped + 1, skipped + len(rows) + 1))


def _trimmed(cells: list[str]) -> list[str]:
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _fitted(path: Path, number: int, row: list[str], width: int) -> list[str]:
    if any(cell.strip() for cell in row[width:]) or len(row) < width:
        filled = max((i + 1 for i, cell in enumerate(row) if cell.strip()), default=0)
        count = len(row) if len(row) < width else filled
        raise UserError(
            f"{path}, row {number}: {count} cells where the header has {width}; every row has one per column"
        )
    return row if len(row) == width else row[:width]
