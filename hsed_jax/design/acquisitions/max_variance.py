"""The variance of the Kriging model (Eq. 11)."""

from collections.abc import Sequence
from typing import ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisitions.base import AbstractAcquisition, deviation
from hsed_jax.design.kriging import Kriging
from hsed_jax.registry import register


@final
@register
class MaxVariance(AbstractAcquisition):
    """Where the variance of the discrepancy is largest (Eq. 11)."""

    use: ClassVar[str] = "a map of the discrepancy"

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """Log of the Kriging variance."""
        del key
        return 2.0 * jnp.log(deviation(kriging.predict(candidates)[1]))

    @staticmethod
    def lesson(value: float, discrepancies: Sequence[float | None]) -> str:
        """The place where the variance is largest."""
        del value, discrepancies
        return "the error of the model where it is most uncertain"
