"""Files that are there whole or not at all."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr


def write_whole(path: Path, text: str, draft: str = ".part") -> None:
    """Write a file so that a kill leaves either the old or the new one.

    Arguments:
        path: of the file.
        text: its content; line ends are kept as they are.
        draft: what the name of the unfinished file ends in; of each writer its own, where there are several.
    """
    unfinished = path.with_name(path.name + draft)
    with unfinished.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def write_netcdf(path: Path, content: "xr.Dataset | xr.DataTree") -> None:
    """Write a NetCDF file so that a kill, or a full disk, leaves either the old or the new one."""
    from dask import config

    unfinished = path.with_name(path.name + ".part")
    # Made in memory: HDF5 takes the process with it where a disk is full.  Nothing of it is a cluster's, whose locks want a path.
    with config.set(scheduler="synchronous"):
        unfinished.write_bytes(content.to_netcdf(engine="h5netcdf"))
    unfinished.replace(path)
