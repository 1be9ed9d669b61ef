"""An excitation of a test: a recorded motion, twice as strong."""

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.declared import REPEATED, Declared
from hsed_jax.physics.excitations.base import AbstractRecord, Scalar
from hsed_jax.registry import register


@register
@final
class Repeated(AbstractRecord):
    """Twice a recorded accelerogram."""

    declared: ClassVar[Declared] = REPEATED

    ground_acceleration: Float[Array, " m"] = eqx.field(converter=jnp.asarray)

    def sample(self, time: Scalar) -> Scalar:
        return 2 * jnp.interp(time, self.time, self.ground_acceleration, left=0.0, right=0.0)
