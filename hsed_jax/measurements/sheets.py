"""A text file as a sheet of cells: its encoding, its separator, its lines; `layout` finds the table in it."""

import csv
import datetime
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hsed_jax.errors import UserError
from hsed_jax.measurements.budget import ask, ask_of_file

# Lines that are examined to find the separator, and rows that may be header and are kept as they were written.
_SAMPLED, _HEADS = 300, 400
# Characters of a very long line that are examined for the separator.
_LONG = 5000
# With the right separator, this share of the cells of a line are numbers.
_LEAST_SHARE = 0.3
NUMBER_WITH_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")
NUMBER_WITH_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eEdD][+-]?\d+)?")
NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
# A number that may have three decimals or a thousands separator.
EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_LINE_WITH_ERROR = re.compile(r"#([A-Z0-9/]+[!?]|N/A|NV|N/D)(\s*[,;\t ]|\s*$)|##+\s*[,;\t]")
_NUMBERS = (int, float, datetime.datetime, datetime.time, datetime.timedelta)
_INTEGER = re.compile(r"[+-]?\d+")
_MISSING = {"n/a", "na", "-", "--", "---", "null", "none", "nil", "missing", "*", "?", "."}
"""Marks of loggers for a missing sample, besides nan and an empty cell."""

BLANK, NUMBER, MISSING, TEXT = range(4)
"""Kinds of a cell. nan counts as a number. Dates and times of day are numbers of seconds."""
STAMP = re.compile(r"((\d{4}-\d{2}-\d{2}|\d{1,2}[./]\d{1,2}[./]\d{2,4})[ T])?\d{1,2}:\d{2}:\d{2}([.,]\d+)?")
"""A time of day, with a date before it or without."""
THOUSANDS = re.compile(r"[+-]?\d{1,3}([.,' \u00a0\u202f]\d{3})+([.,]\d*)?")
"""A number with thousands separators. It is not read as a number, but it shows the separator of the columns."""
_MINUS = re.compile(r"[\u2212\u2012\u2013](?=[\d.,])")


@dataclass
class Sheet:
    """Cells by row.

    Attributes:
        where: the file, and the sheet in it, for messages.
        rows: the cells of each row: texts, and of a workbook numbers, dates, truths and None.
        numbers: of each row, from 1, as an editor or a spreadsheet shows it.
        comments: positions in `rows` of lines that are comments; the marks are taken away.
        delimiter: what separates the cells of a text; None of blanks.
        heads: the first lines of a text as they are written, by their positions in `rows`.
        is_text: whether the cells are texts that may be numbers; a workbook has typed numbers.
    """

    where: str
    rows: Sequence[Sequence[Any]]
    numbers: list[int]
    comments: set[int] = field(default_factory=set)
    delimiter: str | None = ","
    heads: dict[int, str] = field(default_factory=dict)
    is_text: bool = True


def kind_of(cell: Any, is_text: bool = True) -> int:
    """The kind of a cell: blank, a number, the mark of a missing sample, or text (also a number stored as text)."""
    if cell is None:
        return BLANK
    if not isinstance(cell, str):
        return TEXT if isinstance(cell, bool) or not isinstance(cell, _NUMBERS) else NUMBER
    if is_text and cell.isascii() and "_" not in cell:
        try:
            float(cell)
            return NUMBER
        except ValueError:
            pass
    cell = cell.strip()
    if not cell:
        return BLANK
    if not is_text:
        return MISSING if cell.casefold() in _MISSING or NOT_FINITE.fullmatch(cell) else TEXT
    if any(pattern.fullmatch(cell) for pattern in (NUMBER_WITH_POINT, NUMBER_WITH_COMMA, NOT_FINITE, STAMP)):
        return NUMBER
    return MISSING if cell.casefold() in _MISSING else TEXT


def is_missing(cell: Any) -> bool:
    """Whether a cell marks a missing sample."""
    return kind_of(cell) in (BLANK, MISSING)


def sheet_of(path: Path, text: str | None = None) -> Sheet:
    """Read a file of text into cells; `text` is its content, where that has been read.

    Raises:
        UserError: the file cannot be read, is empty, goes beyond the budget, or is not text.
    """
    text = read_text(path) if text is None else text
    ask(path, cells=max(text.count("\n"), text.count("\r")))
    lines = list(lines_of(text))
    bare = [line.strip() for line in lines]
    comments = {k for k, line in enumerate(bare) if is_comment(line)}
    start = next((k for k, line in enumerate(bare) if line), 0)
    if re.fullmatch(r"sep=.", bare[start]):  # Excel's own first line names the separator
        delimiter: str | None = bare[start][-1]
        lines[start], bare[start] = "", ""
    else:
        delimiter = _delimiter([line[:_LONG] for k, line in enumerate(bare) if line and k not in comments])
    ask(path, cells=len(lines) + (text.count(delimiter) if delimiter else sum(1 for _ in re.finditer(r"\S+", text))))
    for k in comments:
        lines[k] = bare[k].lstrip("#%/ \t")
    sheet = Sheet(str(path), [], [], comments, delimiter)
    if delimiter is not None and '"' in text:
        _quoted(sheet, lines, delimiter, comments)
    else:
        # Only the line break is removed: blanks before it may be empty cells behind tabs.
        sheet.rows = [line.split() if delimiter is None else line.rstrip("\r\n").split(delimiter) for line in lines]
        sheet.numbers = list(range(1, len(lines) + 1))
        sheet.heads = {k: lines[k].rstrip("\r\n") for k in range(min(_HEADS, len(lines)))}
    return sheet


