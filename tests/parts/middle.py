"""An acquisition of a test: the candidate next to the middle of the inputs."""

from typing import ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisitions.base import AbstractAcquisition
from hsed_jax.design.kriging import Kriging
from hsed_jax.registry import register


@final
@register
class Middle(AbstractAcquisition):
    """Next to the middle of the inputs."""

    use: ClassVar[str] = "a test"
    is_order: ClassVar[bool] = True

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        return -jnp.max(jnp.abs(candidates - 0.5), axis=1)
