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
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from hidden.campaigns import Case, TooSmall, make
from hidden.catalogue import EFFECTS, FORMULAS, applicable
from hidden.opensees import is_available

WEAK, MEDIUM, STRONG = 0.03, 0.10, 0.25
SIZES = {WEAK: "weak", MEDIUM: "medium", STRONG: "strong"}
_PAIRS = 24


def plan() -> dict[str, list[Case]]:
    """The cases, by group."""
    every = list(EFFECTS)
    groups: dict[str, list[Case]] = {}

    def add(group: str, *cases: Case) -> None:
        groups.setdefault(group, []).extend(cases)

    for number, effect in enumerate(every):
        for formula in ("same", "other"):
            hidden = ((effect, formula),)
            for kind in ("shaken", "component"):
                if applicable(effect, kind):
                    add(f"{formula} formula, medium", Case(kind, hidden, MEDIUM, 0.05, 6, 4, number))
                    add(f"{formula} formula, strong", Case(kind, hidden, STRONG, 0.02, 6, 4, 100 + number))
        if applicable(effect, "shaken"):
            add("same formula, weak", Case("shaken", ((effect, "same"),), WEAK, 0.05, 6, 4, 200 + number))
            add(
                "same formula, noise 10 %",
                Case("shaken", ((effect, "same"),), MEDIUM, 0.10, 3 + number % 10, 4, 300 + number),
            )
        if applicable(effect, "quantities"):
            add("quantities alone, strong", Case("quantities", ((effect, "same"),), STRONG, 0.02, 20, 6, 400 + number))
    for number in range(36):
        kind = ("shaken", "component", "quantities")[number % 3]
        noise = (0.02, 0.05, 0.10)[number // 3 % 3]
        add("control: nothing is missing", Case(kind, (), 0.0, noise, 3 + number % 10, 4, 500 + number))
    if is_available():
        for number, (effect, formula) in enumerate(FORMULAS):
            if formula == "opensees":
                add(
                    "OpenSees materials, medium",
                    Case("component", ((effect, formula),), MEDIUM, 0.02, 6, 4, 700 + number),
                )
    random = np.random.default_rng(0)
    pairs = groups["pairs, medium"] = []
    while len(pairs) < _PAIRS:
        kind = ("shaken", "component")[len(pairs) % 2]
        one, two = random.choice([e for e in every if applicable(e, kind)], 2, replace=False)
        if EFFECTS[one] != EFFECTS[two]:
            pairs.append(Case(kind, ((str(one), "same"), (str(two), "same")), MEDIUM, 0.02, 6, 4, 600 + len(pairs)))
    return groups


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("groups", nargs="*", metavar="GROUP", help="groups whose name contains this (default: all)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_name("hidden_effects.json"), metavar="FILE")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="every N-th case of each group")
    parser.add_argument("--resume", action="store_true", help="keep the cases that were scored already")
    parser.add_argument("--markdown", action="store_true", help="print the table of the last results, measure nothing")
    options = parser.parse_args()
    kept = json.loads(options.output.read_text(encoding="utf-8")) if options.resume or options.markdown else []
    if not options.markdown:
        groups = {
            group: cases[:: options.stride]
            for group, cases in plan().items()
            if not options.groups or any(word in group for word in options.groups)
        }
        known = {json.dumps([row["group"], row["case"]]) for row in kept}
        todo = [(g, c) for g, cases in groups.items() for c in cases if json.dumps([g, _plain(c)]) not in known]
        for row in scored(todo):
            kept.append(row)
            print(_line(row), file=sys.stderr, flush=True)
            options.output.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(table(kept))


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
            found = diagnosed(campaign)
            seconds = time.perf_counter() - begin
            yield row | score(found, json.loads(truth.read_text(encoding="utf-8"))) | {"seconds": seconds}


def diagnosed(folder: Path) -> dict[str, Any]:
    """What the package finds in a campaign folder: the key `diagnosis` of `summary.json`."""
    from hsed_jax.config.load import load_study
    from hsed_jax.diagnosis.diagnose import diagnose
    from hsed_jax.study.build import Built
    from hsed_jax.study.candidates import problem_of

    built = Built(load_study(folder / "study.yaml"))
    assert built.measured is not None
    return diagnose(problem_of(built, built.measured)).summary()


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
        "family": bool(named) and families[named[0]] in {EFFECTS[name] for name in names},
        "exact": sorted(named) == sorted(names),
        "alike": any(set(names) & set(group) for group in found["look_alikes"]),
        "covered": inside,
        "error": [found["error"]["test"][0], found["error"]["test"][1], found["noise_floor"]],
        "ranking": [
            [c["effect"], round(c["probability"], 4), round(c["log_evidence_gain"], 1)] for c in found["ranking"][:4]
        ],
        "change": truth.get("change"),
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The results as a Markdown table."""
    head = (
        "| group | cases | noise explains it | named first | family first | exact set | ambiguous | unexplained | "
        "error before → after (noise) | interval covers | s |"
    )
    lines = [head, "|" + " --- |" * 11]
    for group in dict.fromkeys(row["group"] for row in rows):
        own = [row for row in rows if row["group"] == group and "skipped" not in row]
        if not own:
            continue
        # What a refit of the law absorbs down to the noise is there for nobody to see.
        seen = [row for row in own if row["verdict"] != "adequate"]
        errors = np.median(np.asarray([row["error"] for row in own]), axis=0)
        shares = [_share([row[key] for row in seen]) for key in ("first", "family", "exact")]
        counts = [str(sum(row["verdict"] == verdict for row in own)) for verdict in ("ambiguous", "unexplained")]
        lines.append(
            f"| {group} | {len(own)} | {len(own) - len(seen)} | {' | '.join(shares)} | {' | '.join(counts)} | "
            f"{errors[0]:.3f} → {errors[1]:.3f} ({errors[2]:.3f}) | {_share([c for row in own for c in row['covered']])} | "
            f"{np.median([row['seconds'] for row in own]):.0f} |"
        )
    return "\n".join(lines)


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
    hidden = " + ".join(f"{effect} ({formula})" for effect, formula in case["effects"]) or "nothing"
    about = f"{row['group']}: {case['kind']}, {hidden}, noise {case['noise']:g}, {case['experiments']} experiments"
    if "skipped" in row:
        return f"{about}: skipped, {row['skipped']}"
    mark = "ok " if row["exact"] else "(f)" if row["family"] else "-- "
    errors = " → ".join(f"{error:.3f}" for error in row["error"][:2])
    return f"{mark} {about}: {row['verdict']} {row['named']}, error {errors}, {row['seconds']:.0f} s, {row['ranking']}"


if __name__ == "__main__":
    main()
