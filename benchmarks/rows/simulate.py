"""The simulator: a large batch, one alone, histories, Jacobians, the public call; against C and numba, with their accuracy."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from case import ETA, EXPERIMENTS, QUANTITIES, Numbers, built, columns, degrading, lanes, numbers
from fresh import alone
from measure import line, seconds
from peers import jitted, native
from peers.reference import reference, worst

from hsed_jax import simulate
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.simulator import Conditions, Simulator

CHAINS = 4
CHANNELS = ("elongation", "force")


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row."""
    c, numba = native.compiled(), jitted.compiled()
    peers = {name: peer for name, peer in (("C", c), ("numba", numba)) if peer is not None}
    missing = tuple(module.NOTE for module, peer in ((native, c), (jitted, numba)) if peer is None)
    return [
        _batch(peers, missing, 2_000 if quick else 10_000, 8 if quick else 40),
        _alone(peers, missing),
        _histories(200 if quick else 1_000),
        _jacobian(c, missing),
        _public(2_000 if quick else 10_000),
    ]


def _batch(peers, missing, count: int, checked: int) -> dict[str, Any]:
    case = degrading()
    plain, simulator = numbers(case), case.simulation.simulator
    many = jax.jit(lambda batch: tiled_map(jax.vmap(lambda lane: _one(simulator, lane)), batch))

    def costs_and_results(values):
        batch, arrays = _batch_of(values), columns(values)
        yield "ours", lambda: np.asarray(many(batch))
        for name, peer in peers.items():
            yield name, lambda peer=peer: peer(plain, *arrays, ETA)

    few = lanes(case, checked, seed=1)
    exact = _exact(plain, few)
    accuracy = {name: worst(work(), exact) for name, work in costs_and_results(few)}
    cost = {name: seconds(work) / count * 1e6 for name, work in costs_and_results(lanes(case, count, seed=2))}
    what = f"{count} simulations, 3 quantities, {plain.steps} steps"
    return line("simulate", what, "µs per simulation", cost.pop("ours"), cost, accuracy, missing)


def _alone(peers, missing) -> dict[str, Any]:
    case = degrading()
    plain, simulator = numbers(case), case.simulation.simulator
    values = lanes(case, 1, seed=3)
    lane = jax.tree.map(lambda x: x[0], _batch_of(values))
    one = jax.jit(lambda lane: _one(simulator, lane))
    alone = {**peers, "C": native.compiled(lanes=1)} if "C" in peers else peers
    arrays = columns(values)
    cost = {
        name: seconds(lambda peer=peer: peer(plain, *arrays, ETA), repeats=50) * 1e6 for name, peer in alone.items()
    }
    ours = seconds(lambda: np.asarray(one(lane)), repeats=50) * 1e6
    return line("simulate", "one simulation alone", "µs", ours, cost, notes=missing)


def _histories(count: int) -> dict[str, Any]:
    case = degrading("observe=histories")
    simulator = case.simulation.simulator
    batch = _batch_of(lanes(case, count, seed=4))

    def histories(lane):
        return simulator.respond(*_split(lane), CHANNELS).channels

    kept = jax.jit(lambda batch: tiled_map(jax.vmap(histories), batch))
    alone = jax.jit(lambda batch: tiled_map(jax.vmap(lambda lane: _one(simulator, lane)), batch))
    cost = [seconds(lambda f=f: jax.block_until_ready(f(batch))) / count * 1e6 for f in (kept, alone)]
    samples = simulator.timeline.steps // simulator.timeline.every + 1
    what = f"{count} simulations, histories of {len(CHANNELS)} channels, {samples} samples"
    return line("simulate", what, "µs per simulation", cost[0], {"quantities alone": cost[1]})


