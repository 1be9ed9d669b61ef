"""The benchmark of designs: criteria are those of their authors, the table counts what it says, designs are comparable."""

import json
from dataclasses import dataclass

import designs
import numpy as np
import pytest
import rivals
from scipy import stats

from hsed_jax.diagnosis.rivals import Predictive


@dataclass(frozen=True)
class Foreseen:
    """A state whose predictions are known: one output at three candidates."""

    shares: np.ndarray
    means: np.ndarray
    deviations: np.ndarray
    sigma: np.ndarray

    def predicted(self):
        ones = np.ones(len(self.sigma))
        found = [
            Predictive(m[:, None], d[:, None, None], ones) for m, d in zip(self.means, self.deviations, strict=True)
        ]
        return found, self.sigma[:, None]


STATE = Foreseen(
    np.array([0.3, 0.7]),
    np.array([[1.0, 2.0, 4.0], [1.5, 2.0, 0.5]]),
    np.array([[0.2, 2.0, 0.1], [0.4, 0.1, 1.5]]),
    np.array([0.5, 0.5, 1.0]),
)
Y = np.linspace(-40.0, 40.0, 200_001)


def densities(candidate):
    """What both models expect of a candidate, on a fine grid."""
    spread = np.hypot(STATE.deviations[:, candidate], STATE.sigma[candidate])
    return [stats.norm.pdf(Y, m, s) for m, s in zip(STATE.means[:, candidate], spread, strict=True)]


def integral(values):
    return np.trapezoid(np.nan_to_num(values), Y)


@pytest.mark.parametrize("name", ["discriminate", "box_hill"])
def test_criteria_are_the_integrals_that_define_them(name):
    found = rivals.CRITERIA[name](STATE)
    for candidate in range(3):
        one, other = densities(candidate)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where((one > 1e-300) & (other > 1e-300), np.log(one) - np.log(other), 0.0)
            prior, rest = STATE.shares
        expected = {
            # Kullback & Leibler (1951), the true one by its probability.
            "discriminate": integral((prior * one - rest * other) * ratio),
            # Box & Hill (1967), their bound.
            "box_hill": prior * rest * integral((one - other) * ratio),
        }[name]
        assert found[candidate] == pytest.approx(expected, rel=0.02)


def test_hunter_and_reiner_ask_for_the_largest_difference_of_the_fits():
    np.testing.assert_allclose(
        rivals.CRITERIA["hunter_reiner"](STATE), ((STATE.means[0] - STATE.means[1]) / STATE.sigma) ** 2
    )


def test_the_table_counts_designs_that_had_something_to_choose():
    rows = [{"by": "sobol", "experiments": n, "probability": p, "cpu_seconds": 1.0}
            for n, p in ((2, 0.99), (4, 0.96), (8, 0.97), (6, 0.01), (12, 0.5))]  # fmt: skip
    # Of four that chose: one right after two experiments, one after six, one wrong, one never certain.
    assert designs.markdown(rows).splitlines()[2] == "| `sobol` | 4 of 5 | 0% | 25% | 25% | 50% | 25% | 25% | 1.0 |"


def test_what_was_made_is_not_made_again(tmp_path, monkeypatch):
    asked = []

    def invented(test, right, rival, seed, criteria):
        asked.append((test, right, rival, seed, tuple(criteria)))
        return [rivals.Trial(by, [0, 1, 2], probability=0.96) for by in criteria]

    monkeypatch.setattr(designs, "trials_of", invented)
    output = tmp_path / "designs.jsonl"
    designs.measure(output, ["sobol"], 1)
    first = len(asked)
    designs.measure(output, ["sobol", "random"], 2)
    assert first == 20
    assert [one[-2:] for one in asked[first:]] == [(0, ("random",))] * 20 + [(1, ("sobol", "random"))] * 20
    assert len(output.read_text().splitlines()) == 60
    assert json.loads(output.read_text().splitlines()[0])["designs"] == {"sobol": [3, 0.96]}


@pytest.mark.whole
def test_designs_of_a_seed_begin_alike_and_repeat_nothing():
    # From the prior, of which the initial experiments of seed 0 do not decide this pair.
    trials = rivals.trials_of("shaken", "asymmetry", "quadratic_stiffness", 0, list(rivals.CRITERIA))
    assert {tuple(trial.asked[: rivals.INITIAL]) for trial in trials} == {(0, 1)}
    assert len({tuple(trial.asked) for trial in trials}) > 3
    for trial in trials:
        assert len(set(trial.asked)) == len(trial.asked) <= rivals.MOST
        certain = max(trial.probability, 1 - trial.probability) > rivals.CERTAIN
        assert certain or len(trial.asked) == rivals.MOST
    sobol = next(trial for trial in trials if trial.by == "sobol")
    assert sobol.asked == list(range(len(sobol.asked)))
