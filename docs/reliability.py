"""Tables of the verification manual from kept results of benchmarks: coverage, diagnoses, measured specimens, the paper."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta as beta_distribution

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
TITLE = "Intervals, diagnoses and measured specimens"

# The numbers of the paper: Section 4, and Fig. 5.
PRINTED = {"A": 4.24e5, "beta": 0.826, "settled": 20}
UNITS = {"A": "N/m", "beta": "1/m"}
# Stored diagnoses, and their cases.
DIAGNOSES = {
    "hidden_effects_scored": "unseen during development",
    "hidden_effects_real": "partly used during development",
    "hidden_effects_probed": "unseen but for one, an earlier diagnosis",
    "hidden_effects_unseen": "unseen, an earlier diagnosis",
    "hidden_effects": "partly used during development, an earlier diagnosis",
}

# Limits of the bins of stated probabilities.
BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)

COVERAGE = """These results take hours. They are kept beside the benchmark that measured them, and this page is computed
from them.

## Coverage of intervals

A 90 % interval holds the truth in nine of ten campaigns. The accepted range is 90 % and two standard errors of so many
campaigns to either side, so about one row in twenty lies outside of it. [How the campaigns are made](../coverage.md).
"""
ALARMS = """
## A correct model

The calibrated model is the specimen. A p-value below 0.01 and a verdict other than `adequate` are errors. The last row has
all campaigns, and in brackets the largest rate that is possible with a confidence of 95 % (Clopper & Pearson 1934).
"""
DIAGNOSED = """
## Diagnoses

The specimens have an effect that only the scorer knows; where the noise explains the residual of the plain law there is
nothing to name, and the case does not count. Brackets hold the 95 % interval of a share (Clopper & Pearson 1934).
[What the groups are](../benchmarks.md).
"""
STATED = """
## Stated probabilities

A diagnosis states the probability of each effect that it names. The table sorts these statements by the probability and
compares them with the share of them that is right. They are those of the first file of the table above, where there is an
effect to name. `within`: the mean stated probability is in the 95 % interval of the share. An effect of the right family
changes the same property of the specimen.
"""
DISCOVERED = """
## Discoveries

The specimens have a term that the catalogue lacks, or nothing that it lacks. An error is a wrong place, or a discovery where
nothing is hidden.
"""
MEASURED = """
## Measured specimens

The error of the part of each test that was not fitted, over the standard deviation of the measurement. No specimen is
explained down to its noise; the difference is the validation error of the model.
"""


def page() -> Iterator[str]:
    """The lines of the page below its title."""
    intervals = _kept("intervals")
    yield COVERAGE
    yield from _table(("quantity", "noise", "experiments", "reference", "accepted", "observed", "within"),
                      list(_coverage(intervals)))  # fmt: skip
    yield "\n`python benchmarks/intervals.py`; the population: `python benchmarks/specimens.py`."
    yield ALARMS
    heads = ("noise", "experiments", "campaigns", "p < 0.01", "called wrong")
    yield from _table(heads, list(_alarms(intervals)))
    yield "\n`python benchmarks/intervals.py --only p_values alarms`."
    yield DIAGNOSED
    heads = ("group", "campaigns", "effect to name", "named first", "exact set", "false alarms")
    yield from _table(heads, [row for file, about in DIAGNOSES.items() for row in _diagnoses(_kept(file), about)])
    yield "\n`python benchmarks/hidden_effects.py`."
    yield STATED
    heads = ("stated", "statements", "mean stated", "right", "within", "right family")
    yield from _table(heads, list(_stated(_kept(next(iter(DIAGNOSES))))))
    yield DISCOVERED
    yield from _table(("group", "cases", "wrong", "share that is wrong"), list(_discoveries(_kept("discoveries"))))
    yield "\n`python benchmarks/discoveries.py`."
    yield MEASURED
    heads = ("specimen", "noise", "plain law", "with the named effects", "verdict")
    yield from _table(heads, [_specimen(row["case"], own) for row in _board() if "named" in (own := _last_rows(row))])
    yield "\n`python benchmarks/published.py`."


def paper() -> list[str]:
    """The estimates of the paper's design beside those that it prints."""
    heads = ("reading of the paper", "figure", "the paper", "observed", "90 % interval", "holds it", "difference")
    rows = []
    for reading, found in _kept("paper").items():
        for name, unit in UNITS.items():
            low, high = found["posterior"][name]
            own, printed = found["map"][name], PRINTED[name]
            rows.append((reading, f"{name} [{unit}]", f"{printed:.3g}", f"{own:.4g}", f"{low:.4g} to {high:.4g}",
                         "yes" if low <= printed <= high else "no", f"{own / printed - 1:+.1%}"))  # fmt: skip
        about = (f"right before {PRINTED['settled']}", str(found["settled"]), "–", "–", "–")
        rows.append((reading, "iterations until the improvement stays below 1 %", *about))
    text = """The paper gives neither the size of the error (Eqs. 2 to 4) nor what its third quantity is. The estimates of
each reading ([equations](../equations.md)) stand beside the printed ones. An interval is the
posterior of one reading, and the choice between readings is not part of it (`python benchmarks/paper.py`)."""
    return [text, "", *_table(heads, rows)]


