"""Designs replayed on a physical test matrix.  `python benchmarks/replay.py [--data FOLDER] [--resume]`

The matrix is 41 harmonic runs of a banded rotary friction damper: frequency, amplitude and band tension, ten of the cells twice.
Ten runs, drawn at random, are held out. A sequential design of the package asks for an input, the nearest unused run answers with
what was measured at its own input, and so on until all 31 are used. After each answer the model is fitted to the used runs and
predicts the held-out runs. Counted is the number of runs from which on this error stays within 10 % of that with all 31.

The model is a function of the inputs, friction with a dead length: the force is F = (F0 + s T) (f / 0.5 Hz)^-q, the energy of a
cycle 4 F (a - d), the peak force r F. A diagnosis of the histories at every step would cost minutes a step. A function has no
effects to tell apart, so the acquisition `discriminate` refuses it and is not among the designs.

Equal tests differ by much more than the sensor noise. Therefore the relative error of the study is the scatter between the ten
pairs of equal cells, and a design may ask for a cell again, whose repetition then answers.

A batch of two asks for the second run while the first is out. Random orders use the runs without a design. All orders of a draw
begin with the same three runs, those nearest to the first points of a Sobol' sequence.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

import hsed_jax as hx

RESULTS = Path(__file__).with_suffix(".json")
DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "friction_damper_factorial"
INPUTS = ("frequency", "amplitude", "tension")
OUTPUTS = ("peak_force", "dissipated_energy")
INITIAL, HELD_OUT, DRAWS, ORDERS, WITHIN = 3, 10, 10, 200, 1.1
DESIGNS = {
    "expected improvement": ("expected_improvement", 1),
    "expected improvement, two at a time": ("expected_improvement", 2),
    "largest variance": ("max_variance", 1),
    "largest variance, two at a time": ("max_variance", 2),
    "Sobol' sequence": ("sobol", 1),
}
"""Acquisition and number of runs that are out at a time."""
RANDOM = "random order"


class Runs(NamedTuple):
    """What was tested: `names` (n,), `inputs` (n, 3) in Hz, inch and lbf, `outputs` (n, 2) in N and J."""

    names: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray


def respond(parameters: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The model: friction that grows with the tension, with a dead length. All numbers are SI."""
    force = (parameters["F0"] + parameters["s"] * inputs["tension"]) * (inputs["frequency"] / 0.5) ** -parameters["q"]
    way = jnp.maximum(inputs["amplitude"] - parameters["d"], 0.0)
    return {"peak_force": parameters["r"] * force, "dissipated_energy": 4.0 * force * way}


def study(scatter: Mapping[str, float], size: int) -> hx.Study:
    """The study of the model, whose relative errors are the scatter between equal tests."""
    keys: dict[str, Any] = dict(
        study="replay",
        inputs={
            "frequency": {"loguniform": [0.22, 2.3], "unit": "Hz"},
            "amplitude": {"uniform": [0.4, 1.6], "unit": "inch"},
            "tension": {"uniform": [-3.0, 39.0], "unit": "lbf"},
        },
        model={
            "function": f"{Path(__file__).resolve()}:respond",
            "parameters": {
                "F0": {"lognormal": [7.6, 1.0], "unit": "N"},
                "s": {"lognormal": [4.6, 1.0], "unit": "1"},
                "d": {"lognormal": [-6.0, 1.0], "unit": "m"},
                "q": {"normal": [0.0, 0.3], "unit": "1"},
                "r": {"lognormal": [0.2, 0.5], "unit": "1"},
            },
        },
        experiments={"python": {}},
        observe="quantities",
        quantities=list(OUTPUTS),
        error={name: {"relative": scatter[name]} for name in OUTPUTS},
        design={"initial": INITIAL, "iterations": size - INITIAL, "candidates": 4096, "replicates": True},
        calibration={"sampler": "laplace", "starts": 2, "chains": 2, "step_warmup": 20, "step_draws": 50},
        steps=["design"],
    )
    return hx.Study(**keys)


def measured(data: Path) -> Runs:
    """Energy and peak force of the full cycles of every harmonic run, averaged over them.

    Full cycles are those that reach nine tenths of the largest one; the others are the beginning and the end of the run.
    """
    from hsed_jax.measurements.turns import spans

    table = pd.read_csv(data / "experiments.csv").dropna(subset=["frequency"])
    outputs = []
    for name in table["id"]:
        (record, *_) = (e.record for e in hx.read_files(data / "records" / f"{name}.csv", units=_UNITS))
        assert record is not None
        u, force = record["elongation"], record["force"]
        whole = [slice(one.begin, one.end + 1) for one in spans(u) if one.is_whole]
        reach = [float(np.ptp(u[one])) for one in whole]
        full = [one for one, width in zip(whole, reach, strict=True) if width > 0.9 * max(reach)]
        peaks = [np.abs(force[one]).max() for one in full]
        outputs.append((np.mean(peaks), np.mean([np.trapezoid(force[one], u[one]) for one in full])))
    return Runs(table["id"].to_numpy(dtype=str), table[list(INPUTS)].to_numpy(dtype=float), np.asarray(outputs))


