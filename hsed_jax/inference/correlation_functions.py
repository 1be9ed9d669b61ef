"""Correlation functions of Gaussian processes over the unit cube of the inputs, and the prior of their correlation lengths."""

from collections.abc import Callable
from typing import Literal, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tinygp.kernels import Kernel, stationary
from tinygp.kernels.distance import Distance
from tinygp.transforms import Linear

KernelName = Literal["matern32", "matern52", "gaussian"]

# Log-normal prior: median, for each √d (in d inputs points lie that much farther apart), and spread of the logarithm.
LENGTH, LENGTH_SPREAD = 0.14, 0.5


@final
class Euclidean(Distance):
    """The distance √(Σ_k (x_k − x'_k)²), as a tinygp metric.

    Written as a sum over scalars because XLA fuses that, square root and kernel into one vectorised loop, and it does
    not fuse a reduction over a short axis.
    """

    def distance(self, X1: Float[Array, " d"], X2: Float[Array, " d"]) -> Float[Array, ""]:
        """Distance of two points; at distance zero its derivative is zero, not NaN."""
        return jnp.sqrt(self.squared_distance(X1, X2) + 1e-300)

    def squared_distance(self, X1: Float[Array, " d"], X2: Float[Array, " d"]) -> Float[Array, ""]:
        """Squared distance of two points."""
        return sum((jnp.square(X1[k] - X2[k]) for k in range(X1.shape[0])), start=jnp.zeros(()))


KERNELS: dict[str, Callable[..., Kernel]] = {
    "matern32": stationary.Matern32,
    "matern52": stationary.Matern52,
    "gaussian": stationary.ExpSquared,
}


def correlation(
    a: Float[Array, "A d"], b: Float[Array, "B d"], lengths: Float[Array, " d"], kernel: KernelName
) -> Float[Array, "A B"]:
    """Correlation R(|x − x'|; ρ) of every point of `a` with every point of `b`, one correlation length per input."""
    return Linear(1.0 / lengths, KERNELS[kernel](distance=Euclidean()))(a, b)


def log_prior_of_lengths(log_lengths: Float[Array, " d"]) -> Float[Array, ""]:
    """Log density of the logarithms of correlation lengths in d inputs, without its constant."""
    return -0.5 * jnp.sum(((log_lengths - np.log(LENGTH * np.sqrt(log_lengths.size))) / LENGTH_SPREAD) ** 2)
