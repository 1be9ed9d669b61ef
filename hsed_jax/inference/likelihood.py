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
        weights: 1 where measured and used, 0 where missing or padding, shape (n, J); between them where samples repeat
            one another, so that they count for as many as they are worth.
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
    """√w (f − y)/σ, zero where there are no data; a diverged experiment counts as a thousand standard deviations."""
    residual = (predicted - data.values) / _sigma(errors, data)
    return jnp.sqrt(data.weights) * jnp.where(ok[:, None] > 0, residual, 1e3)


def log_likelihood(
    predicted: Float[Array, "n J"], ok: Float[Array, " n"], errors: Float[Array, " J"], data: Data
) -> Float[Array, ""]:
    """Log of Eq. 4, the normalising constant included."""
    residual = standardised_residual(predicted, ok, errors, data)
    constants = data.weights * (0.5 * LOG_2PI + jnp.log(_sigma(errors, data)))
    return -0.5 * jnp.sum(residual**2) - jnp.sum(constants)


def _sigma(errors: Float[Array, " J"], data: Data) -> Float[Array, "n J"]:
    return jnp.where(data.weights > 0, errors * data.scales, 1.0)
