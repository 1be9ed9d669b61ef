"""The discrepancy of calibrated histories: the most probable parameters of `hsed_jax.inference.discrepancy.cycles`."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hsed_jax.inference.discrepancy.cycles import OverCycles, Products
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.marginal import (
    LEAST_AMPLITUDE,
    beyond_noise,
    log_marginal,
    log_prior_of_amplitudes,
    lowest,
    stiffness,
)
from hsed_jax.inference.posterior import Posterior
from hsed_jax.measurements import half_cycles
from hsed_jax.programs import program

# Log-normal priors of swings in a cycle and of quality: an error follows the motion, and its correlation decays within
# a few cycles.
_SWINGS, _QUALITY = (1.0, 0.7), (3.0, 1.0)
_SWINGS_WITHIN, _QUALITY_WITHIN = (0.05, 10.0), (0.55, 50.0)


class CycleHistory(NamedTuple):
    """The cycles of a response, at every sample.

    Attributes:
        amplitude: half the distance between two turns, interpolated linearly between the middles of the half cycles, (…, m).
        cycles: number of cycles so far: half a cycle from turn to turn, in proportion to the distance in between, (…, m).
    """

    amplitude: np.ndarray
    cycles: np.ndarray


def cycle_history(histories: Float[np.ndarray, "*s m"]) -> CycleHistory:
    """The cycle histories of predicted histories."""
    flat = np.nan_to_num(histories.reshape(-1, histories.shape[-1]), posinf=0.0, neginf=0.0)
    found = [_cycle_history_of(x) for x in flat]
    return CycleHistory(*(np.stack(part).reshape(histories.shape) for part in zip(*found, strict=True)))


def _cycle_history_of(x: Float[np.ndarray, " m"]) -> tuple[np.ndarray, np.ndarray]:
    turns, way = half_cycles(x), np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
    if turns.size < 2 or way[-1] == 0:
        return np.zeros(x.size), np.zeros(x.size)
    size = np.interp(np.arange(x.size), 0.5 * (turns[1:] + turns[:-1]), 0.5 * np.abs(np.diff(x[turns])))
    return size, 0.5 * np.interp(way, way[turns], np.arange(turns.size))


def learn(
    posterior: Posterior,
    data: Data,
    u: Float[Array, " p"],
    wrong: Bool[np.ndarray, " G"],
    previous: OverCycles | None = None,
) -> OverCycles:
    """The discrepancy of a calibrated model, with its most probable parameters.

    Arguments:
        posterior: of the study.
        data: measured histories.
        u: unconstrained coordinates of the MAP.
        wrong: by output, whether its discrepancy is learned.
        previous: another start of the search.
    """
    outputs, p = len(wrong), u.size
    predicted, sigma, along, ok = map(np.asarray, sensitivities(posterior, data, u))

    def by_output(table: np.ndarray) -> np.ndarray:
        return table.reshape(len(table), outputs, -1, *table.shape[2:])

    used = by_output(((np.asarray(data.weights) > 0) & (ok[:, None] > 0)).astype(float))
    of_sigma = _of_histories(by_output(sigma), used)
    z = used * by_output(predicted - np.asarray(data.values)) / of_sigma
    swing, is_wrong = cycle_history(by_output(predicted)), wrong[:, None] * np.ones(used.shape)
    size = swing.amplitude / of_sigma
    reference = np.sum(used * size, axis=(0, 2)) / np.maximum(np.sum(used, axis=(0, 2)), 1)
    reference = np.where(reference > 0, reference, 1.0)
    empty = OverCycles(
        jnp.asarray(wrong, float),
        *(jnp.ones(()), jnp.ones(()), jnp.zeros(p)),
        jnp.asarray(reference),
        jnp.asarray(of_sigma[..., 0]),
        jnp.asarray(np.sqrt(size / reference[:, None])),
        jnp.asarray(swing.cycles),
        jnp.asarray((is_wrong / of_sigma)[..., None] * by_output(along)),
        jnp.asarray(used),
        jnp.asarray(by_output(np.asarray(data.memory))),
        jnp.asarray(np.where(is_wrong > 0, 1.0, np.sqrt(by_output(np.asarray(data.weights))))),
    )
    numbers, curvature = tuple(np.flatnonzero(wrong).tolist()), stiffness(posterior, u)

    def objective(values: Float[Array, " h"]) -> tuple[Array, Array]:
        return _objective(values, empty, numbers, jnp.asarray(is_wrong * z), curvature)

    beyond = beyond_noise(np.swapaxes(z, 1, 2).reshape(-1, outputs), np.swapaxes(used, 1, 2).reshape(-1, outputs))
    starts = [
        np.r_[beyond[list(numbers)], np.log([_SWINGS[0], quality]), np.full(p, spread)]
        for quality, spread in ((_QUALITY[0], 0.03), (5 * _QUALITY[0], 0.3))
    ]
    if previous is not None:
        amplitudes, swings, quality, spread = map(np.asarray, previous.settling)
        starts = [np.r_[amplitudes[list(numbers)], np.log([swings, quality]), spread]]
    linear = [(LEAST_AMPLITUDE, None)]
    bounds = linear * len(numbers) + [tuple(np.log(b)) for b in (_SWINGS_WITHIN, _QUALITY_WITHIN)] + linear * p
    best = lowest(objective, starts, bounds)
    # A variance that is estimated from n experiments, as in Kriging (`hsed_jax.design.kriging`).
    count = int(np.sum((used * is_wrong).any(axis=(1, 2))))
    best[-p:] *= np.sqrt(count / max(count - 2, 1))
    return _with(empty, jnp.asarray(best), numbers)


def _of_histories(sigma: Float[np.ndarray, "n G m"], used: Float[np.ndarray, "n G m"]) -> Float[np.ndarray, "n G 1"]:
    """σ of every history; where it is one because nothing is used, that of other experiments."""
    known = used.sum(axis=2, keepdims=True)
    own = (used * sigma).sum(axis=2, keepdims=True) / np.maximum(known, 1)
    others = own.sum(axis=0) / np.maximum((known > 0).sum(axis=0), 1)
    return np.where(known > 0, own, np.where(others > 0, others, 1.0))


@program
def sensitivities(posterior: Posterior, data: Data, u: Float[Array, " p"]):
    """Predictions and their σ, SI, derivatives along u, and which simulations converged."""
    predicted, ok, along = posterior.sensitivities(u, data)
    return predicted, posterior.sigma(posterior.constrain(u), predicted, ok, data), along, ok


def _with(empty: OverCycles, values: Float[Array, " h"], numbers: tuple[int, ...]) -> OverCycles:
    """The process of amplitudes, logarithms of swings and quality, and spreads."""
    (a, (swings, quality), spread) = jnp.split(values, [len(numbers), len(numbers) + 2])
    amplitudes = jnp.zeros(empty.amplitudes.size).at[jnp.asarray(numbers)].set(a)
    found = amplitudes, jnp.exp(swings), jnp.exp(quality), spread
    return eqx.tree_at(lambda p: (p.amplitudes, p.swings, p.quality, p.spread), empty, found)


@program
def _objective(values, empty: OverCycles, numbers: tuple[int, ...], z, stiffness):
    """Minus the log posterior of the parameters of the process, with the parameters of the model integrated out, and
    its derivative.
    """

    def log_density(values):
        process = _with(empty, values, numbers)
        columns = jnp.concatenate([z[..., None], process.used[..., None] * process.along], axis=-1)
        found = Products(process, columns)
        of_logs = jnp.stack([jnp.log(process.swings), jnp.log(process.quality)])
        middle, wide = np.asarray([_SWINGS, _QUALITY]).T
        prior = -0.5 * jnp.sum(((of_logs - np.log(middle)) / wide) ** 2)
        prior += log_prior_of_amplitudes(process.amplitudes) - 2 * jnp.sum(jnp.log1p(process.spread))
        return -log_marginal(found.products, found.log_determinant, stiffness) - prior

    return jax.value_and_grad(log_density)(values)
