"""Does `discover` find physics that no effect of the catalogue holds?  `python benchmarks/discoveries.py`.

Campaigns are made by `benchmarks/hidden`, which shares no code with the package: with a term of `hidden/unlisted.py`, with
nothing hidden, or with an effect of the catalogue in its own formula.  In the last two there is nothing to discover.  Results are
kept case by case, so that a run that was stopped goes on with `--resume`.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).parent))

import hidden_effects
from hidden import cases, unlisted
from hidden.campaigns import TooSmall, make
from hidden.unlisted import TERMS, Place, Term, histories

HIDDEN, NOTHING, LISTED = "hidden term", "control: nothing is missing", "control: the catalogue has it"
GROUPS = (HIDDEN, NOTHING, LISTED)
_LISTED = 20
_NOISES = 1.5  # of the noise: the error on held-out experiments that a discovery may leave
_CURVE = 0.05  # of the range of the true function: how far from it the learned one may be
_AIMS = {"right": 7 / 8, "within": 1.0, "equivalent": 6 / 8}

Case = cases.Case | unlisted.Case


def plan() -> dict[str, list[Case]]:
    """The cases, by group; those of the controls are cases of the benchmark of hidden effects."""
    known = hidden_effects.plan()
    strong = known["same formula, strong"]
    return {
        HIDDEN: [unlisted.Case(name, 900 + number) for number, name in enumerate(TERMS)],
        NOTHING: list(known[NOTHING]),
        LISTED: [strong[i] for i in np.linspace(0, len(strong) - 1, _LISTED).astype(int)],
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help="groups whose name contains this (default: all)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("discoveries.json"), metavar="FILE")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="every N-th case of each group")
    parser.add_argument("--resume", action="store_true", help="keep the cases that were scored already")
    parser.add_argument("--markdown", action="store_true", help="print the table of the last results, measure nothing")
    parser.add_argument("--alone", action="store_true", help="without the diagnosis before it: minutes less a case")
    options = parser.parse_args()
    kept = json.loads(options.output.read_text(encoding="utf-8")) if options.resume or options.markdown else []
    if not options.markdown:
        known = {json.dumps([row["group"], row["case"]]) for row in kept}
        todo = [
            (group, case)
            for group, its in plan().items()
            if not options.groups or any(word in group for word in options.groups)
            for case in its[:: options.stride]
        ]
        left = [(g, c) for g, c in todo if json.dumps([g, _plain(c)]) not in known]
        for row in scored(left, _alone if options.alone else None):
            kept.append(row)
            print(_line(row), file=sys.stderr, flush=True)
            options.output.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(table(kept))


def _alone(fit: Any, campaign: Any) -> Any:
    """Discover where the catalogue has had no turn, as if nothing had been named."""
    import hsed_jax as hx

    return hx.discover(fit, campaign, SimpleNamespace(verdict="unexplained", effects=[], is_explained=False))


def scored(todo: Sequence[tuple[str, Case]], discover: Callable[..., Any] | None = None) -> Iterator[dict[str, Any]]:
    """Make, discover and score cases.

    Arguments:
        todo: group and case each.
        discover: (fit, campaign) -> what was found; by default that of the package.
    """
    for group, case in todo:
        row = {"group": group, "case": _plain(case)}
        with tempfile.TemporaryDirectory() as place:
            folder, truth = Path(place) / "campaign", Path(place) / "truth.json"
            try:
                (unlisted.make if isinstance(case, unlisted.Case) else make)(case, folder, truth)
            except TooSmall as reason:
                yield row | {"skipped": str(reason)}
                continue
            found, errors, seconds = discovered(folder, discover)
            row |= {"error": errors, "seconds": seconds} | summary(found)
            if isinstance(case, unlisted.Case):
                row |= score(found, TERMS[case.term], dict(np.load(truth.with_suffix(".npz"))))
        yield row


def discovered(folder: Path, discover: Callable[..., Any] | None = None) -> tuple[Any, list[float], float]:
    """What is found in a campaign folder; the error on held-out experiments before and after, and the noise; seconds."""
    import hsed_jax as hx

    campaign = hx.read_campaign(folder)
    # A late actuator seems to draw energy from the specimen; a user is asked whether that is as it should be, and here it is.
    accepted = ", ".join(f"{{{experiment.id}: sign}}" for experiment in campaign)
    study = hx.load_study(folder / "study.yaml", ["calibration.sampler=laplace", f"measurements.accept=[{accepted}]"])
    fit = hx.calibrate(study, campaign)
    before = hx.compare(fit).test
    assert before is not None
    begin = time.perf_counter()
    found = (discover or hx.discover)(fit, campaign)
    seconds = time.perf_counter() - begin
    after = found.error_test if found.found else before.error
    return found, [float(before.error), float(after), float(before.noise_floor)], seconds


def summary(found: Any) -> dict[str, Any]:
    """What was found, to be kept as JSON."""
    return {
        "found": bool(found.found),
        "reason": found.reason,
        "place": _place(found.place) if found.found else None,
        "formula": found.formula if found.found else None,
        "ranking": [[_place(e.place), round(float(e.log_evidence_gain), 1)] for e in list(found.ranking or ())[:4]],
    }


def score(found: Any, term: Term, truth: dict[str, np.ndarray]) -> dict[str, Any]:
    """Compare what was found with a hidden term, whose noise-free histories are `truth`."""
    if not found.found:
        return {"right": False, "curve": None, "equivalent": False}
    visited = histories(truth["time"], truth["elongation"], truth["force"], term.memory)
    curve = curve_error(found, term, visited)
    return {
        "right": Place(found.place.slot, frozenset(found.place.of)) in term.right,
        "curve": curve,
        "equivalent": curve is not None and curve <= _CURVE,
    }


def curve_error(found: Any, term: Term, visited: dict[str, np.ndarray]) -> float | None:
    """Largest distance of the learned function from the true one where the campaign was, over the true one's range.

    What the law itself can take is no difference: of a force a linear function of the elongation and a constant, of a factor a
    constant factor.  None where one is a force and the other a factor.
    """
    if (found.place.slot == "force") != (term.place.slot == "force"):
        return None
    within = np.ones(visited["elongation"].shape, bool)
    for name, (low, high) in found.reach.items():
        within &= (visited[name] >= low) & (visited[name] <= high)
    # In the moment of turning the direction is neither of both.
    within &= np.abs(visited["rate"]) > 3 * unlisted.STICKING * np.quantile(np.abs(visited["rate"]), 0.98)
    if not within.any():
        return None
    at = {name: values[within] for name, values in visited.items()}
    true = np.asarray(term.value(**{name: at[name] for name in term.place.of}))
    learned = np.asarray(found.value({name: at[name] for name in found.place.of}))
    if term.place.slot == "force":
        free = np.stack([np.ones(true.size), at["elongation"] / np.abs(at["elongation"]).max()], axis=1)
        target = learned - true
    else:
        free, target = learned[:, None], true
    return _least_deviation(free, target, float(np.ptp(true)))


def _least_deviation(columns: np.ndarray, target: np.ndarray, unit: float) -> float:
    """The smallest largest deviation of a combination of the columns from the target, in this unit: a linear program."""
    scale = np.abs(columns).max(axis=0)
    columns, target = columns / np.where(scale > 0, scale, 1.0), target / unit
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        return float("inf")
    ones = np.ones((len(target), 1))
    sides = np.block([[columns, -ones], [-columns, -ones]])
    cost = np.append(np.zeros(columns.shape[1]), 1.0)
    bounds = [(None, None)] * columns.shape[1] + [(0, None)]
    return float(linprog(cost, sides, np.concatenate([target, -target]), bounds=bounds).fun)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The results as a Markdown table, a row for each hidden term and for each false discovery; the totals below it."""
    head = "| name | place named | right | error before | after | noise | curve error | formula | s |"
    lines = [head, "|" + " --- |" * 9]
    done = {group: [row for row in rows if row["group"] == group and "skipped" not in row] for group in GROUPS}
    for row in [*done[HIDDEN], *(row for group in GROUPS[1:] for row in done[group] if row["found"])]:
        before, after, noise = (f"{error:.3f}" for error in row["error"])
        curve = row.get("curve")
        lines.append(
            f"| {_name(row)} | {row['place'] or row['reason']} | {_mark(row.get('right'))} | {before} | {after} | {noise} | "
            f"{'–' if curve is None else f'{100 * curve:.1f} %'} | {_formula_cell(row)} | {row['seconds']:.0f} |"
        )
    return "\n".join([*lines, "", _totals(done)])


