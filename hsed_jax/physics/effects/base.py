"""What every physical effect is: parameters with a neutral value, states it needs, contributions to named slots."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from hsed_jax.physics.scales import Scales

Scalar = Float[Array, ""] | float

MULTIPLIED = ("a", "nu", "eta", "h")
ADDED = ("force", "n", "gamma", "compliance", "slack")


class SpringPoint(NamedTuple):
    r"""What an effect may look at: the spring at one instant.

    Attributes:
        elongation: Δu [m].
        rate: Δu̇ [m/s].
        hysteretic: z [N], the force of the Bouc–Wen element.
        memory: further states by name, among them `energy` e [J].
        scales: characteristic values.
        strength: ultimate force of the virgin element, $[A/(\beta+\gamma)]^{1/n}$ [N].
    """

    elongation: Scalar
    rate: Scalar
    hysteretic: Scalar
    memory: dict[str, Scalar]
    scales: Scales
    strength: Scalar


class AbstractEffect(eqx.Module):
    """A physical effect of the spring.

    A subclass is final, declares its parameters as fields (`hsed_jax.physics.parameters.parameter`) and returns its
    contributions to the slots of the law (`hsed_jax.physics.bouc_wen`): factors on `a`, `nu`, `eta`, `h`; addends to `force`
    [N], to `n`, to `gamma` (in units of β), to `compliance` (of what is in series with the element [m/N]) and to `slack` (the
    elongation without force to either side [m]).  Contributions of several effects to one slot multiply (or add), so effects
    commute.  At the neutral value of its parameters an effect contributes exactly nothing.

    Attributes:
        name: as it stands in studies and reports.
        family: the kind of physics.
        reference: where it comes from.
        needs: states of the spring that it looks at besides force and energy: `largest_elongation` [m], `travel` [m] (the
            length of the path of Δu); two effects that need one state share it.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    reference: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()

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
