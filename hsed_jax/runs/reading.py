"""Reading of a run folder, which may be damaged or from another person."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hsed_jax.errors import UserError
from hsed_jax.measurements import read_campaign
from hsed_jax.plain import parse_yaml
from hsed_jax.runs.provenance import read_provenance

if TYPE_CHECKING:
    import xarray as xr

    from hsed_jax.reporting.finished import FinishedRun

# A run compresses nothing; a file that declares many times its size is damaged, or was made to fill the memory.
_LEAST_BYTES, _MOST_UNPACKED = 2**24, 8


def read_run(path: str | Path, known: "xr.DataTree | None" = None) -> "FinishedRun":
    """Read a run folder.

    Arguments:
        path: of the folder.
        known: content of `results.nc`, if it was just written: reading it takes a second.

    Raises:
        UserError: there is no run, it has no results yet, or a file is damaged.

    Example:
        >>> run = hx.read_run("runs/wall")
        >>> run.summary["status"], list(run.results["posterior"])
        ('complete', ['A', 'beta'])
    """
    from hsed_jax.reporting.finished import FinishedRun

    folder = Path(path)
    if not (folder / "study.yaml").is_file():
        raise UserError(
            f"{folder} is not a run folder; this command makes a run: hsed run STUDY.yaml --output {folder}"
        )
    if not (folder / "summary.json").is_file():
        raise UserError(
            f"{folder}: the run has no results yet; go on with it: hsed run STUDY.yaml --output {folder} --resume"
        )
    results, check = folder / "results.nc", folder / "export" / "check.json"
    tree = _tree(results) if known is None and results.is_file() else known
    return FinishedRun(
        folder,
        mapping(folder / "study.yaml", "study", "model", "steps"),
        mapping(folder / "summary.json", "study", "status"),
        read_provenance(folder / "provenance.json").model_dump(exclude_unset=True),
        read_campaign(folder / "campaign"),
        tree,
        {path.stem: _text(path) for path in sorted((folder / "figures").glob("*.svg"))},
        mapping(check, "opensees", "difference") if check.is_file() else None,
    )


@contextmanager
def holding(path: str | Path) -> Iterator[None]:
    """A context in which unexpected content of the files of a run causes one message.

    Raises:
        UserError: with the missing content.
    """
    try:
        yield
    except (OSError, UserError):
        raise
    except Exception as error:  # a number instead of a list can cause any exception
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UserError(
            f"{path}: its files are not those of this version of a run ({said}); restore summary.json and results.nc from "
            "a copy, or make them again: hsed run STUDY.yaml --resume"
        ) from error


def _tree(results: Path) -> "xr.DataTree":
    """The content of `results.nc`."""
    import h5py
    import xarray as xr

    declared = 0

    def count(name: str, node: Any) -> None:
        nonlocal declared
        declared += node.nbytes if isinstance(node, h5py.Dataset) else 0

    try:
        with h5py.File(results, "r") as file:
            file.visititems(count)
        if declared > _LEAST_BYTES + _MOST_UNPACKED * results.stat().st_size:
            raise ValueError(f"{declared} bytes are declared in a file of {results.stat().st_size}")
        return xr.load_datatree(results, engine="h5netcdf")
    except Exception as error:  # HDF5 and its readers raise any exception on damaged bytes
        said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UserError(f"{results}: this is not a file of results ({said}); restore it from a copy") from None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read as text ({error})") from None


def mapping(path: Path, *keys: str) -> dict[str, Any]:
    """Read a mapping in YAML or JSON that has these keys.

    Raises:
        UserError: it is something else.
    """
    text = _text(path)
    try:
        content = json.loads(text) if path.suffix == ".json" else parse_yaml(text, str(path))
    except (ValueError, RecursionError, UserError):
        content = None
    if not isinstance(content, dict) or any(key not in content for key in keys):
        raise UserError(
            f"{path}: it is damaged: it must be a mapping of {', '.join(keys) or 'keys'}; restore it from a copy"
        )
    return content
