"""A ground motion as it was recorded."""

from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.excitations.base import (
    GROUND_MOTION,
    AbstractRecord,
    Kind,
    Scalar,
    setting,
)


@final
class RecordedMotion(AbstractRecord):
    """A recorded accelerogram times a factor, linear between its samples and zero outside them.

    Arguments:
        time: sample times [s], increasing, shape (m,).
        ground_acceleration: samples [m/s²], shape (m,).
        scale: factor.
    """

    name: ClassVar[str] = "recorded"
    kind: ClassVar[Kind] = GROUND_MOTION
    of_file: ClassVar[tuple[str, ...]] = ("time", "ground_acceleration")

    ground_acceleration: Float[Array, " m"] = eqx.field(converter=jnp.asarray)
    scale: Scalar = setting("factor", "1", default=1.0)

    def sample(self, time: Scalar) -> Scalar:
        """Ground acceleration [m/s²] at one instant [s]."""
        return self.scale * jnp.interp(time, self.time, self.ground_acceleration, left=0.0, right=0.0)

    @classmethod
    def sentence(cls, settings: Mapping[str, Any], duration: float | None) -> str:
        """Shaken by the file."""
        return f"Shaken by the recorded motion {settings['file'].rpartition('/')[2]}"
