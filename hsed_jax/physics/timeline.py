"""Times of the integration and of its samples: the only place that turns numbers of steps into times."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""] | float


class Timeline(NamedTuple):
    """The grid of the integration.

    Attributes:
        step: length of a step [s], the same for all steps of all experiments; None if every experiment has its own step
            lengths, from its record or from its inputs.
        steps: their number.
        every: number of steps between kept samples of histories; divides `steps`.
    """

    step: float | None
    steps: int
    every: int = 1

    @property
    def samples(self) -> int:
        """Length of a history, its start included."""
        return self.steps // self.every + 1


def times(step_length: Float[Array, " steps"] | float, every: int, samples: int) -> Float[Array, " samples"]:
    """Times of the kept samples of histories [s], from t = 0.

    Arguments:
        step_length: [s], one number or one per step.
        every: at every so many steps.
        samples: how many.
    """
    lengths = jnp.asarray(step_length)
    if lengths.ndim == 0:
        return lengths * every * jnp.arange(samples)
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(lengths)])[::every]
