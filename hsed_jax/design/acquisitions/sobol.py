"""The order of the candidates, which are a Sobol' sequence."""

from typing import ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisitions.base import AbstractAcquisition
from hsed_jax.design.kriging import Kriging
from hsed_jax.registry import register


@final
@register
class Sobol(AbstractAcquisition):
    """Next in a space-filling sequence."""

    use: ClassVar[str] = "a baseline"
    is_order: ClassVar[bool] = True

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """A number that falls from candidate to candidate."""
        del kriging, key
        return -jnp.log1p(jnp.arange(candidates.shape[0], dtype=candidates.dtype))
