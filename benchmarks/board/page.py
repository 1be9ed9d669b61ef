"""The page of the board, `docs/board.md`: tables from the results, and contact sheets of the loops of every record.

The text needs the results alone. The sheets need the records, too, which are not kept beside them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from board.comparisons import METHODS
from board.records import MOST_ROWS, QUESTIONS, Specimen, Test, tests_of
from board.table import OWN, Rows, by_all, cell, cycle_table, errors, markdown, record_table, refusals
from bouc_wen import in_units_of_the_signal
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

import hsed_jax as hx
from hsed_jax.measurements.checks import SAMPLES

COMMAND = "python benchmarks/published.py --page docs"
_COLUMNS = 10
_SHEETS = {
    "walls": ("stone masonry walls", ("stone_masonry",)),
    "dampers": ("a friction damper, its test matrix", ("friction_damper_factorial",)),
    "others": (
        "the other specimens",
        ("friction_damper", "rc_column", "steel_coupons", "steel_damper", "timber_connection", "steel_specimens",
         "isolated_building"),
    ),
}  # fmt: skip
_METHOD_COLOURS = dict(zip((*OWN.values(), *METHODS), ("0.45", "C0", "C4", "0.65", "C1", "C2", "C3"), strict=True))


def page(rows: Rows, records: Sequence[Specimen], folder: Path) -> None:
    """Write `board.md` and the sheets.

    Arguments:
        rows: the results.
        records: those whose loops are drawn; without any the sheets stay as they are.
        folder: of the documentation; the sheets are in its `images/board`.
    """
    images = folder / "images" / "board"
    images.mkdir(parents=True, exist_ok=True)
    by_case = {row["case"]: row for row in rows}
    for name, sets in ((name, sets) for name, (_, sets) in _SHEETS.items()):
        drawn = [(one, by_case[one.name]) for one in records if one.group in sets and errors(by_case.get(one.name, {}))]
        if drawn:
            _sheet(drawn, images / f"{name}.png")
    (folder / "board.md").write_text(text(rows), encoding="utf-8")


def text(rows: Rows) -> str:
    """The page."""
    rows = sorted(rows, key=lambda row: (row["set"], row["case"]))
    answers = [(row["case"], row.get("own", {}).get(QUESTIONS[0], {"failed": ""})) for row in rows]
    said = [(case.replace("_", " "), own) for case, own in answers if "failed" not in own]
    sentences = "\n".join(
        f"- **{case}**: `{own['verdict']}`; {own['behaviour'] or 'no behaviour is stated'}." for case, own in said
    )
    pictures = "\n\n".join(
        f"![Loops of {title}](images/board/{name}.png)\n\n*Loops of {title}.*"
        for name, (title, sets) in _SHEETS.items()
        if any(row["set"] in sets and errors(row) for row in rows)
    )
    days = [own["ended"][:10] for row in rows for own in row.get("own", {}).values() if "ended" in own]
    benchmark = in_units_of_the_signal()
    refused = "\n".join(f"- {reason} ({len(cases)}): {', '.join(cases)}." for reason, cases in refusals(rows).items())
    return f"""\
% Written by `{COMMAND}`; change benchmarks/board/page.py.

# Measured specimens

