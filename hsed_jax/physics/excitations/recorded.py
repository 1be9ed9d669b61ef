"""A recorded ground motion."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.declared import RECORDED_MOTION, Declared
from hsed_jax.physics.excitations.base import AbstractRecord, Scalar, samples_of
from hsed_jax.registry import register


@register
@final
class RecordedMotion(AbstractRecord):
    """A recorded accelerogram times a factor, linear between its samples and zero outside them.

    Arguments:
        time: sample times [s], increasing, shape (m,).
        ground_acceleration: samples [m/s²], shape (m,).
        scale: factor.
    """

    declared: ClassVar[Declared] = RECORDED_MOTION

    ground_acceleration: Float[Array, " m"] = eqx.field(converter=samples_of)
    scale: Scalar = RECORDED_MOTION.default("scale")

    def sample(self, time: Scalar) -> Scalar:
        """Ground acceleration [m/s²] at one instant [s]."""
        return self.scale * jnp.interp(time, self.time, self.ground_acceleration, left=0.0, right=0.0)