_UNITS = {"t": "s", "du": "inch", "F": "kip"}


def scatter_of(runs: Runs) -> dict[str, float]:
    """Standard deviation of the logarithm of each output of a run about that of an equal run, from the pairs of equal cells."""
    pairs = [
        (i, j)
        for i in range(len(runs.names))
        for j in range(i + 1, len(runs.names))
        if np.array_equal(runs.inputs[i], runs.inputs[j])
    ]
    first, second = (np.log(runs.outputs[[pair[k] for pair in pairs]]) for k in (0, 1))
    return dict(zip(OUTPUTS, np.sqrt(np.mean((second - first) ** 2, axis=0) / 2).tolist(), strict=True))


class Replay:
    """One draw of the held-out runs.

    Arguments:
        runs: all runs.
        scatter: relative error by output.
        draw: number of the draw.
    """

    def __init__(self, runs: Runs, scatter: Mapping[str, float], draw: int):
        from hsed_jax.study.build import Built

        order = np.random.default_rng(draw).permutation(len(runs.names))
        self.cells, self.held = (
            Runs(*(column[rows] for column in runs)) for rows in (np.sort(order[HELD_OUT:]), np.sort(order[:HELD_OUT]))
        )
        self.design = Built(study(scatter, len(self.cells.names))).design.sequential
        self.cube = self.design.space.cube(self.cells.inputs)
        self.first = self._nearest_of_each(self.design.space.initial_design(INITIAL))

    def _nearest_of_each(self, points: np.ndarray) -> list[int]:
        used: list[int] = []
        for point in points:
            used.append(self.nearest(point, used))
        return used

    def nearest(self, point: np.ndarray, used: Sequence[int]) -> int:
        """The unused run that is nearest to a point of the unit cube."""
        distances = np.sum((self.cube - point) ** 2, axis=1)
        distances[list(used)] = np.inf
        return int(np.argmin(distances))

    def _told(self, run: int) -> tuple[list[float], list[float]]:
        return self.cube[run].tolist(), self.cells.outputs[run].tolist()

    def order(self, acquisition: str, out: int) -> list[int]:
        """The runs in the order in which a design uses them.

        Arguments:
            acquisition: by which it chooses.
            out: how many are out at a time.
        """
        from hsed_jax.design.acquisitions import ACQUISITIONS

        used, state, by = list(self.first), self.design.init(), ACQUISITIONS[acquisition]()
        for run in used:
            state = self.design.tell(state, *self._told(run))
        key = jax.random.key(0)
        while len(used) < len(self.cells.names):
            asked = []
            for _ in range(min(out, len(self.cells.names) - len(used))):
                if acquisition == "sobol":
                    # The sequence goes on behind the initial points, whatever was measured.
                    count = 1 + len(used)
                    chosen = self.design.space.initial_design(count)[-1]
                else:
                    key, now = jax.random.split(key)
                    chosen, state, _ = self.design.ask(state, now, by)
                used.append(self.nearest(chosen, used))
                asked.append(len(state.trials))
                nothing = [float("nan")] * len(OUTPUTS)
                state = self.design.tell(state, self._told(used[-1])[0], nothing, "pending")
            for row in asked:
                run = used[row]
                state = self.design.tell(state, *self._told(run), row=row)
        return used

    @cached_property
    def random_orders(self) -> list[list[int]]:
        """Orders without a design, behind the same first runs."""
        rest = [run for run in range(len(self.cells.names)) if run not in self.first]
        random = np.random.default_rng(1)
        return [[*self.first, *random.permutation(rest).tolist()] for _ in range(ORDERS // DRAWS)]

    def errors(self, order: Sequence[int]) -> list[float]:
        """The error of the held-out runs after each run from the last initial one on.

        Of each output it is the RMS of what is predicted less what was measured, over the RMS of what was measured; outputs are
        averaged in the square.
        """
        states, state = [], self.design.init()
        for run in order:
            state = self.design.tell(state, *self._told(run))
            states.append(self.design.data(state))
        data = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states[INITIAL - 1 :])
        thetas = np.asarray(_estimates(self.design.posterior, data, self.design.posterior.starts(2)))
        inputs = self.design.space.si(self.held.inputs)
        found = []
        for theta in thetas:
            predicted = respond(dict(zip(self.design.posterior.names, theta, strict=False)), inputs)
            shares = [
                np.mean((np.asarray(predicted[name]) - self.held.outputs[:, k]) ** 2)
                / np.mean(self.held.outputs[:, k] ** 2)
                for k, name in enumerate(OUTPUTS)
            ]
            found.append(float(np.sqrt(np.mean(shares))))
        return found


@jax.jit
def _estimates(posterior: Any, experiments: Any, starts: Any) -> jax.Array:
    """The most probable parameters of each of m sets of runs, (m, p): the better end of the starts."""
    import optimistix as optx

    def descend(data, start):
        solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-7)
        end = optx.least_squares(
            lambda u, _: posterior.residuals(u, data), solver, start, max_steps=100, throw=False
        ).value
        return end, jnp.sum(posterior.residuals(end, data) ** 2)

    def estimate(data):
        ends, squares = jax.lax.map(lambda start: descend(data, start), starts)
        return posterior.constrain(ends[jnp.nanargmin(squares)])

    return jax.lax.map(estimate, experiments)


