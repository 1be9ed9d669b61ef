"""The posterior of 43 experiments: NUTS and importance sampling as a calibration runs them, against emcee on C and on numba."""

import time
import warnings
from importlib.util import find_spec
from typing import Any, NamedTuple

import jax
import numpy as np
from arviz_stats.base.array import array_stats
from case import EXPERIMENTS, built, measured, numbers
from measure import line
from peers import jitted, native

from hsed_jax.inference.fit import fit

WALKERS = 32
NOTE = "emcee is not installed, so it was not measured"


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row."""
    case = built()
    design = case.design.sequential
    state = design.init()
    for point, values in zip(*measured(case, EXPERIMENTS), strict=True):
        state = design.tell(state, point.tolist(), values.tolist())
    data = design.data(state)
    ours = {sampler: _calibrated(case, data, sampler) for sampler in ("nuts", "importance")}
    peers, notes = {}, []
    for name, module, kept in (("emcee on C", native, 1000), ("emcee on numba", jitted, 300)):
        simulate = module.compiled()
        if find_spec("emcee") is None or simulate is None:
            notes.append(NOTE if simulate is not None else module.NOTE)
        else:
            peers[name] = _emcee(case, data, simulate, 20 if quick else kept, 10 if quick else 200)
    centre, spread = (f(ours["nuts"].chains, axis=(0, 1)) for f in (np.mean, np.std))

    def figures(draws: Draws) -> dict[str, float]:
        far = np.max(np.abs(draws.chains.mean(axis=(0, 1)) - centre) / spread)
        return {"mean from NUTS [sd]": float(far), "effective samples": draws.effective}

    cost = {name: draws.cost for name, draws in peers.items()}
    accuracy = {name: figures(draws) for name, draws in peers.items()}
    what = f"1000 effective samples of the posterior of {EXPERIMENTS} experiments"
    return [
        line("posterior", f"{what}, {by}", "s", draws.cost, cost, {"ours": figures(draws), **accuracy}, tuple(notes))
        for by, draws in (("NUTS", ours["nuts"]), ("importance sampling", ours["importance"]))
    ]


class Draws(NamedTuple):
    """Draws (chains, draws, p), how many independent ones they are worth, and the time they took [s]."""

    chains: np.ndarray
    effective: float
    taken: float

    @property
    def cost(self) -> float:
        """Seconds for a thousand effective samples."""
        return 1000 * self.taken / self.effective


def _calibrated(case, data, sampler: str) -> Draws:
    """A calibration, MAP and all, compiled beforehand."""
    settings = case.settings._replace(sampler=sampler)

    def calibrated(seed: int):
        return fit(case.posterior, data, starts=case.study.calibration.starts, settings=settings,
                   key=jax.random.key(seed), units=case.units)  # fmt: skip

    calibrated(0)
    begin = time.process_time()
    found = calibrated(1)
    chains = np.asarray(found.chains.theta)
    taken = time.process_time() - begin
    # Should another sampler have taken its place, the line would say what is not so.
    assert found.chains.sampler == sampler
    return Draws(chains, min(_ess(chains), found.chains.worth), taken)


def _emcee(case, data, simulate, kept: int, burnt: int) -> Draws:
    """Draws of the walkers; the time is that of burn-in and draws."""
    import emcee

    plain = numbers(case)
    low, high = np.array([prior.bounds for prior in case.posterior.priors.values()], float).T
    values = np.asarray(data.values)
    size = np.asarray([error.size for error in case.errors], float)
    v_p, t_p = (np.asarray(data.conditions.inputs[name]) for name in ("V_P", "T_P"))

    def log_density(thetas):
        inside = np.all((thetas > low) & (thetas < high), axis=1)
        result = np.full(len(thetas), -np.inf)
        some = thetas[inside]
        a, beta = (np.repeat(some[:, i], len(values)) for i in range(2))
        y = simulate(plain, np.tile(v_p, len(some)), np.tile(t_p, len(some)), a, beta, 0.0)
        z = (y.reshape(-1, *values.shape) / values - 1) / size
        result[inside] = -0.5 * np.sum(z**2, axis=(1, 2))
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
    chains = np.swapaxes(sampler.get_chain(discard=burnt), 0, 1)
    return Draws(chains, _ess(chains), taken)


def _ess(chains: np.ndarray) -> float:
    """Bulk effective sample size of the worse parameter."""
    return float(min(array_stats.ess(draws, chain_axis=0, draw_axis=1) for draws in np.moveaxis(chains, -1, 0)))
