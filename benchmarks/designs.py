"""How many experiments tell two explanations apart?  `python benchmarks/designs.py [--seeds N] [--resume]`

Twenty pairs of effects, of shaken structures and of component tests whose loading history is designed: the specimen has the first
effect, and both are explanations of what it does (`rivals.py` says how).  A design asks for one experiment after the other until
either explanation has a probability above 0.95, at most for twelve.  Designs differ in what they choose by and in nothing else.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rivals import CERTAIN, CRITERIA, INITIAL, MOST, TESTS, trials_of

RESULTS = Path(__file__).with_suffix(".jsonl")
_AFTER = (1, 2, 4, MOST - INITIAL)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("criteria", nargs="*", metavar="CRITERION", help=f"of {', '.join(CRITERIA)} (default: all)")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="how many seeds of each pair (default: 20)")
    parser.add_argument("--resume", action="store_true", help="keep the designs that were made already")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing measured")
    parser.add_argument("--by", choices=("test", "pair"), help="a table for each kind of test, or for each pair")
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.jsonl")
    options = parser.parse_args()
    if unknown := set(options.criteria) - set(CRITERIA):
        parser.error(f"there is no criterion {sorted(unknown)[0]}; there are {', '.join(CRITERIA)}")
    if not (options.resume or options.markdown):
        options.output.write_text("", encoding="utf-8")
    if not options.markdown:
        measure(options.output, options.criteria or list(CRITERIA), options.seeds)
    rows = _read(options.output)
    for title, own in _split(rows, options.by).items():
        print(f"\n{title}\n" if title else "", markdown(own), sep="\n")


def measure(output: Path, criteria: Sequence[str], seeds: int) -> None:
    """Make the designs that are not there yet, a line of JSON for each pair and seed."""
    known = {_name(row) for row in _read(output)}
    # Pair by pair for one seed after the other: whoever stops early has all of them.
    for seed in range(seeds):
        for test, kind in TESTS.items():
            for right, rival in (pair for one, other in kind.pairs for pair in ((one, other), (other, one))):
                todo = [by for by in criteria if (test, right, rival, seed, by) not in known]
                if not todo:
                    continue
                cpu = time.process_time()
                trials = trials_of(test, right, rival, seed, todo)
                line = {"test": test, "right": right, "rival": rival, "seed": seed,
                        "cpu_seconds": round((time.process_time() - cpu) / len(todo), 3),
                        "designs": {t.by: [len(t.asked), float(f"{t.probability:.4g}")] for t in trials}}  # fmt: skip
                with output.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")


def _read(output: Path) -> list[dict[str, Any]]:
    """A row for each design: what it chose by, how many experiments it made, the probability of the right one at its end."""
    lines = output.read_text(encoding="utf-8").splitlines() if output.exists() else []
    found = []
    for line in map(json.loads, lines):
        for by, (experiments, probability) in line.pop("designs").items():
            found.append({**line, "by": by, "experiments": experiments, "probability": probability})
    return found


def _name(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[key] for key in ("test", "right", "rival", "seed", "by"))


def _split(rows: Sequence[dict[str, Any]], by: str | None) -> dict[str, list[dict[str, Any]]]:
    """Rows by what is to have a table of its own."""
    titles = {
        "test": lambda row: row["test"],
        "pair": lambda row: f"{row['right']}, not {row['rival']} ({row['test']})",
    }
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(titles[by](row) if by else "", []).append(row)
    return found


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """The table of the results: what share of the designs was certain of the right one after so many experiments of their choice.

    Where the initial experiments were enough, there was nothing to choose, and these designs are not counted.
    """
    heads = ["chosen by", "designs", *(f"right after {n} chosen" for n in _AFTER), "wrong", "never certain", "CPU s"]
    lines = [heads, ["---"] * len(heads)]
    for by in (name for name in CRITERIA if any(row["by"] == name for row in rows)):
        own = [row for row in rows if row["by"] == by]
        chosen = [row for row in own if row["experiments"] > INITIAL]
        right = [row["experiments"] - INITIAL for row in chosen if row["probability"] > CERTAIN]
        wrong = sum(row["probability"] < 1 - CERTAIN for row in chosen)
        counts = [*(sum(n <= after for n in right) for after in _AFTER), wrong, len(chosen) - len(right) - wrong]
        shares = [f"{count / len(chosen):.0%}" if chosen else "–" for count in counts]
        seconds = np.mean([row["cpu_seconds"] for row in own])
        lines.append([f"`{by}`", f"{len(chosen)} of {len(own)}", *shares, f"{seconds:.1f}"])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


if __name__ == "__main__":
    main()