def read_text(path: Path) -> str:
    """Read a text file in the encodings that loggers and spreadsheets write.

    Raises:
        UserError: The file cannot be read, is empty or beyond the budget, or is a workbook.
    """
    ask_of_file(path, whole=True)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise UserError(f"{path}: this is a spreadsheet workbook, not text; save it as CSV")
    text = _MINUS.sub("-", _decoded(data))  # some programs write the sign of mathematics, or a dash
    if not text.strip():
        raise UserError(f"{path}: the file is empty")
    return text


def _decoded(data: bytes) -> str:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    start = data[:400]
    for order, name in ((1, "utf-16-le"), (0, "utf-16-be")):  # without a mark, every other byte of a number is zero
        if len(start) >= 8 and start[order::2].count(0) > 0.7 * len(start[order::2]):
            return data.decode(name, errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return _decoded_by_script(data)


def _decoded_by_script(data: bytes) -> str:
    """Shift-JIS if the first block has its typical pairs of bytes, which Western texts hardly have; otherwise the
    encoding of Windows.
    """
    if len(re.findall(rb"[\x81-\x84\x88-\x90\x93-\x9f][\x40-\x7e\x80-\xfc]", data[:20_000])) >= 2:
        try:
            return data.decode("cp932")
        except UnicodeDecodeError:
            pass
    return data.decode("cp1252", errors="replace")


def lines_of(text: str) -> Iterator[str]:
    """Lines with their ends, as a spreadsheet counts them."""
    return (found[0] for found in re.finditer(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+", text))


def is_comment(line: str) -> bool:
    """Whether a line is a comment."""
    # '#DIV/0!' is a cell of a spreadsheet, and must not vanish as a comment.
    line = line.strip()
    return line.startswith(("#", "%", "//")) and not _LINE_WITH_ERROR.match(line)


def _delimiter(lines: list[str]) -> str | None:
    """The separator of the numbers: with it, most cells of most lines are numbers, in rows of one width."""
    # The first lines, because titles come first, and lines spread over the rest.
    rest = lines[len(lines) // 3 :]
    sampled = rest[:: max(1, len(rest) // _SAMPLED)]
    found: list[tuple[float, int, str | None]] = []
    for order, delimiter in enumerate(("\t", ";", ",", None, "|")):
        rows = [_cells(line, delimiter) for line in sampled]
        widths = [len(row) for row in rows]
        usual = max(set(widths), key=widths.count, default=0)
        # The weight of a line is its share of numbers: a column of words, or of times of day, has none.
        score = sum(_share(row) for row in rows if len(row) == usual) / max(len(rows), 1)
        if usual > 1 and score >= _LEAST_SHARE:
            found.append((round(score, 6), -order, delimiter))
    delimiter = max(found)[2] if found else None
    return _not_decimal(lines, delimiter) if delimiter == "," else delimiter


def _share(row: Sequence[str]) -> float:
    filled = [(cell, kind) for cell in row if (kind := kind_of(cell)) != BLANK]
    told = sum(kind in (NUMBER, MISSING) or bool(THOUSANDS.fullmatch(cell.strip())) for cell, kind in filled)
    return told / len(filled) if filled else 0.0


def _not_decimal(lines: list[str], comma: str) -> str | None:
    """Only blanks separate if each line is one number with a decimal comma below one name."""
    rows = [line.split(comma) for line in lines[: 10 * _SAMPLED]]
    numbers = [row for row in rows if all(_INTEGER.fullmatch(cell) for cell in row)]
    names = [row for row in rows if not any(kind_of(cell) == NUMBER for cell in row)]
    is_single = all(len(row) == 2 and not row[1].startswith(("+", "-")) for row in numbers) and names
    return None if is_single and len(numbers) > len(rows) / 2 and len(names[-1]) == 1 else comma


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return [line]


def _quoted(sheet: Sheet, lines: list[str], delimiter: str, comments: set[int]) -> None:
    """Rows of lines with quotes; a quoted cell may contain a line break, but must be closed."""
    at, rows = 0, []
    while at < len(lines):
        end = at + 1
        if at not in comments and lines[at].count('"') % 2:
            closed = next((k for k in range(at + 1, min(at + 6, len(lines))) if lines[k].count('"') % 2), None)
            end = at + 1 if closed is None else closed + 1
        line = "".join(lines[at:end]).rstrip("\r\n")
        try:
            row = next(csv.reader([line], delimiter=delimiter), []) if end == at + 1 else _joined(line, delimiter)
        except csv.Error as error:
            raise UserError(f"{sheet.where}, row {at + 1}: cannot be read ({error}); check the quotes") from None
        if len(rows) < _HEADS:
            sheet.heads[len(rows)] = line
        rows.append(row)
        sheet.numbers.append(at + 1)
        at = end
    sheet.rows = rows
    sheet.comments = {k for k, number in enumerate(sheet.numbers) if number - 1 in comments}


def _joined(line: str, delimiter: str) -> list[str]:
    rows = list(csv.reader(line.splitlines(keepends=True), delimiter=delimiter))
    return [" ".join(cell.split()) for row in rows for cell in row]
