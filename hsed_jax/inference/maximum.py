"""The maximum a posteriori estimate, by Levenberg–Marquardt from several starts, and the evidence by Laplace."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from hsed_jax.inference.likelihood import LOG_2PI, Data
from hsed_jax.inference.posterior import Posterior


class Maximum(NamedTuple):
    """The best of several starts.

    Attributes:
        u, theta: unconstrained and physical (SI) coordinates of the MAP (Eq. 6), shape (p,).
        log_posterior: log π(θ)L(θ) there.
        covariance: Gauss–Newton covariance of θ there, prior included, shape (p, p).
        log_evidence: log Z by Laplace's method (Tierney & Kadane 1986).
        start: unconstrained coordinates of the mode of the density in u, where a sampler of u starts, shape (p,).
        whitening: L with u = start + L w, w nearly standard normal, shape (p, p).
        converged: whether the winning start met its tolerances.
    """

    u: Float[Array, " p"]
    theta: Float[Array, " p"]
    log_posterior: Float[Array, ""]
    covariance: Float[Array, "p p"]
    log_evidence: Float[Array, ""]
    start: Float[Array, " p"]
    whitening: Float[Array, "p p"]
    converged: Bool[Array, ""]


def maximise(posterior: Posterior, data: Data, starts: Float[Array, "s p"]) -> Maximum:
    """Find the MAP.  Pure and traceable; compile it once per study.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        starts: unconstrained starting points.
    """
    descend = partial(_least_squares, posterior, data)
    ends, converged = jax.vmap(descend)(starts)
    heights = jax.vmap(lambda u: posterior.log_posterior(u, data))(ends)
    best = jnp.argmax(jnp.where(jnp.isfinite(heights), heights, -jnp.inf))
    u = ends[best]
    theta = posterior.constrain(u)

    to_theta = jax.jacfwd(posterior.constrain)(u)
    curvature = posterior.curvature(u, data)
    covariance = to_theta @ jnp.linalg.inv(curvature) @ to_theta.T
    start, whitening = _sampling_frame(posterior, data, u)
    log_evidence = posterior.log_density(start, data) + 0.5 * u.size * LOG_2PI + jnp.linalg.slogdet(whitening)[1]
    return Maximum(u, theta, heights[best], covariance, log_evidence, start, whitening, converged[best])


def _least_squares(posterior: Posterior, data: Data, start: Float[Array, " p"]):
    solution = optx.least_squares(
        lambda u, _: posterior.residuals(u, data),
        optx.LevenbergMarquardt(rtol=1e-6, atol=1e-8),
        start,
        max_steps=60,
        throw=False,
    )
    return solution.value, solution.result == optx.RESULTS.successful


def _sampling_frame(posterior: Posterior, data: Data, u: Float[Array, " p"]):
    """The mode of the density in u and a whitening there; a MAP at a bound lies at infinity of u, the mode does not."""

    def frame(center):
        return jnp.linalg.inv(jnp.linalg.cholesky(posterior.curvature(center, data))).T

    near = jnp.clip(u, -4.0, 4.0)
    rough = frame(near)
    solution = optx.minimise(
        lambda w, _: -posterior.log_density(near + rough @ w, data),
        optx.BFGS(rtol=1e-4, atol=1e-4),
        jnp.zeros_like(u),
        max_steps=30,
        throw=False,
    )
    center = near + rough @ solution.value
    return center, frame(center)
