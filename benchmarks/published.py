"""The scoreboard of measured specimens.  `python benchmarks/published.py [CASE ...] [--data FOLDER] [--resume]`

Every record of a folder of data sets is taken as a stranger takes it: the raw file goes in, every default is kept, nothing is
set by hand. The program calibrates the plain law, names what it lacks and adds it (`board/own_run.py`). Four other methods get
the same rows (`board/comparisons.py`). All errors are those of rows that were not fitted: the RMS of the residual over the RMS of
the measured force. A line of JSON for each specimen is kept, so a board that was stopped goes on with `--resume`.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from board.comparisons import compared
from board.own_run import finished_run, own_run
from board.page import page, picture_of_errors
from board.records import DATA, QUESTIONS, Specimen, specimens
from board.table import markdown

import hsed_jax as hx
from hsed_jax.backend import limit_threads, prepare

RESULTS = Path(__file__).with_name("board.jsonl")
PARTS = ("comparisons", "own")
_DISCOVER = ("steps=[calibrate, compare, diagnose, discover, improve]",)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help="names of records (default: all)")
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="holds the data sets")
    parser.add_argument("--files", nargs="+", type=Path, metavar="FILE", help="raw files in place of the data sets")
    parser.add_argument("--only", choices=PARTS, help="the other methods alone, or the program's own runs alone")
    parser.add_argument(
        "--question", choices=QUESTIONS, help="that the program's own runs answer (default: both, one after the other)"
    )
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="LIMIT",
        help="give up a run of the program after so long on the clock (default: never)",
    )
    parser.add_argument(
        "--runs",
        nargs="+",
        type=Path,
        metavar="FOLDER",
        help="take finished runs of `hsed run FILE` from there, run nothing",
    )
    parser.add_argument("--discover", action="store_true", help="the program also learns what no name is for")
    parser.add_argument("--resume", action="store_true", help="keep what was measured already")
    parser.add_argument("--markdown", action="store_true", help="print the table of the last results, measure nothing")
    parser.add_argument("--page", type=Path, metavar="FOLDER", help="write board.md and its pictures, measure nothing")
    parser.add_argument("--draw", type=Path, metavar="FILE.png", help="draw the errors, measure nothing")
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.jsonl", help="where results are kept")
    options = parser.parse_args()
    if options.markdown or options.page or options.draw:
        rows = read(options.output)
        if options.draw:
            picture_of_errors(rows, options.draw)
        if options.page:
            page(rows, specimens(options.data), options.page)
        if options.markdown:
            print(markdown(rows))
        return
    if options.runs:
        take(options.runs, options.output)
        return
    overrides = _DISCOVER if options.discover else ()
    chosen = [Specimen(file, "files") for file in options.files or ()] or specimens(options.data)
    if unknown := set(options.cases) - {one.name for one in chosen}:
        parser.error(f"there is no record {sorted(unknown)[0]!r} in {options.data}")
    wanted = [one for one in chosen if not options.cases or one.name in options.cases]
    parts = (options.only,) if options.only else PARTS
    questions = (options.question,) if options.question else QUESTIONS
    measure(wanted, options.output, parts, questions, options.resume, overrides, options.seconds)
    print(markdown(read(options.output)))


def measure(
    wanted: Sequence[Specimen],
    output: Path,
    parts: Sequence[str],
    questions: Sequence[str],
    resume: bool,
    overrides: Sequence[str],
    limit: float | None,
) -> None:
    """Measure parts of the rows of some specimens, and keep the file of results after each.

    Arguments:
        wanted: the specimens.
        output: the file, a line of JSON for each specimen; lines of other specimens stay as they are.
        parts: of `PARTS`.
        questions: that the program's own runs answer; the other methods answer all.
        resume: whether a part that is there stays as it is.
        overrides, limit: of `own_run`.
    """
    prepare()
    limit_threads()
    rows = {row["case"]: row for row in read(output)}
    for one in wanted:
        row = rows.setdefault(one.name, {"case": one.name, "set": one.group})
        own = row.get("own", {})
        left = [q for q in questions if not (resume and q in own)] if "own" in parts else []
        is_compared = "comparisons" in row or "comparisons" not in parts
        if resume and ("refused" in row or (is_compared and not left)):
            continue
        try:
            row.pop("refused", None)
            if "comparisons" in parts:
                row["comparisons"] = compared(one, row.get("comparisons", {}) if resume else {})
            for question in left:
                row["own"] = own = {**own, question: own_run(one, question, overrides, limit)}
        except hx.UserError as refusal:
            row["refused"] = str(refusal).replace(str(one.source), one.source.name)
        print(one.name, row.get("refused", "done"), file=sys.stderr, flush=True)
        write(list(rows.values()), output)


def take(folders: Sequence[Path], output: Path) -> None:
    """Put the finished runs of some folders, which answer the first question, into the rows that are there, in place of older
    ones."""
    rows, question = read(output), QUESTIONS[0]
    for row in rows:
        own, found = row.get("own", {}), finished_run(folders, row["case"])
        if found is not None and found["ended"] > own.get(question, {}).get("ended", ""):
            row["own"] = {**own, question: found}
    write(rows, output)
    print(f"{sum(question in row.get('own', {}) for row in rows)} of {len(rows)} rows have a run of the program")


def read(output: Path) -> list[dict[str, Any]]:
    """The rows of a file of results; none where there is no file."""
    return [json.loads(line) for line in output.read_text(encoding="utf-8").splitlines()] if output.exists() else []


def write(rows: Sequence[dict[str, Any]], output: Path) -> None:
    """Keep rows; a stop while it writes leaves the old file."""
    draft = output.with_suffix(".part")
    draft.write_text("".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows), encoding="utf-8")
    draft.replace(output)


if __name__ == "__main__":
    main()
