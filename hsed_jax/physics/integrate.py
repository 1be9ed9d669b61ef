"""One experiment integrated: a lean Runge–Kutta step, counted, peaks of the continuous response, sampled channels.

Steps are counted and not timed, so that uneven sampling is a table of step lengths, and a padded step has length zero.  The loop
is JAX's own: a solver of differential equations in general takes half as long again to compile, for choices that are made here.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from hsed_jax.physics.excitations import AbstractForcing
from hsed_jax.physics.laws.base import Turn
from hsed_jax.physics.outputs import EQ_18, of_each, own_name, owner_of, quantity
from hsed_jax.physics.response import Response
from hsed_jax.physics.steps import Step
from hsed_jax.physics.systems import RESOLVED, AbstractSystem, State

Scalar = Float[Array, ""] | float


class Progress(NamedTuple):
    """What travels through the integration.

    Attributes:
        state: at the end of the last step.
        kept: what the quantities keep (`hsed_jax.physics.outputs.Kept`), by name.
        forcing: what the excitation carries along.
        sample: of the excitation, at the end of the last step.
    """

    state: State
    kept: dict[str, tuple[Scalar, ...]]
    forcing: PyTree
    sample: Any


def integrate(
    system: AbstractSystem,
    forcing: AbstractForcing,
    step_length: Float[Array, "..."] | float,
    steps: int,
    *,
    channels: tuple[str, ...] = (),
    quantities: tuple[str, ...] = (),
    every: int = 1,
) -> Response:
    """Integrate one experiment.  Its derivatives are exact in forward and in reverse mode.

    Arguments:
        system: what is integrated.
        forcing: the excitation on the half-step grid.
        step_length: [s], one number or one per step, shape (steps,).
        steps: number of steps.
        channels: names of the histories to keep.
        quantities: names of those to keep beside the ones of Eq. 18.
        every: keep the histories at every so many steps (and at t = 0); divides `steps`.

    Returns:
        The response, with histories of shape (steps // every + 1,); not ok where numbers overflow, or where the steps are too
        long for the spring.
    """
    names = (*of_each(system.measured, EQ_18), *quantities)
    kept: dict[str, tuple[Scalar, ...]] = {
        name: tuple(jnp.asarray(number) for number in quantity(name).kept.start) for name in names
    }
    begin = Progress(system.start(), kept, *forcing.start())
    step = partial(_step, system, forcing, jnp.asarray(step_length))
    if channels:
        end, histories = _sampled(system, step, begin, channels, steps, every)
    else:
        end, histories = jax.lax.fori_loop(0, steps, step, begin), {}
    values = {name: quantity(name).kept.value(end.kept[name], end.state.memory[_place(system, name)]) for name in names}
    finite = jnp.isfinite(sum(jnp.abs(value) for value in values.values()))
    return Response(values, histories, finite & (system.steepness(forcing, step_length) < RESOLVED))


def _sampled(
    system: AbstractSystem, step: Any, begin: Progress, channels: tuple[str, ...], steps: int, every: int
) -> tuple[Progress, dict[str, Float[Array, " samples"]]]:
    """The end, and the channels at the start and after every so many steps."""

    def between(progress: Progress, sample: Int[Array, ""]) -> tuple[Progress, dict[str, Scalar]]:
        progress = jax.lax.fori_loop(0, every, lambda i, moved: step(sample * every + i, moved), progress)
        return progress, system.channels(progress.state, progress.sample, channels)

    end, rest = jax.lax.scan(between, begin, jnp.arange(steps // every))
    first = system.channels(begin.state, begin.sample, channels)
    return end, {name: jnp.concatenate([jnp.atleast_1d(first[name]), rest[name]]) for name in channels}


def _step(
    system: AbstractSystem, forcing: AbstractForcing, lengths: Float[Array, "..."], number: Any, before: Progress
) -> Progress:
    r"""One step of the classical fourth-order Runge–Kutta method, the forcing known at its ends and in its middle.

    Afterwards it looks for a reversal inside the step, a zero of Δu̇, where a hysteretic spring has its peaks, and updates
    them there and not on the grid: with θ ∈ (0, 1) the zero of the linear Δu̇, the peak elongation is the cubic Hermite
    interpolant of Δu at θ.  What the spring does of it is its own: a law that integrates its force mends the kink
    (`hsed_jax.physics.laws.reversal`), a law of paths commits its states there.  This is worth a factor of four in step size.
    """
    h = lengths if lengths.ndim == 0 else lengths[number]
    carry, middle = forcing.advance(before.forcing, 2 * number + 1)
    carry, last = forcing.advance(carry, 2 * number + 2)
    start, first = before.state, before.sample

    def moved(rates: State, length: Scalar) -> State:
        return jax.tree.map(lambda y, k: y + length * k, start, rates)

    flow = system.rates(start, first, h)
    second = _kept(moved(flow, 0.5 * h))
    third = _kept(moved(system.rates(second, middle, h), 0.5 * h))
    fourth = _kept(moved(system.rates(third, middle, h), h))
    # From the states of the stages, which are kept, and not from their rates, which then need not be: a step of many
    # lanes takes as long as its loads and stores.
    end = jax.tree.map(
        lambda y, b, c, d, k: y + ((b - y) + 2 * (c - y) + (d - y)) / 3 + h / 6 * k,
        *(start, second, third, fourth, system.rates(fourth, last, h)),
    )
    end = jax.lax.optimization_barrier(end)
    end, turns = _turned(system, (start, first), (end, last), flow, h)
    # Each of the two stages is off by h²/8 ÿ, one this way and one that.
    halfway = jax.tree.map(lambda b, c: 0.5 * (b + c), second, third)
    passed = Step(system, (start, first), (halfway, middle), (end, last), h, turns)
    kept = {
        name: quantity(name).kept.after(numbers, passed._replace(specimen=_place(system, name)))
        for name, numbers in before.kept.items()
    }
    return Progress(end, kept, carry, last)


def _kept(state: State) -> State:
    """The state of a stage, written to memory: without the barrier XLA computes it again for everything that uses it.

    Its displacement is cheaper to compute again.
    """
    velocity, memory = jax.lax.optimization_barrier((state.velocity, state.memory))
    return State(state.displacement, velocity, memory)


def _turned(
    system: AbstractSystem, before: tuple, after: tuple, flow: State, h: Scalar
) -> tuple[State, tuple[tuple[Scalar, Scalar], ...]]:
    """The state after a step in which specimens may turn, and force and elongation of each at its reversal (or else the end).

    `flow` are the rates at the start of the step.
    """
    memories, turns = [], []
    for i, (specimen, first, last) in enumerate(
        zip(system.specimens, system.kinematics(*before), system.kinematics(*after), strict=True)
    ):
        turn = _turn(first, last, h)
        memory, force = specimen.turned(turn, before[0].memory[i], flow.memory[i], after[0].memory[i])
        memories.append(memory)
        turns.append((force, turn.elongation))
    return after[0]._replace(memory=tuple(memories)), tuple(turns)


def _turn(first: tuple[Scalar, Scalar], last: tuple[Scalar, Scalar], h: Scalar) -> Turn:
    """Whether and where a specimen turns, from its elongation [m] and rate [m/s] at both ends of a step."""
    (du0, v0), (du1, v1) = first, last
    turns = v0 * v1 < 0
    theta = jax.lax.optimization_barrier(jnp.where(turns, v0 / jnp.where(turns, v0 - v1, 1.0), 1.0))
    turns, rest = theta < 1, 1 - theta
    # The cubic in powers of 1 − θ: exactly Δu₁ where nothing turns.
    back, bend = du0 - du1, 2 * (du0 - du1) + h * (v0 + v1)
    elongation = du1 + rest * (rest * (back + bend + h * v1 - rest * bend) - h * v1)
    elongation = jax.lax.optimization_barrier(elongation)
    return Turn(turns, h, theta, du0, elongation, v0, v1)


def _place(system: AbstractSystem, name: str) -> int:
    """Index of the specimen that a quantity is of."""
    owner, _ = owner_of(name), own_name(name)
    return system.names.index(owner) if owner else 0
