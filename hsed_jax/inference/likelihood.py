r"""The likelihood: independent Gaussian errors whose standard deviation is declared or inferred, per output.

$$\log L = -\tfrac12\sum_{ij}\Big[\Big(\frac{y_{ij}-f_{ij}(\theta)}{\sigma_{ij}}\Big)^2+\log 2\pi\sigma_{ij}^2\Big]$$

(Abbiati & Marelli, Eqs. 3–4, with σ a standard deviation), $\sigma_{ij} = s_j\,c_{ij}$: the scale c is 1 for an absolute error
and the magnitude of the measured value for a relative one; s is a declared number or a parameter.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

LOG_2PI = 1.8378770664093453


class Data(NamedTuple):
    """Measured outputs of n experiments (padded) and what it takes to predict them.

    Attributes:
        conditions: conditions of the experiments, leading axis n.
        values: measured outputs, SI, shape (n, J).
        scales: c in σ = s·c, shape (n, J).
        weights: 1 where measured and used, 0 where missing or padding, shape (n, J).
        count: how many experiments there are; rows beyond are padding.
    """

    conditions: PyTree
    values: Float[Array, "n J"]
    scales: Float[Array, "n J"]
    weights: Float[Array, "n J"]
    count: Int[Array, ""]


def standardised_residual(
    predicted: Float[Array, "n J"], ok: Float[Array, " n"], errors: Float[Array, " J"], data: Data
) -> Float[Array, "n J"]:
    """(f − y)/σ, zero where there are no data; a diverged experiment counts as a thousand standard deviations."""
    sigma = jnp.where(data.weights > 0, errors * data.scales, 1.0)
    residual = (predicted - data.values) / sigma
    return data.weights * jnp.where(ok[:, None] > 0, residual, 1e3)


def log_likelihood(
    predicted: Float[Array, "n J"], ok: Float[Array, " n"], errors: Float[Array, " J"], data: Data
) -> Float[Array, ""]:
    """Log of Eq. 4, the normalising constant included."""
    residual = standardised_residual(predicted, ok, errors, data)
    sigma = jnp.where(data.weights > 0, errors * data.scales, 1.0)
    present = jnp.arange(data.values.shape[0]) < data.count
    counted = data.weights * present[:, None]
    return -0.5 * jnp.sum(counted * (residual**2 + LOG_2PI)) - jnp.sum(counted * jnp.log(sigma))
