"""Does the diagnosis find an effect that it cannot know?  `python benchmarks/hidden_effects.py`.

Campaigns are made by `benchmarks/hidden`, which shares no code with the package; the truth lies in files that only the scorer
opens.  Every case is made, diagnosed from its campaign folder alone, and scored; results are kept case by case, so that a run
that was stopped goes on with `--resume`.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from hidden.campaigns import TooSmall, make
from hidden.cases import Case, draw
from hidden.catalogue import EFFECTS, FAMILIES, FORMULAS, KINDS, REAL, applicable
from hidden.mixtures import drawn, mixable
from hidden.opensees import is_available
from hidden.probed import forces
from hidden.specimen import Scales

from hsed_jax.behaviour.histories import Range, along_the_test
from hsed_jax.behaviour.probes import probed
from hsed_jax.behaviour.specimens import longest_step
from hsed_jax.config.load import load_study
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.diagnose import diagnose
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.errors import UserError
from hsed_jax.study.build import Built

WEAK, MEDIUM, STRONG = 0.03, 0.10, 0.25
SIZES = {WEAK: "weak", MEDIUM: "medium", STRONG: "strong"}
NOISES = (0.02, 0.05, 0.10)
_PAIRS, _CONTROLS = 24, 100
# Sizes of an effect in another formula, with the noise; experiments to train with and held out, by kind of campaign.
_SIZED = (("medium", MEDIUM, 0.05), ("strong", STRONG, 0.02))
_EXPERIMENTS = {"shaken": (6, 4), "component": (6, 4), "quantities": (20, 6)}
# So many mixtures of formulas for each effect and kind of campaign.
_MIXTURES = 4
# Quantities whose curves are judged: those that every specimen has.
_JUDGED = ("initial_stiffness", "unloading_stiffness+", "unloading_stiffness-", "strength+", "strength-", "rate_force")
# No specimen has so many times the strength of the law.
_FAR = 100.0
# A curve is right that is off by less, over its largest value.
_CURVE = 0.1
# What is left with this probability is noise.
_NOISE = 0.05


def plan() -> dict[str, list[Case]]:
    """The cases, by group; every n-th of a group is spread evenly over kinds of campaign, effects and their formulas."""
    groups = _same_formula() | _other_formulas() | _mixed_formulas() | _real_specimens() | _controls()
    if is_available():
        groups["OpenSees materials, medium"] = [
            Case("component", ((effect, formula),), MEDIUM, 0.02, 6, 4, 700 + number)
            for number, (effect, formula) in enumerate(FORMULAS)
            if formula == "opensees"
        ]
    return groups | {"pairs, medium": _pairs()}


def _same_formula() -> dict[str, list[Case]]:
    """One effect in the formula of the catalogue."""
    groups: dict[str, list[Case]] = {}
    numbered = list(enumerate(EFFECTS))
    # There and back, so that an even stride meets other effects in the second kind.
    for kind, there_or_back in (("shaken", numbered), ("component", numbered[::-1])):
        for number, effect in there_or_back:
            if applicable(effect, kind):
                hidden = ((effect, "same"),)
                _add(groups, "same formula, medium", Case(kind, hidden, MEDIUM, 0.05, 6, 4, number))
                _add(groups, "same formula, strong", Case(kind, hidden, STRONG, 0.02, 6, 4, 100 + number))
    for number, effect in numbered:
        hidden = ((effect, "same"),)
        _add(groups, "same formula, weak", Case("shaken", hidden, WEAK, 0.05, 6, 4, 200 + number))
        varied = Case("shaken", hidden, MEDIUM, 0.10, 3 + number % 10, 4, 300 + number)
        _add(groups, "same formula, noise 10 %", varied)
        if applicable(effect, "quantities"):
            _add(groups, "quantities alone, strong", Case("quantities", hidden, STRONG, 0.02, 20, 6, 400 + number))
    return groups


def _other_formulas() -> dict[str, list[Case]]:
    """One effect in every formula but the catalogue's and OpenSees', kind by kind and effect by effect.

    The formulas of an effect follow one another from another one on for each effect and kind, so that no stride always meets
    the same.
    """
    groups: dict[str, list[Case]] = {}
    for turn, kind in enumerate(KINDS):
        for number, effect in enumerate(EFFECTS):
            names = [name for e, name in FORMULAS if e == effect and name not in ("same", "opensees")]
            if not names or not applicable(effect, kind):
                continue
            for place in range(len(names)):
                index = (place + number + turn) % len(names)
                hidden, seed = ((effect, names[index]),), 1000 + 10 * number + index
                for label, size, noise in _SIZED:
                    own = seed + (1000 if label == "strong" else 0)
                    case = Case(kind, hidden, size, noise, *_EXPERIMENTS[kind], own)
                    _add(groups, f"other formula, {label}", case)
    return groups


def _mixed_formulas() -> dict[str, list[Case]]:
    """One effect in a mixture of two of its formulas, the kinds and effects in turn."""
    groups: dict[str, list[Case]] = {}
    for label, size, noise in _SIZED:
        for turn in range(_MIXTURES):
            for place, kind in enumerate(KINDS):
                for number, effect in enumerate(EFFECTS):
                    if len(mixable(effect)) > 1 and applicable(effect, kind):
                        seed = 10000 + 1000 * turn + 100 * place + number + (5000 if label == "strong" else 0)
                        hidden = ((effect, drawn(effect, seed)),)
                        _add(
                            groups,
                            f"mixed formulas, {label}",
                            Case(kind, hidden, size, noise, *_EXPERIMENTS[kind], seed),
                        )
    return groups


def _real_specimens() -> dict[str, list[Case]]:
    """What tests of real specimens show, in every formula."""
    groups: dict[str, list[Case]] = {}
    for kind in ("shaken", "component"):
        for number, (effect, formula) in enumerate(key for key in FORMULAS if key[0] in REAL):
            for label, size, noise in _SIZED:
                seed = 20000 + 100 * number + (1000 if label == "strong" else 0) + (50 if kind == "shaken" else 0)
                case = Case(kind, ((effect, formula),), size, noise, *_EXPERIMENTS[kind], seed)
                _add(groups, f"real specimens, {label}", case)
    return groups


def _controls() -> dict[str, list[Case]]:
    """Nothing is hidden: white noise; noise with a memory that nobody declares; records of few samples."""
    groups: dict[str, list[Case]] = {}
    random = np.random.default_rng(1)
    for number in range(_CONTROLS):
        experiments, noise = 3 + number % 10, NOISES[number // 3 % 3]
        _add(
            groups, "control: nothing is missing", Case(KINDS[number % 3], (), 0.0, noise, experiments, 4, 500 + number)
        )
        kind, memory, every = (
            ("shaken", "component")[number % 2],
            float(random.uniform(0.2, 0.9)),
            int(random.integers(5, 11)),
        )
        remembering = Case(kind, (), 0.0, noise, experiments, 4, 3000 + number, memory=round(memory, 3))
        _add(groups, "control: noise with a memory", remembering)
        coarse = Case(kind, (), 0.0, noise, experiments, 4, 3100 + number, every=every)
        _add(groups, "control: coarse sampling", coarse)
    for cases in groups.values():
        # Kind by kind, and within a kind in no order, in which noise and number of experiments would repeat with the stride.
        random.shuffle(cases)
        cases.sort(key=_place_of_kind)
    return groups


def _pairs() -> list[Case]:
    random = np.random.default_rng(0)
    pairs: list[Case] = []
    while len(pairs) < _PAIRS:
        kind = ("shaken", "component")[len(pairs) % 2]
        one, two = random.choice([e for e in EFFECTS if applicable(e, kind)], 2, replace=False)
        if EFFECTS[one] != EFFECTS[two]:
            pairs.append(Case(kind, ((str(one), "same"), (str(two), "same")), MEDIUM, 0.02, 6, 4, 600 + len(pairs)))
    return sorted(pairs, key=_place_of_kind)


def _place_of_kind(case: Case) -> int:
    # A group whose kinds alternate would show only one of them to an even stride.
    return KINDS.index(case.kind)


def _add(groups: dict[str, list[Case]], group: str, case: Case) -> None:
    groups.setdefault(group, []).append(case)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help="groups whose name contains this (default: all)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("hidden_effects.json"), metavar="FILE")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="every N-th case of each group")
    parser.add_argument(
        "--offset", type=int, default=0, metavar="N", help="from this case of each group on (with --stride)"
    )
    parser.add_argument("--resume", action="store_true", help="keep the cases that were scored already")
    parser.add_argument("--markdown", action="store_true", help="print the table of the last results, measure nothing")
    parser.add_argument("--by", choices=list(SPLITS), help="split the rows of the table by this")
    options = parser.parse_args()
    keeps = (options.resume or options.markdown) and options.output.exists()
    kept = json.loads(options.output.read_text(encoding="utf-8")) if keeps else []
    if not options.markdown:
        groups = {
            group: cases[options.offset :: options.stride]
            for group, cases in plan().items()
            if not options.groups or any(word in group for word in options.groups)
        }
        known = {json.dumps([row["group"], row["case"]]) for row in kept}
        todo = [(g, c) for g, cases in groups.items() for c in cases if json.dumps([g, _plain(c)]) not in known]
        for row in scored(todo):
            kept.append(row)
            print(_line(row), file=sys.stderr, flush=True)
            options.output.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(table(kept, options.by))


def scored(cases: Sequence[tuple[str, Case]]) -> Iterator[dict[str, Any]]:
    """Make, diagnose and score cases; the next campaign is made while one is diagnosed."""
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(1, get_context("spawn")) as maker:
        places = [(Path(folder) / f"campaign{n}", Path(folder) / f"truth{n}.json") for n in range(len(cases))]
        futures = [maker.submit(_made, case, *place) for (_, case), place in zip(cases, places, strict=True)]
        for (group, case), (campaign, truth), future in zip(cases, places, futures, strict=True):
            row = {"group": group, "case": _plain(case)}
            if message := future.result():
                yield row | {"skipped": message}
                continue
            begin = time.perf_counter()
            try:
                found = diagnosed(campaign)
            except UserError as refusal:
                # As a quantity that happens to be negative, of which a relative error is none.
                yield row | {"skipped": f"refused: {refusal}"}
                continue
            seconds = time.perf_counter() - begin
            told = json.loads(truth.read_text(encoding="utf-8"))
            judged = {"behaviour": behaviour(found, folder_range(campaign), case, told)} if case.effects else {}
            yield row | score(found.summary(), told) | judged | {"seconds": seconds}


def diagnosed(folder: Path) -> Diagnosis:
    """What the package finds in a campaign folder."""
    built = Built(load_study(folder / "study.yaml"))
    assert built.experiments.measured is not None
    return diagnose(problem_of(built, built.experiments.measured))


def behaviour(found: Diagnosis, visited: Range, case: Case, truth: dict[str, Any]) -> dict[str, Any] | None:
    """The curves of the diagnosis beside those of the hidden specimen, by the same numerical experiments.

    Returns:
        By quantity: the largest difference over the largest value of the hidden specimen along the test (a force that depends
        on the rate over the strength), and at how many of the places the interval holds it; None where nothing was probed, or
        the effect is not in the specimen.
    """
    plan = draw(case)
    if not found.behaviour.curves or any(item.formula.place != "specimen" for item in plan.hidden):
        return None
    step = longest_step(plan.A / plan.beta / plan.A, visited.elongation)
    histories = along_the_test(visited, step)
    force = forces(
        plan,
        truth["deltas"],
        Scales(**truth["scales"]["used"]),
        *histories.imposed,
    )
    # Its own steps may be too long for a hidden formula, which then goes to infinity.
    is_fine = np.all(np.abs(force) < _FAR * plan.A / plan.beta, axis=1)
    if not is_fine.all():
        return None
    hidden = probed(histories, force, is_fine).quantities
    strength = np.nanmax(hidden["strength+"])
    judged = {}
    for name in _JUDGED:
        curve, true = found.behaviour.curves[name], hidden[name]
        size = strength if name == "rate_force" else np.abs(true).max()
        inside = (curve.q05 <= true) & (true <= curve.q95)
        judged[name] = {
            "off": float(np.abs(curve.mean - true).max() / size),
            "off_before": float(np.abs(curve.before - true).max() / size),
            "inside": int(inside.sum()),
            "of": len(true),
        }
    return judged


def folder_range(folder: Path) -> Range:
    """What the tests of a campaign folder visited, as the diagnosis sees it."""
    built = Built(load_study(folder / "study.yaml"))
    assert built.experiments.measured is not None
    visited = problem_of(built, built.experiments.measured, effects=[]).visited
    assert visited is not None
    return visited


def score(found: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """Compare a diagnosis with the truth."""
    names = [effect["effect"] for effect in truth["effects"]]
    named = found["effects"]
    families = {c["effect"]: c["family"] for c in found["ranking"]}
    inside = []
    for effect in truth["effects"]:
        estimate = next((c["estimate"] for c in found["ranking"] if c["effect"] == effect["effect"]), {})
        if effect["formula"] != "same" or effect["effect"] not in named:
            continue
        # The amplitude comes first.
        for name, true in list(effect["parameters"].items())[:1]:
            if name in estimate:
                inside.append(estimate[name]["q05"] <= true["value"] <= estimate[name]["q95"])
    return {
        "named": named,
        "verdict": found["verdict"],
        "first": bool(named) and named[0] in names,
        "family": bool(named) and families[named[0]] in {FAMILIES[name] for name in names},
        "exact": sorted(named) == sorted(names),
        # Of a pair one is named, and what the other does a refit absorbs down to the noise.
        "absorbed": bool(named) and set(named) < set(names) and (found["p_value_after"] or 0.0) >= _NOISE,
        "alike": any(set(names) & set(group) for group in found["look_alikes"]),
        "covered": inside,
        "error": [found["error"]["test"][0], found["error"]["test"][1], found["noise_floor"]],
        "ranking": [
            [c["effect"], round(c["probability"], 4), round(c["log_evidence_gain"], 1)] for c in found["ranking"][:4]
        ],
        "change": truth.get("change"),
    }


def table(rows: Sequence[dict[str, Any]], by: str | None = None) -> str:
    """The results as a Markdown table, a row for each group, or for each part of it where it is split by one of SPLITS."""
    head = (
        "| group | cases | noise explains it | named first | family first | exact set | false alarms | ambiguous | "
        "unexplained | error before → after (noise) | error raised | interval covers | curves within 10 % | bands hold | s |"
    )
    lines = [head, "|" + " --- |" * 15]
    parts: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        if "skipped" not in row:
            parts.setdefault(row["group"] + (f": {SPLITS[by](row['case'])}" if by else ""), []).append(row)
    for label, own in parts.items():
        # What a refit of the law absorbs down to the noise, all of it or one of two effects, is there for nobody to see.
        seen = [row for row in own if row["verdict"] != "adequate" and not row["absorbed"]]
        errors = np.median(np.asarray([row["error"] for row in own]), axis=0)
        shares = [_share([row[key] for row in seen]) for key in ("first", "family", "exact")]
        counts = [sum(row["verdict"] == verdict for row in own) for verdict in ("ambiguous", "unexplained")]
        # An effect is named that is not there.
        alarms = sum(bool(set(row["named"]) - {effect for effect, _ in row["case"]["effects"]}) for row in own)
        raised = sum(row["error"][1] > row["error"][0] for row in own)
        lines.append(
            f"| {label} | {len(own)} | {len(own) - len(seen)} | {' | '.join(shares)} | {alarms} | "
            f"{counts[0]} | {counts[1]} | {errors[0]:.3f} → {errors[1]:.3f} ({errors[2]:.3f}) | {raised} | "
            f"{_share([c for row in own for c in row['covered']])} | {' | '.join(_of_curves(own))} | "
            f"{np.median([row['seconds'] for row in own]):.0f} |"
        )
    return "\n".join(lines)


def _of_curves(rows: Sequence[dict[str, Any]]) -> tuple[str, str]:
    """How many probed curves are within a tenth of those of the hidden specimen, and how often their bands hold these."""
    judged = [one for row in rows for one in (row.get("behaviour") or {}).values()]
    held = [k < one["inside"] for one in judged for k in range(one["of"])]
    return _share([one["off"] <= _CURVE for one in judged]), _share(held)


def _hidden(case: dict[str, Any]) -> str:
    return " + ".join(f"{effect} ({formula})" for effect, formula in case["effects"]) or "nothing"


SPLITS: dict[str, Callable[[dict[str, Any]], str]] = {
    "kind": lambda case: case["kind"],
    "effect": lambda case: " + ".join(effect for effect, _ in case["effects"]) or "nothing",
    "formula": _hidden,
}


def _share(flags: Sequence[bool]) -> str:
    return f"{100 * sum(flags) / len(flags):.0f} %" if flags else "–"


def _made(case: Case, folder: Path, truth: Path) -> str | None:
    """Make a campaign; why it could not be made, or None."""
    try:
        make(case, folder, truth)
    except TooSmall as reason:
        return str(reason)
    return None


def _plain(case: Case) -> dict[str, Any]:
    return {**vars(case), "effects": [list(effect) for effect in case.effects]}


def _line(row: dict[str, Any]) -> str:
    case = row["case"]
    about = (
        f"{row['group']}: {case['kind']}, {_hidden(case)}, noise {case['noise']:g}, {case['experiments']} experiments"
    )
    if "skipped" in row:
        return f"{about}: skipped, {row['skipped']}"
    mark = "ok " if row["exact"] else "(f)" if row["family"] else "-- "
    errors = " → ".join(f"{error:.3f}" for error in row["error"][:2])
    return f"{mark} {about}: {row['verdict']} {row['named']}, error {errors}, {row['seconds']:.0f} s, {row['ranking']}"


if __name__ == "__main__":
    main()
