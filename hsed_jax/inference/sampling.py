"""Draws of a posterior by the sampler that a study asks for: NUTS, importance sampling, or the Gaussian around the mode.

Importance sampling says itself whether it may be believed; where not, NUTS takes its place if the study leaves it open.

No sampler crosses from one mode of a posterior to another.  So each mode is drawn from by itself, in its own frame, and the
draws are mixed as the modes share the posterior.
"""

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.chains import by_nuts
from hsed_jax.inference.heights import constrained, heights
from hsed_jax.inference.importance import Proposal, Weighted, resampled, weigh
from hsed_jax.inference.likelihood import LOG_2PI, Data
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.nuts import Chains, Settings, convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers import SAMPLERS
from hsed_jax.inference.watch import Watch

# Fields of `Chains` that are arrays.
_ARRAYS = 5
# Draws of each chain that say anything of a posterior.
_TELLING = 10


def draw(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    step_size: Float[Array, ""],
    key: PRNGKeyArray,
    settings: Settings,
    watch: Watch | None = None,
    seconds: float | None = None,
) -> Chains:
    """Draws of the posterior (chains, draws, p).

    Arguments:
        posterior: of the study.
        data: measured outputs.
        maximum: the modes and the whitening there (`maximise`).
        step_size: of NUTS, to begin adaptation from.
        key: of the random numbers.
        settings: sizes, and by which sampler.
        watch: follows NUTS.
        seconds: budget of NUTS; `doubt` says what it left undone.
    """
    asked = Requested(posterior, data, maximum, step_size, key, settings, watch or Watch(), seconds)
    if not maximum.others:
        return _of_one_mode(asked)
    of_order, *keys = jax.random.split(key, 1 + len(maximum.modes))
    asked = asked._replace(seconds=seconds and seconds / len(keys))
    found = [
        _of_one_mode(asked._replace(maximum=mode, key=of_mode))
        for mode, of_mode in zip(maximum.modes, keys, strict=True)
    ]
    return _mixed(found, maximum.shares, of_order)


def _mixed(found: list[Chains], shares: Float[np.ndarray, " modes"], key: PRNGKeyArray) -> Chains:
    """Chains that hold draws of every mode in proportion to its share, in random order.

    A chain takes its draws from the chains of the same number and in their order, so that one that has not converged in its mode
    still differs from the others.
    """
    # A budget leaves some of them fewer.
    chains, draws = found[0].theta.shape[0], min(c.theta.shape[1] for c in found)
    ends = np.round(np.cumsum(shares) * draws).astype(int)
    counts = np.diff(ends, prepend=0)
    random = _generator(key)
    chosen = np.empty((chains, draws), dtype=int)
    for chain in chosen:
        mode = random.permutation(np.repeat(np.arange(len(found)), counts))
        for k, count in enumerate(counts):
            chain[mode == k] = k * draws + np.sort(random.choice(draws, count, replace=False))
    arrays = jax.device_put(
        [
            np.concatenate([np.asarray(leaf)[:, :draws] for leaf in leaves], axis=1)[np.arange(chains)[:, None], chosen]
            for leaves in zip(*(c[: _ARRAYS - 1] for c in found), strict=True)
        ]
    )
    # Mixing hides that draws of one mode follow one another: they are worth what they were.
    worths = [min(chains * count, convergence(c).ess_bulk.min()) for c, count in zip(found, counts, strict=True)]
    errors = [c.emulator_error for c in found if c.emulator_error is not None]
    return Chains(
        *arrays,
        step_size=found[0].step_size,
        sampler="nuts" if any(c.sampler == "nuts" for c in found) else found[0].sampler,
        worth=float(1 / sum(share**2 / max(worth, 1.0) for share, worth in zip(shares, worths, strict=True))),
        emulator_error=max(errors) if len(errors) == len(found) else None,
        doubt="; ".join(dict.fromkeys(c.doubt for c in found if c.doubt)) or None,
    )


