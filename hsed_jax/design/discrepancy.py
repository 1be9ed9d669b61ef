r"""The discrepancy norm between measured and predicted quantities (Abbiati & Marelli, Eq. 12).

$$\mathcal M(x) = \sum_j \frac{(R_{HS,j}(x) - R_{CS,j}(x,\theta_{MAP}))^2}{\mathrm{Var}_x[R_{CS,j}(x,\theta_{MAP})]}$$
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def variance_over(predicted: Float[Array, "m J"], ok: Float[Array, " m"]) -> Float[Array, " J"]:
    """Variance of each predicted quantity over a sample of inputs; diverged simulations do not count."""
    weight = ok[:, None] / jnp.maximum(jnp.sum(ok), 1.0)
    mean = jnp.sum(weight * predicted, axis=0)
    return jnp.sum(weight * (predicted - mean) ** 2, axis=0)


def discrepancy(
    measured: Float[Array, "n J"],
    predicted: Float[Array, "n J"],
    variance: Float[Array, " J"],
    weights: Float[Array, "n J"],
) -> Float[Array, " n"]:
    """The norm of Eq. 12 per experiment; quantities that were not measured (weight 0) do not count."""
    return jnp.sum(weights * (measured - predicted) ** 2 / variance, axis=1)
