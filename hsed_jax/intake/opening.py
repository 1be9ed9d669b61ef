"""The content of a file of any format: tables of columns with names and units, for the command line and the page."""

from collections.abc import Collection, Iterable
from itertools import chain, count
from pathlib import Path
from typing import NamedTuple

from hsed_jax.errors import UserError
from hsed_jax.intake.cells import found_in_cells
from hsed_jax.intake.found import Found
from hsed_jax.intake.words import is_channel
from hsed_jax.measurements.containers import CONTAINERS
from hsed_jax.measurements.layout import table_in
from hsed_jax.measurements.sheets import read_text, sheet_of
from hsed_jax.plain import shown, stem_of

TEXT = ("csv", "txt", "tsv", "dat", "out", "asc", "prn", "lvm", "tra")
WORKBOOKS = ("xlsx", "xlsm")
FORMATS = (*TEXT, *WORKBOOKS, *CONTAINERS)
"""Endings of files that can be read."""


class Opened(NamedTuple):
    """Tables of a file.

    Attributes:
        tables: by the name of a sheet; of a file that has none, by an empty name.
        notes: omitted parts of the file.
    """

    tables: dict[str, Found]
    notes: list[str]


def opened_file(path: Path) -> Opened:
    """Read the tables of a file.

    Raises:
        UserError: its format is unknown, it cannot be read, exceeds the budget, or has no column of numbers.
    """
    ending = path.suffix.lower().lstrip(".")
    if ending not in FORMATS:
        older = "; save an older workbook as .xlsx" if ending in ("xls", "ods", "xlsb") else ""
        raise UserError(
            f"{path}: files ending in {path.suffix!r} cannot be read; allowed: .{', .'.join(FORMATS)}{older}"
        )
    if ending in WORKBOOKS:
        from hsed_jax.intake.workbooks import read_workbook

        return Opened(*read_workbook(path))
    if ending in TEXT:
        return Opened({"": found_in_text(path)}, [])
    from hsed_jax.intake.arrays import found_in_arrays

    return Opened({"": found_in_arrays(path)}, [])


def found_in_text(path: Path) -> Found:
    """The columns of a file of text.

    Raises:
        UserError: it has none, or the columns of its cells are ambiguous.
    """
    text = read_text(path)
    if text.startswith("LabVIEW Measurement"):
        from hsed_jax.intake.lvm import found_in_lvm

        return found_in_lvm(path, text)
    laid = table_in(sheet_of(path, text), is_channel)
    if laid is None:
        first = next(line for line in text.splitlines() if line.strip())
        raise UserError(f"{path}: no row has numbers; it begins with {shown(first.strip())}")
    return found_in_cells(path, laid)


class Gathered(NamedTuple):
    """The content of some files.

    Attributes:
        records: every table, by the name of a record; files of one column each are one record.
        notes: omitted parts of these files.
        refused: faults of files that cannot be read.
    """

    records: dict[str, Found]
    notes: list[str]
    refused: list[str]

    @property
    def left_out(self) -> list[str]:
        """The unused parts of the files, and the reasons."""
        return [*(f"{said}; the file is left out" for said in self.refused), *self.notes]


def gathered(files: Iterable[Path], sheet: str | None = None) -> Gathered:
    """The content of the files of one call.

    Arguments:
        files: of one specimen.
        sheet: of workbooks, the only one to read.

    Raises:
        UserError: none of them has columns of numbers (the message names the first one), there is no such sheet, or files that
            are columns of one record differ in length.
    """
    records: dict[str, Found] = {}
    notes: list[str] = []
    refused: list[str] = []
    for file in files:
        stem = stem_of(file.name)
        try:
            tables, said = opened_file(file)
            if sheet is not None and (sheet in tables or "" not in tables):
                if sheet not in tables:
                    raise UserError(
                        f"{file}: there is no sheet {shown(sheet)}; sheets with a table: {', '.join(tables)}"
                    )
                said = [*said, *(f"sheet {title!r} is left out" for title in tables if title != sheet)]
                tables = {sheet: tables[sheet]}
        except UserError as mistake:
            refused.append(str(mistake))
            continue
        notes.extend(f"{file}: {line}" for line in said)
        for title, table in tables.items():
            records[_fresh(f"{stem}_{stem_of(title)}" if len(tables) > 1 else stem, records)] = table
    if not records:
        raise UserError(refused[0] if refused else "no file was given")
    if (one := _joined(records)) is not None:
        records = {next(iter(records)): one}
    for id, table in records.items():
        notes.extend(f"record {id!r}: {said}" for said in table.notes)
        notes.extend(f"record {id!r}: column {name!r} is left out: {said}" for name, said in table.faults.items())
    return Gathered(records, notes, refused)


def _fresh(name: str, taken: Collection[str]) -> str:
    """A name that no other record has: `test.csv` and `test.txt` are two."""
    numbered = (f"{name}-{number}" for number in count(2))
    return next(one for one in chain([name], numbered) if one not in taken)


def _joined(tables: dict[str, Found]) -> Found | None:
    """Several files of one column each as one table, each column called like its file where it has no name; None if they are
    not such files.

    Raises:
        UserError: they differ in length.
    """
    if len(tables) < 2 or any(len(found.columns) != 1 or len(found.names) != 1 for found in tables.values()):
        return None
    columns, units, notes = {}, {}, []
    for stem, found in tables.items():
        name = found.names[0]
        own = name if found.is_named else stem
        own = own if own not in columns else f"{own} ({stem})"
        columns[own] = found.columns[name]
        if name in found.units:
            units[own] = found.units[name]
        notes.extend(found.notes)
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{name!r} has {length}" for name, length in lengths.items())
        raise UserError(f"the files are columns of one record and differ in length: {said}")
    return Found(columns, {}, list(columns), units, tuple(notes))
