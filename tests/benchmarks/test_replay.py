"""The replay of designs: energy of a loop of known area, the count of runs, scatter of pairs, orders that use each run once."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import replay

INCH, KIP, POUND = 0.0254, 4448.2216152605, 4.4482216152605
TRUE = {"F0": 1500.0, "s": 70.0, "d": 3e-3, "q": 0.1, "r": 1.3}


def test_the_energy_of_a_friction_loop_is_its_area(tmp_path):
    (tmp_path / "records").mkdir()
    inputs = {"id": ["a"], "frequency": [1.0], "amplitude": [1.0], "tension": [30.0], "series": [2]}
    pd.DataFrame(inputs).to_csv(tmp_path / "experiments.csv", index=False)
    # Two half cycles of half the amplitude, then five full ones and another small one: only the full ones count.
    turns = [0.0, 0.5, -0.5, *[1.0, -1.0] * 5, 0.4, -0.4, 0.0]
    u = np.concatenate([np.linspace(a, b, 60, endpoint=False) for a, b in pairwise(turns)] + [[0.0]])
    force = 2.0 * np.sign(np.diff(u, append=-1.0))
    frame = pd.DataFrame({"t": 0.01 * np.arange(len(u)), "du": u, "F": force})
    frame.to_csv(tmp_path / "records" / "a.csv", index=False)
    runs = replay.measured(tmp_path)
    peak, energy = runs.outputs[0]
    assert peak == pytest.approx(2 * KIP)
    assert energy == pytest.approx(4 * INCH * 2 * KIP, rel=0.03)


def test_the_count_begins_where_the_error_stays_near_the_last_one():
    assert replay.needed([1.0, 0.5, 0.21, 0.19, 0.2]) == 5
    assert replay.needed([0.2, 0.2, 0.5, 0.2]) == 6
    assert replay.needed([0.2, 0.21, 0.2]) == 3


def test_the_scatter_is_that_of_one_run_of_a_pair():
    inputs = np.asarray([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [2.0, 1.0, 0.0], [3.0, 1.0, 0.0]])
    outputs = np.asarray([[1.0, 10.0], [np.exp(0.2), 10.0], [5.0, 20.0], [5.0 * np.exp(-0.2), 20.0], [9.0, 9.0]])
    scatter = replay.scatter_of(replay.Runs(np.asarray(list("abcde")), inputs, outputs))
    assert scatter["peak_force"] == pytest.approx(0.2 / np.sqrt(2))
    assert scatter["dissipated_energy"] == 0.0


def made(count=14, noise=0.02):
    """Runs of a specimen that follows the model."""
    random = np.random.default_rng(4)
    inputs = random.uniform([0.25, 0.5, 0.0], [2.0, 1.5, 36.0], (count + replay.HELD_OUT, 3))
    si = dict(zip(replay.INPUTS, (inputs * [1.0, INCH, POUND]).T, strict=True))
    exact = replay.respond(TRUE, si)
    outputs = np.stack([np.asarray(exact[name]) for name in replay.OUTPUTS], axis=1)
    names = np.asarray([f"r{k}" for k in range(len(inputs))])
    return replay.Runs(names, inputs, outputs * np.exp(noise * random.normal(size=outputs.shape)))


def test_the_page_quotes_the_results():
    page = (Path(replay.__file__).parent / "README.md").read_text(encoding="utf-8")
    results = json.loads(replay.RESULTS.read_text(encoding="utf-8"))
    assert replay.markdown(results) in page
    median = {
        name: round(float(np.median([replay.needed(curve) for draw in results["draws"] for curve in draw[name]])))
        for name in (*replay.DESIGNS, replay.RANDOM)
    }
    assert (
        f"expected improvement needs {median['expected improvement']}, the largest variance {median['largest variance']}, "
        f"a Sobol' sequence {median["Sobol' sequence"]} and random orders {median[replay.RANDOM]}"
    ) in " ".join(page.split())
    peak, energy = (100 * results["scatter"][name] for name in replay.OUTPUTS)
    assert f"{peak:.0f} % of the peak force and {energy:.0f} % of the energy" in " ".join(page.split())


@pytest.fixture(scope="module")
def replayed():
    return replay.Replay(made(), dict.fromkeys(replay.OUTPUTS, 0.02), 0)


@pytest.mark.whole
@pytest.mark.parametrize("name", replay.DESIGNS)
def test_a_design_uses_every_run_once_and_finds_the_specimen(replayed, name):
    order = replayed.order(*replay.DESIGNS[name])
    assert order[: replay.INITIAL] == replayed.first
    assert sorted(order) == list(range(14))
    errors = replayed.errors(order)
    assert len(errors) == 14 - replay.INITIAL + 1
    assert errors[-1] < 0.04  # the noise of the held-out runs is 0.02


@pytest.mark.whole
def test_all_orders_end_with_the_same_error(replayed):
    ends = [replayed.errors(order)[-1] for order in replayed.random_orders[:3]]
    assert ends == pytest.approx([ends[0]] * 3, rel=1e-4)
