"""What every physical effect is: parameters with a neutral value, states it needs, contributions to named slots."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from hsed_jax.physics.scales import Scales

Scalar = Float[Array, ""] | float

MULTIPLIED = ("a", "nu", "eta", "h")
ADDED = ("force",)


class SpringPoint(NamedTuple):
    """What an effect may look at: the spring at one instant.

    Attributes:
        elongation: Δu [m].
        rate: Δu̇ [m/s].
        hysteretic: z [N], the force of the Bouc–Wen element.
        memory: further states by name, among them `energy` e [J].
        scales: characteristic values.
    """

    elongation: Scalar
    rate: Scalar
    hysteretic: Scalar
    memory: dict[str, Scalar]
    scales: Scales


class AbstractEffect(eqx.Module):
    """A physical effect of the spring.

    A subclass is final, declares its parameters as fields (`hsed_jax.physics.parameters.parameter`) and returns its
    contributions to the slots of the law (`hsed_jax.physics.bouc_wen`): factors on `a`, `nu`, `eta`, `h`, an addend to
    `force`.  Contributions of several effects to one slot multiply (or add), so effects commute.  At the neutral value of
    its parameters an effect contributes exactly nothing.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    reference: ClassVar[str]

    @abstractmethod
    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """Contributions by slot."""


EFFECTS: dict[str, type[AbstractEffect]] = {}


def register[T: type[AbstractEffect]](cls: T) -> T:
    """Class decorator: put an effect into the catalogue under its name."""
    if cls.name in EFFECTS:
        raise ValueError(f"An effect named {cls.name!r} is in the catalogue already.")
    EFFECTS[cls.name] = cls
    return cls


def combine(contributions: list[dict[str, Any]]) -> Callable[[str], Any]:
    """Merge contributions: slot name -> value, or the neutral Python number where nobody wrote (and XLA folds it away)."""
    merged: dict[str, Any] = {}
    for contribution in contributions:
        for slot, value in contribution.items():
            if slot in MULTIPLIED:
                merged[slot] = merged[slot] * value if slot in merged else value
            elif slot in ADDED:
                merged[slot] = merged[slot] + value if slot in merged else value
            else:
                raise ValueError(f"There is no slot {slot!r}; slots are {', '.join((*MULTIPLIED, *ADDED))}.")
    return lambda slot: merged.get(slot, 1.0 if slot in MULTIPLIED else 0.0)
