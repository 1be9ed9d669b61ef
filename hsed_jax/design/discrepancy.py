r"""The discrepancy norm between measured and predicted quantities (Abbiati & Marelli, Eq. 12).

$$\mathcal M(x) = \sum_j \frac{(R_{HS,j}(x) - R_{CS,j}(x,\theta_{MAP}))^2}{\mathrm{Var}_x[R_{CS,j}(x,\theta_{MAP})]}$$
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


def variance_over(
    predicted: Float[Array, "m J"], ok: Float[Array, " m"], groups: Int[np.ndarray, " J"]
) -> Float[Array, " J"]:
    """Variance of each predicted output over a sample of inputs; diverged simulations do not count.

    For a history it is the variance over inputs and time, times the number of samples. The sum over the samples in the norm
    is then their mean, so a history counts like a quantity.

    Arguments:
        predicted: columns are quantities, or the samples of histories.
        ok: 1 where the simulation converged.
        groups: output of each column.
    """
    members = jnp.asarray(groups[:, None] == np.arange(groups.max() + 1)[None], float)
    number = members.sum(axis=0)
    weight = ok / jnp.maximum(jnp.sum(ok), 1.0)
    mean = (weight @ predicted) @ members / number
    squares = (weight @ (predicted - mean[groups]) ** 2) @ members / number
    return (squares * number)[groups]


def discrepancy(
    measured: Float[Array, "n J"],
    predicted: Float[Array, "n J"],
    variance: Float[Array, " J"],
    weights: Float[Array, "n J"],
    groups: Int[np.ndarray, " J"],
) -> Float[Array, " n"]:
    """The norm of Eq. 12 per experiment; NaN without a measurement.

    It is the number of outputs times the mean over the measured outputs, each the mean over its measured samples. Missing
    values (weight 0) therefore neither increase nor decrease the misfit.

    Arguments:
        measured, predicted: columns are quantities, or the samples of histories.
        variance: of each column (`variance_over`).
        weights: of the measurement; 0 where it is missing.
        groups: output of each column.
    """
    members = jnp.asarray(groups[:, None] == np.arange(groups.max() + 1)[None], float)
    of_output = weights @ members
    is_measured = of_output > 0
    # The weight of a column instead of 1: larger if others of its output, or other outputs, are missing.
    share = jnp.where(is_measured, members.sum(axis=0) / jnp.where(is_measured, of_output, 1.0), 0.0)
    share *= members.shape[1] / jnp.maximum(jnp.sum(is_measured, axis=1, keepdims=True), 1)
    norm = jnp.sum(weights * share[:, groups] * (measured - predicted) ** 2 / variance, axis=1)
    return jnp.where(is_measured.any(axis=1), norm, jnp.nan)
