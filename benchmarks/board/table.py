"""The tables of the board: a summary of every method, a line for each record, and what was refused.

A row of the results holds `case`, `set`, and what was measured: `comparisons` by question and method, `own` by question, or
`refused`, the sentence with which the program refuses the record.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from board.comparisons import METHODS
from board.records import QUESTIONS

OWN = {
    "plain": "plain law, hsed_jax",
    "named": "with what is named, hsed_jax",
    "remainder": "with the remainder, hsed_jax",
}
"""The program's own errors of a row, and their titles. Older runs have no remainder."""
_EVERY = (OWN["plain"], OWN["named"], *METHODS)

Rows = Sequence[Mapping[str, Any]]


def errors(row: Mapping[str, Any], question: str = QUESTIONS[0]) -> dict[str, float]:
    """Errors of the rows that were not fitted, by the title of the method."""
    own = row.get("own", {}).get(question, {})
    program = {title: own[key] for key, title in OWN.items() if key in own}
    return program | {
        name: found["held"]
        for name in METHODS
        if isinstance(found := row.get("comparisons", {}).get(question, {}).get(name), dict)
    }


def by_all(rows: Rows, question: str = QUESTIONS[0]) -> Rows:
    """The rows of which every method and the program have an error."""
    return [row for row in rows if {*_EVERY} <= {*errors(row, question)}]


def summary(rows: Rows, question: str) -> str:
    """A line for each method that has an error of every record: quartiles of its error, where it is the best, seconds.

    Best is the smallest error of all methods that the table holds, on the same record.
    """
    found = [known for row in rows if (known := errors(row, question))]
    names = [name for name in (*OWN.values(), *METHODS) if all(name in known for known in found)]
    heads = ["method", "records", "median error", "quartiles", "best on", "error above 1 on", "median s"]
    lines = [heads, ["---"] * len(heads)]
    for name in names:
        values = np.asarray([known[name] for known in found])
        best = sum(min(names, key=lambda one: known[one]) == name for known in found)
        low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
        seconds = [s for row in rows if (s := _seconds(row, question, name)) is not None]
        lines.append([
            name, str(len(values)), f"**{cell(middle)}**", f"{cell(low)} to {cell(high)}", str(best),
            str(int(np.sum(values > 1))), f"{np.median(seconds):.1f}" if seconds else "–",
        ])  # fmt: skip
    return _table(lines)


def markdown(rows: Rows) -> str:
    """The summaries of both questions, of the records that the program has run and of all."""
    parts: list[str] = []
    for question in QUESTIONS:
        if own := by_all(rows, question):
            count = f"{len(own)} records that every method has run"
            parts.append(f"{question.capitalize()}, {count}:\n\n{summary(own, question)}")
        learned = [row for row in own if OWN["remainder"] in errors(row, question)]
        if 0 < len(learned) < len(own):
            count = f"the {len(learned)} of these records that were run since the remainder is learned"
            parts.append(f"{question.capitalize()}, {count}:\n\n{summary(learned, question)}")
        others = [{**row, "own": {}} for row in rows]
        count = sum(bool(errors(row, question)) for row in others)
        if count > len(own):
            parts.append(
                f"{question.capitalize()}, the other methods alone, {count} records:\n\n{summary(others, question)}"
            )
    return "\n\n".join(parts)


def record_table(rows: Rows) -> str:
    """A line for each record that has an error: errors of all methods, what is named, verdict, seconds of the program's run."""
    titles = _titles(rows, QUESTIONS[0])
    heads = ["record", *titles, "named", "verdict", "s"]
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        known, own = errors(row), row.get("own", {}).get(QUESTIONS[0], {})
        if not known:
            continue
        least = min(known, key=lambda name: known[name])
        cells = [f"**{cell(known[name])}**" if name == least else cell(known.get(name)) for name in titles]
        named = ", ".join(
            f"`{e}`" + (f" ({own['forms'][e]})" if e in own["forms"] else "") for e in own.get("effects", ())
        )
        verdict = f"`{own['verdict']}`" if "verdict" in own else own.get("failed", "–")
        seconds = f"{own['seconds']:.0f}" if "seconds" in own else "–"
        lines.append([row["case"].replace("_", " "), *cells, named or "–", verdict, seconds])
    return _table(lines)


def cycle_table(rows: Rows) -> str:
    """A line for each record: errors of the cycles that were left out, by method."""
    titles = _titles(rows, QUESTIONS[1])
    heads = ["record", *titles]
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        known = errors(row, QUESTIONS[1])
        if known:
            least = min(known, key=lambda name: known[name])
            cells = [f"**{cell(known[name])}**" if name == least else cell(known.get(name)) for name in titles]
            lines.append([row["case"].replace("_", " "), *cells])
    return _table(lines)


def refusals(rows: Rows) -> dict[str, list[str]]:
    """Names of the records that were refused, by the reason without the record's name."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if "refused" in row:
            reason = row["refused"].replace(row["case"], "RECORD").removeprefix("RECORD: ")
            found.setdefault(reason.split(". ")[0].split("; ")[0], []).append(row["case"])
    return found


def cell(value: float | None) -> str:
    """Three decimals; two digits of what is smaller than these can show."""
    return "–" if value is None else f"{value:.3f}" if value >= 1e-3 else f"{value:.1e}"


def _titles(rows: Rows, question: str) -> list[str]:
    """The methods that have an error of any record."""
    found = {name for row in rows for name in errors(row, question)}
    return [name for name in (*OWN.values(), *METHODS) if name in found]


def _seconds(row: Mapping[str, Any], question: str, name: str) -> float | None:
    if name == OWN["named"]:
        return row.get("own", {}).get(question, {}).get("seconds")
    if name in OWN.values():
        return None
    return row.get("comparisons", {}).get(question, {}).get(name, {}).get("seconds")


def _table(lines: Sequence[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
