"""The beginning of a declared record: titles above the names of its columns, and a row of units below them.

The declaration names the wanted columns, so the row with their names is known and nothing is guessed.  Lines above it are no
data; a row of numbers there is refused.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from itertools import islice
from pathlib import Path

from hsed_jax.errors import UserError
from hsed_jax.measurements.sheets import NUMBER, is_comment, kind_of, lines_of
from hsed_jax.measurements.spelled import is_unit, spelled_unit
from hsed_jax.measurements.units import parse_unit
from hsed_jax.plain import shown

DELIMITERS = (";", "\t", ",", None)
_ABOVE = 60  # lines that may stand above the names


def titles_above(
    path: Path, text: str, wanted: Iterable[str], skipped: int, cells: Callable[[str, str | None], list[str]]
) -> int:
    """Number of lines above the names of the columns, or above the numbers of a table without names.

    Arguments:
        path: the file, for messages.
        text: from its first row that is neither blank nor a comment.
        wanted: columns that the record should have.
        skipped: lines before the text.
        cells: the parts of a line between separators.

    Raises:
        UserError: a row of numbers stands above the names.
    """
    lines, wanted = list(islice(lines_of(text), _ABOVE)), set(wanted)
    hits = [
        0 if is_comment(line) else max(named_columns(line, lines[k + 1 : k + 2], wanted, d, cells) for d in DELIMITERS)
        for k, line in enumerate(lines)
    ]
    if hits[0] or not wanted:
        return 0
    if max(hits) > 0:
        above = hits.index(max(hits))
        for k, line in enumerate(lines[:above]):
            if not is_comment(line) and _is_row_of_numbers(line, cells):
                raise UserError(
                    f"{path}, row {skipped + k + 1}: a row of numbers stands above the names of the columns in row "
                    f"{skipped + above + 1}; correct this row, or keep one table in the file"
                )
        return above
    if not all(column.isdecimal() for column in wanted):
        return 0
    # By their positions: the first row with as many numbers as the following ones, below titles of another width.
    above = next((k for k, line in enumerate(lines) if not is_comment(line) and _is_row_of_numbers(line, cells)), 0)
    widths = [max(len(_filled(line, d, cells)) for d in DELIMITERS) for line in (lines[0], lines[above])]
    return above if widths[0] != widths[1] else 0


def named_columns(
    line: str,
    following: Sequence[str],
    wanted: Set[str],
    delimiter: str | None,
    cells: Callable[[str, str | None], list[str]],
) -> int:
    """Number of wanted columns that a line names between separators. Blanks separate only if they do so in the next
    line: ``U [mm],F [kN]`` names no column ``U``.
    """
    own = [cell.strip() for cell in cells(line.rstrip("\r\n"), delimiter)]
    if delimiter is None and any(len(cells(other.rstrip("\r\n"), None)) != len(own) for other in following):
        return 0
    return len(wanted & {*own})


def row_of_units(row: Sequence[str], positions: Sequence[int]) -> dict[int, str]:
    """The units in a row by the position of their column; empty if it is not a row of units.

    Arguments:
        row: cells below the names.
        positions: of the columns that are wanted.
    """
    cells = {k: row[k].strip() for k in positions if k < len(row)}
    filled = {k: cell for k, cell in cells.items() if cell}
    is_one = filled and all(is_unit(cell) and kind_of(cell) != NUMBER for cell in filled.values())
    return filled if is_one and not any(kind_of(cell) == NUMBER for cell in row) else {}


def ask_of_units(path: Path, told: Mapping[str, str], declared: Mapping[str, str]) -> None:
    """Refuse a row of units that contradicts the declaration.

    Arguments:
        path: the file.
        told: unit by column, as the file writes it.
        declared: unit by column, as the campaign declares it.

    Raises:
        UserError: with both units.
    """
    for column, text in told.items():
        if column not in declared:
            continue
        bare = text.strip("[](){}<> ")
        try:
            own, said = parse_unit(declared[column]), parse_unit(spelled_unit(text) or bare)
            agree = (own.factor, own.si) == (said.factor, said.si)
        except UserError:  # a unit of another quantity than those of the channels
            agree = False
        if not agree:
            raise UserError(
                f"{path}, column {column!r}: its row of units says {shown(bare)}, the campaign declares the unit "
                f"{declared[column]!r}; correct the one that is wrong"
            )


def _is_row_of_numbers(line: str, cells: Callable[[str, str | None], list[str]]) -> bool:
    for delimiter in DELIMITERS:
        filled = _filled(line, delimiter, cells)
        if len(filled) > 1 and all(kind_of(cell) == NUMBER for cell in filled):
            return True
    return False


def _filled(line: str, delimiter: str | None, cells: Callable[[str, str | None], list[str]]) -> list[str]:
    return [cell.strip() for cell in cells(line.rstrip("\r\n"), delimiter) if cell.strip()]
