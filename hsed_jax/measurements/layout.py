"""The table in a sheet of cells: titles above it, names, units, the rows of numbers, text below it."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from hsed_jax.errors import UserError
from hsed_jax.measurements.sheets import BLANK, MISSING, NUMBER, TEXT, Sheet, kind_of
from hsed_jax.measurements.spelled import is_unit, without_unit
from hsed_jax.plain import shown

# Rows above the numbers that may name their columns, and rows that are examined to find the columns with numbers.
_ABOVE, _SAMPLED = 40, 2000
# A sheet with so many times more columns than rows, so many columns at least and so many rows at most holds its channels in rows.
_LYING, _LEAST_LYING, _MOST_LYING = 3, 16, 100
# A block of so many rows above the names is a table, and not a parameter of the test.
_LEAST_BLOCK = 3


@dataclass
class Laid:
    """A table found in a sheet.

    Attributes:
        names: of the columns, as the file has them; their positions from 1 where it names none.
        units: of each, as the file writes it; empty where it does not.
        is_named: whether the file names its columns.
        rows: positions of the rows of the table in the sheet.
        sheet: the cells; transposed if the channels are in rows. notes: omitted parts and decisions.
    """

    names: list[str]
    units: list[str]
    is_named: bool
    rows: list[int]
    sheet: Sheet
    notes: list[str] = field(default_factory=list)


def table_in(sheet: Sheet, knows: Callable[[str], bool] = lambda name: False) -> Laid | None:
    """Find the table of a sheet; None where no row has a number.

    Arguments:
        sheet: cells.
        knows: whether a text is the name of a channel, which decides between two rows that could be the names.

    Raises:
        UserError: something other than numbers stands between two parts of the table, or its rows differ in width so that a cell
            cannot be assigned to its column; with the row.
    """
    sheet, notes = _turned(sheet)
    counts = [_counted(sheet, k) for k in range(len(sheet.rows))]
    blocks = _blocks(counts)
    if not blocks:
        return None
    longest = max(blocks, key=lambda block: block[1] - block[0])
    columns = _columns_of_numbers(sheet, range(*longest))
    start, end = _trimmed(sheet, longest, columns)
    before = [_trimmed(sheet, block, columns) for block in blocks if block[1] <= longest[0]]
    before = [block for block in before if block[1] - block[0] >= _LEAST_BLOCK]
    after = [_trimmed(sheet, block, columns) for block in blocks if block[0] >= longest[1]]
    parts = [*before, (start, end), *(block for block in after if block[1] > block[0])]
    heads = _header(sheet, parts[0][0], columns, knows)
    for one, other in pairwise(parts):
        notes.append(_joined(sheet, heads, one, other, columns))
    notes.append(_apart(sheet, parts))
    if parts[0][0] > 0 and (said := _bad_rows(sheet, heads, parts[0][0], counts)):
        notes.append(said)
    filled = [k for part in parts for k in range(*part) if any(n for n in counts[k])]
    _ask_of_widths(sheet, filled)
    if said := _below(sheet, parts[-1][1]):
        notes.append(said)
    width = max(len(sheet.rows[k]) for k in filled)
    names, units = _named(sheet, heads, columns, width, filled)
    return Laid(names, units, heads.names is not None, filled, sheet, [note for note in notes if note])


def _turned(sheet: Sheet) -> tuple[Sheet, list[str]]:
    """The sheet, or its transpose where every channel lies in a row."""
    if len(sheet.rows) > _MOST_LYING:
        return sheet, []
    filled = [row for row in sheet.rows if any(kind_of(cell) != BLANK for cell in row)]
    long = [row for row in filled if len(row) >= _LEAST_LYING]
    if not long or max(map(len, long)) < _LYING * len(filled):
        return sheet, []
    width = max(map(len, long))
    rows = [[row[k] if k < len(row) else "" for row in long] for k in range(width)]
    if sum(kind_of(cell, sheet.is_text) == NUMBER for row in rows for cell in row) < width * len(long) / 2:
        return sheet, []
    said = "the channels are in rows, which are read as columns; rows in the messages below are samples"
    return Sheet(sheet.where, rows, list(range(1, width + 1)), delimiter="\t", is_text=sheet.is_text), [said]


def _counted(sheet: Sheet, k: int) -> tuple[int, int, int]:
    """How many numbers, texts and marks of missing samples are in a row."""
    if k in sheet.comments:
        return 0, 1, 0
    kinds = [kind_of(cell, sheet.is_text) for cell in sheet.rows[k]]
    return kinds.count(NUMBER), kinds.count(TEXT), kinds.count(MISSING)


def _blocks(counts: list[tuple[int, int, int]]) -> list[tuple[int, int]]:
    """Runs of rows that hold numbers, and hardly anything else: first, and one behind the last; empty rows do not end one."""
    blocks, start, last = [], None, 0
    for k, (numbers, texts, missing) in enumerate(counts):
        if numbers and texts <= numbers:
            start, last = (k if start is None else start), k
        elif start is not None and (texts or missing):
            blocks.append((start, last + 1))
            start = None
    return blocks if start is None else [*blocks, (start, last + 1)]


def _columns_of_numbers(sheet: Sheet, rows: range) -> list[int]:
    """Columns most of whose filled cells are numbers."""
    sampled = [sheet.rows[k] for k in rows[:: max(1, len(rows) // _SAMPLED)]]
    found = []
    for column in range(max(map(len, sampled))):
        kinds = [kind_of(row[column], sheet.is_text) for row in sampled if column < len(row)]
        numbers = kinds.count(NUMBER)
        if numbers and numbers >= kinds.count(TEXT):
            found.append(column)
    return found


def _is_clean(sheet: Sheet, k: int, columns: Sequence[int]) -> bool:
    row = sheet.rows[k]
    kinds = [kind_of(row[c], sheet.is_text) if c < len(row) else BLANK for c in columns]
    return NUMBER in kinds and TEXT not in kinds and k not in sheet.comments


def _belongs(sheet: Sheet, k: int, columns: Sequence[int]) -> bool:
    """Whether a row with other content is part of the table: it begins with a number, unlike `Max` and `End of test`."""
    row, first = sheet.rows[k], columns[0]
    return first < len(row) and kind_of(row[first], sheet.is_text) == NUMBER and k not in sheet.comments


def _trimmed(sheet: Sheet, block: tuple[int, int], columns: Sequence[int]) -> tuple[int, int]:
    """A block without the rows at both ends that are titles or a footer; a row with a fault stays, so that it is reported."""
    start, end = block
    while start < end and not _is_clean(sheet, start, columns):
        start += 1
    while end > start and not _is_clean(sheet, end - 1, columns):
        end -= 1
    if start == end:
        return start, end
    while start > block[0] and _belongs(sheet, start - 1, columns):
        start -= 1
    while end < block[1] and _belongs(sheet, end, columns):
        end += 1
    return start, end


@dataclass
class _Heads:
    """Positions of the rows with names and with units, and the cells of them."""

    names: int | None
    name_cells: list[str]
    unit_cells: list[str]


def _header(sheet: Sheet, start: int, columns: Sequence[int], knows: Callable[[str], bool]) -> _Heads:
    width = columns[-1] + 1
    above = [k for k in range(start) if any(kind_of(c, sheet.is_text) != BLANK for c in sheet.rows[k])]
    candidates: list[tuple[float, int, int, list[str]]] = []
    unit_row: tuple[int, list[str]] | None = None
    for k in above[-_ABOVE:]:
        cells = _fitted(sheet, k, width)
        words = [cells[c] for c in columns if c < len(cells) and _is_word(cells[c])]
        if not words:
            continue
        if sum(is_unit(cells[c]) for c in columns if c < len(cells)) >= max(1, 0.6 * len(words)) and (
            len(above) > 1 and any(cells[c].strip("[]()-") for c in columns if c < len(cells))
        ):
            unit_row = k, cells
        hits = sum(knows(without_unit(word)[0]) for word in words)
        candidates.append((len(set(words)) / len(columns), hits, k, cells))
    # If a row of names stands above a row of units, the units are not names.
    named = [one for one in candidates if unit_row is None or one[2] != unit_row[0]]
    named = [one for one in named if one[1] or one[0] >= (0.5 if len(one[3]) > 1 else 0.6)]
    if not named and unit_row is not None:
        named, unit_row = [one for one in candidates if one[2] == unit_row[0]], None
    if not named:
        return _Heads(None, [], [])
    # Of equally full rows, take the row with names of channels; of several, the nearest row.
    fullest = max(named, key=lambda one: (min(one[0], 0.99) if one[1] else one[0] * 0.5, one[1], one[2]))
    return _Heads(fullest[2], fullest[3], [] if unit_row is None else unit_row[1])


def _is_word(cell: str) -> bool:
    return bool(cell) and kind_of(cell) in (TEXT, MISSING)


def _fitted(sheet: Sheet, k: int, width: int) -> list[str]:
    """The cells of a row of the header, as texts; if blanks or commas cut names, as many cells as there are columns."""
    cells = ["" if cell is None else " ".join(str(cell).split()) for cell in sheet.rows[k]]
    while cells and not cells[-1]:
        cells.pop()
    line = sheet.heads.get(k, "")
    if len(cells) <= width or not line:
        return cells
    if k in sheet.comments:
        line = line.lstrip("#%/ \t")
    if sheet.delimiter is None:
        tries = [re.split(r"\s{2,}|\t", line.strip()), _bracketed(cells), re.findall(r'"[^"]*"|\S+', line)]
        tries.append([cell.strip() for cell in re.split(r"[,;]", line)])
        return next(([cell.strip('"') for cell in one] for one in tries if len(one) == width), cells)
    if len(cells) == 2 * width and all(map(is_unit, cells[1::2])):
        return [f"{name} [{unit}]" for name, unit in zip(cells[::2], cells[1::2], strict=True)]
    return cells


def _bracketed(cells: list[str]) -> list[str]:
    """Cells separated by blanks, with a unit in brackets joined to the name before it."""
    joined: list[str] = []
    for cell in cells:
        if joined and cell.startswith(("[", "(", "/")):
            joined[-1] += f" {cell}"
        else:
            joined.append(cell)
    return joined


def _joined(sheet: Sheet, heads: _Heads, one: tuple[int, int], other: tuple[int, int], columns: Sequence[int]) -> str:
    """The note on two parts of a table that are one, because the names stand above both.

    Raises:
        UserError: something else is between them.
    """
    between = [k for k in range(one[1], other[0]) if any(kind_of(c, sheet.is_text) != BLANK for c in sheet.rows[k])]
    first = [str(cell).strip() for cell in heads.name_cells]
    for k in between:
        if heads.names is not None and _fitted(sheet, k, columns[-1] + 1) == first:
            return f"row {sheet.numbers[k]} repeats the names of the columns: the parts are read as one record"
    k = between[0]
    raise UserError(
        f"{sheet.where}, row {sheet.numbers[k]}: {_quoted(sheet, k)} stands between rows of numbers, which continue in row "
        f"{sheet.numbers[other[0]]}; correct this row, or keep one table in the file"
    )


def _apart(sheet: Sheet, parts: Sequence[tuple[int, int]]) -> str:
    """The note on a few rows of numbers that an empty row separates from all others; they may be samples or a summary."""
    for start, end in (parts[0], parts[-1]):
        rows = range(start, end)
        empty = [k for k in rows if all(kind_of(cell, sheet.is_text) == BLANK for cell in sheet.rows[k])]
        if not empty:
            continue
        for few, where in ((range(start, empty[0]), "above"), (range(empty[-1] + 1, end), "below")):
            if 0 < len(few) < _LEAST_BLOCK and len(rows) > 4 * _LEAST_BLOCK:
                said = (
                    f"row {sheet.numbers[few[0]]}, {where} an empty row, is read as a sample: {_quoted(sheet, few[0])}"
                )
                return f"{said}; delete it if it is not a sample"
    return ""


def _bad_rows(sheet: Sheet, heads: _Heads, start: int, counts: list[tuple[int, int, int]]) -> str:
    """The note on rows with numbers between the names and the table, which are not read."""
    if heads.names is None:
        return ""
    rows = [k for k in range(heads.names + 1, start) if counts[k][0]]
    if not rows:
        return ""
    return f"row {sheet.numbers[rows[0]]} above the table is left out: {_quoted(sheet, rows[0])}"


def _below(sheet: Sheet, end: int) -> str:
    rows = [k for k in range(end, len(sheet.rows)) if any(kind_of(c, sheet.is_text) != BLANK for c in sheet.rows[k])]
    if not rows:
        return ""
    first, last = sheet.numbers[rows[0]], sheet.numbers[rows[-1]]
    which = f"row {first}" if first == last else f"rows {first} to {last}"
    return f"{which} below the table {'is' if first == last else 'are'} left out: {_quoted(sheet, rows[0])}"


def _quoted(sheet: Sheet, k: int) -> str:
    return shown(" ".join(str(cell) for cell in sheet.rows[k] if cell is not None and str(cell).strip()))


def _ask_of_widths(sheet: Sheet, rows: list[int]) -> None:
    """Refuse rows of different width if blanks separate: the missing cell is unknown.

    Raises:
        UserError: with the first row that differs.
    """
    if sheet.delimiter is not None or not sheet.is_text:
        return
    widths = [len(sheet.rows[k]) for k in rows]
    usual = max(set(widths), key=widths.count)
    wrong = next((k for k, width in zip(rows, widths, strict=True) if width != usual), None)
    if wrong is not None:
        raise UserError(
            f"{sheet.where}, row {sheet.numbers[wrong]}: {len(sheet.rows[wrong])} numbers where other rows have {usual}; blanks "
            "separate the columns, so a missing sample needs a mark, such as nan"
        )


def _ask_of_longer(sheet: Sheet, names: int, count: int, rows: list[int]) -> None:
    """Refuse single rows with more cells than names: the column of each cell is unknown.

    Raises:
        UserError: with the first of them.
    """
    longer = [k for k in rows if any(kind_of(cell) != BLANK for cell in sheet.rows[k][count:])]
    if longer and 2 * len(longer) < len(rows):
        row, filled = sheet.numbers[longer[0]], len(sheet.rows[longer[0]])
        raise UserError(
            f"{sheet.where}, row {row}: {filled} cells where row {sheet.numbers[names]} names {count} columns; correct the row, "
            "or name every column"
        )


def _named(
    sheet: Sheet, heads: _Heads, columns: Sequence[int], width: int, rows: list[int]
) -> tuple[list[str], list[str]]:
    """Names of the columns, each once, and their units; empty names of columns without a cell.

    Raises:
        UserError: the names do not stand above the columns.
    """
    names, units = [], []
    cells = heads.name_cells
    filled = sum(bool(cell) for cell in cells)
    if heads.names is not None and sheet.is_text:
        _ask_of_longer(sheet, heads.names, len(cells), rows)
    if heads.names is not None and (filled > width or len(cells) < columns[-1] + 1) and sheet.is_text:
        raise UserError(
            f"{sheet.where}, row {sheet.numbers[heads.names]}: {filled} names stand above {len(columns)} columns of numbers, so "
            "names and columns cannot be matched; a decimal comma, or a comma or blank in a name, may have been read as a "
            "separator: separate the columns by semicolons or tabs, and name each"
        )
    for column in range(width):
        said = cells[column].strip() if column < len(cells) else ""
        unit = heads.unit_cells[column].strip().strip("[](){}<>").strip() if column < len(heads.unit_cells) else ""
        _, own = without_unit(said)
        if said and unit and not own:
            said = f"{said} [{unit}]"
        if not said and all(
            column >= len(sheet.rows[k]) or kind_of(sheet.rows[k][column], sheet.is_text) == BLANK for k in rows
        ):
            names.append("")
            units.append("")
            continue
        said = said or str(column + 1)
        names.append(f"{said} ({column + 1})" if said in names else said)
        units.append(own or unit)
    return names, units
