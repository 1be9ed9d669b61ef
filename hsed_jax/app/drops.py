"""What becomes of dropped files: a folder within the folder of the page, the files in it as they came."""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import pandas as pd

from hsed_jax.app.folder import Folder, checked_name, stem_of
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, numeric_columns, read_campaign
from hsed_jax.measurements.tables import read_experiment_table

DROPPED = "dropped"
"""Where the files lie as they came."""
WORKBOOKS = (".xlsx", ".xlsm")
_CAMPAIGN = ("campaign.yaml", "experiments.csv")

Columns = dict[str, np.ndarray]


def landed(folder: Folder, files: Mapping[str, bytes], where: Path | None = None) -> Path:
    """Write dropped files into the folder.

    Arguments:
        folder: of the page.
        files: content by name.
        where: the folder that earlier ones of the same drop went to; by default a new one.

    Returns:
        The folder that they went to.

    Raises:
        UserError: a name is none, or the disk does not take them.
    """
    names = [checked_name(name) for name in files]
    if where is None:
        records = [name for name in names if name not in _CAMPAIGN]
        where = folder.fresh("campaign" if len(records) < len(names) or not records else stem_of(records[0]))
    place = folder.inside(where, DROPPED)
    try:
        place.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            write_whole(folder.inside(place, name), content)
    except OSError as error:
        raise UserError(f"{folder.name(where)}: cannot be written ({error.strerror})") from None
    return where


def taken_back(folder: Folder, where: Path, names: Iterable[str]) -> None:
    """Remove files that were dropped and cannot be used, and the folder that was made for them if nothing else is in it."""
    for name in names:
        folder.inside(where, DROPPED, name).unlink(missing_ok=True)
    with suppress(OSError):  # something else is in it
        (where / DROPPED).rmdir()
        where.rmdir()


def is_campaign(where: Path) -> bool:
    """Whether what was dropped is a campaign: it says itself what it is."""
    return all((where / DROPPED / name).is_file() for name in _CAMPAIGN)


def lay_out(folder: Folder, where: Path) -> None:
    """Put the files of a dropped campaign where its table of experiments says that they are.

    Raises:
        UserError: the table cannot be read, or names a place outside the campaign.
    """
    dropped = where / DROPPED
    for name in _CAMPAIGN:
        shutil.copyfile(dropped / name, folder.inside(where, name))
    table = read_experiment_table(where / "experiments.csv")
    said = [table.text(row, "record").replace("\\", "/") for row in range(len(table.rows))]
    places = {Path(name).name: name for name in said if name}
    for file in sorted(dropped.iterdir()):
        if file.name in _CAMPAIGN:
            continue
        place = folder.inside(where, places.get(file.name, f"records/{file.name}"))
        if not place.is_relative_to(where):
            raise UserError(f"experiments.csv names the record {places[file.name]!r}, which is outside the campaign")
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)


def read_within(folder: Folder, name: str) -> tuple[Path, Campaign]:
    """A campaign that lies in the folder, and where.

    Raises:
        UserError: it is damaged, or one of its records lies outside the folder.
    """
    where = folder.inside(name)
    table = read_experiment_table(folder.inside(where, "experiments.csv"))
    for row in range(len(table.rows)):
        folder.inside(where, table.text(row, "record").replace("\\", "/"))
    for file in (folder.inside(where, "campaign.yaml"), *where.glob("records/*")):
        folder.inside(file)
    return where, read_campaign(where)


def tables(where: Path) -> dict[str, Columns]:
    """Columns of numbers by the name of a record: of every file that was dropped, and of every sheet of a workbook.

    Raises:
        UserError: a file has none; the message names it.
    """
    found: dict[str, Columns] = {}
    for file in sorted((where / DROPPED).iterdir()):
        if file.suffix.lower() in WORKBOOKS:
            found |= _sheets(file)
        else:
            with _as_dropped(file):
                found[stem_of(file.name)] = numeric_columns(file)
    return found


@contextmanager
def _as_dropped(file: Path) -> Iterator[None]:
    """Within, a message names a file as it was dropped, not where it lies."""
    try:
        yield
    except UserError as error:
        raise UserError(str(error).replace(str(file), file.name)) from None


def _sheets(file: Path) -> dict[str, Columns]:
    """Sheets with columns of numbers; above them the last row is their names, and one below it their units."""
    try:
        sheets = pd.read_excel(file, sheet_name=None, header=None, engine="openpyxl")
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise UserError(f"{file.name}: cannot be read as a workbook ({error})") from None
    found, stem = {}, stem_of(file.name)
    for title, sheet in sheets.items():
        if columns := _columns_of(sheet, f"{file.name}, sheet {title!r}"):
            found[stem if len(sheets) == 1 else f"{stem}_{stem_of(str(title))}"] = columns
    if not found:
        raise UserError(f"{file.name}: no sheet has two columns of numbers side by side")
    return found


def _columns_of(sheet: pd.DataFrame, where: str) -> Columns:
    """Columns of numbers of a sheet; none where fewer than two stand side by side."""
    numbers = sheet.map(lambda cell: isinstance(cell, int | float) and not isinstance(cell, bool) and cell == cell)
    filled = numbers.sum(axis=1) >= 2
    if not filled.any():
        return {}
    first, last = int(np.argmax(filled)), len(filled) - int(np.argmax(filled[::-1]))
    columns: Columns = {}
    for position in range(sheet.shape[1]):
        cells = sheet.iloc[first:last, position]
        if not bool(numbers.iloc[first, position]):
            continue
        is_number = numbers.iloc[first:last, position].to_numpy()
        if not is_number.all():
            row = first + int(np.argmin(is_number))
            cell = sheet.iat[row, position]
            said = "is empty" if pd.isna(cell) else f"holds {str(cell)[:40]!r}"
            raise UserError(f"{where}, row {row + 1}, column {position + 1} {said}; a number is wanted in every row")
        above = [str(sheet.iat[row, position]).strip() for row in range(max(0, first - 2), first)]
        heads = [head for head in above if head and head != "nan"]
        name = heads[0] + (f" [{heads[1].strip('[]()')}]" if len(heads) > 1 else "") if heads else str(position + 1)
        columns[name if name not in columns else f"{name} ({position + 1})"] = cells.to_numpy(dtype=float)
    return columns if len(columns) >= 2 else {}
