"""Kriging of the discrepancy and expected improvement over many candidates, against scikit-learn."""

import warnings
from importlib.util import find_spec
from typing import Any

import hsed_jax  # isort: skip  # first: it sets what JAX must find in its environment

import jax
import jax.numpy as jnp
import numpy as np
from case import EXPERIMENTS, built, measured
from measure import line, seconds
from scipy.stats import norm

from hsed_jax.design.acquisition import choose, sobol_candidates
from hsed_jax.design.kriging import condition, fit_kriging
from hsed_jax.physics.simulator import Conditions

assert hsed_jax

NOTE = "scikit-learn is not installed, so it was not measured"
STARTS = 10
LENGTHS, NUGGETS = (0.02, 20.0), (1e-10, 1.0)


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row."""
    x, y = _training_set()
    mask = jnp.ones(EXPERIMENTS, bool)
    candidates = sobol_candidates(4_096 if quick else 100_000, x.shape[1], seed=1)
    tested = (jnp.asarray(x), mask)
    key = jax.random.key(0)

    def fit(starts=STARTS):
        bounds = {"length_bounds": LENGTHS, "nugget_bounds": NUGGETS}
        return jax.block_until_ready(
            fit_kriging(jnp.asarray(x), jnp.asarray(y), mask, starts=starts, key=key, **bounds)
        )

    def likelihood(lengths, nugget):
        kriging = condition(jnp.asarray(x), jnp.asarray(y), mask, jnp.asarray(lengths), jnp.asarray(nugget))
        return float(kriging.log_likelihood)

    kriging = fit()
    best = float(fit(2 * STARTS if quick else 20 * STARTS).log_likelihood)
    of_fit = {"ours": seconds(fit)}
    of_choice = {
        "ours": seconds(lambda: choose(kriging, candidates, *tested, "expected_improvement", key).index.item())
    }
    below_best = {"ours": best - float(kriging.log_likelihood)}
    notes = (NOTE,)
    if find_spec("sklearn") is not None:
        notes = ()
        model = _scikit_learn(x, y)
        of_fit["scikit-learn"] = seconds(lambda: _scikit_learn(x, y), repeats=2)
        points = np.asarray(candidates)
        of_choice["scikit-learn"] = seconds(lambda: _improvement(model, points).argmax(), repeats=2)
        scale, lengths, noise = _hyperparameters(model)
        below_best["scikit-learn"] = best - likelihood(lengths, noise / scale)
    accuracy = {who: {"log-likelihood below the best": value} for who, value in below_best.items()}
    return [
        line("kriging", f"fit, {EXPERIMENTS} points, {STARTS} starts", *_in_ms(of_fit), accuracy, notes),
        line("kriging", f"expected improvement over {len(candidates)} candidates", *_in_ms(of_choice), notes=notes),
    ]


def _training_set() -> tuple[np.ndarray, np.ndarray]:
    """The design's inputs in the unit cube, and how far the model at the specimen's own parameters is from it there."""
    case = built()
    cube, values = measured(case, EXPERIMENTS)
    conditions = {name: jnp.asarray(v) for name, v in case.space.si(case.space.declared(cube)).items()}
    truth = jnp.asarray([case.laboratory.parameters[name] for name in case.parameters[0]])
    predicted = np.asarray(case.posterior.predict(truth, Conditions(conditions), jnp.asarray(EXPERIMENTS))[0])
    return cube, np.sum((values - predicted) ** 2 / predicted.var(axis=0), axis=1)


def _in_ms(cost: dict[str, float]) -> tuple[str, float, dict[str, float]]:
    in_ms = {name: value * 1e3 for name, value in cost.items()}
    return "ms", in_ms.pop("ours"), in_ms


def _scikit_learn(x: np.ndarray, y: np.ndarray):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    matern = ConstantKernel(1.0, (1e-3, 1e4)) * Matern([0.5] * x.shape[1], LENGTHS, nu=2.5)
    kernel = matern + WhiteKernel(1e-2, (1e-10, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of optima on a bound
        return GaussianProcessRegressor(kernel, n_restarts_optimizer=STARTS - 1, normalize_y=True, random_state=0).fit(
            x, y
        )


def _hyperparameters(model) -> tuple[float, np.ndarray, float]:
    smooth, white = model.kernel_.k1, model.kernel_.k2
    return smooth.k1.constant_value, smooth.k2.length_scale, white.noise_level


def _improvement(model, points: np.ndarray) -> np.ndarray:
    mean, deviation = model.predict(points, return_std=True)
    noise = _hyperparameters(model)[2] * model._y_train_std**2
    deviation = np.sqrt(np.maximum(deviation**2 - noise, 1e-30))
    best = model.predict(model.X_train_).max()
    z = (mean - best) / deviation
    return (mean - best) * norm.cdf(z) + deviation * norm.pdf(z)
