"""The posterior of 43 experiments: NUTS as a calibration runs it, against emcee on C and on numba."""

import time
import warnings
from importlib.util import find_spec
from typing import Any

import hsed_jax  # isort: skip  # first: it sets what JAX must find in its environment

import jax
import jax.numpy as jnp
import numpy as np
from arviz_stats.base.array import array_stats
from case import EXPERIMENTS, built, measured, numbers
from measure import line
from peers import jitted, native

from hsed_jax.inference.maximum import maximise
from hsed_jax.inference.nuts import sample

assert hsed_jax

WALKERS = 32
NOTE = "emcee is not installed, so it was not measured"


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row."""
    case = built()
    design = case.design
    state = design.init()
    for point, values in zip(*measured(case, EXPERIMENTS), strict=True):
        state = design.tell(state, point.tolist(), values.tolist())
    data = design.data(state)
    draws = {"ours": _nuts(case, data)}
    notes = []
    for name, module, kept in (("emcee on C", native, 1000), ("emcee on numba", jitted, 300)):
        simulate = module.compiled()
        if find_spec("emcee") is None or simulate is None:
            notes.append(NOTE if simulate is not None else module.NOTE)
        else:
            draws[name] = _emcee(case, data, simulate, 20 if quick else kept, 10 if quick else 200)
    cost = {name: 1000 * taken / _ess(chains) for name, (chains, taken) in draws.items()}
    centre, spread = (f(draws["ours"][0], axis=(0, 1)) for f in (np.mean, np.std))
    accuracy = {
        name: {
            "mean from ours [sd]": float(np.max(np.abs(chains.mean(axis=(0, 1)) - centre) / spread)),
            "effective samples": _ess(chains),
        }
        for name, (chains, _) in draws.items()
    }
    what = f"1000 effective samples of the posterior of {EXPERIMENTS} experiments"
    return [line("posterior", what, "s", cost.pop("ours"), cost, accuracy, tuple(notes))]


def _nuts(case, data) -> tuple[np.ndarray, float]:
    """Draws (chains, draws, p) and the time of MAP, adaptation and draws [s]."""
    posterior, settings = case.posterior, case.settings
    starts = posterior.starts(case.study.calibration.starts)

    @jax.jit
    def draw(data, key):
        maximum = maximise(posterior, data, starts)
        return sample(posterior, data, maximum, jnp.asarray(0.8), key, settings)

    jax.block_until_ready(draw(data, jax.random.key(0)))
    begin = time.process_time()
    chains = jax.block_until_ready(draw(data, jax.random.key(1)))
    return np.asarray(chains.theta), time.process_time() - begin


def _emcee(case, data, simulate, kept: int, burnt: int) -> tuple[np.ndarray, float]:
    """Draws (walkers, draws, p) and the time of burn-in and draws [s]."""
    import emcee

    plain = numbers(case)
    low, high = np.array([prior.bounds for prior in case.posterior.priors.values()], float).T
    values = np.asarray(data.values)
    sigma = np.asarray(data.scales) * np.asarray(case.errors[0], float)
    v_p, t_p = (np.asarray(data.conditions.inputs[name]) for name in ("V_P", "T_P"))

    def log_density(thetas):
        inside = np.all((thetas > low) & (thetas < high), axis=1)
        result = np.full(len(thetas), -np.inf)
        some = thetas[inside]
        a, beta = (np.repeat(some[:, i], len(values)) for i in range(2))
        y = simulate(plain, np.tile(v_p, len(some)), np.tile(t_p, len(some)), a, beta, 0.0)
        result[inside] = -0.5 * np.sum(((y.reshape(-1, *values.shape) - values) / sigma) ** 2, axis=(1, 2))
        return result

    start = np.random.default_rng(0).uniform(low, high, (WALKERS, len(low)))
    sampler = emcee.EnsembleSampler(WALKERS, len(low), log_density, vectorize=True)
    log_density(start)
    np.random.seed(0)  # the only way to fix emcee's draws
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sampler.run_mcmc(start, burnt + kept)
    taken = time.process_time() - begin
    return np.swapaxes(sampler.get_chain(discard=burnt), 0, 1), taken


def _ess(chains: np.ndarray) -> float:
    """Bulk effective sample size of the worse parameter."""
    return float(min(array_stats.ess(draws, chain_axis=0, draw_axis=1) for draws in np.moveaxis(chains, -1, 0)))
