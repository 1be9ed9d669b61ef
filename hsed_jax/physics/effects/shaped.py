"""An effect in its simplest shape, while no simulation of the batch has another shape.

The expression of an effect with all its forms costs several times as much as its simplest form, which most models have.
"""

from collections.abc import Mapping
from typing import Any, final

import jax
from jaxtyping import Array, Bool

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, neutral
from hsed_jax.physics.effects.forms import chosen
from hsed_jax.physics.gates import gated
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.states import SharedState


def shapes_of(effect: type[Any]) -> frozenset[str]:
    """The parameters that tell the forms of an effect from its simplest one, whatever drives it."""
    drivers = {chosen(number) for number in range(1, len(effect.drivers))}
    return frozenset(name for name, known in parameters_of(effect).items() if known.shapes) - drivers


@final
class Shaped(AbstractSpringEffect):
    """An effect, in its simplest shape where that is enough.

    Attributes:
        whole: the effect.
        simplest: the same, with numbers for the parameters of its shape, so that these compute nothing.
        is_shaped: whether any of these parameters is not neutral, the same for all that run together.
    """

    whole: AbstractSpringEffect
    simplest: AbstractSpringEffect
    is_shaped: Bool[Array, ""]

    @classmethod
    def of(
        cls, effect: type[AbstractSpringEffect], values: Mapping[str, Scalar], is_shaped: Bool[Array, ""]
    ) -> AbstractSpringEffect:
        """The effect with these parameters; as it is, where it has but one shape."""
        shapes = shapes_of(effect)
        # Every parameter of a shape has a neutral value, which is its default.
        simplest = {name: value for name, value in values.items() if name not in shapes}
        return cls(effect(**values), effect(**simplest), is_shaped) if shapes else effect(**values)

    @property
    def states(self) -> tuple[str, ...]:
        """Those of the effect."""
        return self.whole.states

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """Those of the effect."""
        return self.whole.needs

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """What the effect contributes, to the slots of its whole expression and of its simplest one."""
        both = self.whole, self.simplest
        written: list[dict[str, Any]] = jax.eval_shape(lambda: [effect.contribute(point) for effect in both])  # pyright: ignore[reportUnknownMemberType]
        absent = {slot: neutral(slot) for part in written for slot in part}
        there, simpler = (lambda effect=effect: absent | effect.contribute(point) for effect in both)
        return gated(self.is_shaped, there, simpler)

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Rates of the effect's states."""
        return self.whole.flow(point)

    def settle(self, point: SpringPoint) -> dict[str, Scalar]:
        """What a step commits of the effect's states."""
        return self.whole.settle(point)


def kind_of(effect: AbstractSpringEffect) -> type[AbstractSpringEffect]:
    """What an effect is, whatever its shape."""
    return type(effect.whole if isinstance(effect, Shaped) else effect)
