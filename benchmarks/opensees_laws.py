"""Materials of OpenSees calibrated to measured specimens and to records that OpenSees made, beside differential evolution.

Both have the same model, priors, samples and number of simulations.  Differential evolution (SciPy) minimises the squared
residual over the range of the priors; the error is that of the fitted experiments and of those that were held out.

    python benchmarks/opensees_laws.py FOLDER --output benchmarks/opensees_laws.json   # cases that FILE has are kept

    python benchmarks/opensees_laws.py --coverage 4 --search 300 --output benchmarks/opensees_coverage.json

The second command calibrates so many further records of each material that OpenSees made, and counts how many true parameters
the 90 % intervals hold.  FOLDER has the measured files of `MEASURED`; without it, only the records that OpenSees made are
calibrated.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

import hsed_jax as hx
from hsed_jax.config.load import load_study
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.measurements import Campaign, Channel
from hsed_jax.models.opensees import MATERIALS
from hsed_jax.models.opensees.base import Marks
from hsed_jax.models.opensees.simulated import Simulated
from hsed_jax.models.opensees.workers import Workers
from hsed_jax.study.build import Built

# File, units of its columns, material, and what its study frees beyond the table.
MEASURED = {
    "concrete column": ("rc_column/records/column.csv", {"displacement": "m", "force": "kN"}, "Pinching4", {}),
    "concrete column, IMK": ("rc_column/records/column.csv", {"displacement": "m", "force": "kN"}, "IMKPinching", {}),
    "steel brace": ("steel_specimens/brace_Black_Strut-1.csv", {}, "HystereticSM", {"negative": {}}),
    "steel brace, Pinching4": ("steel_specimens/brace_Black_Strut-1.csv", {}, "Pinching4", {}),
    "steel brace, IMK": ("steel_specimens/brace_Black_Strut-1.csv", {}, "IMKPinching", {}),
    "masonry wall CS01": ("stone_masonry/curves/FD_CS01_Magenes2010.csv", {}, "Pinching4", {}),
    "masonry wall CS01, IMK": ("stone_masonry/curves/FD_CS01_Magenes2010.csv", {}, "IMKPinching", {}),
}
MADE = ("SelfCentering", "IMKBilin", "SAWS", "IMKPeakOriented", "Pinching4")
NOISE = 0.02
"""Of a record that OpenSees made, over the RMS of its force."""
SAMPLES, STARTS = 300, 2
# Of the records whose coverage is counted; those of the cases have smaller ones.
_FIRST_SEED = 100


def measured(folder: Path, file: str, units: dict[str, str]) -> Campaign:
    """A measured specimen; the last third of its record is held out."""
    return hx.read_files(folder / file, units=units)


def made(material: str, seed: int) -> tuple[Campaign, dict[str, float]]:
    """A record that OpenSees made at parameters drawn from the priors, its last third held out, and these parameters."""
    random = np.random.default_rng(seed)
    peaks = np.repeat([0.2, 0.4, 0.6, 0.8, 1.0], 2)
    cycle = np.sin(np.linspace(0, 2 * np.pi, 40, endpoint=False))
    elongation = 0.04 * np.concatenate([peak * cycle for peak in peaks])
    marks, truth = Marks(2e7, 1e5, 0.04, 0.5), {}
    for name, known in MATERIALS[material].parameters.items():
        if known.value is not None:
            truth[name] = known.value
            continue
        ((kind, given),) = (known.prior_of(marks) or {}).items()
        # Within the middle of its prior.
        if kind == "uniform":
            truth[name] = float(given[0] + (given[1] - given[0]) * random.uniform(0.25, 0.75))
        elif kind == "lognormal":
            truth[name] = float(np.exp(given[0] + 0.3 * given[1] * random.uniform(-1, 1)))
        else:
            truth[name] = float(given * random.uniform(0.2, 0.8))
    force = Simulated(material)(truth, {"elongation": elongation})["force"]
    noisy = force + NOISE * np.sqrt(np.mean(force**2)) * random.standard_normal(force.size)
    cut = round(elongation.size * 2 / 3)
    whole = {"elongation": elongation, "force": noisy, "time": np.arange(elongation.size, dtype=float)}
    first = {name: values[:cut] for name, values in whole.items()}
    campaign = Campaign.from_frames(
        {"id": ["E01", "E02"], "split": ["train", "test"], "from": [np.nan, float(cut)]},
        {"E01": first, "E02": whole},
        name=material,
        protocol="displacement",
        channels={"time": "s", "elongation": "m", "force": Channel("force", "N")},
    )
    return campaign, truth


class Counted:
    """How many simulations OpenSees performed since `start`."""

    def __init__(self):
        self.count, whole = 0, Workers.forces

        def forces(workers: Workers, *words: Any) -> np.ndarray:
            self.count += 1
            return whole(workers, *words)

        Workers.forces = forces  # type: ignore[method-assign]

    def start(self) -> None:
        """Begin to count."""
        self.count = 0


def settings(material: str, extra: dict[str, Any], search: int) -> dict[str, Any]:
    """The study of a case."""
    return {
        "study": "case",
        "model": {"opensees": material, "parameters": extra, "search": search},
        "experiments": {"campaign": "case"},
        "observe": "histories",
        "error": {"inflate": True},
        "measurements": {"samples": SAMPLES},
        "calibration": {"starts": STARTS, "sampler": "laplace"},
        "steps": ["calibrate", "compare"],
    }


def coverage(material: str, seed: int, search: int) -> dict[str, Any]:
    """How many true parameters of a record that OpenSees made are within their 90 % intervals, and those that are not."""
    campaign, truth = made(material, seed)
    fit = hx.calibrate(load_study(settings(material, {}, search)), campaign)
    told = {name: one for name, one in fit.fit.summary().items() if name in truth}
    missed = {
        name: [truth[name], one["q05"], one["q95"]]
        for name, one in told.items()
        if not one["q05"] <= truth[name] <= one["q95"]
    }
    return {"material": material, "seed": seed, "inside": len(told) - len(missed), "of": len(told), "missed": missed}


def case(
    campaign: Campaign, material: str, extra: dict[str, Any], search: int, counted: Counted, seed: int
) -> dict[str, Any]:
    """One specimen: error and simulations of the calibration, and the error of differential evolution with as many."""
    study = load_study(settings(material, extra, search))
    counted.start()
    began = time.perf_counter()
    fit = hx.calibrate(study, campaign)
    spent, seconds = counted.count, time.perf_counter() - began
    compared = hx.compare(fit)
    built = Built(study, campaign)
    free, fixed = built.mechanics.parameters
    taken = {split: built.experiments.taken(getattr(campaign, split).experiments) for split in ("train", "test")}

    def error(values: np.ndarray, split: str) -> float:
        parameters, found = {**fixed, **dict(zip(free, values.tolist(), strict=True))}, []
        for experiment in taken[split]:
            record, scored = experiment.record, experiment.scored
            assert record is not None and scored is not None
            try:
                simulated = Simulated(material)(parameters, {"elongation": record["elongation"]})["force"]
            except ExperimentFailed:
                return 1e3
            left = simulated[experiment.in_window] - scored["force"]
            found.append(np.mean(left**2) / np.var(scored["force"]))
        return float(np.sqrt(np.mean(found)))

    members = max(16, 3 * len(free))
    lows, highs = ([float(prior.quantile(share)) for prior in free.values()] for share in (0.002, 0.998))
    counted.start()
    evolved = differential_evolution(
        lambda x: error(np.asarray(x), "train"),
        list(zip(lows, highs, strict=True)),
        maxiter=max(1, spent // members - 1),
        init=np.clip(np.random.default_rng(seed).random((members, len(free))), 0.0, 1.0) * (np.array(highs) - lows)
        + lows,
        tol=0.0,
        polish=False,
        rng=np.random.default_rng(seed),
    )
    return {
        "material": material,
        "search": search,
        "free": len(free),
        "simulations": spent,
        "seconds": round(seconds, 1),
        "error_train": compared.train.error,
        "error_test": None if compared.test is None else compared.test.error,
        "evolution": {
            "simulations": counted.count,
            "error_train": error(evolved.x, "train"),
            "error_test": error(evolved.x, "test") if taken["test"] else None,
        },
        "interval": {name: [told["q05"], told["q95"]] for name, told in fit.fit.summary().items()},
    }


def main() -> None:
    """Calibrate every case, and keep what came of it after each."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument(
        "--search", type=int, default=1000, metavar="N", help="simulations of the search (default: 1000)"
    )
    text = "count how many true parameters the intervals hold, in N further records of each material"
    parser.add_argument("--coverage", type=int, metavar="N", help=text)
    options = parser.parse_args()
    if options.coverage:
        rows = []
        for number, material in enumerate(MADE * options.coverage):
            rows.append(coverage(material, _FIRST_SEED + number, options.search))
            print(rows[-1], flush=True)
            options.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
        print(f"{sum(row['inside'] for row in rows)} of {sum(row['of'] for row in rows)} parameters are inside")
        return
    counted = Counted()
    found = json.loads(options.output.read_text(encoding="utf-8")) if options.output.exists() else {}

    def keep(name: str, one: dict[str, Any]) -> None:
        found[name] = one
        told = one["evolution"]
        print(
            f"{name}: {one['material']}, {one['simulations']} simulations: train {one['error_train']:.3f}, test "
            f"{one['error_test']:.3f}; evolution {told['error_train']:.3f}, {told['error_test']:.3f}",
            flush=True,
        )
        options.output.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")

    for seed, material in enumerate(MADE):
        if f"made by {material}" in found:
            continue
        campaign, truth = made(material, seed)
        one = case(campaign, material, {}, options.search, counted, seed)
        inside = {n: low <= truth[n] <= high for n, (low, high) in one["interval"].items() if n in truth}
        keep(f"made by {material}", {**one, "truth": truth, "inside": sum(inside.values()), "of": len(inside)})
    for name, (file, units, material, extra) in MEASURED.items() if options.folder else ():
        if name not in found:
            keep(name, case(measured(options.folder, file, units), material, extra, options.search, counted, 0))


if __name__ == "__main__":
    main()
