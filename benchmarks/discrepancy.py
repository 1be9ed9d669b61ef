"""Do bands of a wrong model cover a specimen that was never tested, and intervals the value that predicts best?

    python benchmarks/discrepancy.py [--campaigns N] [--only CASE ...] [--resume] [--markdown]

The paper's case: a specimen that loses stiffness, a model that does not know it, noise of 5 %.  Experiments are drawn at random
from 319 inputs that fill the space, and 64 of the others are new ones.  Results go to `discrepancy.json` beside this file, from
which `--markdown` prints the table.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

RESULTS = Path(__file__).with_suffix(".json")
STUDY = Path(__file__).parents[1] / "configs" / "paper.yaml"
POOL, NEW, NOISE = 319, 64, 0.05
_90 = 1.6448536


class Case(NamedTuple):
    """Campaigns of a kind: how many experiments, what is said of the error, and the stiffness degradation of the specimen."""

    experiments: int
    error: str
    eta: float = 2e-5

    def __str__(self) -> str:
        specimen = "" if self.eta else ", a model that lacks nothing"
        return f"{self.experiments} experiments, {self.error or 'the declared error alone'}{specimen}"


CASES = [
    *(Case(n, error) for n in (10, 20, 43) for error in ("", "inflate", "discrepancy")),
    *(Case(20, error, 0.0) for error in ("", "discrepancy")),
]


@cache
def clean(eta: float):
    """All experiments, without noise."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import campaign_of

    hidden = f"{{stiffness_degradation: {{eta: {eta}}}}}" if eta else "{}"
    told = [f"design.initial={POOL}", f"experiments.virtual.effects={hidden}", "steps=[calibrate]"]
    return campaign_of(hx.load_study(STUDY, told))


@cache
def built(case: Case):
    """The study of such campaigns."""
    import hsed_jax as hx
    from hsed_jax.study.build import Built

    more = f", {case.error}: true" if case.error else ""
    told = [f"error={{relative: {NOISE}{more}}}", "steps=[calibrate]", "calibration.sampler=importance",
            "calibration.draws=100"]  # fmt: skip
    return Built(hx.load_study(STUDY, told), clean(case.eta))


@cache
def best(eta: float) -> dict[str, float]:
    """The parameters that predict best over the inputs, with the specimen known everywhere."""
    from hsed_jax.analysis.calibration import calibrate_built

    return calibrate_built(built(Case(0, "", eta)), clean(eta)).map


def campaign_with(case: Case, seed: int):
    """Experiments and new ones, with noise; and the specimen at the new ones."""
    random, campaign = np.random.default_rng(seed), clean(case.eta)
    chosen = random.permutation(POOL)[: case.experiments + NEW]
    experiments, exact = [], []
    for place, number in enumerate(chosen):
        e = campaign.experiments[number]
        noisy = {name: value * (1 + NOISE * random.standard_normal()) for name, value in e.quantities.items()}
        split = "train" if place < case.experiments else "test"
        experiments.append(replace(e, quantities=noisy, split=split))
        if split == "test":
            exact.append(list(e.quantities.values()))
    return replace(campaign, experiments=tuple(experiments)), np.asarray(exact)


def look(case: Case, seed: int) -> dict:
    """What one campaign shows."""
    from hsed_jax.analysis.calibration import calibrate_built

    campaign, exact = campaign_with(case, seed)
    found = calibrate_built(built(case), campaign)
    intervals, new = found.fit.summary(), found.test
    assert new is not None
    quiet = np.sqrt(new.sd**2 - new.parts["noise"] ** 2)
    process = found.fit.discrepancy
    return {
        "holds": {n: bool(s["q05"] < best(case.eta)[n] < s["q95"]) for n, s in intervals.items()},
        "sd": {n: s["sd"] / best(case.eta)[n] for n, s in intervals.items()},
        "measured": (np.abs(new.measured - new.mean) < _90 * new.sd).mean(axis=0).tolist(),
        "specimen": (np.abs(exact - new.mean) < _90 * quiet).mean(axis=0).tolist(),
        "error": np.sqrt(np.mean((new.mean / exact - 1) ** 2, axis=0)).tolist(),
        "amplitudes": [] if process is None else np.asarray(process.amplitudes).tolist(),
    }


def measured(cases: list[Case], campaigns: int, known: dict) -> Iterator[dict]:
    """What has been found, after each campaign anew."""
    found = {str(case): dict(known.get(str(case), {})) for case in cases}
    for seed in range(campaigns):
        for case in cases:
            if str(seed) not in found[str(case)]:
                found[str(case)][str(seed)] = look(case, seed)
                yield found


def table(results: dict) -> str:
    """The results as Markdown."""
    heads = ("case", "campaigns", "A", "beta", "force, elongation, energy: measured", "the specimen", "error")
    rows = [heads, ("---",) * len(heads)]
    for case, of_seed in results.items():
        each = list(of_seed.values())

        def mean(key: str, each: list = each) -> str:
            return ", ".join(f"{share:.0%}" for share in np.mean([one[key] for one in each], axis=0))

        held = [f"{np.mean([one['holds'][name] for one in each]):.0%}" for name in ("A", "beta")]
        rows.append((case, str(len(each)), *held, mean("measured"), mean("specimen"), mean("error")))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=40, help="of each case")
    parser.add_argument("--only", nargs="+", help="words of the cases to measure, such as 20")
    parser.add_argument("--resume", action="store_true", help="add to what was measured")
    parser.add_argument("--markdown", action="store_true", help="print the table of what was measured last")
    options = parser.parse_args()
    known = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if not options.markdown:
        cases = [case for case in CASES if all(word in str(case) for word in options.only or [])]
        for found in measured(cases, options.campaigns, known if options.resume else {}):
            known |= found
            RESULTS.write_text(json.dumps(known, indent=1))
    print(table(known))


if __name__ == "__main__":
    main()
