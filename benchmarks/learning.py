"""Which design learns parameters fastest?  `python benchmarks/learning.py`.

Designs of the paper's campaign that differ in nothing but what they choose by, over seeds (noise, candidates, chains): how far
the model, calibrated on so many experiments, is from the specimen over the whole space of inputs.  The specimen's stiffness
degrades; the model does not know it.  (How soon designs tell two explanations apart is asked by `designs.py`.)
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from case import ETA, PAPER
from scipy.stats import qmc

import hsed_jax as hx

RESULTS = Path(__file__).with_suffix(".json")
CHOOSERS = ("expected_improvement", "max_variance", "sobol", "random")
INITIAL, AFTER = 3, (1, 4, 7)
_POINTS = 256
_COMMON = ("experiments.virtual.noise={relative: 0.1}", "error=null", "design.candidates=4096",
           "calibration={chains: 2, step_warmup: 50, step_draws: 50}")  # fmt: skip


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="how many seeds (default: 3)")
    parser.add_argument("--quick", action="store_true", help="one seed, few experiments: to see that it runs")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing measured")
    options = parser.parse_args()
    if not options.markdown:
        seeds = list(range(1 if options.quick else options.seeds))
        found = {"seeds": len(seeds), "designs": compared(seeds, 2 if options.quick else AFTER[-1])}
        if options.quick:
            print(json.dumps(found, indent=1))
            return
        RESULTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(markdown(json.loads(RESULTS.read_text(encoding="utf-8"))))


def compared(seeds: list[int], iterations: int) -> dict[str, dict[str, list[float]]]:
    """By design and number of experiments, the error of the calibrated model of every seed."""
    study = hx.load_study(PAPER, [*_COMMON, f"design.iterations={iterations}", "steps=[design]"])
    points = [{"design.acquisition": name, "seed": seed} for name in CHOOSERS for seed in seeds]
    with tempfile.TemporaryDirectory() as folder:
        sweep = hx.sweep(study, points=points, output=Path(folder) / "errors")
        steps = [_steps(sweep.path / "runs" / f"{number:04d}") for number in range(1, len(points) + 1)]
    error = _Error()
    found: dict[str, dict[str, list[float]]] = {name: {} for name in CHOOSERS}
    for point, made in zip(points, steps, strict=True):
        for count in (n for n in AFTER if n <= len(made)):
            # Step n is calibrated on the initial and n - 1 chosen experiments.
            by_count = found[point["design.acquisition"]].setdefault(str(INITIAL + count - 1), [])
            by_count.append(error(made[count - 1]["map"]))
    return found


def _steps(run: Path) -> list[dict[str, Any]]:
    events = [json.loads(line) for line in (run / "journal.jsonl").read_text(encoding="utf-8").splitlines()]
    return [event for event in events if event["event"] == "step"]


class _Error:
    """Normalised error of the model against the specimen, without noise, over the space of inputs."""

    def __init__(self):
        self.model = hx.load_study(PAPER)
        specimen = hx.load_study(PAPER, [f"model.effects.stiffness_degradation.eta={ETA}"])
        v, t = qmc.Sobol(2, seed=1).random(_POINTS).T
        self.inputs = {"V_P": 1.5 + 1.5 * v, "T_P": 0.5 + t}
        self.truth = self._quantities(specimen, {"A": 5.0e5, "beta": 1.0})

    def __call__(self, parameters: dict[str, float]) -> float:
        predicted = self._quantities(self.model, parameters)
        squares = [
            np.mean((predicted[name] - truth) ** 2) / np.mean((truth - truth.mean()) ** 2)
            for name, truth in self.truth.items()
        ]
        return float(np.sqrt(np.mean(squares)))

    def _quantities(self, study: Any, parameters: dict[str, float]) -> dict[str, np.ndarray]:
        known = {name: parameters[name] for name in ("A", "beta")}
        response = hx.simulate(study, self.inputs, known, channels=())
        return {name: np.asarray(values) for name, values in response.quantities.items()}


def markdown(found: dict[str, Any]) -> str:
    """The table of the results."""
    counts = list(found["designs"]["expected_improvement"])
    heads = ["chosen by", *(f"error after {n} experiments" for n in counts)]
    lines = [f"| {' | '.join(heads)} |", f"| {' | '.join('---' for _ in heads)} |"]
    for name, errors in found["designs"].items():
        lines.append(f"| `{name}` | {' | '.join(_median(errors[n]) for n in counts)} |")
    return "\n".join(lines)


def _median(values: list[float]) -> str:
    return f"{np.median(values):.3f} ({min(values):.3f} to {max(values):.3f})"


if __name__ == "__main__":
    main()
