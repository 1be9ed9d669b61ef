"""The folder that the page may read and write, and nothing outside it."""

import os
from collections.abc import Iterator
from pathlib import Path

from hsed_jax.errors import UserError
from hsed_jax.plain import name_fault, shown

# Largest depth of an offered campaign or run in the folder.
_DEPTH = 3
OFFERED = ("report.html", "study.yaml", "improved.yaml", "summary.json", "results.nc", "learned_effect.py")
"""Files of a run that the page provides."""


class Folder:
    """The folder in which the command was started.

    Arguments:
        root: the folder.

    Raises:
        UserError: there is no such folder.
    """

    def __init__(self, root: str | Path):
        self.root = Path(root).resolve()
        if not self.root.is_dir():
            raise UserError(f"{root}: no such folder")

    def inside(self, *parts: str | Path) -> Path:
        """A path within the folder, with resolved symbolic links.

        Raises:
            UserError: it lies elsewhere.
        """
        said = "/".join(map(str, parts))
        try:
            path = self.root.joinpath(*parts).resolve()
        except (OSError, RuntimeError, ValueError):  # an impossible name, or links in a circle
            path = None
        if path is None or not path.is_relative_to(self.root):
            raise UserError(f"{shown(said)} is not within {self.root}; the page reads and writes nothing outside it")
        return path

    def name(self, path: Path) -> str:
        """A path within the folder, as the page shows it and commands started in the folder take it."""
        return str(path.relative_to(self.root))

    def fresh(self, *parts: str) -> Path:
        """An unused path within the folder: the last part, with a number behind it if necessary.

        Raises:
            UserError: it lies elsewhere.
        """
        path, number = self.inside(*parts), 1
        while path.exists():
            number += 1
            path = self.inside(*parts[:-1], f"{parts[-1]}-{number}")
        return path

    def campaigns(self) -> list[str]:
        """Folders of measurements, those within runs left out."""
        return [self.name(path) for path, files in self._walk() if {"campaign.yaml", "experiments.csv"} <= files]

    def runs(self) -> list[str]:
        """Run folders, the latest first."""
        found = [path for path, files in self._walk() if _is_run(files)]
        return [self.name(path) for path in sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)]

    def studies(self) -> list[Path]:
        """Files in YAML that may be studies, those of runs left out."""
        found = [(path, name) for path, files in self._walk() if not _is_run(files) for name in sorted(files)]
        return [path / name for path, name in found if name.endswith(".yaml") and name != "campaign.yaml"]

    def handed_out(self, run: str, name: str) -> Path:
        """A file of a run that the page provides.

        Raises:
            UserError: there is no such file, or not within the folder.
        """
        folder = self.inside(run)
        if name not in OFFERED or not (folder / "study.yaml").is_file():
            raise UserError(f"{shown(f'{run}/{name}')} is no file of a run")
        path = self.inside(folder, name)
        if not path.is_file():
            raise UserError(f"{shown(f'{run}/{name}')}: there is no such file")
        return path

    def _walk(self) -> Iterator[tuple[Path, set[str]]]:
        """Folders and their files, without links, hidden files and the content of runs."""
        for where, folders, files in os.walk(self.root):
            path = Path(where)
            is_deep = len(path.relative_to(self.root).parts) >= _DEPTH
            folders[:] = [] if is_deep or _is_run(set(files)) else sorted(f for f in folders if not f.startswith("."))
            yield path, set(files)


def checked_name(name: str) -> str:
    """The name of a file that somebody drops.

    Raises:
        UserError: it is a path, hidden, or cannot name a file.
    """
    if (fault := name_fault(name)) or "\\" in name or name.startswith("."):
        raise UserError(f"{shown(name)} cannot be taken: {fault or 'a plain name of a file is wanted'}")
    return name


def _is_run(files: set[str]) -> bool:
    return {"study.yaml", "provenance.json"} <= files
