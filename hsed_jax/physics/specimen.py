r"""The specimen: a spring law with any number of effects around it.

$$r = f(\Delta u, \text{states}) + \sum \text{force},\qquad \dot e = r\,\Delta\dot u$$

with f the force of the element of the law, to whose slots effects write, and `force` their contribution beside it.  Inside a
slack s there is no force; beyond it, the elongation of the element is the elongation minus the slack,
$\Delta u - \mathrm{clip}(\Delta u, -s, s)$.  An integration may cross a slack in a step: force and flow of the element are
then multiplied by the share of the step outside the slack.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterable, Mapping
from functools import partial
from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool

from hsed_jax.physics.effects.base import (
    AbstractEffect,
    AbstractSpringEffect,
    SpringPoint,
    combine,
    merged,
    neutral,
)
from hsed_jax.physics.effects.forms import slots_of, slots_of_any
from hsed_jax.physics.effects.shaped import kind_of
from hsed_jax.physics.gates import Contributor, gated, gathered, in_any_simulation
from hsed_jax.physics.laws.base import AbstractSpringLaw, Memory, Scalar, Slots, Turn
from hsed_jax.physics.scales import Scales, is_zero
from hsed_jax.physics.states import SharedState

ALWAYS = ("force", "slack")
"""Slots of every specimen, for any law."""


@final
class Specimen(eqx.Module):
    """A spring with effects.

    Arguments:
        law: of its element.
        effects: their order does not matter.
        scales: characteristic values for the effects.
        acting: whether each effect acts, the same for all specimens that run together; None: all do.

    Raises:
        ValueError: an effect writes to a slot that the law does not serve (when something is computed with it).
    """

    law: AbstractSpringLaw
    effects: tuple[AbstractSpringEffect, ...] = ()
    scales: Scales = Scales()
    acting: tuple[Bool[Array, ""], ...] | None = None

    @property
    def is_gated(self) -> bool:
        """Whether it may have any of several sets of effects."""
        return self.acting is not None

    def start(self) -> Memory:
        """The states of a virgin spring: those of the law, absorbed energy e [J], and those that effects need or have."""
        names = ["energy", *(state.name for state in self._shared), *(s for e in self.effects for s in e.states)]
        return {**self.law.start(), **{name: jnp.zeros(()) for name in names}}

    def force(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Scalar:
        """Restoring force r [N] at elongation Δu [m] and its rate [m/s]."""
        point = self._point(elongation, rate, memory)
        return self._force(point, self._slots(point))[0]

    def rates(self, elongation: Scalar, rate: Scalar, memory: Memory) -> Memory:
        """Time derivatives of the states."""
        return self.force_and_rates(elongation, rate, memory)[1]

    def force_and_rates(
        self, elongation: Scalar, rate: Scalar, memory: Memory, step: Scalar = 0.0
    ) -> tuple[Scalar, Memory]:
        """Restoring force r [N] and time derivatives of the states; averages over a step [s] for values that jump within it."""
        point = self._point(elongation, rate, memory)
        slots = self._slots(point)
        flow = self.law.flow(_beyond(elongation, slots), rate, memory, slots)
        flow = {name: _outside(point, slots, value, step) for name, value in flow.items()}
        force, point = self._force(point, slots, step)
        rates = {name: jnp.zeros_like(value) for name, value in memory.items()}
        rates |= {**flow, "energy": force * rate}
        rates |= {state.name: state.rate(elongation, rate) for state in self._shared if state.rate is not None}
        flows = [Contributor(lambda e=effect: e.states, partial(effect.flow, point)) for effect in self.effects]
        rates |= gathered(flows, self.acting, _joined, lambda state: 0.0)
        return force, rates

    def settle(self, elongation: Scalar, rate: Scalar, memory: Memory, turned: Bool[Array, ""]) -> Memory:
        """The states after a step that ends at this elongation [m] with this rate [m/s], or turns there."""
        point = self._point(elongation, rate, memory)
        slots = self._slots(point)
        committed = self.law.settle(_beyond(elongation, slots), memory, slots)
        kept = {s.name: s.settled(memory[s.name], elongation, turned) for s in self._shared if s.settled is not None}
        # A law of paths commits the present force of the element.
        point = point._replace(hysteretic=committed.get("hysteretic", point.hysteretic))
        settled = [Contributor(lambda e=effect: e.states, partial(effect.settle, point)) for effect in self.effects]
        return {**memory, **committed, **kept, **gathered(settled, self.acting, _joined, memory.__getitem__)}

    def turned(self, turn: Turn, before: Memory, flow: Memory, after: Memory) -> tuple[Memory, Scalar]:
        """The states after a step with a possible reversal, and the force at the reversal (otherwise at the end) [N].

        Arguments:
            turn: the step.
            before, after: states at its ends, as integrated.
            flow: rates at its start.
        """
        turns = in_any_simulation(turn.happens) if self.is_gated else None
        mended = partial(self.law.mended, turn, before, flow, after, self.rates)
        at_turn, at_end = gated(turns, mended, lambda: (after, after))
        rate = jnp.where(turn.happens, 0.0, turn.after)
        return self.settle(turn.elongation, rate, at_end, turn.happens), self.force(turn.elongation, rate, at_turn)

    @property
    def _shared(self) -> tuple[SharedState, ...]:
        return tuple(dict.fromkeys(state for effect in self.effects for state in effect.needs))

    def _point(self, elongation: Scalar, rate: Scalar, memory: Memory) -> SpringPoint:
        return SpringPoint(
            elongation, rate, memory["hysteretic"], memory, self.scales, self.law.yardstick, self.law.stiffness
        )

    def _slots(self, point: SpringPoint) -> Slots:
        def written(effect: AbstractSpringEffect) -> Mapping[str, Scalar]:
            contribution = effect.contribute(point)
            if missing := _missing(contribution, type(self.law)):
                raise ValueError(f"{kind_of(effect).name}: {missing}")
            return contribution

        parts = [
            Contributor(partial(slots_of_any, kind_of(effect)), partial(written, effect)) for effect in self.effects
        ]
        return combine([gathered(parts, self.acting, merged, neutral)])

    def _force(self, point: SpringPoint, slots: Slots, step: Scalar = 0.0) -> tuple[Scalar, SpringPoint]:
        """Restoring force, and the point with the present force of the element."""
        element = self.law.force(_beyond(point.elongation, slots), point.memory, slots)
        if element is not point.hysteretic:
            # A law of paths has its force only now; forces beside it may depend on it.
            point = point._replace(hysteretic=element)
            slots = self._slots(point)
        return _outside(point, slots, element, step) + slots("force"), point


def _joined(parts: Iterable[Mapping[str, Scalar]]) -> dict[str, Scalar]:
    return {name: value for part in parts for name, value in part.items()}


def unserved(effect: type[AbstractEffect], law: type[AbstractSpringLaw], form: str | None = None) -> str:
    """The reason why a law cannot have an effect in a form (by default the default one); empty if it can."""
    return _missing(slots_of(effect, form), law) if issubclass(effect, AbstractSpringEffect) else ""


def _missing(written: Iterable[str], law: type[AbstractSpringLaw]) -> str:
    served = (*ALWAYS, *law.slots)
    missing = [slot for slot in written if slot not in served]
    if not missing:
        return ""
    return (
        f"it writes to the slot {missing[0]}, which the law {law.name} does not have; its slots are {', '.join(served)}"
    )


def _beyond(elongation: Scalar, slots: Slots) -> Scalar:
    """The elongation of the element behind the slack."""
    slack = slots("slack")
    return elongation if is_zero(slack) else elongation - jnp.clip(elongation, -slack, slack)


def _outside(point: SpringPoint, slots: Slots, value: Scalar, step: Scalar) -> Array | Scalar:
    """A value of the element, zero inside the slack: multiplied by the share of a step around this instant that is outside."""
    slack = slots("slack")
    if is_zero(slack):
        return value
    u, half = point.elongation, 0.5 * jnp.abs(point.rate) * step
    inside = jnp.maximum(jnp.minimum(u + half, slack) - jnp.maximum(u - half, -slack), 0.0)
    passed = 1 - inside / jnp.where(half > 0, 2 * half, 1.0)
    return value * jnp.where(half > 0, passed, jnp.abs(u) >= slack)
