"""Do bands of a wrong model cover a specimen that was never tested, and intervals the value that predicts best?

    python benchmarks/discrepancy.py [--campaigns N] [--only CASE ...] [--resume] [--markdown]

The paper's case: a specimen that loses stiffness, a model that does not know it, noise of 5 %.  Of quantities, experiments are
drawn at random from 319 inputs that fill the space, and 64 of the others are new ones; of histories, from 64 inputs, and 4.
Results go to `discrepancy.json` beside this file, from which `--markdown` prints the tables.
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
NOISE = 0.05
# Experiments that there are, and new ones of a campaign, by what is observed.
POOL, NEW = {"quantities": 319, "histories": 64}, {"quantities": 64, "histories": 4}
_90 = 1.6448536


class Case(NamedTuple):
    """Campaigns of a kind: how many experiments, what is said of the error, the stiffness degradation of the specimen, and what
    is observed."""

    experiments: int
    error: str
    eta: float = 2e-5
    observe: str = "quantities"

    def __str__(self) -> str:
        specimen = "" if self.eta else ", a model that lacks nothing"
        histories = " of histories" if self.observe == "histories" else ""
        return f"{self.experiments} experiments{histories}, {self.error or 'the declared error alone'}{specimen}"


CASES = [
    *(Case(n, error) for n in (10, 20, 43) for error in ("", "inflate", "discrepancy")),
    *(Case(20, error, 0.0) for error in ("", "discrepancy")),
    *(Case(n, "discrepancy", observe="histories") for n in (3, 4)),
    *(Case(6, error, observe="histories") for error in ("", "inflate", "discrepancy")),
    *(Case(6, error, 0.0, "histories") for error in ("", "discrepancy")),
]


@cache
def clean(eta: float, observe: str):
    """All experiments, without noise."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import campaign_of

    hidden = f"{{stiffness_degradation: {{eta: {eta}}}}}" if eta else "{}"
    told = [f"design.initial={POOL[observe]}", f"experiments.virtual.effects={hidden}", f"observe={observe}",
            "steps=[calibrate]"]  # fmt: skip
    return campaign_of(hx.load_study(STUDY, told))


@cache
def built(case: Case):
    """The study of such campaigns."""
    import hsed_jax as hx
    from hsed_jax.study.build import Built

    more = f", {case.error}: true" if case.error else ""
    told = [f"error={{relative: {NOISE}{more}}}", f"observe={case.observe}", "steps=[calibrate]",
            "calibration.sampler=importance", "calibration.draws=100"]  # fmt: skip
    return Built(hx.load_study(STUDY, told), clean(case.eta, case.observe))


@cache
def best(eta: float, observe: str) -> dict[str, float]:
    """The parameters that predict best over the inputs, with the specimen known everywhere."""
    from hsed_jax.analysis.calibration import calibrate_built

    return calibrate_built(built(Case(0, "", eta, observe)), clean(eta, observe)).map


def noisy(experiment, observe: str, random: np.random.Generator):
    """What a laboratory measures of an experiment."""
    if observe == "quantities":
        of = experiment.quantities
        return replace(experiment, quantities={n: v * (1 + NOISE * random.standard_normal()) for n, v in of.items()})
    record = experiment.record
    channels = dict(record.channels)
    for name in ("elongation", "force"):
        rms = np.sqrt(np.mean(channels[name] ** 2))
        channels[name] = channels[name] + NOISE * rms * random.standard_normal(len(record))
    return replace(experiment, record=replace(record, channels=channels))


def campaign_with(case: Case, seed: int):
    """Experiments and new ones, with noise; and the specimen at the new ones."""
    random, campaign = np.random.default_rng(seed), clean(case.eta, case.observe)
    chosen = random.permutation(POOL[case.observe])[: case.experiments + NEW[case.observe]]
    experiments, exact = [], []
    for place, number in enumerate(chosen):
        e = campaign.experiments[number]
        split = "train" if place < case.experiments else "test"
        experiments.append(replace(noisy(e, case.observe, random), split=split))
        if split == "test":
            of_record = () if e.record is None else [e.record[name] for name in ("elongation", "force")]
            exact.append(np.concatenate(of_record) if case.observe == "histories" else list(e.quantities.values()))
    return replace(campaign, experiments=tuple(experiments)), np.asarray(exact)


def look(case: Case, seed: int) -> dict:
    """What one campaign shows."""
    from hsed_jax.analysis.calibration import calibrate_built

    campaign, known = campaign_with(case, seed)
    found = calibrate_built(built(case), campaign)
    intervals, new = found.fit.summary(), found.test
    assert new is not None
    # Shorter records are padded.
    exact = np.zeros(new.mean.shape)
    exact[new.used] = known.ravel()
    quiet = np.sqrt(new.sd**2 - new.parts["noise"] ** 2)
    process, best_ones = found.fit.discrepancy, best(case.eta, case.observe)

    def by_output(table: np.ndarray) -> list[float]:
        return [float(table[:, own][new.used[:, own]].mean()) for own in map(new.columns, new.outputs)]

    # Of a history relative to the RMS of its channel.
    squares = by_output((new.mean - exact) ** 2 if case.observe == "histories" else (new.mean / known - 1) ** 2)
    scales = by_output(exact**2) if case.observe == "histories" else np.ones(len(squares))
    return {
        "holds": {n: bool(s["q05"] < best_ones[n] < s["q95"]) for n, s in intervals.items()},
        "sd": {n: s["sd"] / best_ones[n] for n, s in intervals.items()},
        "measured": by_output(np.abs(new.measured - new.mean) < _90 * new.sd),
        "specimen": by_output(np.abs(exact - new.mean) < _90 * quiet),
        "error": np.sqrt(np.divide(squares, scales)).tolist(),
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


def table(results: dict, observe: str) -> str:
    """The results of one kind as Markdown."""
    outputs = "elongation, force" if observe == "histories" else "force, elongation, energy"
    heads = ("case", "campaigns", "A", "beta", f"{outputs}: measured", "the specimen", "error")
    rows = [heads, ("---",) * len(heads)]
    for case, of_seed in results.items():
        if ("of histories" in case) != (observe == "histories"):
            continue
        each = list(of_seed.values())

        def mean(key: str, each: list = each) -> str:
            return ", ".join(f"{share:.0%}" for share in np.mean([one[key] for one in each], axis=0))

        held = [f"{np.mean([one['holds'][name] for one in each]):.0%}" for name in ("A", "beta")]
        rows.append((case, str(len(each)), *held, mean("measured"), mean("specimen"), mean("error")))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=40, help="of each case")
    parser.add_argument("--only", nargs="+", help="words of the cases to measure, such as 20 or histories")
    parser.add_argument("--resume", action="store_true", help="add to what was measured")
    parser.add_argument("--markdown", action="store_true", help="print the table of what was measured last")
    options = parser.parse_args()
    known = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if not options.markdown:
        cases = [case for case in CASES if all(word in str(case) for word in options.only or [])]
        for found in measured(cases, options.campaigns, known if options.resume else {}):
            known |= found
            RESULTS.write_text(json.dumps(known, indent=1))
    print(*(table(known, observe) for observe in POOL), sep="\n\n")


if __name__ == "__main__":
    main()
