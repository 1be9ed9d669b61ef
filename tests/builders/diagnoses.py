"""Diagnoses and comparisons of better models, without a search."""

from dataclasses import replace

import numpy as np

from builders.misfits import histories
from hsed_jax.behaviour.findings import Behaviour, Behaviours, ProbedCurve, Value, told
from hsed_jax.criticism.compare import compare
from hsed_jax.diagnosis.findings import Candidate, Diagnosis
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE
from hsed_jax.physics.scales import Scales


def candidate(effect, gain, probability=0.0):
    estimate = {"delta": {"mean": 0.4, "sd": 0.1, "q05": 0.2, "q95": 0.6, "unit": "1"}}
    score = {"gain": gain, "standard_error": 1.0} if np.isfinite(gain) else None
    return Candidate(effect, "family", probability, gain, 3.0, 0.01, estimate, 0.1, 0.2, score=score)


def diagnosis(candidates, effects=(), look_alikes=()):
    return Diagnosis("missing_effects", list(effects), list(candidates), [list(g) for g in look_alikes],
                     None, None, np.zeros(0), 0.0,
                     0.5, (0.3, 0.3), (0.05, 0.05), 0.05, {}, {}, histories(1, 0, 6)[1].train_prediction, Scales())  # fmt: skip


def falling():
    """A stiffness that falls along the test and a force that stays, where the model as it was had a smaller one."""
    places = np.linspace(0.0, 1.0, 5)
    stiffness, force = 3e6 - 2e6 * places, np.full(5, 4e4)
    curves = {
        "initial_stiffness": ProbedCurve(np.full(5, 2e6), stiffness, 0.9 * stiffness, 1.1 * stiffness),
        "strength+": ProbedCurve(np.full(5, 3e4), force, force, force),
        "recentring": ProbedCurve(np.full(5, 0.5), np.full(5, 0.5), np.full(5, 0.5), np.full(5, 0.5)),
    }
    ends = Value(3e6, 2.7e6, 3.3e6), Value(1e6, 0.9e6, 1.1e6)
    change = Behaviour("initial_stiffness", "falls", {"absorbed_energy": 0.97}, *ends, "N/m")
    return Behaviours(
        [replace(change, sentence=told(change, ELONGATION_AND_FORCE))], {"strength": 0.0}, curves, (*places,)
    )


def improved(comparison, factors):
    """As a comparison of a better model: experiment i of a split is too strong by `factors[i]`."""

    def better(prediction):
        size = 1 + np.asarray(factors[: len(prediction.experiments)])[:, None]
        return prediction and replace(prediction, predicted=size * prediction.measured, mean=size * prediction.measured)

    train = better(comparison.train_prediction)
    test = None if comparison.test_prediction is None else better(comparison.test_prediction)
    return compare(train, test, np.ones(len(train.outputs), dtype=bool), 2, [])
