"""Measure the package against its peers, on this machine, in this run: `python benchmarks/run.py`.

Every figure is a cost, so lower is better; every ratio is our cost in units of a peer's.
"""

import argparse
import datetime
import importlib
import importlib.metadata
import json
import os
import platform
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fresh import alone
from guard import guarded

# Rows that are measured on one core, and the others.
ONE_CORE = ("simulate", "kriging", "posterior")
ROWS = (*ONE_CORE, "memory", "diagnosis", "improvement", "campaign", "sweep")
_PACKAGES = (
    "hsed_jax",
    "jax",
    "jaxlib",
    "diffrax",
    "equinox",
    "numpyro",
    "numpy",
    "scipy",
    "numba",
    "scikit-learn",
    "emcee",
    "distributed",
)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"what to measure, of {', '.join(ROWS)} (default: all)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("results.json"), metavar="FILE")
    parser.add_argument("--quick", action="store_true", help="small sizes: to see that it runs, not to quote")
    parser.add_argument(
        "--guard",
        action="store_true",
        help="compare with the last results, keep nothing; 1 if a ratio or an error grew",
    )
    parser.add_argument("--markdown", action="store_true", help="print the table of the last results, measure nothing")
    parser.add_argument("--brief", action="store_true", help="of the table, only the work, the ratios and our cost")
    options = parser.parse_args()
    if unknown := [row for row in options.rows if row not in ROWS]:
        parser.error(f"there is no row {unknown[0]!r}; the rows are {', '.join(ROWS)}")
    if options.guard:
        sys.exit(_guard(options.output, options.rows or ROWS, options.quick))
    if not options.markdown:
        lines, failed = _lines(options.rows or ROWS, options.quick)
        if failed:
            sys.exit(f"nothing is kept: not measured, for the reason above: {', '.join(failed)}")
        results = {"machine": machine(), "quick": options.quick, "lines": lines}
        options.output.write_text(json.dumps(results, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    print(table(json.loads(options.output.read_text(encoding="utf-8")), options.brief))


def _guard(kept: Path, rows: Sequence[str], quick: bool) -> int:
    """Say what grew, against the results in a file; 1 if anything did or could not be measured."""
    before, failed = json.loads(kept.read_text(encoding="utf-8"))["lines"], []

    def measure(some: Sequence[str]) -> list[dict[str, Any]]:
        lines, missed = _lines(some, quick)
        failed.extend(missed)
        return lines

    grown, apart = guarded(before, measure, rows)
    for row in failed:
        print(f"not measured, for the reason above: {row}")
    for sentence in apart:
        print(f"not compared: {sentence}")
    for sentence in grown:
        print(f"grown: {sentence}")
    if not grown:
        print("no ratio and no error has grown")
    return 1 if grown or failed else 0


def _lines(rows: Sequence[str], quick: bool) -> tuple[list[dict[str, Any]], list[str]]:
    """The lines of rows, and the rows that failed: what the others took minutes for is not lost with them."""
    lines, failed = [], []
    for row in rows:
        print(f"measuring {row} …", file=sys.stderr, flush=True)
        try:
            lines += measured(row, quick)
        except Exception:
            traceback.print_exc()
            failed.append(row)
    return lines, failed


def measured(row: str, quick: bool) -> list[dict[str, Any]]:
    """The lines of one row, from a process of its own: threads are counted before anything is imported."""
    return alone(_measure, row, quick, cores=one_core() if row in ONE_CORE else ())


def one_core() -> set[int]:
    """The core for what is measured on one."""
    return {max(os.sched_getaffinity(0))}


def _measure(row: str, quick: bool) -> list[dict[str, Any]]:
    return importlib.import_module(f"rows.{row}").measure(quick)


def machine() -> dict[str, Any]:
    """Where and with what it was measured."""
    cpu = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    models = [entry.split(":")[1].strip() for entry in cpu if entry.startswith("model name")]
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "cpu": models[0] if models else platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        "versions": versions,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def table(results: dict[str, Any], brief: bool) -> str:
    """The results as a Markdown table, and what must be said with it."""
    head = ("row", "work", "our cost / peer's", "ours", "peers", "accuracy")
    shown = slice(1, 4) if brief else slice(None)
    rows = [head[shown], ("---",) * len(head[shown])]
    for entry in results["lines"]:
        accuracy = (
            f"{who}: " + ", ".join(f"{name} {_short(value)}" for name, value in figures.items())
            for who, figures in entry["accuracy"].items()
        )
        rows.append(
            (
                entry["row"],
                entry["work"],
                "; ".join(f"**{_ratio(ratio)}** {name}" for name, ratio in entry["ratios"].items()),
                f"{_short(entry['ours'])} {entry['unit']}",
                "; ".join(f"{name} {_short(cost)}" for name, cost in entry["peers"].items()),
                "; ".join(accuracy),
            )[shown]
        )
    m = results["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in m["versions"].items())
    notes = dict.fromkeys(note for entry in results["lines"] for note in entry["notes"])
    said = [
        f"{m['cpu']}, {m['cores']} cores (load {m['load']:.1f} at the end), {m['date']}; Python {m['python']}, {versions}."
    ]
    if results["quick"]:
        said.append("Measured with --quick: sizes too small to quote.")
    return "\n".join(["| " + " | ".join(row) + " |" for row in rows] + ["", *said, *(f"Note: {n}." for n in notes)])


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _ratio(value: float) -> str:
    return f"{value:.2g}" if value < 99 else f"{value:.0f}"


if __name__ == "__main__":
    main()
