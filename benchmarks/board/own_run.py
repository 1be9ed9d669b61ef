"""The program's own run of a record: the raw file in, every default kept, a time limit, and what it says of the held-out rows.

`hsed init` writes the study and `hsed run` does the rest, each in a process of its own, as a user starts them. Only the question
of every third cycle needs a campaign folder in place of the raw file: its experiments are windows of the record.

The errors of the run's summary are over the RMS of the force about its mean. Here they are over the RMS of the measured force, as
the errors of all methods of the board: one factor, from the held-out rows of the run itself, turns one into the other.
"""

import json
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from board.records import QUESTIONS, Specimen, windowed

import hsed_jax as hx

_DRAWN = 150
"""So many held-out rows of the prediction are kept for the picture."""


def own_run(specimen: Specimen, question: str, overrides: Sequence[str], limit: float | None) -> dict[str, Any]:
    """Run the program on a record.

    Arguments:
        specimen: the record.
        question: of `QUESTIONS`.
        overrides: settings of the run, `KEY=VALUE`; none for the defaults.
        limit: seconds after which the run is given up; None: never.

    Returns:
        `plain`, `named`, `noise`: errors of the held-out rows [1]; `remainder`: that with what the last model leaves, learned,
        or of the last model where this does not help; `verdict`, `effects`, `forms`, `behaviour`; CPU `seconds` of
        the run; when it `ended`; `loop`: elongation [m] and force [N] of the prediction of held-out rows. `failed`: why there is
        no result.
    """
    with tempfile.TemporaryDirectory() as place:
        work = Path(place) / specimen.name
        try:
            if question == QUESTIONS[0] and not specimen.source.is_dir():
                _hsed("init", shutil.copy(specimen.source, place), *specimen.words)
            else:
                if question == QUESTIONS[0]:
                    shutil.copytree(specimen.source, work)
                else:
                    hx.write_campaign(windowed(specimen.campaign()), work)
                _hsed("init", work, "--output", work / "study.yaml")
            begin = _children()
            _hsed("run", work / "study.yaml", *overrides, "--output", work / "run", limit=limit)
        except subprocess.TimeoutExpired:
            return {"failed": f"no end after {limit:.0f} s"}
        except hx.UserError as refusal:
            return {"failed": str(refusal)}
        except subprocess.CalledProcessError as failure:
            return {"failed": failure.stderr.strip().splitlines()[-1].replace(f"{place}/", "")}
        return {**_outcome(work / "run"), "seconds": round(_children() - begin)}


def finished_run(folders: Sequence[Path], name: str) -> dict[str, Any] | None:
    """The same of the last finished run of a record in some folders, without its CPU seconds, which no run folder keeps.

    Arguments:
        folders: searched for run folders at any depth.
        name: of the record, which `hsed run FILE` gives to its run folder.

    Returns:
        As `own_run`; None where no run of that name is complete.
    """
    places = [path.parent for folder in folders for path in folder.glob(f"**/{name}/summary.json")]
    complete = [
        p for p in places if json.loads((p / "summary.json").read_text(encoding="utf-8"))["status"] == "complete"
    ]
    return _outcome(max(complete, key=_ended)) if complete else None


def _ended(run: Path) -> str:
    """Date and minute of the end of a run, UTC."""
    return json.loads((run / "provenance.json").read_text(encoding="utf-8"))["sessions"][-1]["end"][:16]


def _hsed(*words: str | Path, limit: float | None = None) -> None:
    """A command of the package in a process of its own."""
    command = [sys.executable, "-m", "hsed_jax", *map(str, words)]
    subprocess.run(command, check=True, capture_output=True, text=True, timeout=limit)


def _children() -> float:
    """CPU seconds of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _outcome(run: Path) -> dict[str, Any]:
    """What the run folder says."""
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    found, trail = summary["diagnosis"], summary["improvement"]["steps"]
    with xr.open_datatree(run / "results.nc") as opened:
        results: Any = opened
        improved = "predictions_improved" if "predictions_improved" in results else "predictions"
        tests = list(results[improved]["test"].values())
        measured = np.concatenate([test["force_measured"].values for test in tests])
        measured = measured[np.isfinite(measured)]
        loop = _loop(run, results[improved]["test"])
    scale = summary["comparison"]["test"]["per_output"]["force"]["scale"]
    factor = scale / float(np.sqrt(np.mean(measured**2)))
    named = next(step["error_test"] for step in trail[::-1] if set(step["effects"]) <= set(found["effects"]))
    learned, rest = summary.get("discovery", {}), summary["improvement"].get("remainder", {})
    last = rest["comparison"]["test"]["error"] if rest.get("helps") else trail[-1]["error_test"]
    return {
        "plain": _rounded(trail[0]["error_test"] * factor),
        "named": _rounded(named * factor),
        "remainder": _rounded(last * factor),
        "noise": _rounded(summary["comparison"]["test"]["noise_floor"] * factor),
        "verdict": found["verdict"],
        "effects": found["effects"],
        "forms": {c["effect"]: c["form"] for c in found["ranking"] if c["effect"] in found["effects"] and "form" in c},
        "behaviour": found.get("behaviour_sentence", ""),
        **({"learned": _rounded(learned["error_test"] * factor)} if learned.get("found") else {}),
        "ended": _ended(run),
        "loop": loop,
    }


def _loop(run: Path, tests: Any) -> list[list[float]]:
    """Elongation and predicted force of the first held-out test, at few rows."""
    import hsed_jax as hx

    name, test = next(iter(tests.items()))
    record = hx.read_campaign(run / "campaign")[str(name)].record
    assert record is not None
    force = test["force_predicted"].values
    rows = np.flatnonzero(np.isfinite(test["force_measured"].values) & np.isfinite(force))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(_DRAWN, len(rows))).astype(int))]
    elongation = np.interp(test["time"].values[rows], record.time, record["elongation"])
    return [[_rounded(value) for value in values] for values in (elongation, force[rows])]


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
