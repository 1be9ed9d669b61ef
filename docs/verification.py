"""Writes the verification manual, `docs/verification/`, from errors that it measures.

    python docs/verification.py             # runs every test with the mark `verification`, which takes minutes
    python docs/verification.py TEST ...    # runs some of them, and keeps the other rows; options of pytest go with them,
                                            # such as -m verification for the slow cases, too
    python docs/verification.py --pages     # runs nothing, and writes the pages from the kept errors

The errors are kept in `docs/verification/observed.json`.  The pages are made of this file, of the kept results of benchmarks
(`docs/reliability.py`) and of the words below.
"""

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import reliability

FOLDER = Path(__file__).parent / "verification"
KEPT = FOLDER / "observed.json"
# Programs whose version may influence an error.
PROGRAMS = ("jax", "diffrax", "numpy", "scipy", "openseespy")
# Rows of the first table.
WORST = 25

WRITTEN = "*Written by `python docs/verification.py`; not to be edited by hand.*\n"

CHAPTERS = {
    "convergence": (
        "Order of convergence",
        """An oscillator on each law, the frame of the paper, and a specimen that is pulled, each on steps of four lengths under
twelve smooth motions. The *order* p is the slope of the logarithm of the error over the logarithm of the step: the mean over
the motions, with its standard error. The error is that of 400 steps, against 6400. The *grid convergence index* estimates the
same error from 200 and 400 steps alone: 3 e/(2ᵖ − 1), with e the difference between the two (Roache 1994). *Index covers* is
the share of the motions in which the index is at least the error. The method is RK4 and has order four where nothing has a
corner. A law that yields or turns at a corner has it within a step, because the step is not split there, and its order is
lower.""",
    ),
    "dynamics": (
        "Structures, motions and spectra",
        """Linear structures have exact responses. Nonlinear ones are compared with DOP853 of SciPy, which is restarted at each
reversal of the specimen.""",
    ),
    "laws": (
        "Spring laws",
        """Each law is compared with a second program of the law (`tests/laws_in_steps.py`), with its closed form, and with
the materials of OpenSees: along paths of imposed elongation and in a structure that is shaken. `tests/data/laws.csv` has
forces that OpenSees computed. A material of OpenSees that is a [model](../opensees_laws.md) is compared with the formulas of
its parameters.""",
    ),
    "effects": (
        "Effects and their forms",
        """Each form of each effect is compared with its equation in NumPy, at 60 random states of the spring and two sizes of
its parameters. A row of an effect has the largest error over its forms. Effects outside the spring are compared with a
structure, a motion or a record that was changed by hand.""",
    ),
    "opensees": (
        "Exported laws in OpenSees",
        """`hsed export` writes a law with its effects as materials of OpenSees, and so a material that is the model itself.
OpenSees pulls each of them along growing cycles.
The error is the root mean square of the difference over the standard deviation of the force. Materials of OpenSees that
integrate their force are of first order in the step, and have most of the error. `python docs/verification.py
tests/exports/test_export.py -m verification` measures every case of the export.""",
    ),
    "inference": (
        "Calibration, evidence and sensitivity",
        """Posteriors are compared with grids, quadrature and closed forms. An error of draws is divided by its Monte Carlo
standard error where the row says so.""",
    ),
    "design": (
        "Kriging and expected improvement",
        """Eqs. 7 to 14 are compared with dense linear algebra in NumPy, and with SciPy's quadrature and optimiser.""",
    ),
    "paper": (
        "The figures of the paper",
        """The paper gives a frame, a specimen and a design. The rows compare them with 600 simulations by DOP853 (rtol 1e-12) and
with a grid over the parameters. The second table has the estimates beside those that the paper prints.""",
    ),
}


