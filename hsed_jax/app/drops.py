"""The storage of dropped files: a folder within the folder of the page, with the unchanged files."""

import os
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from hsed_jax.app.folder import Folder, checked_name
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.intake.opening import Gathered, gathered
from hsed_jax.measurements import Campaign, read_campaign
from hsed_jax.measurements.tables import read_experiment_table
from hsed_jax.plain import stem_of

DROPPED = "dropped"
"""The folder of the unchanged files."""
_CAMPAIGN = ("campaign.yaml", "experiments.csv")


def landed(folder: Folder, files: Mapping[str, bytes], where: Path | None = None) -> Path:
    """Write dropped files into the folder.

    Arguments:
        folder: of the page.
        files: content by name.
        where: the folder of earlier files of the same drop; by default a new one.

    Returns:
        The folder of the files.

    Raises:
        UserError: a name is not allowed, or the files cannot be written.
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
    """Remove unusable dropped files, and the folder that was made for them if it is empty."""
    for name in names:
        folder.inside(where, DROPPED, name).unlink(missing_ok=True)
    with suppress(OSError):  # something else is in it
        (where / DROPPED).rmdir()
        where.rmdir()


def is_campaign(names: Collection[str]) -> bool:
    """Whether dropped files are a campaign, with its own declaration.

    Raises:
        UserError: they are an incomplete campaign; the message has the missing files.
    """
    missing = [name for name in _CAMPAIGN if name not in names]
    if len(missing) == 1:
        raise UserError(f"these are files of a campaign; drop its {missing[0]}, too")
    return not missing


def lay_out(folder: Folder, where: Path) -> Campaign:
    """Put the files of a dropped campaign at the paths in its table of experiments, and read it.

    Raises:
        UserError: it cannot be read, is not complete, or names a place outside the campaign; no file was moved.
    """
    # An incomplete campaign leaves nothing behind, because its next file may follow.
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
    """A campaign in the folder, and its path.

    Raises:
        UserError: it is damaged, or one of its records is outside the folder.
    """
    where = folder.inside(name)
    table = read_experiment_table(folder.inside(where, "experiments.csv"))
    for row in range(len(table.rows)):
        folder.inside(where, table.text(row, "record").replace("\\", "/"))
    for file in (folder.inside(where, "campaign.yaml"), *where.glob("records/*")):
        folder.inside(file)
    return where, read_campaign(where)


def tables(where: Path) -> Gathered:
    """The content of the dropped files.

    Raises:
        UserError: none of them has columns of numbers; the message names the first one.
    """
    dropped = where / DROPPED
    with _as_dropped(dropped):
        records, notes, refused = gathered(sorted(dropped.iterdir()))
    return Gathered(records, [_named(said, dropped) for said in notes], [_named(said, dropped) for said in refused])


@contextmanager
def _as_dropped(place: Path, name: str = "") -> Iterator[None]:
    """A context in which messages have the name of a dropped file or folder instead of its path."""
    try:
        yield
    except UserError as error:
        raise UserError(_named(str(error), place, name)) from None


def _named(said: str, place: Path, name: str = "") -> str:
    """A message with the name of a folder instead of its path, or without it."""
    return said.replace(str(place), name) if name else said.replace(f"{place}{os.sep}", "")
