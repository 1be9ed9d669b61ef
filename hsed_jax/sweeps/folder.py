"""The folder of a sweep: the only module that knows its layout.

`sweep.yaml` is the plan, `runs/0001` the run folder of the first point and `outcomes/0001.json` how it ended, written by the
process that ran it.  Table, results and figures are made from these files, so a kill at any moment loses at most the running
studies.
"""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hsed_jax.drafts import extend, first_link, write_whole
from hsed_jax.errors import UserError
from hsed_jax.plain import dump_yaml, parse_yaml
from hsed_jax.sweeps.plan import Plan

# The files of a sweep, which another sweep may replace; all other files in its folder are the user's.
_OF_A_SWEEP = ("sweep.yaml", "runs", "outcomes", "table.parquet", "results.nc", "failures.txt", "figures")


class SweepFolder:
    """The folder of a sweep, owned by this process.

    Arguments:
        path: of the folder.
        plan: the studies to run; None to continue the plan in the folder.
        resume: continue the existing run.
        force: delete the files of the sweep in it.

    Raises:
        UserError: the folder exists and neither option was given, it contains something else, or another process uses it.
    """

    def __init__(self, path: str | Path, plan: Plan | None, *, resume: bool, force: bool):
        self.path = Path(path).absolute()
        written = self.path / "sweep.yaml"
        try:
            occupied = self.path.exists() and (
                # A sweep killed in its first moments leaves a lock and a draft.
                not self.path.is_dir() or any(i.name != ".lock" and i.suffix != ".part" for i in self.path.iterdir())
            )
            # A sweep.yaml alone may be the user's own, of --grid.
            if occupied and not (self.path / "outcomes").is_dir():
                raise UserError(f"{path} exists and is not a folder of a sweep; choose another --output")
            if occupied and not (resume or force):
                raise UserError(f"{path} holds a sweep already; say --resume to go on with it or --force to replace it")
            if resume and not written.is_file():
                raise UserError(f"{path}: there is no sweep to resume; leave out --resume to start one")
            self.path.mkdir(parents=True, exist_ok=True)
            if (link := first_link(self.path, [".lock", *_OF_A_SWEEP])) is not None:
                raise UserError(f"{link} is a symbolic link, which redirects the files of the sweep; remove it")
            self._lock = extend(self.path / ".lock")
        except OSError as error:
            raise UserError(f"{path} cannot be written to ({error.strerror}); choose another --output") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if resume:
                self.plan = _agreed(str(path), _read(written), plan)
            else:
                assert plan is not None
                self.plan = plan
                self._begin(written)
        except BlockingIOError:
            self.close()
            raise UserError(
                f"{path} is in use by another running process; wait for it or choose another --output"
            ) from None
        except BaseException:
            self.close()
            raise

    def _begin(self, written: Path) -> None:
        for item in self.path.iterdir():
            if item.name in _OF_A_SWEEP or item.suffix == ".part":
                shutil.rmtree(item) if item.is_dir() and not item.is_symlink() else item.unlink()
        for name in ("runs", "outcomes"):
            (self.path / name).mkdir()
        content = {"study": self.plan.study, "points": list(self.plan.points)}
        write_whole(written, dump_yaml(content))

    def close(self) -> None:
        """Let another process have the folder."""
        self._lock.close()

    def pending(self) -> list[int]:
        """Numbers of the points that have not completed, from 0."""
        ends = enumerate(outcomes(self.path, len(self.plan.points)))
        return [number for number, ended in ends if ended["status"] != "complete"]

    def note_failure(self, number: int, message: str, traceback: str) -> None:
        """Record the failure of a study whose process could not record it."""
        note(self.path, number, {"status": "failed", "message": message, "traceback": traceback})


def run_folder(path: Path, number: int) -> Path:
    """The run folder of a point; the first is 0."""
    return path / "runs" / f"{number + 1:04d}"


def note(path: Path, number: int, ended: dict[str, Any]) -> None:
    """Write the outcome of the study of a point."""
    text = json.dumps(ended, indent=1, ensure_ascii=False) + "\n"
    write_whole(path / "outcomes" / f"{number + 1:04d}.json", text, f".{os.getpid()}.part")


def outcome(path: Path, number: int) -> dict[str, Any]:
    """The outcome of the study of a point; `{"status": "pending"}` if it has not, or if its results were deleted."""
    try:
        ended = json.loads((path / "outcomes" / f"{number + 1:04d}.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {"status": "pending"}
    lost = ended["status"] == "complete" and not (run_folder(path, number) / "summary.json").is_file()
    return {"status": "pending"} if lost else ended


def outcomes(path: Path, count: int) -> list[dict[str, Any]]:
    """The outcomes of the studies of all points."""
    return [outcome(path, number) for number in range(count)]


@contextmanager
def alone(path: Path, number: int) -> Iterator[None]:
    """Wait until no other process runs the study of a point, and keep it so.

    A cluster starts a study again when it loses contact with a worker, which may still continue. A worker may also outlive a
    killed sweep.
    """
    with extend(path / "outcomes" / f"{number + 1:04d}.lock") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _read(written: Path) -> Plan:
    content = parse_yaml(written.read_text(encoding="utf-8"), str(written))
    return Plan(content["study"], tuple(content["points"]))


def _agreed(path: str, before: Plan, now: Plan | None) -> Plan:
    """The plan to continue; refuses to mix two sweeps in one folder."""
    if now is None or now == before:
        return before
    what = "study" if now.study != before.study else "points"
    raise UserError(
        f"{path} holds a sweep of {'another' if what == 'study' else 'other'} {what}; resume with the {what} it was "
        "started with, or choose another --output"
    )
