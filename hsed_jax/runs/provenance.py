"""`provenance.json`: versions, machine and times of a run."""

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from pydantic import BaseModel, Field

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError

_PACKAGES = ("hsed_jax", "jax", "jaxlib", "diffrax", "optimistix", "numpyro", "tinygp", "numpy", "scipy")


class Git(BaseModel):
    """State of the package's own checkout."""

    commit: str
    modified: bool


class Machine(BaseModel):
    """The machine of a run."""

    platform: str
    processor: str
    cores: int | None


class Session(BaseModel):
    """From a start or resume to the end; no end if it was stopped."""

    start: str
    end: str | None = None


class Provenance(BaseModel):
    """`provenance.json`."""

    python: str
    versions: dict[str, str]
    git: Git | None
    seed: int | None
    machine: Machine
    sessions: list[Session] = Field(min_length=1)


def begin_session(path: Path, seed: int | None) -> None:
    """Record the start of a session of a run.

    Raises:
        UserError: what is there is damaged.
    """
    earlier = read_provenance(path).sessions if path.exists() else []
    now = Provenance(
        python=sys.version.split()[0],
        versions={package: version(package) for package in _PACKAGES},
        git=_git_state(),
        seed=seed,
        machine=Machine(
            platform=platform.platform(),
            processor=platform.processor() or platform.machine(),
            cores=os.cpu_count(),
        ),
        sessions=[*earlier, Session(start=_now())],
    )
    _write(path, now)


def end_session(path: Path) -> None:
    """Record the end of the last session.

    Raises:
        UserError: what is there is damaged.
    """
    content = read_provenance(path)
    content.sessions[-1].end = _now()
    _write(path, content)


def read_provenance(path: Path) -> Provenance:
    """The content of the file.

    Raises:
        UserError: it is missing or damaged.
    """
    try:
        return Provenance.model_validate_json(path.read_bytes())
    except (OSError, ValueError):
        raise UserError(
            f"{path}: it is damaged; delete it, and say --resume to continue without its record of earlier sessions"
        ) from None


def _write(path: Path, content: Provenance) -> None:
    write_whole(path, content.model_dump_json(indent=2, exclude_unset=True) + "\n")


def _git_state() -> Git | None:
    """Commit of the package's own checkout and whether it was changed; None if it is not a checkout."""
    here = Path(__file__).parent
    if not (here.parent / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(here), *arguments], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        return Git(commit=git("rev-parse", "HEAD"), modified=bool(git("status", "--porcelain")))
    except (OSError, subprocess.CalledProcessError):
        return None


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
