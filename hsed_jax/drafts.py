"""Writing of files: completely or not at all, and never through a symbolic link. A run folder may come from another person,
and a link in it would redirect the writing to another file of the user.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    import xarray as xr


def create(path: Path) -> BinaryIO:
    """Open a new file for writing; it replaces a file or a link of the same name.

    Raises:
        OSError: it cannot be created, or another process creates the name at the same moment.
    """
    path.unlink(missing_ok=True)
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666), "wb")


def extend(path: Path) -> BinaryIO:
    """Open a file to write at its end; it is created if it is missing.

    Raises:
        OSError: it cannot be opened, or it is a symbolic link.
    """
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666), "ab")


def write_whole(path: Path, content: str | bytes, draft: str = ".part") -> None:
    """Write a file so that a kill leaves either the old or the new one.

    Arguments:
        path: of the file.
        content: of it; a text is written in UTF-8, with its line ends as they are.
        draft: ending of the name of the unfinished file; several writers need different ones.
    """
    unfinished = path.with_name(path.name + draft)
    with create(unfinished) as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def write_netcdf(path: Path, content: "xr.Dataset | xr.DataTree") -> None:
    """Write a NetCDF file so that a kill, or a full disk, leaves either the old or the new one."""
    from dask import config

    # Made in memory: HDF5 takes the process with it where a disk is full.  Nothing of it is a cluster's, whose locks want a path.
    with config.set(scheduler="synchronous"):
        write_whole(path, bytes(content.to_netcdf(engine="h5netcdf")))


def first_link(folder: Path, names: Iterable[str]) -> Path | None:
    """The first symbolic link among some entries of a folder and their contents; None without one."""
    for path in (folder / name for name in names):
        if path.is_symlink():
            return path
        for where, folders, files in os.walk(path):
            found = [Path(where, name) for name in (*folders, *files) if Path(where, name).is_symlink()]
            if found:
                return found[0]
    return None