def _jacobian(c, missing) -> dict[str, Any]:
    case = built()
    plain, predict = numbers(case), case.inference.posterior.predict
    values = lanes(case, EXPERIMENTS, seed=5)
    conditions = Conditions({name: jnp.asarray(values[name]) for name in case.experiments.space.names})
    thetas = jnp.stack([jnp.asarray(x) for x in list(lanes(case, CHAINS, seed=6).values())[-2:]], axis=1)

    def outputs(theta):
        found = predict(theta, conditions, jnp.asarray(EXPERIMENTS))[0]
        return found, found

    both = jax.jit(jax.vmap(jax.jacfwd(outputs, has_aux=True)))
    alone = jax.jit(jax.vmap(lambda theta: outputs(theta)[0]))
    ours = seconds(lambda: jax.block_until_ready(both(thetas)))
    cost = {"values alone": seconds(lambda: jax.block_until_ready(alone(thetas)))}
    accuracy = {}
    if c is not None:
        v_p, t_p = (np.tile(values[name], 3 * CHAINS) for name in ("V_P", "T_P"))
        steps = 1e-6 * np.vstack([np.zeros(2), np.eye(2)])
        shifted = np.asarray(thetas)[None] * (1 + steps[:, None])
        a, beta = (np.repeat(shifted[..., i].ravel(), EXPERIMENTS) for i in range(2))

        def differences():
            y = c(plain, v_p, t_p, a, beta, 0.0).reshape(3, CHAINS, EXPERIMENTS, 3)
            return np.moveaxis((y[1:] - y[0]) / (1e-6 * np.asarray(thetas).T[:, :, None, None]), 0, -1), y[0]

        cost["C, differences"] = seconds(differences)
        by_hand, ours_found = differences()[0], np.asarray(both(thetas)[0])
        scale = np.abs(by_hand).max(axis=(0, 1), keepdims=True)
        accuracy["ours"] = {"against differences": float(np.quantile(np.abs(ours_found - by_hand) / scale, 0.95))}
    what = f"value and Jacobian, {EXPERIMENTS} experiments × {CHAINS} parameter vectors × {thetas.shape[1]} parameters"
    cost = {name: value * 1e3 for name, value in cost.items()}
    return line("simulate", what, "ms", ours * 1e3, cost, accuracy, missing)


def _public(count: int) -> dict[str, Any]:
    # This row has one core; the process it was started from has them all.
    cores = os.sched_getaffinity(os.getppid())
    cost, notes = alone(public, count, cores=cores)
    what = f"{count} simulations by hx.simulate, wall seconds on {len(cores)} cores"
    return line("simulate", what, "s", cost.pop("ours"), cost, notes=notes)


def public(count: int) -> tuple[dict[str, float], tuple[str, ...]]:
    """Wall seconds of the public call on all cores of this process, and of C with a thread for each core."""
    case = degrading()
    plain, free = numbers(case), case.mechanics.parameters[0]
    values = lanes(case, count, seed=2)
    parameters = {name: x for name, x in values.items() if name in free}
    inputs = {name: x for name, x in values.items() if name not in free}
    cost = {"ours": _wall(lambda: simulate(case.study, inputs, parameters, channels=()).quantities)}
    c, cores = native.compiled(), len(os.sched_getaffinity(0))
    if c is None:
        return cost, (native.NOTE,)
    parts = list(zip(*(np.array_split(x, cores) for x in columns(values)), strict=True))
    with ThreadPoolExecutor(cores) as threads:
        cost["C, a thread for each core"] = _wall(lambda: list(threads.map(lambda part: c(plain, *part, ETA), parts)))
    return cost, ()


def _wall(work) -> float:
    """Best wall time of five calls after the first [s]."""
    taken = []
    for _ in range(6):
        begin = time.perf_counter()
        jax.block_until_ready(work())
        taken.append(time.perf_counter() - begin)
    return min(taken[1:])


def _one(simulator: Simulator, lane):
    return simulator.quantities(*_split(lane), QUANTITIES)[0]


def _split(lane):
    parameters, inputs = lane
    return parameters, Conditions(inputs)


def _batch_of(values):
    arrays = {name: jnp.asarray(x) for name, x in values.items()}
    return {n: arrays[n] for n in ("A", "beta")}, {n: arrays[n] for n in ("V_P", "T_P")}


def _exact(plain: Numbers, values) -> np.ndarray:
    return np.array([reference(plain, *row, ETA) for row in zip(*columns(values), strict=True)])
