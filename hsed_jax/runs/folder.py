"""The run folder: the only module that knows its layout.

The journal is append-only, and an event is on the disk before it is used. A run that is killed at any moment therefore loses
no measurements. All other files can be made again from the journal.
"""

import fcntl
import json
import math
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from hsed_jax.drafts import create, extend, first_link, write_netcdf, write_whole
from hsed_jax.errors import UserError
from hsed_jax.plain import dump_yaml
from hsed_jax.runs.provenance import begin_session, end_session
from hsed_jax.runs.reading import mapping

if TYPE_CHECKING:
    import xarray as xr


# The files of a run, which another run may replace; all other files in its folder are the user's.
_OF_A_RUN = (
    "journal.jsonl",
    "provenance.json",
    "study.yaml",
    "campaign",
    "laboratory",
    "reached",
    "results.nc",
    "summary.json",
    "cycles.csv",
    "backbones.csv",
    "figures",
    "report.html",
    "improved.yaml",
    "learned_effect.py",
    "export",
)


class RunFolder:
    """A run folder that this process owns.

    Arguments:
        path: of the folder.
        study: the study with every default written out.
        resume: continue the existing run.
        force: delete the files of the run in it.

    Raises:
        UserError: the folder exists and neither was given, it holds a symbolic link where a run writes, or it belongs to
            another study or another running process.
    """

    def __init__(self, path: str | Path, study: Mapping[str, Any], *, resume: bool = False, force: bool = False):
        self.path = Path(path)
        try:
            occupied = self.path.exists() and (not self.path.is_dir() or any(map(_is_content, self.path.iterdir())))
            # A study alone does not show a run, because `hsed init` writes one beside the measurements.  A lock
            # does not show a run, either, because sweeps have one.
            begun = (self.path / "study.yaml").exists() and (self.path / ".lock").exists()
            if occupied and not (begun or self._journal.exists() or self._provenance.exists()):
                raise UserError(f"{self.path} exists and is not a run folder; choose another --output")
            if resume and not self.path.exists():
                raise UserError(f"{self.path}: there is no run to resume; leave out --resume to start one")
            if occupied and not (resume or force):
                raise UserError(
                    f"{self.path} holds a run already; say --resume to go on with it or --force to replace it"
                )
            self.path.mkdir(parents=True, exist_ok=True)
            self._refuse_links()
            self._lock = self._locked()
        except OSError as error:
            raise UserError(f"{self.path} cannot be written to ({error.strerror}); choose another --output") from None
        try:
            if occupied and force:
                self._clear()
            written = self.path / "study.yaml"
            is_begun = resume and written.exists()
            if is_begun:
                self._agree(mapping(written), dict(study))
            begin_session(self._provenance, study.get("seed"))
            if not is_begun:
                write_whole(written, dump_yaml(dict(study)))
        except BaseException:
            # A notebook may keep an exception, which would keep the lock, too.
            self.close()
            raise

    def close(self) -> None:
        """Let another process have the folder."""
        self._lock.close()

    def record(self, event: str, **content: Any) -> None:
        """Append an event to the journal and flush it to the disk; a number that is not finite is written as null."""
        line = json.dumps(_with_null({"event": event, **content}), allow_nan=False)
        with extend(self._journal) as journal:
            journal.write(f"{line}\n".encode())
            journal.flush()
            os.fsync(journal.fileno())

    def events(self) -> list[dict[str, Any]]:
        """All events so far, null read as NaN; a last line that a kill cut short is dropped from the file, too.

        Raises:
            UserError: the journal is damaged.
        """
        if not self._journal.exists():
            return []
        try:
            whole, _, rest = self._journal.read_bytes().rpartition(b"\n")
        except OSError as error:
            raise self.damaged(f"it cannot be read ({error.strerror})") from None
        events = [self._event(number, line) for number, line in enumerate(whole.split(b"\n"), start=1) if line]
        if rest:
            write_whole(self._journal, whole.decode() + "\n" if whole else "")
        return events

    def _event(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            event = _with_nan(json.loads(line.decode()))
        except (ValueError, RecursionError):
            raise self.damaged(f"line {number} is no event") from None
        if not (isinstance(event, dict) and isinstance(event.get("event"), str)):
            raise self.damaged(f"line {number} is no event")
        return event

    def damaged(self, how: str) -> UserError:
        """Message for an unusable journal, with the remedies."""
        return UserError(
            f"{self._journal}: {how}; restore it from a copy, or begin another run and add the experiments: "
            f"hsed tell STUDY.yaml --output DIR --campaign {self.campaign}"
        )

    def keep(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Store the state of a calculation, instead of its earlier state."""
        self._reached.mkdir(exist_ok=True)
        unfinished = self._reached / f"{name}.part"
        with create(unfinished) as file:
            np.savez(file, *arrays)
        unfinished.replace(self._reached / f"{name}.npz")

    def recall(self, name: str) -> list[np.ndarray] | None:
        """The stored state of a calculation; None without one, or if it cannot be read."""
        path = self._reached / f"{name}.npz"
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
                return list(kept.values())
        except (OSError, ValueError, EOFError, BadZipFile):
            return None

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write `summary.json`: numbers that are not finite are left out."""
        text = json.dumps(_finite(summary), indent=2, ensure_ascii=False, allow_nan=False)
        write_whole(self.path / "summary.json", text + "\n")

    def write_results(self, tree: "xr.DataTree") -> None:
        """Write `results.nc`."""
        write_netcdf(self.path / "results.nc", tree)

    def write_cycles(self, cycles: str, backbones: str) -> None:
        """Write `cycles.csv` and `backbones.csv`."""
        write_whole(self.path / "cycles.csv", cycles)
        write_whole(self.path / "backbones.csv", backbones)

    def write_report(self, page: str) -> None:
        """Write `report.html`."""
        write_whole(self.path / "report.html", page)

    @property
    def campaign(self) -> Path:
        """Folder of the experiments."""
        return self.path / "campaign"

    @property
    def laboratory(self) -> Path:
        """Folder of the folders in which experiments are requested and answered."""
        return laboratory_folder(self.path)

    @property
    def figures(self) -> Path:
        """Folder of the figures."""
        return self.path / "figures"

    @property
    def improved(self) -> Path:
        """The study with the missing effects added."""
        return self.path / "improved.yaml"

    def finish(self) -> None:
        """Record the end of the run, and delete intermediate states, which the results replace."""
        shutil.rmtree(self._reached, ignore_errors=True)
        end_session(self._provenance)

    @property
    def _provenance(self) -> Path:
        return self.path / "provenance.json"

    @property
    def _reached(self) -> Path:
        return self.path / "reached"

    @property
    def _journal(self) -> Path:
        return self.path / "journal.jsonl"

    def _locked(self):
        lock = extend(self.path / ".lock")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise UserError(
                f"{self.path} is in use by another running process; wait for it or choose another --output"
            ) from None
        return lock

    def _refuse_links(self) -> None:
        """Refuse a folder with a link that redirects written files; a record in `laboratory` is read alone."""
        drafts = [path.name for path in self.path.glob("*.part")]
        link = first_link(self.path, [".lock", *drafts, *(name for name in _OF_A_RUN if name != "laboratory")])
        link = link or next((path for path in (self.laboratory, *self.laboratory.glob("*")) if path.is_symlink()), None)
        if link is not None:
            raise UserError(
                f"{link} is a symbolic link, and what the run writes would go elsewhere; replace it by what it leads to, or "
                "choose another --output"
            )

    def _clear(self) -> None:
        for item in self.path.iterdir():
            if item.name in _OF_A_RUN or item.suffix == ".part":
                shutil.rmtree(item) if item.is_dir() and not item.is_symlink() else item.unlink()

    def _agree(self, before: Any, now: Any, path: str = "") -> None:
        """Refuse to mix two studies in one folder; name the first key that differs."""
        if isinstance(before, dict) and isinstance(now, dict):
            for key in {**before, **now}:
                self._agree(before.get(key), now.get(key), f"{path}.{key}".lstrip("."))
        elif before != now:
            raise UserError(
                f"{self.path} holds a run of another study: {path} was {before!r} and is now {now!r}; "
                "resume with the study it was started with, or choose another --output"
            )


def laboratory_folder(path: str | Path) -> Path:
    """The working folder of the laboratory of a run; known before the run exists."""
    return Path(path) / "laboratory"


def write_page(page: str, path: str | Path) -> None:
    """Write a page of several runs; this replaces only a page of this package.

    Raises:
        UserError: the existing file is not such a page, or the page cannot be written.
    """
    from hsed_jax.reporting.page import GENERATOR

    path = Path(path)
    if path.exists() and (
        not path.is_file() or GENERATOR not in path.read_text(encoding="utf-8", errors="replace")[:2000]
    ):
        raise UserError(f"{path} exists and is not a report; choose another --output")
    try:
        write_whole(path, page)
    except OSError as error:
        raise UserError(f"{path} cannot be written ({error.strerror}); choose another --output") from None


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        kept = {str(key): _finite(item) for key, item in value.items()}
        return {key: item for key, item in kept.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _with_null(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _with_null(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_with_null(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _with_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_nan(item) for item in value]
    return math.nan if value is None else value


def _is_content(path: Path) -> bool:
    """Whether a file of a run folder has content: a run that is killed in its first moments leaves a lock and a draft."""
    return path.name != ".lock" and path.suffix != ".part"
