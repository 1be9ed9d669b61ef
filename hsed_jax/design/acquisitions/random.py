"""A random order of the candidates."""

from typing import ClassVar, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisitions.base import AbstractAcquisition
from hsed_jax.design.kriging import Kriging
from hsed_jax.registry import register


@final
@register
class Random(AbstractAcquisition):
    """At random."""

    use: ClassVar[str] = "a baseline"
    is_order: ClassVar[bool] = True

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """Log of a uniform random number for each candidate."""
        del kriging
        return jnp.log(jax.random.uniform(key, (candidates.shape[0],), minval=jnp.finfo(candidates.dtype).tiny))
