r"""A posterior around points of u to second order; every search for its modes uses it.

One simulation of each experiment with its derivatives gives the whole expansion.  The curvature is that of Gauss and Newton:
the expected Fisher information, and the positive part of the curvature of priors and transformation, $F = \sum \frac{\partial
f\,\partial f^\top}{\sigma^2} + 2\,\partial\log\sigma\,\partial\log\sigma^\top$.

The simulations are those of `hsed_jax.inference.simulations`, all starts side by side.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.likelihood import Data, decorrelated, log_likelihood
from hsed_jax.inference.population import Population
from hsed_jax.inference.posterior import Posterior, positive_part
from hsed_jax.inference.simulations import filled, linearised_at
from hsed_jax.programs import program

# Points of a call.
_WIDTH = 4
# Coordinates have order one, so the curvature has at least this size if the Hessian is smaller.
_LEAST_OF_POPULATION = 0.25


class Expansion(NamedTuple):
    """A posterior around one point of u.

    Attributes:
        log_posterior: log density in θ, unnormalised.
        slope: its gradient, (p,).
        hessian: of minus that density, made positive semidefinite, (p, p).
        log_density: log density in u, unnormalised.
        gradient: of `log_density`, (p,).
        curvature: minus its Hessian, made positive, (p, p).
        information: the part of the curvature from the measurements, (p, p).
        predicted: outputs of the experiments, SI, (n, J).
        ok: 1 where the simulation converged, else 0, (n,).
    """

    log_posterior: Float[Array | np.ndarray, ""]
    slope: Float[Array | np.ndarray, " p"]
    hessian: Float[Array | np.ndarray, "p p"]
    log_density: Float[Array | np.ndarray, ""]
    gradient: Float[Array | np.ndarray, " p"]
    curvature: Float[Array | np.ndarray, "p p"]
    information: Float[Array | np.ndarray, "p p"]
    predicted: Float[Array | np.ndarray, "n J"]
    ok: Float[Array | np.ndarray, " n"]


def expand(posterior: Posterior, data: Data, points: Sequence[np.ndarray] | np.ndarray) -> list[Expansion]:
    """The posterior around each of some points, in NumPy."""
    found: list[Expansion] = []
    for at in range(0, len(points), _WIDTH):
        block = np.stack([np.asarray(point) for point in points[at : at + _WIDTH]])
        found += _expanded(posterior, data, block, linearised_at(posterior, data, block, _WIDTH))
    return found


def expand_each(posterior: Posterior, data: Sequence[Data], point: np.ndarray) -> list[Expansion]:
    """The posterior around one point with data that differ in their weights only: one simulation serves all."""
    block = np.asarray(point)[None]
    simulated = linearised_at(posterior, data[0], block, _WIDTH)
    return [_expanded(posterior, own, block, simulated)[0] for own in data]


def _expanded(
    posterior: Posterior, data: Data, block: Float[np.ndarray, "k p"], simulated: Sequence[np.ndarray]
) -> list[Expansion]:
    known = [filled(own, _WIDTH) for own in simulated]
    leaves = [np.asarray(leaf) for leaf in _expansions(posterior, data, filled(block, _WIDTH), *known)]
    return [Expansion(*(leaf[i] for leaf in leaves)) for i in range(len(block))]


def centred(posterior: Posterior, data: Data, theta: Float[Array, " p"]) -> Posterior:
    """The same posterior in coordinates that follow the offsets of a population, as the measurements determine them at θ."""
    levels, first = posterior.population.levels, posterior.population.first
    if not levels:
        return posterior
    plain = eqx.tree_at(lambda p: p.population, posterior, Population(levels, first))
    theta = posterior.population.settled(theta)
    (around,) = expand(plain, data, [np.asarray(plain.unconstrain(theta))])
    suited = plain.population.centred(np.asarray(theta), np.asarray(around.information))
    return eqx.tree_at(lambda p: p.population, posterior, suited)


@program
def _expansions(
    posterior: Posterior,
    data: Data,
    points: Float[Array | np.ndarray, "S p"],
    *simulated: Float[Array | np.ndarray, "S ..."],
) -> Expansion:
    return jax.vmap(lambda u, *own: _expansion(posterior, data, u, *own))(points, *simulated)


def _expansion(
    posterior: Posterior,
    data: Data,
    u: Float[Array, " p"],
    predicted: Float[Array, "n J"],
    ok: Float[Array, " n"],
    along: Float[Array, "n J p"],
) -> Expansion:
    """The posterior around u, where the outputs and their derivatives are known."""
    z, log_sigma, z_along, sigma_along = posterior.compared_along(u, predicted, ok, along, data)
    likelihood, (by_z, by_sigma) = jax.value_and_grad(
        lambda z, log_sigma: log_likelihood(z, log_sigma, ok, data), argnums=(0, 1)
    )(z, log_sigma)
    told = jnp.einsum("nj,pnj->p", by_z, z_along) + jnp.einsum("nj,pnj->p", by_sigma, sigma_along)
    # The mean alone: the dependence of z on σ has its own term.
    g = jax.vmap(lambda one: decorrelated(one, data))(z_along + z * sigma_along)
    h = jnp.sqrt(2 * data.weights) * sigma_along
    information = g @ g.T + jnp.einsum("pnj,qnj->pq", h, h)

    (prior, density), (slope, gradient), of_priors, of_density = posterior.prior_expansion(u)
    if posterior.population.levels:
        # The density couples spreads and offsets, and its curvature is not positive everywhere.
        values, axes = jnp.linalg.eigh(information - of_density)
        curvature = (axes * jnp.maximum(values, _LEAST_OF_POPULATION)) @ axes.T
    else:
        curvature = information + jnp.diag(positive_part(of_density))
    return Expansion(
        likelihood + prior,
        told + slope,
        information + of_priors.T @ of_priors,
        likelihood + density,
        told + gradient,
        curvature,
        information,
        predicted,
        ok,
    )
