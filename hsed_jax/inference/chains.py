r"""Draws by NUTS: an accurate emulator makes them and the simulator weights them, or the simulator makes them alone.

A trajectory needs dozens of densities, and a draw needs one.  Chains of an emulated posterior therefore need one simulation
for each draw.  Weights $w = p(x)/\tilde p(x)$ correct the error of the emulator.  The Pareto shape of the weights and the
effective number of draws show whether the draws are reliable (`hsed_jax.inference.importance`).

Weights carry no information outside the sampled region, and the polynomial of the emulator may end where the posterior
continues.  Therefore Metropolis steps start from the draws, some of them long.  Steps that the simulator accepts outside the
region of the emulator show a missed part.

If chains of the emulator diverge or mix slowly, the weights do not correct this: a tail that a chain rarely visits has few
draws, and their weights look normal.  Then the draws are moved by many steps of the emulator between two of the simulator,
until they settle (`hsed_jax.inference.moves`).

If the posterior is far from its mode, the first emulator is wrong.  Short chains then give the region and the frame of the next
emulator.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PRNGKeyArray
from scipy.special import softmax

from hsed_jax.inference.blocks import follow
from hsed_jax.inference.emulator import Design, Emulator, degree_for, emulate, simulations
from hsed_jax.inference.importance import TELLING, Proposal, flattened, look, systematic, weighted
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.log_densities import log_densities, simulated
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.moves import moved, wandered
from hsed_jax.inference.nuts import Chains, Settings, advance, arrived, begin, convergence
from hsed_jax.inference.posterior import Posterior, constrained
from hsed_jax.inference.watch import Watch, fingerprint
from hsed_jax.programs import program

# Error of the emulated log density [nats] at which the weights leave a third of the draws.
_ACCURATE = 1.0
# Chains do not sample all parts in proportion if their effective number is below this share of the draws, or if more
# than this share of the draws diverges.
_WORTHY, _MAY_DIVERGE = 0.2, 0.01
# Number of emulators, and the width of the design of the first one, relative to the Gaussian around the mode.
_ROUNDS, _SPREAD = 5, 1.3


def by_nuts(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    step_size: Float[Array, ""],
    key: PRNGKeyArray,
    settings: Settings,
    watch: Watch,
    seconds: float | None = None,
) -> Chains:
    """Chains of the posterior, shorter than planned if the budget ends earlier; the arguments are those of `draw`."""
    of_emulator, of_chains = jax.random.split(key)
    keys, began = jax.random.split(of_chains, settings.chains), time.perf_counter()
    # The weights of a few draws cannot be judged.
    if settings.chains * settings.draws >= TELLING:
        random = np.random.default_rng(np.asarray(jax.random.key_data(of_emulator)))
        found = _by_emulators(posterior, data, maximum, step_size, keys, settings, random, watch, seconds)
        if found is not None:
            return found
    return _chains(posterior, data, maximum, None, step_size, keys, settings, watch, _left(seconds, began))[0]


def _by_emulators(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    step_size: Float[Array, ""],
    keys: Key[Array, " chains"],
    settings: Settings,
    random: np.random.Generator,
    watch: Watch,
    seconds: float | None,
) -> Chains | None:
    """Chains by the first emulator with reliable weights; None if no emulator is good enough."""
    began, p = time.perf_counter(), maximum.start.size
    degree = degree_for(len(posterior.model_names))
    count = simulations(len(posterior.model_names), degree)
    learning = settings._replace(draws=-(-count // settings.chains))
    frame, before = Proposal(np.asarray(maximum.start), np.asarray(maximum.whitening)), None
    w = _SPREAD * random.standard_normal((count, p))
    points, log_drawn = frame.center + w @ frame.frame.T, -0.5 * np.sum((w / _SPREAD) ** 2, axis=1)
    for number in range(_ROUNDS):
        watch.report("simulations for the emulator of the posterior")
        outputs, ok, log_density = simulated(posterior, data, points, watch)
        log_weight = log_density - log_drawn
        if not np.isfinite(log_weight).any():
            return None
        if number > 0:
            frame = frame.learnt(points, log_weight)
        design = Design(points, outputs, ok, flattened(log_weight, p))
        # The new emulator keeps the old simulations: with the new ones alone it would be wrong elsewhere.
        both = design if before is None else _joined(design, before)
        emulator, before = emulate(posterior, data, both, degree), design
        is_accurate = float(emulator.error) < _ACCURATE
        start, whitening = jax.device_put((frame.center, frame.frame))
        at = maximum._replace(start=start, whitening=whitening)
        half = None if seconds is None else 0.5 * max(seconds - (time.perf_counter() - began), 0.0)
        asked = settings if is_accurate else learning
        chains, u, name = _chains(posterior, data, at, emulator, step_size, keys, asked, watch, half)
        if is_accurate and chains.theta.shape[1]:
            found = _weighed(posterior, data, emulator, chains, u, name, random, watch, _left(seconds, began))
            if found is not None:
                return found._replace(emulator_error=float(emulator.error))
        drawn, log_density = u.reshape(-1, p), np.asarray(chains.log_density).ravel()
        if len(drawn) < count:
            return None
        rows = np.linspace(0, len(drawn) - 1, count).astype(int)
        points, log_drawn = drawn[rows], log_density[rows]
    return None


def _joined(design: Design, before: Design) -> Design:
    """Both designs; the shares of the first one determine the error."""
    silent = before._replace(shares=np.zeros_like(before.shares))
    return Design(*(np.concatenate(values) for values in zip(design, silent, strict=True)))


def _left(seconds: float | None, began: float) -> float | None:
    return None if seconds is None else max(seconds - (time.perf_counter() - began), 0.0)


def _chains(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    emulator: Emulator | None,
    step_size: Float[Array, ""],
    keys: Key[Array, " chains"],
    settings: Settings,
    watch: Watch,
    seconds: float | None,
) -> tuple[Chains, Float[np.ndarray, "chains draws p"], str]:
    """Chains by the emulator or by the simulator, their draws in u, and the name under which they are saved."""
    by = "simulator" if emulator is None else "emulator"
    name = f"draws-{fingerprint(posterior.names, data, maximum, step_size, keys, settings, by)}"
    # Chains in lockstep wait for the longest trajectory among them; two at a time, on a thread each, wait for less.  Always two,
    # so that the draws do not depend on the machine.
    together = 2 - settings.chains % 2
    target = jnp.asarray(settings.target_acceptance)
    chain_states = follow(
        lambda chain_state, most: advance(posterior, data, maximum, target, emulator, chain_state, jnp.asarray(most)),
        [begin(maximum, step_size, keys[i : i + together], settings) for i in range(0, settings.chains, together)],
        watch,
        name,
        seconds,
    )
    made = max(min(int(chain_state.done) for chain_state in chain_states) - settings.warmup, 0)
    parts = [arrived(posterior, maximum, chain_state, settings) for chain_state in chain_states]
    # In NumPy, because JAX would compile each operation for every number of chains and draws.
    of_draws, places, step_sizes = (
        jax.tree.map(lambda *leaves: np.concatenate(leaves), *of) for of in zip(*parts, strict=True)
    )
    drawn = [values[:, :made] for values in of_draws]
    return Chains(*jax.device_put([*drawn, step_sizes])), places[:, :made], name


def _weighed(
    posterior: Posterior,
    data: Data,
    emulator: Emulator,
    chains: Chains,
    u: Float[np.ndarray, "chains draws p"],
    name: str,
    random: np.random.Generator,
    watch: Watch,
    seconds: float | None,
) -> Chains | None:
    """Chains of the emulator made draws of the posterior; None if they are too far from it.

    Each chain is resampled alone and keeps its order.  So R-hat and ESS have their usual meaning and include the loss by the
    weights.
    """
    began = time.perf_counter()
    # In the order of draws, so that all chains are equally long when the budget ends.
    points = np.swapaxes(u, 0, 1).reshape(-1, u.shape[-1])
    known = log_densities(posterior, data, points, watch, f"weights-of-{name}", seconds)
    made = len(known) // len(u)
    log_density = known[: made * len(u)].reshape(made, len(u)).T
    log_weight = log_density - np.asarray(chains.log_density)[:, :made]
    draws = weighted(points[: log_density.size], known[: log_density.size], log_weight.T.ravel())
    if not np.isfinite(log_weight).any(axis=1).all() or (log_density.size >= TELLING and not draws.reliable):
        return None
    rows = np.arange(len(u))[:, None]
    chosen = np.stack([systematic(shares, made, random) for shares in softmax(log_weight, axis=1)])
    at, there = u[rows, chosen].reshape(-1, u.shape[-1]), log_density[rows, chosen].ravel()
    if log_density.size >= TELLING:
        seen = look(
            lambda points: log_densities(posterior, data, points, watch, f"looks-of-{name}"),
            # The evidence of the weights is the constant difference of the two log densities.
            lambda points: (
                np.asarray(_emulated(posterior, data, emulator, jax.device_put(points))) + draws.log_evidence
            ),
            *(at, there, random),
        )
        if not draws._replace(missed=seen.missed).reliable:
            return None
    of_draws = chains.theta, log_density, chains.diverging, chains.steps
    kept = [np.asarray(values)[rows, chosen] for values in of_draws]
    found = Chains(*jax.device_put(kept), step_size=chains.step_size)
    if log_density.size < TELLING or not _needs_moves(found):
        return found
    left = _left(seconds, began)
    on = moved(
        lambda points: log_densities(posterior, data, points),
        lambda going, standing, key: wandered(posterior, data, emulator, going, standing, key),
        *(at, there, random, watch, f"moves-of-{name}", left),
    )
    theta = np.asarray(constrained(posterior, jax.device_put(on.points))).reshape(found.theta.shape)
    # Moved draws no longer depend on the chains of NUTS, so its divergences do not apply to them.
    diverging = np.asarray(found.diverging) & (not on.settled)
    arrays = theta, on.log_density.reshape(log_density.shape), diverging, np.asarray(found.steps)
    doubt = None
    if not on.settled:
        doubt = (
            "chains of NUTS diverged or mixed slowly, and the steps of emulator and simulator that followed did not settle: "
            "tails may be too short; more informative priors or data would help"
        )
    return Chains(*jax.device_put(arrays), step_size=chains.step_size, worth=float(on.worth), doubt=doubt)


def _needs_moves(chains: Chains) -> bool:
    """Whether chains of an emulator, after weighting and resampling, mix so slowly that they may have missed a part."""
    judged, count = convergence(chains), chains.diverging.size
    return judged.divergences > _MAY_DIVERGE * count or not judged.ess_bulk.min() >= _WORTHY * count


@program
def _emulated(posterior: Posterior, data: Data, emulator: Emulator, u: Float[Array, "N p"]) -> Float[Array, " N"]:
    return jax.lax.map(lambda x: emulator.log_density(posterior, x, data), u)
