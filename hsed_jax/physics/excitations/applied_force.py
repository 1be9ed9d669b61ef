"""A force on one mass, while the ground rests: a shaker, an actuator, a blast, a release."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.declared import HISTORY_OF_A_FORCE, Declared
from hsed_jax.physics.excitations.base import AbstractRecord, Applied, Scalar, samples_of
from hsed_jax.registry import register

# As the integration resolves a period (`hsed_jax.study.timelines`).
_STEPS_PER_PERIOD = 24


@register
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

    declared: ClassVar[Declared] = HISTORY_OF_A_FORCE

    force: Float[Array, " m"] = eqx.field(converter=samples_of)
    mass: int = eqx.field(static=True)
    scale: Scalar = HISTORY_OF_A_FORCE.default("scale")

    @property
    def shortest_period(self) -> Scalar:
        """Period [s] for which a step is at most the interval between two samples: an impact must not fall between steps."""
        return _STEPS_PER_PERIOD * jnp.min(jnp.diff(self.time))

    def sample(self, time: Scalar) -> Applied:
        """The force at one instant [s]."""
        return Applied({self.mass - 1: self.scale * jnp.interp(time, self.time, self.force, left=0.0, right=0.0)})
