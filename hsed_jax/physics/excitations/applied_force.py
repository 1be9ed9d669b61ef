"""A force on one mass, while the ground rests: a shaker, an actuator, a blast, a release."""

from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.excitations.base import (
    APPLIED_FORCE,
    AbstractRecord,
    Applied,
    Kind,
    Scalar,
    setting,
)

# As the integration resolves a period (`hsed_jax.study.timelines`).
_STEPS_PER_PERIOD = 24


@final
class AppliedForce(AbstractRecord):
    r"""A history of a force on one mass times a factor, linear between its samples and zero outside them.

    $$M\ddot u + C\dot u + K u + b\,r = p(t)\,e_i$$

    Arguments:
        time: sample times [s], increasing, shape (m,).
        force: samples [N], shape (m,).
        mass: that it acts on, numbered from 1.
        scale: factor.
    """

    name: ClassVar[str] = "applied_force"
    kind: ClassVar[Kind] = APPLIED_FORCE
    of_file: ClassVar[tuple[str, ...]] = ("time", "force")

    force: Float[Array, " m"] = eqx.field(converter=jnp.asarray)
    mass: int = setting("number of the mass", "1", kind="whole")
    scale: Scalar = setting("factor", "1", default=1.0)

    @property
    def shortest_period(self) -> Scalar:
        """So long [s] that a step is at most the interval between two samples: an impact must not fall between steps."""
        return _STEPS_PER_PERIOD * jnp.min(jnp.diff(self.time))

    def sample(self, time: Scalar) -> Applied:
        """The force at one instant [s]."""
        return Applied({self.mass - 1: self.scale * jnp.interp(time, self.time, self.force, left=0.0, right=0.0)})

    @classmethod
    def sentence(cls, settings: Mapping[str, Any], duration: float | None) -> str:
        """The file and the mass."""
        return (
            f"Driven by the force {settings['file'].rpartition('/')[2]} on mass {settings['mass']}, the ground at rest"
        )
