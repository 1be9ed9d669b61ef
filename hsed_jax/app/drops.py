"""What becomes of dropped files: a folder within the folder of the page, the files in it as they came."""

import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from hsed_jax.app.folder import Folder, checked_name, stem_of
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Found, numeric_columns, read_campaign
from hsed_jax.measurements.tables import read_experiment_table
from hsed_jax.measurements.workbooks import WORKBOOKS, read_workbook

DROPPED = "dropped"
"""Where the files lie as they came."""
_CAMPAIGN = ("campaign.yaml", "experiments.csv")


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


def is_campaign(names: Collection[str]) -> bool:
    """Whether files that were dropped are a campaign, which says itself what it is.

    Raises:
        UserError: they are a part of one; the message says what is missing.
    """
    missing = [name for name in _CAMPAIGN if name not in names]
    if len(missing) == 1:
        raise UserError(f"these are files of a campaign; drop its {missing[0]}, too")
    return not missing


def lay_out(folder: Folder, where: Path) -> Campaign:
    """Put the files of a dropped campaign where its table of experiments says that they are, and read it.

    Raises:
        UserError: it cannot be read, is not complete, or names a place outside the campaign; nothing was put anywhere.
    """
    # Of a campaign that is not complete yet nothing is left: the next file of it may be on its way.
    with TemporaryDirectory(prefix="campaign-") as name, _as_dropped(Path(name), where.name):
        trial = Path(name)
        _put(where, trial)
        read_campaign(trial)
    _put(where, folder.inside(where))
    return read_campaign(where)


def _put(where: Path, target: Path) -> None:
    """Copy dropped files to their places in a folder."""
    dropped = where / DROPPED
    for name in _CAMPAIGN:
        shutil.copyfile(dropped / name, target / name)
    table = read_experiment_table(target / "experiments.csv")
    said = [table.text(row, "record").replace("\\", "/") for row in range(len(table.rows))]
    places = {Path(name).name: name for name in said if name}
    for file in sorted(dropped.iterdir()):
        if file.name in _CAMPAIGN:
            continue
        place = (target / places.get(file.name, f"records/{file.name}")).resolve()
        if not place.is_relative_to(target.resolve()):
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


class Dropped(NamedTuple):
    """What was dropped.

    Attributes:
        records: what every file has, and every sheet of a workbook, by the name of a record.
        notes: what of these files was left out.
        refused: what is wrong with files that cannot be read.
    """

    records: dict[str, Found]
    notes: list[str]
    refused: list[str]

    @property
    def left_out(self) -> list[str]:
        """What of the files is not used, and why."""
        return [*(f"{said}; the file is left out" for said in self.refused), *self.notes]


def tables(where: Path) -> Dropped:
    """What the files that were dropped have.

    Raises:
        UserError: none of them has columns of numbers; the message names the first one.
    """
    dropped = Dropped({}, [], [])
    for file in sorted((where / DROPPED).iterdir()):
        stem = stem_of(file.name)
        try:
            with _as_dropped(file, file.name):
                if file.suffix.lower().lstrip(".") in WORKBOOKS:
                    sheets, hidden = read_workbook(file)
                    of_file = [
                        (f"{stem}_{stem_of(title)}" if len(sheets) > 1 else stem, sheets[title]) for title in sheets
                    ]
                    dropped.notes.extend(f"{file.name}: sheet {title!r} is hidden and is left out" for title in hidden)
                else:
                    of_file = [(stem, numeric_columns(file))]
        except UserError as mistake:
            dropped.refused.append(str(mistake))
            continue
        for name, table in of_file:
            dropped.records[_fresh(name, dropped.records)] = table
    if not dropped.records:
        raise UserError(dropped.refused[0] if dropped.refused else "nothing was dropped")
    for id, table in dropped.records.items():
        dropped.notes.extend(
            f"record {id!r}: column {name!r} is left out: {said}" for name, said in table.faults.items()
        )
    return dropped


def _fresh(name: str, taken: Collection[str]) -> str:
    """A name that no other record has: `test.csv` and `test.txt` are two."""
    numbered = (f"{name}-{number}" for number in count(2))
    return next(one for one in chain([name], numbered) if one not in taken)


@contextmanager
def _as_dropped(place: Path, name: str) -> Iterator[None]:
    """Within, a message names a file or folder as it was dropped, not where it lies."""
    try:
        yield
    except UserError as error:
        raise UserError(str(error).replace(str(place), name)) from None