def _coverage(intervals: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    def row(quantity: str, noise: str, experiments: str, share: float, count: int) -> tuple[str, ...]:
        error = 2 * np.sqrt(0.9 * 0.1 / count)
        low, high = 0.9 - error, min(0.9 + error, 1.0)
        return (quantity, noise, experiments, f"90 %, {count} campaigns", f"{low:.0%} to {high:.0%}", f"{share:.0%}",
                "yes" if low <= share <= high else "no")  # fmt: skip

    everything: list[bool] = []
    for case in intervals["intervals"]:
        for name in ("A", "beta", "size"):
            everything += case[name]
            yield row(name, case["case"], str(case["experiments"]), float(np.mean(case[name])), len(case[name]))
    # The three intervals of a campaign depend on one another, so a campaign counts once.
    campaigns = sum(len(case["seeds"]) for case in intervals["intervals"])
    yield row("all of them", "–", "–", float(np.mean(everything)), campaigns)
    recovered = _kept("specimens")["recovery"]
    for name, share in recovered["coverage"].items():
        yield row(f"{name} of a population", "–", "–", share, recovered["replications"])


def _alarms(intervals: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    small, wrong, campaigns = 0, 0, 0
    for judged, diagnosed in zip(intervals["p_values"], intervals["alarms"], strict=True):
        below = sum(p < 0.01 for p in judged["p"])
        alarms = sum(verdict != "adequate" for verdict in diagnosed["verdict"])
        small, wrong, campaigns = small + below, wrong + alarms, campaigns + len(judged["p"])
        yield judged["case"], str(judged["experiments"]), str(len(judged["p"])), str(below), str(alarms)
    most = [f"{count} (below {_interval(count, campaigns)[1]:.1%})" for count in (small, wrong)]
    yield ("all of them", "–", str(campaigns), *most)


def _diagnoses(rows: Sequence[Mapping[str, Any]], about: str) -> Iterator[tuple[str, ...]]:
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if "skipped" not in row:
            groups.setdefault(row["group"], []).append(row)
    for group, own in groups.items():
        # An effect that a refit of the law absorbs down to the noise cannot be detected.
        seen = [row for row in own if row["verdict"] != "adequate" and not row["absorbed"]]
        alarms = sum(bool(set(row["named"]) - {effect for effect, _ in row["case"]["effects"]}) for row in own)
        yield (f"{group} ({about})", str(len(own)), str(len(seen)), _share(seen, lambda row: row["first"]),
               _share(seen, lambda row: row["exact"]), f"{alarms} of {len(own)}")  # fmt: skip


def _stated(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    # The pages are written after pytest has run in this process: it wants to import the package itself.
    from hsed_jax.physics.effects import EFFECTS
    from hsed_jax.physics.names import own_name

    statements: list[tuple[float, bool, bool]] = []
    for row in rows:
        if "skipped" in row or row["verdict"] == "adequate" or row["absorbed"]:
            continue
        truth = {effect for effect, _ in row["case"]["effects"]}
        families = {EFFECTS[own_name(effect)].family for effect in truth}
        for effect, probability, _ in row["ranking"]:
            if effect in row["named"]:
                is_right = effect in truth
                statements.append((probability, is_right, is_right or EFFECTS[own_name(effect)].family in families))
    for low, high in pairwise(BINS):
        own = [one for one in statements if low <= one[0] < high or one[0] == high == BINS[-1]]
        if not own:
            continue
        mean = float(np.mean([probability for probability, *_ in own]))
        least, most = _interval(sum(is_right for _, is_right, _ in own), len(own))
        yield (f"{low:g} to {high:g}", str(len(own)), f"{mean:.2f}", _share(own, lambda one: one[1]),
               "yes" if least <= mean <= most else "no", _share(own, lambda one: one[2]))  # fmt: skip


def _discoveries(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    for group in dict.fromkeys(row["group"] for row in rows):
        own = [row for row in rows if row["group"] == group and row.get("found") is not None]
        wrong = [row for row in own if (not row["right"] if "right" in row else row["found"])]
        yield group, str(len(own)), str(len(wrong)), _share(own, lambda row, wrong=wrong: row in wrong)


def _last_rows(row: Mapping[str, Any]) -> Mapping[str, Any]:
    """The run of the program that predicts the last rows of a record; empty without one."""
    return row.get("own", {}).get("last rows", {})


def _specimen(case: str, own: Mapping[str, Any]) -> tuple[str, ...]:
    errors = (f"{own[key]:.3f}" for key in ("noise", "plain", "named"))
    return case.replace("_", " "), *errors, f"`{own['verdict']}`"


def _share(rows: Sequence[Any], is_one: Callable[[Any], bool]) -> str:
    """The share of rows, and its interval."""
    if not rows:
        return "–"
    count = sum(map(is_one, rows))
    low, high = _interval(count, len(rows))
    return f"{count / len(rows):.0%} ({low:.0%} to {high:.0%})"


def _interval(count: int, of: int) -> tuple[float, float]:
    """The 95 % interval of a share; 95 % to the only side that there is, where none or all count."""
    tail = 0.05 if count in (0, of) else 0.025
    low = 0.0 if count == 0 else float(beta_distribution.ppf(tail, count, of - count + 1))
    high = 1.0 if count == of else float(beta_distribution.ppf(1 - tail, count + 1, of - count))
    return low, high


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield from ("| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows))


def _board() -> list[dict[str, Any]]:
    """Lines of the scoreboard: of some records only other methods have run."""
    return [json.loads(line) for line in (BENCHMARKS / "board.jsonl").read_text(encoding="utf-8").splitlines()]


def _kept(name: str) -> Any:
    return json.loads((BENCHMARKS / f"{name}.json").read_text(encoding="utf-8"))
