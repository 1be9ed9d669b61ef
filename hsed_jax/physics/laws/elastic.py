"""The linear elastic law."""

from collections.abc import Mapping
from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractSpringLaw, Memory, Scalar, Slots, still
from hsed_jax.physics.parameters import parameter
from hsed_jax.registry import register


@final
@register
class Elastic(AbstractSpringLaw):
    r"""A linear spring: $f = k\,(\Delta u - p)$.  The plastic elongation p is zero unless an effect writes to `plastic`."""

    name: ClassVar[str] = "elastic"
    title: ClassVar[str] = "a linear elastic spring"
    reference: ClassVar[str] = "Hooke 1678"
    slots: ClassVar[tuple[str, ...]] = ("plastic",)
    steepest: ClassVar[Mapping[str, float]] = {"k": 0.999}

    k: Scalar = parameter("k", "N/m", "stiffness", lower=0.0)

    @property
    def stiffness(self) -> Scalar:
        """k [N/m]."""
        return self.k

    @property
    def strength(self) -> Scalar:
        """Infinite."""
        return jnp.inf

    @property
    def steepness(self) -> Scalar:
        """Infinite: the force has no limit."""
        return 0.0

    def start(self) -> Memory:
        """No force."""
        return still("hysteretic")

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """The force k (Δu − p) [N]."""
        return self.k * (elongation - slots("plastic"))

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The force."""
        return {"hysteretic": self.force(elongation, memory, slots)}
