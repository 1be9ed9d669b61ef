"""Calibrations whose draws and predictions are given, without a search."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

import hsed_jax as hx
from builders.diagnoses import improved
from builders.misfits import histories
from hsed_jax.analysis.calibration import Calibration
from hsed_jax.analysis.remedy import Improvement
from hsed_jax.criticism.improve import Step, Trail
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.inference.fit import Fit
from hsed_jax.inference.likelihood import Error, data_of
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.nuts import Chains, Convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

STUDY = hx.load_study("configs/paper.yaml")
UNITS = {"A": "N/m", "beta": "1/m", "stiffness_degradation.delta": "1", "error.force": "1"}


def fitted(names=("A", "beta"), at=(4e5, 1.0), count=3, outputs=("force",), groups=(0,)):
    """A posterior of normal draws, 1 % wide, around its MAP; nobody simulates its model."""
    centre = np.asarray(at, dtype=float)
    theta = centre * (1 + 0.01 * np.random.default_rng(0).standard_normal((2, 60, len(names))))
    zeros = jnp.zeros((2, 60))
    chains = Chains(jnp.asarray(theta), zeros, zeros > 1, zeros.astype(int), jnp.full(2, 0.5))
    good = Convergence(np.full(len(names), 1.0), np.full(len(names), 900.0), 0)
    known = {name: Prior("lognormal", [float(np.log(value)), 1.0]) for name, value in zip(names, at, strict=True)}
    errors = [Error(known.pop(f"error.{output}", 0.05)) for output in outputs]
    posterior = Posterior(Predictor(unasked), known, errors, outputs, np.asarray(groups))
    assert posterior.names == tuple(names)
    none = np.zeros((count, len(groups)))
    data = data_of(Conditions({}), none, none > 0, np.full(none.shape, np.inf), count)
    one = jnp.eye(len(names))
    maximum = Maximum(one[0], jnp.asarray(centre), jnp.zeros(()), one, jnp.zeros(()), one[0], one, jnp.asarray(True))
    return Fit(posterior, data, maximum, chains, good, UNITS)


def unasked(theta, conditions):
    raise AssertionError("the predictions are given")


@dataclass(frozen=True, repr=False)
class Predicted(Calibration):
    """A calibration with given predictions."""

    train: Prediction
    test: Prediction | None


def calibration(case, observe="histories", names=("A", "beta"), at=(4e5, 1.0)):
    """A calibration whose predictions are those of a synthetic comparison."""
    campaign, comparison, _ = case
    train = comparison.train_prediction
    built = Built(STUDY.model_copy(update={"observe": observe}), campaign)
    fit = fitted(names, at, outputs=train.outputs, groups=train.groups)
    return Predicted(built, campaign, fit, train, comparison.test_prediction)


def improvement():
    """A model that gained an effect."""
    _, before, _ = case = histories(2, 2)
    old, new = (
        calibration(case),
        calibration(case, names=("A", "beta", "stiffness_degradation.delta"), at=(5e5, 0.8, 0.4)),
    )
    trail = Trail([Step([], 0.3, 0.4, {"A": 4e5}), Step(["stiffness_degradation"], 0.1, 0.2, {"A": 5e5})], 0.05)
    return Improvement(STUDY, old, new, before, improved(before, [0.01] * 4), trail)
