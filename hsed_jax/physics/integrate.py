"""One experiment integrated by diffrax: a lean Runge–Kutta step, peaks of the continuous response, sampled channels.

diffrax's own Runge–Kutta classes store every stage; at six states and a thousand steps that costs twenty times the
arithmetic.  `RungeKutta4` keeps nothing.  The independent variable of the integration is the *step number*, so that uneven
sampling is a table of step lengths, and a padded step has length zero.

The loop over the steps uses diffrax's interface for manual steps.  `diffeqsolve` serves adaptive steps: with its comparisons of
times, a program takes a quarter to four fifths longer to compile.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from operator import itemgetter
from typing import Any, ClassVar, NamedTuple, cast, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from hsed_jax.physics.excitations import AbstractForcing
from hsed_jax.physics.laws.base import Memory, Turn
from hsed_jax.physics.names import of_each, own_name, owner_of
from hsed_jax.physics.outputs import EQ_18, quantity
from hsed_jax.physics.response import Response
from hsed_jax.physics.steps import Step
from hsed_jax.physics.systems import RESOLVED, AbstractSystem, State

Scalar = Float[Array, ""] | float


class Progress(NamedTuple):
    """The values that travel through the integration.

    Attributes:
        state: at the end of the last step.
        kept: the numbers of the quantities (`hsed_jax.physics.outputs.Kept`), by name.
        channels: at the end of the last step.
    """

    state: State
    kept: dict[str, tuple[Scalar, ...]]
    channels: dict[str, Scalar]


_Carry = tuple[Progress, Any]
"""Values that travel, and the state of the solver."""


@final
class RungeKutta4(diffrax.AbstractSolver[Any]):
    """The classical fourth-order Runge–Kutta method with a forcing that is known at the ends and the middle of the step.

    After each step it looks for a reversal inside it, a zero of Δu̇, where a hysteretic spring has its peaks, and updates the
    peaks there instead of on the grid.  With θ ∈ (0, 1) the zero of the linear Δu̇, the peak elongation is the cubic Hermite
    interpolant of Δu at θ.  The spring law then acts: a law that integrates its force corrects the kink
    (`hsed_jax.physics.laws.reversal`), and a law of paths commits its states there.  This allows four times longer steps.
    """

    term_structure: ClassVar = diffrax.ODETerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    forcing: AbstractForcing
    step_length: Float[Array, "..."] | float
    channel_names: tuple[str, ...] = eqx.field(static=True)

    def order(self, terms: Any) -> int:
        """The order of the method: four."""
        return 4

    def init(self, terms: Any, t0: Any, t1: Any, y0: Progress, args: Any) -> Any:
        """The forcing at the start."""
        return self.forcing.start()

    def func(self, terms: Any, t0: Any, y0: Progress, args: Any) -> Any:
        """The vector field at the start of a step."""
        return terms.vf(t0, y0, args)

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Progress, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Progress, None, dict[str, Progress], tuple[Any, Any], diffrax.RESULTS]:
        """One step from step number `t0` to `t1 = t0 + 1`."""
        del made_jump
        system, *_ = args
        number = jnp.asarray(t0, int)
        lengths = jnp.asarray(self.step_length)
        h = lengths if lengths.ndim == 0 else lengths[number]
        carry, first = solver_state
        carry, middle = self.forcing.advance(carry, 2 * number + 1)
        carry, last = self.forcing.advance(carry, 2 * number + 2)

        def flow_of(state: State, sample: Any) -> State:
            return terms.vf(t0, y0._replace(state=state), (system, sample, h)).state

        def stage(state: State, given: tuple[Any, Scalar]) -> tuple[State, tuple[State, State]]:
            sample, length = given
            rates = flow_of(state, sample)

            def moved(y: Scalar, k: Scalar) -> Scalar:
                return y + length * k

            return _kept(jax.tree.map(moved, start, rates)), (state, rates)

        def stacked(*leaves: Array) -> Array:
            return jnp.stack(leaves)

        def array(leaf: Scalar) -> Array:
            return jnp.asarray(leaf)

        start: State = jax.tree.map(array, y0.state)
        stages = (jax.tree.map(stacked, first, middle, middle, last), h * jnp.asarray([0.5, 0.5, 1.0, 0.0]))
        # A program of the whole catalogue has the stage once, as a loop: it compiles in two thirds of the time.
        _, found = jax.lax.scan(stage, start, stages, unroll=1 if any(one.is_gated for one in system.specimens) else 4)
        (_, flow), (second, _), (third, _), (fourth, final) = (jax.tree.map(itemgetter(i), found) for i in range(4))

        # From the states of the stages, which are stored, so that their rates need not be stored: a step of many
        # simulations takes as long as its loads and stores.  In this order the sum is exactly 4y if the step has no length.
        def ended(y: Scalar, b: Scalar, c: Scalar, d: Scalar, k: Scalar) -> Scalar:
            return y + (b + d + 2 * c - 4 * y) / 3 + h / 6 * k

        end: State = jax.tree.map(ended, start, second, third, fourth, final)

        # The rates of displacements are the velocities of the stages themselves.
        def displaced(y: Scalar, a: Scalar, b: Scalar, c: Scalar, d: Scalar) -> Scalar:
            return y + h / 6 * (a + 2 * (b + c) + d)

        velocities = (state.velocity for state in (start, second, third, fourth))
        end = end._replace(displacement=jax.tree.map(displaced, start.displacement, *velocities))
        end = jax.lax.optimization_barrier(end)
        end, turns = _turned(system, (start, first), (end, last), flow, h)

        # The two stages have errors of h²/8 ÿ with opposite signs.
        def mean(b: Scalar, c: Scalar) -> Scalar:
            return 0.5 * (b + c)

        halfway: State = jax.tree.map(mean, second, third)
        passed = Step(system, (start, first), (halfway, middle), (end, last), h, turns)
        kept = {
            name: quantity(name).kept.after(before, passed._replace(specimen=_place(system, name)))
            for name, before in y0.kept.items()
        }
        y1 = Progress(end, kept, system.channels(end, last, self.channel_names))
        return y1, None, {"y0": y0, "y1": y1}, (carry, last), diffrax.RESULTS.successful


def _kept(state: State) -> State:
    """The state of a stage, written to memory.  Without the barrier XLA computes it again for every use.

    Recomputing its displacement is cheaper than storing it.
    """
    velocity, memory = jax.lax.optimization_barrier((state.velocity, state.memory))
    return State(state.displacement, velocity, memory)


def _turned(
    system: AbstractSystem, before: tuple[State, Any], after: tuple[State, Any], flow: State, h: Scalar
) -> tuple[State, tuple[tuple[Scalar, Scalar], ...]]:
    """The state after a step with possible reversals, and force and elongation of each specimen at its reversal (otherwise at
    the end).

    `flow` are the rates at the start of the step.
    """
    memories: list[Memory] = []
    turns: list[tuple[Scalar, Scalar]] = []
    for i, (specimen, first, last) in enumerate(
        zip(system.specimens, system.kinematics(*before), system.kinematics(*after), strict=True)
    ):
        turn = _turn(first, last, h)
        memory, force = specimen.turned(turn, before[0].memory[i], flow.memory[i], after[0].memory[i])
        memories.append(memory)
        turns.append((force, turn.elongation))
    return after[0]._replace(memory=tuple(memories)), tuple(turns)


def _turn(first: tuple[Scalar, Scalar], last: tuple[Scalar, Scalar], h: Scalar) -> Turn:
    """The reversal of a specimen within a step, if any, from its elongation [m] and rate [m/s] at both ends."""
    (du0, v0), (du1, v1) = first, last
    turns = v0 * v1 < 0
    theta = jax.lax.optimization_barrier(jnp.where(turns, v0 / jnp.where(turns, v0 - v1, 1.0), 1.0))
    turns, rest = theta < 1, 1 - theta
    # The cubic in powers of 1 − θ: exactly Δu₁ without a reversal.
    back, curvature = du0 - du1, 2 * (du0 - du1) + h * (v0 + v1)
    elongation = du1 + rest * (rest * (back + curvature + h * v1 - rest * curvature) - h * v1)
    elongation = jax.lax.optimization_barrier(elongation)
    return Turn(turns, h, theta, du0, elongation, v0, v1)


def _place(system: AbstractSystem, name: str) -> int:
    """Index of the specimen that a quantity is of."""
    owner, _ = owner_of(name), own_name(name)
    return system.names.index(owner) if owner else 0


def integrate(
    system: AbstractSystem,
    forcing: AbstractForcing,
    step_length: Float[Array, "..."] | float,
    steps: int,
    *,
    channels: tuple[str, ...] = (),
    quantities: tuple[str, ...] = (),
    every: int = 1,
    stop: Int[Array, ""] | None = None,
) -> Response:
    """Integrate one experiment, differentiable in forward mode, and without `stop` in reverse mode, too.

    Arguments:
        system: the integrated one.
        forcing: the excitation on the half-step grid.
        step_length: [s], one number or one per step, shape (steps,).
        steps: number of steps.
        channels: names of the histories to keep.
        quantities: names of quantities to compute besides those of Eq. 18.
        every: number of steps between kept samples of the histories (t = 0 is kept, too); divides `steps`.
        stop: steps to make, at most `steps`, rounded up to a kept sample; samples of histories after them are the last one.

    Returns:
        The response, with histories of shape (steps // every + 1,); not ok where numbers overflow, or where the steps are too
        long for the spring.
    """
    solver, terms = RungeKutta4(forcing, step_length, channels), diffrax.ODETerm(_vector_field)
    _, sample = forcing.start()
    args = (system, sample, 0.0)
    still = system.start()
    names = (*of_each(system.measured, EQ_18), *quantities)
    begin: dict[str, tuple[Scalar, ...]] = {name: quantity(name).kept.start for name in names}
    start = Progress(still, begin, system.channels(still, sample, channels))

    def array(leaf: Any) -> Array:
        return jnp.asarray(leaf)

    def step(number: Any, carry: _Carry) -> _Carry:
        progress, solver_state = carry
        progress, _, _, solver_state, _ = solver.step(terms, number, number + 1, progress, args, solver_state, False)
        return progress, solver_state

    def next_sample(number: Any, carry: tuple[_Carry, dict[str, Array]]) -> tuple[_Carry, dict[str, Array]]:
        inner, histories = carry

        def within(k: Any, inner: _Carry) -> _Carry:
            return step(every * number + k, inner)

        inner = cast(_Carry, jax.lax.fori_loop(0, every, within, inner)) if every > 1 else step(number, inner)
        return inner, {name: kept.at[number + 1].set(inner[0].channels[name]) for name, kept in histories.items()}

    carry: _Carry = jax.tree.map(array, (start, solver.init(terms, 0, 1, start, args)))
    samples = steps // every
    histories = {name: jnp.zeros(samples + 1).at[0].set(value) for name, value in carry[0].channels.items()}
    made = samples if stop is None else -(-stop // every)
    found = cast(tuple[_Carry, dict[str, Array]], jax.lax.fori_loop(0, made, next_sample, (carry, histories)))
    (end, _), histories = found
    if stop is not None:
        last = jnp.minimum(jnp.arange(samples + 1), stop // every)
        histories = {name: values[last] for name, values in histories.items()}
    memory = end.state.memory
    values = {name: quantity(name).kept.value(end.kept[name], memory[_place(system, name)]) for name in names}
    finite = jnp.isfinite(sum(jnp.abs(value) for value in values.values()))
    return Response(values, histories, finite & (system.steepness(forcing, step_length) < RESOLVED))


def _none(value: Array) -> Array:
    return jnp.zeros_like(value)


def _vector_field(number: Any, progress: Progress, args: Any) -> Progress:
    system, sample, step = args
    still: Progress = jax.tree.map(_none, progress)
    return still._replace(state=system.rates(progress.state, sample, step))
