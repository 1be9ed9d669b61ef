"""Files that are there whole or not at all."""

import os
from pathlib import Path


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