class Row(NamedTuple):
    """The comparison of a test, over all cases of the test with the same words.

    Attributes:
        problem, reference, test: words, and the test without its cases.
        tolerance, error: the largest error of the cases.
        cases: how many there are.
        figures: further numbers by name, of the case with the largest error.
    """

    problem: str
    reference: str
    test: str
    tolerance: float
    error: float
    cases: int
    figures: dict[str, float]

    @property
    def share(self) -> float:
        """The error over its tolerance."""
        return self.error / self.tolerance if self.tolerance else float(self.error > 0)


def rows_of(kept: Mapping[str, Any], chapter: str) -> list[Row]:
    """The rows of a chapter, in the order of their problems."""
    found: dict[tuple[Any, ...], Row] = {}
    for node, rows in kept["tests"].items():
        for row in rows:
            if row["chapter"] != chapter:
                continue
            key = (row["problem"], row["reference"], node.split("[")[0], row["tolerance"])
            so_far = found.get(key)
            cases = 1 + (so_far.cases if so_far else 0)
            if so_far and so_far.error >= row["error"]:
                found[key] = so_far._replace(cases=cases)
            else:
                found[key] = Row(*key, error=row["error"], cases=cases, figures=row.get("figures", {}))
    return sorted(found.values(), key=lambda row: (row.problem, row.test))


def pages(kept: Mapping[str, Any]) -> dict[str, str]:
    """The text of every page that is written, by file."""
    found = {"index.md": index(kept)}
    for chapter, (title, text) in CHAPTERS.items():
        lines = [f"# {title}", "", WRITTEN, text, "", *table(rows_of(kept, chapter))]
        if chapter == "paper":
            lines += ["", *reliability.paper()]
        found[f"{chapter}.md"] = "\n".join(lines) + "\n"
    return found | {"reliability.md": "\n".join([f"# {reliability.TITLE}", "", WRITTEN, *reliability.page()]) + "\n"}


def index(kept: Mapping[str, Any]) -> str:
    """The first page: the content, and the largest errors."""
    rows = {chapter: rows_of(kept, chapter) for chapter in CHAPTERS}
    worst = sorted((row for own in rows.values() for row in own), key=lambda row: -row.share)[:WORST]
    lines = [HEAD, "## The largest errors\n", f"The {WORST} rows whose error is the largest share of its tolerance:\n"]
    heads = ("problem", "reference", "observed error", "tolerance", "share", "test")
    lines += _table(heads, [(r.problem, r.reference, _figure(r.error), _figure(r.tolerance), f"{r.share:.0%}",
                             _test(r.test)) for r in worst])  # fmt: skip
    lines += ["\n## Chapters\n"]
    lines += _table(
        ("chapter", "rows", "comparisons", "largest share of a tolerance"),
        [
            (f"[{CHAPTERS[chapter][0]}]({chapter}.md)", str(len(own)), str(sum(r.cases for r in own)),
             f"{max(r.share for r in own):.0%}") for chapter, own in rows.items() if own
        ],
    )  # fmt: skip
    lines += [
        f"\nBesides: [{reliability.TITLE.lower()}](reliability.md), from kept benchmarks, and the",
        "[requirements with the tests that hold them](requirements.md).",
        "\n## What ran\n",
        *_table(("program", "version"), list(kept["versions"].items())),
    ]
    if kept["skipped"]:
        lines += ["\nThese tests did not run:\n"]
        lines += _table(("test", "reason"), [(_test(node), reason) for node, reason in kept["skipped"].items()])
    return "\n".join([*lines, TREE])


HEAD = f"""# Verification manual

{WRITTEN}
Every row is a problem, a reference that is independent of the package, a tolerance, the error that was observed, and the
test that compares them. The test fails where the error exceeds the tolerance, so a row cannot be out of date by more than
its tolerance. The manual follows the terms of ASME V&V 10 and V&V 20: *code verification* compares with exact solutions and
measures the order of convergence, *calculation verification* estimates the error of a step, *validation* compares with
measurements ([measured specimens](reliability.md#measured-specimens)).

An error is the largest difference over the largest expected value, or a relative difference where one number is compared.
Errors have two significant digits. They differ between machines in the last digits of double precision; problem, reference
and tolerance do not, and every run of the tests compares them with this manual.

```
python docs/verification.py          # measures every row again, and writes these pages
python docs/verification.py tests/physics/test_laws.py -n 0    # measures the rows of one file
python benchmarks/baseline.py        # repeats a small calibration, design step and diagnosis with frozen results
```
"""
TREE = """
```{toctree}
:hidden:

"""
TREE += "\n".join([*CHAPTERS, "reliability", "requirements"]) + "\n```\n"


