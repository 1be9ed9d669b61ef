r"""Importance sampling of the posterior: draws of a Student t around the mode, weighted to be exact.

The posterior of a calibration is nearly Gaussian, so that a proposal of heavier tails, $w_s = p(u_s)/t(u_s)$, makes nearly every
simulation an independent draw, where a chain needs dozens of them for one.  The proposal learns its centre and its spread from
its own draws.  Whether that was enough is told by the Pareto shape of the weights (below 0.7) and by how many draws they are
worth.

Source: Geweke 1989; Cappé, Guillin, Marin & Robert 2004 (population Monte Carlo); Vehtari, Simpson, Gelman, Yao & Gabry 2024
(Pareto smoothed importance sampling).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.posterior import Posterior
from hsed_jax.physics.batch import TILE
from hsed_jax.programs import program

_DEGREES = 5.0
_MOST_ROUNDS = 5
# A round ends the learning when its draws are worth this share of their number.
_GOOD = 0.5
# The weights of a poor proposal are flattened until so many draws per parameter count.
_ENOUGH = 10
# Beyond this Pareto shape the weights have no mean that can be relied on; of less worth than this share, a chain is better.
_SHAPE, _WORTHY = 0.7, 0.1
# Fewer weights than this have no tail to take a shape from.
_TELLING = 25


class Weighted(NamedTuple):
    """Weighted draws of a posterior.

    Attributes:
        u: unconstrained coordinates, (S, p).
        log_density: log density in u, (S,).
        weights: summing to one, (S,).
        shape: Pareto shape of the largest weights.
    """

    u: Float[np.ndarray, "S p"]
    log_density: Float[np.ndarray, " S"]
    weights: Float[np.ndarray, " S"]
    shape: float

    @property
    def worth(self) -> float:
        """Number of draws that the weighted ones are worth (Kish)."""
        return float(1 / np.sum(self.weights**2))

    @property
    def reliable(self) -> bool:
        """Whether moments of these draws may be believed."""
        if not np.isfinite(self.shape):
            return False
        # What a few draws say of their tail is uncertain (Vehtari et al. 2024, section 3.2.4).
        return bool(self.shape < min(_SHAPE, 1 - 1 / np.log10(len(self.u))) and self.worth >= _WORTHY * len(self.u))


def weigh(posterior: Posterior, data: Data, maximum: Maximum, key: PRNGKeyArray, draws: int) -> Weighted:
    """Draw from around the mode and weigh.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        maximum: the mode and the whitening there.
        key: of the random numbers.
        draws: S; the rounds before the last, in which the proposal learns, have fewer.
    """
    center, frame = maximum.start, maximum.whitening
    learning = min(draws, TILE * (1 + center.size // 4))
    for number in range(_MOST_ROUNDS):
        share, center, frame = _learn(posterior, data, center, frame, jax.random.fold_in(key, number), learning)
        if share > _GOOD:
            break
    u, log_density, log_weight = _draw(posterior, data, center, frame, jax.random.fold_in(key, _MOST_ROUNDS), draws)
    log_weight = np.asarray(log_weight)
    if not np.isfinite(log_weight).any():
        return Weighted(np.asarray(u), np.asarray(log_density), np.full(draws, 1 / draws), np.inf)
    weights = np.exp(log_weight - log_weight.max())
    return Weighted(np.asarray(u), np.asarray(log_density), weights / weights.sum(), _pareto_shape(log_weight))


@program
def _draw(posterior, data, center, frame, key, draws):
    of_normal, of_length = jax.random.split(key)
    normal = jax.random.normal(of_normal, (draws, center.size))
    length = jnp.sqrt(_DEGREES / (2 * jax.random.gamma(of_length, _DEGREES / 2, (draws,))))
    w = normal * length[:, None]
    u = center + w @ frame.T
    log_density = jax.lax.map(lambda x: posterior.log_density(x, data), u, batch_size=TILE)
    log_density = jnp.where(jnp.isnan(log_density), -jnp.inf, log_density)
    of_proposal = -0.5 * (_DEGREES + center.size) * jnp.log1p(jnp.sum(w**2, axis=1) / _DEGREES)
    return u, log_density, log_density - of_proposal


@program
def _learn(posterior, data, center, frame, key, draws):
    """The share of a round's draws that count, and centre and frame of the next proposal."""
    u, _, log_weight = _draw(posterior, data, center, frame, key, draws)
    log_weight = log_weight - jnp.max(log_weight)

    def shares(power):
        return jax.nn.softmax(jnp.where(jnp.isfinite(log_weight), power * log_weight, -jnp.inf))

    def counting(share):
        return 1 / jnp.sum(share**2)

    enough = jnp.minimum(_ENOUGH * center.size, 0.5 * draws)
    power = jax.lax.while_loop(
        lambda power: (counting(shares(power)) < enough) & (power > 1e-6), lambda power: 0.7 * power, 1.0
    )
    share = shares(power)
    middle = share @ u
    apart = jnp.sqrt(share)[:, None] * (u - middle)
    spread = jnp.linalg.solve(frame, apart.T)
    factor = jnp.linalg.cholesky(spread @ spread.T + 1e-6 * jnp.eye(center.size))
    learnt = jnp.all(jnp.isfinite(factor))
    return (
        counting(shares(1.0)) / draws,
        jnp.where(learnt, middle, center),
        jnp.where(learnt, frame @ factor, frame),
    )


def _pareto_shape(log_weight: Float[np.ndarray, " S"]) -> float:
    from arviz_stats.base.array import array_stats

    finite = log_weight[np.isfinite(log_weight)]
    if len(finite) < _TELLING:
        return np.inf
    # ArviZ takes what is to be weighed down: the negative logarithm of the weights.
    return float(array_stats.psislw(finite.max() - finite)[1])


def resampled(
    weighted: Weighted, count: int, key: PRNGKeyArray
) -> tuple[Float[Array, "count p"], Float[Array, " count"]]:
    """Equally weighted draws (count, p) and their log density, by systematic resampling, in random order."""
    of_offset, of_order = jax.random.split(key)
    places = (np.arange(count) + float(jax.random.uniform(of_offset))) / count
    chosen = np.minimum(np.searchsorted(np.cumsum(weighted.weights), places), len(weighted.weights) - 1)
    chosen = np.asarray(jax.random.permutation(of_order, chosen))
    return jnp.asarray(weighted.u[chosen]), jnp.asarray(weighted.log_density[chosen])