def _totals(done: dict[str, list[dict[str, Any]]]) -> str:
    hidden = done[HIDDEN]
    reached = {
        "right": sum(row["right"] for row in hidden),
        "within": sum(row["error"][1] <= _NOISES * row["error"][2] for row in hidden),
        "equivalent": sum(row["equivalent"] for row in hidden),
    }
    # Of eight terms 7 and 6 were aimed at; of more or fewer as many in proportion.
    aims = {key: int(np.ceil(share * len(hidden))) for key, share in _AIMS.items()}
    what = {
        "right": "right place first",
        "within": f"error at most {_NOISES:g} times the noise",
        "equivalent": f"curve within {100 * _CURVE:.0f} %",
    }
    parts = [f"{what[key]} {reached[key]} of {len(hidden)} (aim: {aims[key]})" for key in what]
    for group in GROUPS[1:]:
        false = sum(row["found"] for row in done[group])
        parts.append(f"{group}: found in {false} of {len(done[group])} (aim: 0)")
    return "; ".join(parts) + "."


def _place(place: Any) -> str:
    return str(Place(place.slot, frozenset(place.of)))


def _plain(case: Case) -> dict[str, Any]:
    return dict(vars(case)) if isinstance(case, unlisted.Case) else hidden_effects._plain(case)


def _name(row: dict[str, Any]) -> str:
    if "term" in row["case"]:
        return row["case"]["term"]
    return f"{row['group']}: {' + '.join(effect for effect, _ in row['case']['effects']) or row['case']['kind']}"


def _mark(right: bool | None) -> str:
    return "–" if right is None else "yes" if right else "no"


def _formula_cell(row: dict[str, Any]) -> str:
    if not row["formula"]:
        return "–"
    # A bar would end the cell.
    return "`" + row["formula"].replace("|", "\\|") + "`" + (" ✓" if row.get("equivalent") else "")


def _line(row: dict[str, Any]) -> str:
    if "skipped" in row:
        return f"{_name(row)}: skipped, {row['skipped']}"
    errors = " → ".join(f"{error:.3f}" for error in row["error"][:2])
    curve = "" if row.get("curve") is None else f", curve {100 * row['curve']:.1f} %"
    right = "" if "right" not in row else f" ({'right' if row['right'] else 'not right'})"
    what = f"{row['place']}{right}" if row["found"] else f"nothing: {row['reason']}"
    return (
        f"{_name(row)}: {what}, error {errors} ({row['error'][2]:.3f}){curve}, {row['seconds']:.0f} s, {row['ranking']}"
    )


if __name__ == "__main__":
    main()