def _of_one_mode(asked: Requested) -> Chains:
    if asked.settings.sampler != "auto":
        return SAMPLERS[asked.settings.sampler].draw(asked)
    weights, random = _weighed(asked)
    return _by_weights(asked, weights, random) if weights.reliable else by_nuts_or_gaussian(asked)


def of_gaussian(asked: Requested) -> Chains:
    """Draws of the Gaussian around the mode."""
    u, height = _gaussian(asked.maximum, jax.random.split(asked.key)[0], asked.number)
    settings = asked.settings._replace(sampler="laplace")
    return _independent(asked.posterior, u, height, asked.step_size, settings, asked.number)


def by_importance(asked: Requested) -> Chains:
    """Draws by importance sampling, with a doubt where it cannot be relied on."""
    return _by_weights(asked, *_weighed(asked))


def by_nuts_or_gaussian(asked: Requested) -> Chains:
    """Draws by NUTS; where the budget ends before there are enough to tell anything, those of the Gaussian around the mode."""
    # Whoever asked for them, they are the same programs.
    settings = asked.settings._replace(sampler="nuts")
    key, seconds, planned = jax.random.split(asked.key)[1], asked.seconds, settings.draws
    found = by_nuts(asked.posterior, asked.data, asked.maximum, asked.step_size, key, settings, asked.watch, seconds)
    made, budget = found.theta.shape[1], f"stopped by the budget of {seconds} s (calibration.seconds)"
    if made == planned:
        return found
    if made >= min(_TELLING, planned):
        return found._replace(doubt=f"{budget} after {made} of {planned} draws")
    instead = f"{budget} before there were draws of the posterior: these draws are from the Gaussian around the MAP"
    return of_gaussian(asked)._replace(doubt=instead)


def _weighed(asked: Requested) -> tuple[Weighted, np.random.Generator]:
    random = _generator(jax.random.split(asked.key)[0])
    return weigh_around(asked.posterior, asked.data, asked.maximum, asked.number, random, asked.watch), random


def _by_weights(asked: Requested, weights: Weighted, random: np.random.Generator) -> Chains:
    u, height = resampled(weights, asked.number, random)
    settings = asked.settings._replace(sampler="importance")
    found = _independent(asked.posterior, u, height, asked.step_size, settings, weights.worth)
    return found._replace(doubt=weights.doubt)


def weigh_around(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    draws: int,
    random: np.random.Generator,
    watch: Watch | None = None,
) -> Weighted:
    """Weighted draws of u around a mode."""
    proposal = Proposal(np.asarray(maximum.start), np.asarray(maximum.whitening))
    return weigh(lambda u: heights(posterior, data, u, watch), proposal, draws, random)


def _generator(key: PRNGKeyArray) -> np.random.Generator:
    return np.random.default_rng(np.asarray(jax.random.key_data(key)))


def _gaussian(
    maximum: Maximum, key: PRNGKeyArray, number: int
) -> tuple[Float[np.ndarray, "N p"], Float[np.ndarray, " N"]]:
    start, whitening = np.asarray(maximum.start), np.asarray(maximum.whitening)
    w = _generator(key).standard_normal((number, start.size))
    # The Gaussian is as high as the density at the mode, which the evidence by Laplace's method was made of.
    top = float(maximum.log_evidence) - 0.5 * start.size * LOG_2PI - np.linalg.slogdet(whitening)[1]
    return start + w @ whitening.T, top - 0.5 * np.sum(w**2, axis=1)


def _independent(
    posterior: Posterior,
    u: Float[np.ndarray, "N p"],
    height: Float[np.ndarray, " N"],
    step_size: Float[Array, ""],
    settings: Settings,
    worth: float,
) -> Chains:
    """Independent draws in the shape of chains."""
    shape = (settings.chains, settings.draws)
    arrays = (
        np.asarray(constrained(posterior, jax.device_put(u))).reshape(*shape, -1),
        height.reshape(shape),
        np.zeros(shape, dtype=bool),
        np.zeros(shape, dtype=int),
        np.full(settings.chains, float(step_size)),
    )
    return Chains(*jax.device_put(arrays), sampler=settings.sampler, worth=worth)
