"""A spring law of a test: a linear spring with twice its stiffness."""

from collections.abc import Mapping
from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractSpringLaw, Memory, Scalar, Slots
from hsed_jax.physics.parameters import parameter
from hsed_jax.registry import register


@final
@register
class Doubled(AbstractSpringLaw):
    """A linear spring, $f = 2k\\,\\Delta u$."""

    name: ClassVar[str] = "doubled"
    title: ClassVar[str] = "twice a linear spring"
    reference: ClassVar[str] = "a test"
    steepest: ClassVar[Mapping[str, float]] = {"k": 0.999}

    k: Scalar = parameter("k", "N/m", "half of the stiffness", lower=0.0)

    @property
    def stiffness(self) -> Scalar:
        return 2 * self.k

    @property
    def strength(self) -> Scalar:
        return jnp.inf

    def start(self) -> Memory:
        return {"hysteretic": jnp.zeros(())}

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        return 2 * self.k * elongation

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        return {"hysteretic": self.force(elongation, memory, slots)}
