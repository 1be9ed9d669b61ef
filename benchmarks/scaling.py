"""What `growth.py` draws: costs at growing sizes, one thing made larger at a time, the rest as in the paper's case.

CPU time on one core, best of several after a warm-up, so without compilation; memory in processes of its own.
"""

import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from case import QUANTITIES, built, lanes
from fresh import alone
from measure import seconds
from rows.memory import growth

from hsed_jax.design.acquisition import choose, sobol_candidates
from hsed_jax.design.acquisitions.expected_improvement import ExpectedImprovement
from hsed_jax.design.kriging import fit_kriging
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

_EXPERIMENTS, _SIMULATIONS = 43, 256
# One parameter each; the law's two come first.
_EFFECTS = (
    "stiffness_degradation",
    "strength_degradation",
    "viscous_damping",
    "quadratic_damping",
    "hardening",
    "cubic_stiffness",
    "quadratic_stiffness",
    "coulomb_friction",
    "peak_softening",
    "damping_error",
)


class Sizes(NamedTuple):
    """What is measured at how many sizes."""

    batch: Sequence[int] = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
    duration: Sequence[int] = (5, 10, 20, 40, 80)
    experiments: Sequence[int] = (10, 20, 50, 100, 200, 500)
    parameters: Sequence[int] = (2, 3, 4, 6, 8, 12)
    candidates: Sequence[int] = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
    memory: Sequence[int] = (100_000, 300_000, 1_000_000, 3_000_000)


QUICK = Sizes((100, 1_000), (5, 10), (10, 20), (2, 4), (1_000, 10_000), (100_000, 200_000))


def measure(sizes: Sizes) -> list[dict[str, Any]]:
    """Panels: title, the two axes with their units, and points (size, cost) by what was done."""
    batch, jacobian = f"{_SIMULATIONS} simulations", "values and Jacobian"
    return [
        _panel("A larger batch", "simulations", {"simulations": _batch}, sizes.batch),
        _panel("A longer response", "duration [s]", {batch: _duration}, sizes.duration),
        _panel("More experiments", "experiments", {"Kriging fit": _kriging, jacobian: _jacobian}, sizes.experiments),
        _panel("More parameters", "free parameters", {jacobian: _parameters}, sizes.parameters),
        _panel("More candidates", "candidates", {"expected improvement": _candidates}, sizes.candidates),
        _panel("Memory of a batch", "simulations", {"hx.simulate": _memory}, sizes.memory, "added memory [MiB]"),
    ]


def _panel(
    title: str,
    size: str,
    curves: dict[str, Callable[[int], float]],
    at: Sequence[int],
    cost: str = "CPU time [s]",
) -> dict[str, Any]:
    points = {}
    for name, curve in curves.items():
        print(f"measuring: {title.lower()}, {name} …", file=sys.stderr, flush=True)
        points[name] = [[n, curve(n)] for n in at]
    return {"title": title, "size": size, "cost": cost, "curves": points}


def _batch(count: int) -> float:
    return _simulated(built(), count)


def _duration(duration: int) -> float:
    return _simulated(built(f"excitation.duration={duration}.0"), _SIMULATIONS)


def _simulated(case: Built, count: int) -> float:
    """Seconds of a batch of simulations."""
    simulator, values = case.simulation.simulator, lanes(case, count, seed=1)
    batch = tuple({n: jnp.asarray(values[n]) for n in names} for names in (("A", "beta"), ("V_P", "T_P")))

    def one(lane):
        return simulator.quantities(lane[0], Conditions(lane[1]), QUANTITIES)[0]

    many = jax.jit(lambda batch: tiled_map(jax.vmap(one), batch))
    return seconds(lambda: jax.block_until_ready(many(batch)), repeats=_repeats(count, 10_000))


def _jacobian(experiments: int) -> float:
    return _differentiated(built(), experiments)


def _parameters(count: int) -> float:
    """Of one model with many effects, so many of whose parameters are free: it is not the model that grows."""
    free = count - 2
    given = [f"{effect}: {{delta: 0.05}}" for effect in _EFFECTS[free:]]
    effects = ", ".join([*(f"{effect}: {{}}" for effect in _EFFECTS[:free]), *given])
    return _differentiated(built(f"model.effects={{{effects}}}"), _EXPERIMENTS)


def _differentiated(case: Built, experiments: int) -> float:
    """Seconds of the predictions of so many experiments and their Jacobian in the free parameters."""
    predict, values = case.inference.posterior.predict, lanes(case, experiments, seed=2)
    conditions = Conditions({name: jnp.asarray(values[name]) for name in case.experiments.space.names})
    theta = jnp.asarray([float(prior.quantile(0.6)) for prior in case.inference.posterior.priors.values()])

    def outputs(theta):
        found = predict(theta, conditions, jnp.asarray(experiments))[0]
        return found, found

    both = jax.jit(jax.jacfwd(outputs, has_aux=True))
    return seconds(lambda: jax.block_until_ready(both(theta)))


def _kriging(experiments: int) -> float:
    x, y, mask = _training_set(experiments)
    key = jax.random.key(0)
    work = lambda: jax.block_until_ready(fit_kriging(x, y, mask, key=key))  # noqa: E731
    return seconds(work, repeats=_repeats(experiments, 50))


def _candidates(count: int) -> float:
    x, y, mask = _training_set(_EXPERIMENTS)
    key = jax.random.key(0)
    kriging, among = fit_kriging(x, y, mask, key=key), sobol_candidates(count, x.shape[1], seed=1)
    return seconds(lambda: choose(kriging, among, x, mask, ExpectedImprovement(), key).index.item())


def _memory(count: int) -> float:
    return alone(growth, count)[0]


def _training_set(experiments: int):
    """Inputs that fill the unit square, and a smooth response with some scatter, as a discrepancy has."""
    x = np.asarray(sobol_candidates(experiments, 2, seed=3))
    y = np.sin(4 * x[:, 0]) * np.exp(x[:, 1]) + 0.05 * np.random.default_rng(0).normal(size=experiments)
    return jnp.asarray(x), jnp.asarray(y), jnp.ones(experiments, bool)


def _repeats(size: int, small: int) -> int:
    """Fewer for what takes seconds."""
    return 5 if size <= small else 1
