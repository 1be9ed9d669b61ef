r"""The base of every spring law: the force of an element from its elongation and its states, and the evolution of the states.

Two kinds of laws fit.  A law of **rates** integrates its force, $\dot z = g(\Delta u, \Delta\dot u, z)\,\Delta\dot u$
(Bouc–Wen): its `force` is a state and its `flow` is g Δu̇.  A law of **paths** (bilinear, Menegotto–Pinto, Takeda) gives its
force as a continuous function of the elongation and of the states committed at the end of the last step.  It has no `flow`, and
its `settle` commits.  Between two commits the elongation has one direction: at a reversal within a step, the commit is at the
reversal.

Effects add forces beside a law, a slack before it, energy and other states.  The law does not know them
(`hsed_jax.physics.specimen`).
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hsed_jax.physics.parameters import parameter

Scalar = Float[Array, ""] | float
Memory = dict[str, Scalar]
Slots = Callable[[str], Scalar]
"""The contributions of effects to a slot, by its name; the neutral Python number without a contribution."""


class Turn(NamedTuple):
    r"""A step of the integration with a possible reversal of the elongation.

    Attributes:
        happens: whether it turns.
        length: of the step [s].
        share: θ of the step before the turn, 1 without a turn.
        start: elongation at the start of the step [m].
        elongation: at the turn, or at the end of the step [m].
        before, after: rates of the elongation at the start and at the end of the step [m/s].
    """

    happens: Bool[Array, ""]
    length: Scalar
    share: Scalar
    start: Scalar
    elongation: Scalar
    before: Scalar
    after: Scalar


class AbstractSpringLaw(eqx.Module):
    """A spring law: its parameters are fields (`hsed_jax.physics.parameters.parameter`), a subclass is final.

    A parameter given as a Python number is a constant of the compiled program, one given as an array is an input of it.
    Derivatives pass in forward mode, so both sides of a `jnp.where` must be finite.

    Attributes:
        name: as in studies.
        title: in a sentence.
        reference: where it comes from.
        slots: the slots of its element, besides `force` and `slack`, which every specimen has; an effect that writes to
            another slot is impossible with this law.
        steepest: parameters that determine the largest stiffness and steepness of the virgin law, with the critical quantile
            of their prior; the steps of the integration are chosen for these.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    reference: ClassVar[str]
    slots: ClassVar[tuple[str, ...]] = ()
    steepest: ClassVar[Mapping[str, float]]

    @property
    @abstractmethod
    def stiffness(self) -> Scalar:
        """Stiffness of the virgin element [N/m]."""

    @property
    @abstractmethod
    def strength(self) -> Scalar:
        """Yield force of the virgin element, or its bound [N]; infinite without one."""

    @property
    def yardstick(self) -> Scalar:
        """Reference of effects for the force of the element [N]: the strength, or a substitute if the law has none."""
        return self.strength

    @property
    def yield_elongation(self) -> Scalar:
        """Strength over stiffness [m]."""
        return self.strength / self.stiffness

    @property
    def steepness(self) -> Scalar:
        """Rate, over the elongation, at which the force of the virgin element approaches its limit [1/m]."""
        return 1 / self.yield_elongation

    @abstractmethod
    def start(self) -> Memory:
        """The states of a virgin element by name; one is `hysteretic`, its force as integrated or when last committed [N]."""

    @abstractmethod
    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """Force of the element [N] at its elongation [m]."""

    def flow(self, elongation: Scalar, rate: Scalar, memory: Memory, slots: Slots) -> Memory:
        """Time derivatives of its integrated states."""
        del elongation, rate, memory, slots
        return {}

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The committed states after a step that ends, or turns, at this elongation [m]."""
        del elongation, memory, slots
        return {}

    def mended(
        self,
        turn: Turn,
        before: Memory,
        flow: Memory,
        after: Memory,
        rates: Callable[[Scalar, Scalar, Memory], Memory],
    ) -> tuple[Memory, Memory]:
        """States at the turn, and at the end of the step, corrected for the error of the integrator at a turn. A law of paths
        needs no correction: its force at the turn follows from the committed states.

        Arguments:
            turn: the step; without a turn, both are the states at the end.
            before, after: states at the start and at the end of the step, as integrated.
            flow: rates at the start.
            rates: from elongation [m], rate [m/s] and states to the rates, effects included.
        """
        del turn, before, flow, rates
        return after, after


class AbstractYieldingLaw(AbstractSpringLaw):
    """A law of paths with a stiffness and a yield force."""

    steepest: ClassVar[Mapping[str, float]] = {"k": 0.999}

    k: Scalar = parameter("k", "N/m", "initial stiffness", lower=0.0)
    F_y: Scalar = parameter("F_y", "N", "yield force", lower=0.0)

    @property
    def stiffness(self) -> Scalar:
        """Stiffness before yielding [N/m]."""
        return self.k

    @property
    def strength(self) -> Scalar:
        """The yield force [N]."""
        return self.F_y

    @property
    def steepness(self) -> Scalar:
        """None: its force follows from the path, however long a step is."""
        return 0.0


def still(*names: str) -> Memory:
    """States that are zero in a virgin element."""
    return {name: jnp.zeros(()) for name in names}
