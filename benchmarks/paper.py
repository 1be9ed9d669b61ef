"""The paper's campaign under several readings of what the paper leaves open, beside the values that it prints.

    python benchmarks/paper.py [--quick] [--markdown]

Two choices move the estimates: the scale of the error (Eqs. 2 to 4 have a given one, of a size that the paper does not print) and
what the third quantity of Eq. 18 is, the work at the end or the largest work so far.  Every reading is the whole of
`configs/paper.yaml`, with a design of its own; the MAP at the inputs that the first reading chose stands beside it, so that one
sees what the likelihood alone does.  Results go to `paper.json` beside this file, from which `--markdown` prints the table.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from case import PAPER

RESULTS = Path(__file__).with_suffix(".json")
_LARGEST = "quantities=[peak_force, peak_elongation, peak_energy]"
_LOGARITHM = "error={relative: 0.05}"
READINGS = {
    "given scale, e at the end (configs/paper.yaml)": (),
    "log-normal, e at the end": (_LOGARITHM,),
    "given scale, largest e": (_LARGEST,),
    "log-normal, largest e": (_LOGARITHM, _LARGEST),
}
PRINTED = ("the paper", "4.24e5", "0.826", "–", "–", "“right before 20 iterations”")
HEADS = ("reading", "A [N/m]", "beta [1/m]", "A, inputs of the first", "beta, inputs of the first",
         "largest EI below 1 % of its maximum from")  # fmt: skip


def designed(reading: tuple[str, ...], iterations: int, output: Path) -> dict[str, Any]:
    """Estimates, intervals and inputs at the end of a design."""
    import hsed_jax as hx

    study = hx.load_study(PAPER, [*reading, f"design.iterations={iterations}"])
    hx.run(study, output=output, progress=False, figures=False)
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    calibration, improvement = summary["calibration"], summary["design"]["max_expected_improvement"]
    least = 0.01 * max(improvement)
    return {
        "map": calibration["map"],
        "posterior": {n: [p["q05"], p["q95"]] for n, p in calibration["posterior"].items()},
        "inputs": summary["design"]["inputs"],
        # The first step after which it never rises again.
        "settled": next(i for i in range(len(improvement) + 1) if all(x < least for x in improvement[i:])),
    }


def at(reading: tuple[str, ...], inputs: list[list[float]]) -> dict[str, float]:
    """The MAP of a reading from experiments at given inputs."""
    import hsed_jax as hx
    from hsed_jax.analysis.calibration import calibrate_built
    from hsed_jax.laboratories.base import experiment_id
    from hsed_jax.measurements import Experiment
    from hsed_jax.study.build import Built

    built = Built(hx.load_study(PAPER, [*reading, "steps=[calibrate]", "calibration.sampler=laplace"]))
    campaign = built.site.empty_campaign()
    for number, row in enumerate(inputs):
        of_one = dict(zip(built.experiments.space.names, row, strict=True))
        measured = built.site.laboratory.perform(number, of_one).quantities
        campaign = campaign.add(Experiment(experiment_id(number), of_one, quantities=measured))
    return calibrate_built(built, campaign).map


def markdown(found: dict[str, Any]) -> str:
    """The table of the results."""

    def row(name: str, one: dict[str, Any]) -> tuple[str, ...]:
        own, there, ranges = one["map"], one["same inputs"], one["posterior"]
        of_a = f"{own['A'] / 1e5:.2f}e5 ({ranges['A'][0] / 1e5:.2f}e5 to {ranges['A'][1] / 1e5:.2f}e5)"
        of_beta = f"{own['beta']:.3f} ({ranges['beta'][0]:.3f} to {ranges['beta'][1]:.3f})"
        return name, of_a, of_beta, f"{there['A'] / 1e5:.2f}e5", f"{there['beta']:.3f}", f"iteration {one['settled']}"

    rows = [HEADS, ("---",) * len(HEADS), PRINTED, *(row(name, one) for name, one in found.items())]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few experiments, nothing kept: to see that it runs")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing measured")
    options = parser.parse_args()
    if options.markdown:
        print(markdown(json.loads(RESULTS.read_text(encoding="utf-8"))))
        return
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, reading) in enumerate(READINGS.items()):
            found[name] = designed(reading, 3 if options.quick else 40, Path(folder) / str(number))
    inputs = next(iter(found.values()))["inputs"]
    for name, reading in READINGS.items():
        found[name]["same inputs"] = at(reading, inputs)
    if not options.quick:
        RESULTS.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(markdown(found))


if __name__ == "__main__":
    main()
