"""Kriging of the discrepancy and expected improvement over many candidates, against scikit-learn."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from case import EXPERIMENTS, built, measured
from measure import line, seconds
from peers import surrogate
from peers.surrogate import LENGTHS, NOTE, NUGGETS, STARTS

from hsed_jax.design.acquisition import choose, sobol_candidates
from hsed_jax.design.acquisitions.expected_improvement import ExpectedImprovement
from hsed_jax.design.kriging import fit_kriging
from hsed_jax.physics.simulator import Conditions


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

    kriging = fit()
    best = float(fit(2 * STARTS if quick else 20 * STARTS).log_posterior)
    of_fit = {"ours": seconds(fit)}
    of_choice = {"ours": seconds(lambda: choose(kriging, candidates, *tested, ExpectedImprovement(), key).index.item())}
    # The peer maximises the likelihood alone, so that only its time is compared.
    accuracy = {"ours": {"log-posterior below the best": best - float(kriging.log_posterior)}}
    notes = (NOTE,)
    if surrogate.is_there():
        notes = ()
        model = surrogate.fitted(x, y)
        of_fit["scikit-learn"] = seconds(lambda: surrogate.fitted(x, y))
        points = np.asarray(candidates)
        of_choice["scikit-learn"] = seconds(lambda: surrogate.improvement(model, points).argmax())
    return [
        line("kriging", f"fit, {EXPERIMENTS} points, {STARTS} starts", *_in_ms(of_fit), accuracy, notes),
        line("kriging", f"expected improvement over {len(candidates)} candidates", *_in_ms(of_choice), notes=notes),
    ]


def _training_set() -> tuple[np.ndarray, np.ndarray]:
    """The design's inputs in the unit cube, and how far the model at the specimen's own parameters is from it there."""
    case = built()
    cube, values = measured(case, EXPERIMENTS)
    conditions = {
        name: jnp.asarray(v) for name, v in case.experiments.space.si(case.experiments.space.declared(cube)).items()
    }
    truth = jnp.asarray([case.site.laboratory.parameters[name] for name in case.mechanics.parameters[0]])
    predicted = np.asarray(case.inference.posterior.predict(truth, Conditions(conditions), jnp.asarray(EXPERIMENTS))[0])
    return cube, np.sum((values - predicted) ** 2 / predicted.var(axis=0), axis=1)


def _in_ms(cost: dict[str, float]) -> tuple[str, float, dict[str, float]]:
    in_ms = {name: value * 1e3 for name, value in cost.items()}
    return "ms", in_ms.pop("ours"), in_ms
