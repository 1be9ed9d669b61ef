"""A small calibration, diagnosis and design step whose results are frozen: `python benchmarks/baseline.py`.

    python benchmarks/baseline.py             # repeats them, and prints what changed; exit status 1 if more than is allowed
    python benchmarks/baseline.py --freeze    # keeps the new results, after a change that is meant to change them

The record is made here, in closed form: a Bouc–Wen spring with a dashpot beside it, pulled three times.  The design is that of
the paper, with one step.  `baseline.json` beside this file has each result, how far it may change, and why so far.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import numpy as np

import hsed_jax as hx
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.diagnose import diagnose
from hsed_jax.laboratories.base import experiment_id
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record
from hsed_jax.study.build import Built

KEPT = Path(__file__).with_suffix(".json")
PAPER = Path(__file__).parents[1] / "configs" / "paper.yaml"
A, BETA, DASHPOT, NOISE = 2.0e7, 200.0, 3.0e5, 1.5e3
# Frequency [Hz], amplitude [m] and split of each test.
TESTS: tuple[tuple[float, float, Literal["train", "test"]], ...] = (
    (0.4, 0.02, "train"),
    (1.0, 0.014, "train"),
    (0.7, 0.018, "test"),
)
SAMPLES, PARTS = 120, 50
CANDIDATES = ("viscous_damping", "hardening", "stiffness_degradation", "coulomb_friction")

SEARCHED = (1e-4, "the search of the maximum stops at a gain of 1e-6 in the log density")
CURVED = (1e-3, "the curvature at the maximum has the error of the maximum")
DRAWN = (0.05, "weighted draws: another version of a library may draw others")
CHOSEN = (1e-6, "a point of the candidate set, so any change is another point")
IMPROVED = (0.01, "the surrogate is fitted by an optimiser with several starts")


class Frozen(NamedTuple):
    """A result: its value, by how much it may change (relative; None for a word), and why."""

    value: float | str
    allowed: float | None
    why: str


def pulled() -> Campaign:
    """Three cyclic tests of a Bouc–Wen spring with a dashpot: on a monotone step the force relaxes to ±A/β over the way."""
    experiments = []
    for number, (frequency, amplitude, split) in enumerate(TESTS):
        time = np.linspace(0.0, 5.0 / frequency, (SAMPLES - 1) * PARTS + 1)
        omega, growth = 2 * np.pi * frequency, 0.2 + 0.8 * frequency / 5.0 * time
        elongation = amplitude * growth * np.sin(omega * time)
        force = np.zeros(time.size)
        for k, step in enumerate(np.diff(elongation)):
            limit = np.sign(step) * A / BETA
            force[k + 1] = limit + (force[k] - limit) * np.exp(-BETA * abs(step))
        slope = 0.8 * frequency / 5.0 * np.sin(omega * time) + growth * omega * np.cos(omega * time)
        force += DASHPOT * amplitude * slope
        noisy = force[::PARTS] + NOISE * np.random.default_rng([0, number]).standard_normal(SAMPLES)
        record = Record(time[::PARTS], {"elongation": elongation[::PARTS], "force": noisy})
        experiments.append(Experiment(experiment_id(number), record=record, split=split))
    channels = {
        "time": Channel("time", "s"),
        "elongation": Channel("elongation", "m"),
        "force": Channel("force", "N", noise=Noise(absolute=NOISE)),
    }
    return Campaign("baseline", "displacement", {}, channels, {}, tuple(experiments))


def study() -> hx.Study:
    """The spring alone, without the dashpot."""
    priors = {"A": {"lognormal": [17.1, 0.7]}, "beta": {"lognormal": [4.9, 0.7]}, "gamma": 0.0, "n": 1.0}
    return hx.load_study(
        {
            "study": "baseline",
            "model": {"parameters": priors},
            "experiments": {"campaign": "nowhere"},
            "observe": "histories",
            "steps": ["calibrate"],
            "calibration": {"sampler": "laplace"},
        }
    )


def results() -> Iterator[tuple[str, Frozen]]:
    """Every result by its name."""
    campaign = pulled()
    fit = hx.calibrate(study(), campaign)
    spread = fit.fit.summary()
    for name in ("A", "beta"):
        yield f"calibration: {name}", Frozen(fit.map[name], *SEARCHED)
        yield f"calibration: standard deviation of {name}", Frozen(spread[name]["sd"], *DRAWN)
    compared = hx.compare(fit)
    yield "calibration: error", Frozen(compared.train.error, *SEARCHED)
    yield "calibration: noise floor", Frozen(compared.train.noise_floor, *SEARCHED)

    found = diagnose(problem_of(fit.built, campaign, list(CANDIDATES)).calibrated(fit.map))
    first = found.ranking[0]
    yield "diagnosis: verdict", Frozen(found.verdict, None, "the dashpot is far above the noise")
    yield "diagnosis: effects", Frozen(" ".join(found.effects), None, "the dashpot is far above the noise")
    yield "diagnosis: size", Frozen(first.estimate["delta"]["mean"], *DRAWN)
    yield "diagnosis: error of the training tests", Frozen(first.error_train, *CURVED)
    yield "diagnosis: error of the held-out test", Frozen(first.error_test, *CURVED)

    built = Built(
        hx.load_study(
            PAPER, ["design.initial=4", "design.iterations=1", "design.candidates=1024", "calibration.sampler=laplace"]
        )
    )
    design, state = built.design.sequential, built.design.sequential.init()
    for number, cube in enumerate(design.space.initial_design(4)):
        si = {name: float(x[0]) for name, x in design.space.si(design.space.declared(cube[None])).items()}
        measured = built.site.laboratory.perform(number, si).quantities
        state = design.tell(state, cube.tolist(), [measured[name] for name in built.study.quantities])
    chosen, _, info = design.ask(state, jax.random.key(0))
    for name, value in zip(design.space.names, design.space.declared(chosen[None])[0], strict=True):
        yield f"design: next {name}", Frozen(float(value), *CHOSEN)
    yield "design: expected improvement", Frozen(float(info.expected_improvement), *IMPROVED)
    for name, value in zip(built.inference.posterior.names, info.maximum.theta, strict=True):
        yield f"design: {name}", Frozen(float(value), *SEARCHED)


def compared(kept: Mapping[str, Frozen], now: Mapping[str, Frozen]) -> list[tuple[str, str, str, str, bool]]:
    """Name, kept result, new result, change beside what is allowed, and whether it is allowed; of every name of both."""
    rows = []
    for name in {**kept, **now}:
        if name not in kept or name not in now:
            rows.append((name, *("there" if name in some else "missing" for some in (kept, now)), "–", False))
            continue
        old, new = kept[name], now[name].value
        if isinstance(old.value, str) or isinstance(new, str) or old.allowed is None:
            rows.append((name, str(old.value), str(new), "none", old.value == new))
            continue
        change = abs(new / old.value - 1)
        rows.append((name, f"{old.value:.6g}", f"{new:.6g}", f"{change:.1e} of {old.allowed:g}", change <= old.allowed))
    return rows


def frozen() -> dict[str, Frozen]:
    """The kept results."""
    return {name: Frozen(**one) for name, one in json.loads(KEPT.read_text(encoding="utf-8")).items()}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--freeze", action="store_true", help="keep the new results")
    options = parser.parse_args()
    now = dict(results())
    if options.freeze:
        kept: dict[str, Any] = {name: one._asdict() for name, one in now.items()}
        KEPT.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    rows = compared(frozen(), now)
    for name, old, new, change, is_allowed in rows:
        print(f"{'  ' if is_allowed else '! '}{name:44} {old:>24} {new:>24}   {change}")
    sys.exit(0 if all(row[-1] for row in rows) else 1)


if __name__ == "__main__":
    main()