Each record is a raw file of a laboratory. The file goes in, every default is kept, and nothing is set by hand. hsed_jax
calibrates the plain law of Bouc and Wen, names the missing effects and adds them. It then learns what this model leaves as a
function of the path ([the remainder](discrepancy.md#the-remainder-of-a-component-test)). Four other methods get the same rows:

- the **plain law**, fitted by differential evolution;
- **Bouc-Wen-Baber-Noori**: 13 parameters with degradation and pinching, fitted by differential evolution;
- a **Gaussian process** of seven features of the path of the elongation (zero mean, Matérn 5/2, 400 rows at most);
- a **recurrent network** (gated recurrent units, early stopping, three settings).

Each method knows the elongation of all rows and the force of the fitted rows. It simulates from the start of the test.
hsed_jax also knows the force of the other rows: it does not fit them, but chooses with them between the sets that it has
fitted ([how](diagnosis.md)), and it leaves out a remainder that does not help there. Its error is therefore a little too small
in this comparison.

An error is the RMS of the residual over the RMS of the measured force, on rows that were not fitted. An error of 1 is that of a
force of zero. A record of more than {MOST_ROWS} rows is thinned ([long records](measurements.md#long-records)).

Two questions are asked. The *last rows* are the last third of a file, or what a campaign declares. In most tests they hold the
largest cycles, so this question is an extrapolation. *Every third cycle* leaves out cycles 3, 6, 9, ... and fits the others, so
this question is an interpolation. To hsed_jax the rows that are not fitted are test experiments, windows of the record. A
window of fewer than {SAMPLES} samples is left out.

Seconds are CPU seconds. Those of hsed_jax are of the whole run, from the raw file's study to its report. The runs of
hsed_jax ended {" to ".join(sorted({min(days), max(days)})) if days else "never"}.

## Summary

{markdown(rows)}

![Distribution of the errors of every method on rows that were not fitted](images/measured_specimens.png)

*Errors on the last rows. A point is a record. It is dark where every method has run. The line is the median of the dark points.*

## Loops

Grey rows were fitted. Black rows are the last rows, which were not fitted. The blue line is the prediction of these rows by
hsed_jax, where it has run. The number is the error of hsed_jax (blue) or the smallest error of the other methods (black).

{pictures}

## Every record, last rows

The smallest error of a record is bold.

{record_table(rows)}

## Results of hsed_jax

The stiffness is that of a loop to half of the largest elongation, of the virgin specimen and after the whole test. The strength
of these runs is the force at the ends of this loop.

{sentences}

## Every record, every third cycle

{cycle_table(rows)}

## Beside a published result

The Bouc-Wen benchmark of Noël and Schoukens is simulated by its authors: a force shakes a mass on a hysteretic spring. hsed_jax
starts from the linear model and finds the structure (`python benchmarks/bouc_wen.py`). Errors are over the RMS of the test
signal.

| linear model | structure found by hsed_jax | best published learned model |
| --- | --- | --- |
| {cell(benchmark["linear"])} | {cell(benchmark["found"])} | {cell(benchmark["published"])} |

## Refused

These records have no error. The program stops with this reason, where RECORD is the name:

{refused}

## Commands

```
python benchmarks/published.py --data FOLDER --resume           # all records: measure what is not there yet
python benchmarks/published.py --data FOLDER --only own --seconds 600   # runs of hsed_jax alone, given up after 600 s each
{COMMAND} --data FOLDER     # this page and its pictures
```
"""


def picture_of_errors(rows: Rows, path: Path) -> None:
    """Draw the errors of every method on the last rows: a point for each record, dark where every method has run, and the median
    of the dark points as a line."""
    everywhere = [row["case"] for row in by_all(rows)]
    names = [name for name in (*OWN.values(), *METHODS) if any(name in errors(row) for row in rows)]
    figure, axes = plt.subplots(figsize=(7.2, 0.4 * len(names) + 0.7), layout="constrained")
    random = np.random.default_rng(0)
    for place, name in enumerate(names[::-1]):
        known = [(row["case"] in everywhere, errors(row)[name]) for row in rows if name in errors(row)]
        is_common, values = np.asarray([c for c, _ in known], bool), np.asarray([value for _, value in known])
        heights = place + random.uniform(-0.25, 0.25, len(values))
        for which, strength in ((is_common, 0.8), (~is_common, 0.25)):
            axes.scatter(values[which], heights[which], 12, color=_METHOD_COLOURS[name], alpha=strength, linewidths=0)
        if is_common.any():
            axes.vlines(np.median(values[is_common]), place - 0.38, place + 0.38, color="k", linewidth=2)
    axes.set_yticks(range(len(names)), names[::-1])
    axes.axvline(1.0, color="0.8", linewidth=0.8, zorder=0)
    axes.set(xscale="log", xlabel="error on rows that were not fitted (1: a force of zero)")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _sheet(drawn: Sequence[tuple[Specimen, Mapping[str, Any]]], path: Path) -> None:
    """A small picture of the loops of each record."""
    columns = min(_COLUMNS, len(drawn))
    lines = -(-len(drawn) // columns)
    figure, grid = plt.subplots(
        lines, columns, figsize=(1.15 * columns, 1.05 * lines), layout="constrained", squeeze=False
    )
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (one, row) in zip(grid.flat, drawn, strict=False):
        try:
            tests = tests_of(one.campaign(), QUESTIONS[0])
        except hx.UserError:
            continue
        _loops(axes, tests, row)
    figure.savefig(path, dpi=90, pil_kwargs={"optimize": True})
    plt.close(figure)


def _loops(axes: Axes, tests: Sequence[Test], row: Mapping[str, Any]) -> None:
    """The first fitted and the first held-out test, the prediction over them, the error beside them."""
    for test in (next(t for t in tests if t.fitted.any()), next(t for t in tests if t.held.any())):
        for which, colour, width in (("fitted", "0.7", 0.4), ("held", "k", 0.5)):
            rows = getattr(test, which)
            axes.plot(np.where(rows, test.elongation, np.nan), test.force, color=colour, linewidth=width)
    own = row.get("own", {}).get(QUESTIONS[0], {})
    if "loop" in own:
        axes.plot(*own["loop"], color="C0", linewidth=0.5)
    known = errors(row)
    shown = own.get("named", min(known.values(), default=np.nan))
    axes.text(
        0.5,
        1.0,
        row["case"].removeprefix("FD_").replace("_", " ")[:20],
        fontsize=5,
        transform=axes.transAxes,
        ha="center",
    )
    axes.text(
        0.98,
        0.02,
        f"{shown:.2f}",
        fontsize=5,
        color="C0" if "named" in own else "k",
        transform=axes.transAxes,
        ha="right",
    )