def table(rows: Sequence[Row]) -> list[str]:
    """The rows of a chapter; further figures have a column each."""
    names = list(dict.fromkeys(name for row in rows for name in row.figures))
    heads = (
        "problem",
        "reference",
        "tolerance",
        "observed error",
        *(n.replace("_", " ") for n in names),
        "cases",
        "test",
    )
    return _table(
        heads,
        [
            (
                *(row.problem, row.reference, _figure(row.tolerance), _figure(row.error)),
                *(f"{row.figures[name]:.3g}" if name in row.figures else "–" for name in names),
                *(str(row.cases), _test(row.test)),
            )
            for row in rows
        ],
    )


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows)]


def _figure(value: float) -> str:
    return "0" if value == 0 else f"{value:.2g}"


def _test(node: str) -> str:
    return f"`{node.removeprefix('tests/')}`"


class Reports:
    """Rows and reasons of skips that tests report.

    Attributes:
        tests: rows by test.
        skipped: reasons by test.
    """

    def __init__(self) -> None:
        self.tests: dict[str, list[dict[str, Any]]] = {}
        self.skipped: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """The hook of pytest for each report."""
        if report.skipped and isinstance(report.longrepr, tuple):
            self.skipped[report.nodeid] = str(report.longrepr[2]).removeprefix("Skipped: ")
        if report.when == "call" and report.passed:
            self.tests[report.nodeid] = [
                {**row, "error": float(f"{row['error']:.1e}")} for _, rows in report.user_properties for row in rows
            ]


def measured(words: Sequence[str]) -> dict[str, Any]:
    """Run the tests, all or some, and what is kept then.

    Raises:
        SystemExit: a test failed, with the exit status of pytest.
    """
    reports, kept = Reports(), {"tests": {}, "skipped": {}}
    if any(not word.startswith("-") and Path(word.split("::")[0]).exists() for word in words):
        kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.is_file() else kept
    status = pytest.main(["-m", "verification and not slow", "--measure", *words], plugins=[reports])
    if status != pytest.ExitCode.OK:
        raise SystemExit(int(status))
    done = {node.split("[")[0] for node in (*reports.tests, *reports.skipped)}
    found = {
        part: {k: v for k, v in kept[part].items() if k.split("[")[0] not in done} | new
        for part, new in (("tests", reports.tests), ("skipped", reports.skipped))
    }
    return {"versions": versions(), **{part: dict(sorted(rows.items())) for part, rows in found.items()}}


def versions() -> dict[str, str]:
    """Versions of the programs that an error may depend on."""

    def of(name: str) -> str:
        try:
            return version(name)
        except PackageNotFoundError:
            return "not installed"

    return {"Python": platform.python_version(), **{name: of(name) for name in PROGRAMS}}


def main() -> None:
    """The command."""
    words = sys.argv[1:]
    if words != ["--pages"]:
        keep(measured(words))
    for name, text in pages(json.loads(KEPT.read_text(encoding="utf-8"))).items():
        (FOLDER / name).write_text(text, encoding="utf-8")


def keep(found: Mapping[str, Any]) -> None:
    """Write the measured errors, a line for each test, so that a change of one test changes one line."""
    parts = []
    for part, of in found.items():
        lines = [f"  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in of.items()]
        parts.append(f' "{part}": {{\n' + ",\n".join(lines) + "\n }")
    KEPT.write_text("{\n" + ",\n".join(parts) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