def needed(errors: Sequence[float]) -> int:
    """How many runs are used when the error stays within 10 % of the last one from there on."""
    within = np.asarray(errors) <= WITHIN * errors[-1]
    outside = np.flatnonzero(~within)
    return INITIAL + (int(outside[-1]) + 1 if outside.size else 0)


def measure(data: Path, output: Path, resume: bool, report: Callable[[str], None]) -> dict[str, Any]:
    """Replay all designs and random orders on all draws; results are kept after each draw."""
    runs = measured(data)
    scatter = scatter_of(runs)
    kept = json.loads(output.read_text(encoding="utf-8")) if resume and output.exists() else {}
    results = {"scatter": scatter, "draws": kept.get("draws", [])}
    for draw in range(len(results["draws"]), DRAWS):
        replay = Replay(runs, scatter, draw)
        found = {name: [replay.errors(replay.order(*how))] for name, how in DESIGNS.items()}
        found[RANDOM] = [replay.errors(order) for order in replay.random_orders]
        results["draws"].append({name: [[round(e, 4) for e in one] for one in many] for name, many in found.items()})
        output.write_text(json.dumps(results) + "\n", encoding="utf-8")
        report(f"draw {draw + 1} of {DRAWS}")
    return results


def markdown(results: Mapping[str, Any]) -> str:
    """The table: runs needed, and the errors on the way."""
    steps = (4, 6, 8, 12, 16)
    heads = ["design", "orders", "runs needed, median", "quartiles", *(f"error after {n}" for n in steps), "after all"]
    lines = [heads, ["---"] * len(heads)]
    for name in (*DESIGNS, RANDOM):
        curves = [curve for draw in results["draws"] for curve in draw[name]]
        low, middle, high = np.quantile([needed(curve) for curve in curves], (0.25, 0.5, 0.75))
        errors = np.median(curves, axis=0)
        shown = [f"{errors[n - INITIAL]:.3f}" for n in steps] + [f"{errors[-1]:.3f}"]
        lines.append([name, str(len(curves)), f"**{middle:.0f}**", f"{low:.0f} to {high:.0f}", *shown])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Errors over the number of runs: medians of the designs, and the band of nine tenths of the random orders."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8.0, 3.0), layout="constrained")
    for name in (RANDOM, *DESIGNS):
        curves = np.asarray([curve for draw in results["draws"] for curve in draw[name]])
        used = INITIAL + np.arange(len(curves[0]))
        style: dict[str, Any] = {"linestyle": "--" if "two" in name else "-", "linewidth": 1.4}
        if name == RANDOM:
            axes.fill_between(
                used, *np.quantile(curves, (0.05, 0.95), axis=0), color="0.88", label="90 % of random orders"
            )
            style["color"] = "0.5"
        axes.plot(used, np.median(curves, axis=0), label=name, **style)
    axes.set(xlabel="runs used", ylabel="error of held-out runs", ylim=(0, None))
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="of the test matrix")
    parser.add_argument("--resume", action="store_true", help="keep the draws that were replayed already")
    parser.add_argument("--markdown", action="store_true", help="the table of the last results, nothing replayed")
    parser.add_argument(
        "--draw", type=Path, metavar="FILE.png", help="the figure of the last results, nothing replayed"
    )
    parser.add_argument("--output", type=Path, default=RESULTS, metavar="FILE.json")
    options = parser.parse_args()
    if options.markdown or options.draw:
        results = json.loads(options.output.read_text(encoding="utf-8"))
        if options.draw:
            draw(results, options.draw)
    else:
        results = measure(options.data, options.output, options.resume, lambda words: print(words, flush=True))
    print(markdown(results))


if __name__ == "__main__":
    main()
