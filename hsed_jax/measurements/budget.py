"""One memory budget for every reader of measurements: the size of a file's content is counted before it is read.

A file of some kilobytes can declare, or unpack to, more than a machine holds.  Every reader asks first, so no file takes more
than about half a gigabyte of RAM.
"""

import stat
from pathlib import Path

from hsed_jax.errors import UserError

_ONE_BY_ONE = "save it as Parquet or HDF5, of which only the columns of the channels are read"
# A number has 8 bytes, and up to four copies of it exist while a record is made; a cell of text is an object of some 70 bytes.
_MOST = {
    "bytes": (2**26, _ONE_BY_ONE),
    "cells": (5_000_000, _ONE_BY_ONE),
    "numbers": (12_000_000, "thin the record, or split it into several experiments"),
    "parts": (10_000, "keep the channels of one record in it, and nothing else"),
}
MOST = {kind: most for kind, (most, _) in _MOST.items()}
"""Limits for one file: unpacked bytes of a file that is read completely; cells of text; numbers of binary columns;
parts (variables, data sets, groups, columns and sheets).
"""


def ask(where: object, **asked: int) -> None:
    """Refuse content beyond the budget.

    Arguments:
        where: the file, and the place in it, for the message.
        asked: how many of a kind (`MOST`) would be read at least.

    Raises:
        UserError: the content exceeds the budget; the message has both numbers and a remedy.
    """
    for kind, count in asked.items():
        most, advice = _MOST[kind]
        if count > most:
            raise UserError(f"{where}: {count:,} {kind} are more than the allowed {most:,}; {advice}")


def ask_of_file(path: Path, *, whole: bool) -> None:
    """Refuse a path that is not a file, and a file beyond the budget if it is read completely.

    Raises:
        UserError: it is missing, empty, not a file, or too large.
    """
    try:
        about = path.stat()
    except (OSError, ValueError) as error:  # a ValueError for a name with NUL in it
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"{path}: cannot be read ({reason})") from None
    if not stat.S_ISREG(about.st_mode):
        raise UserError(f"{path}: cannot be read (it is no file)")
    if not about.st_size:
        raise UserError(f"{path}: the file is empty")
    if whole:
        ask(path, bytes=about.st_size)
