r"""A planned component test: the elongation of the specimen is imposed in cycles of stepwise amplitudes.

$$\Delta u(t) = a_j\,\sin\frac{v\,t'}{a_j},\qquad \Delta\dot u(t) = v\,\cos\frac{v\,t'}{a_j},\qquad T_j = \frac{2\pi a_j}{v}$$

with $t'$ the time since the first cycle of amplitude $a_j$: the peak rate $v$ is the same at all amplitudes, so elongation
and rate are continuous where one amplitude follows another.  The duration depends on the amplitudes. A quarter of a cycle has
the same number of steps at every amplitude, so that every reversal is the end of a step.

The amplitudes are a study's own, or those of a published protocol (`hsed_jax.physics.protocols`).
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.physics.declared import CYCLES, CYCLIC_ELONGATION, Declared
from hsed_jax.physics.excitations.base import AbstractForcing, AbstractImposedElongation, Imposed, Scalar, Tabulated
from hsed_jax.physics.protocols import Protocol
from hsed_jax.physics.timeline import Timeline
from hsed_jax.registry import register


@register
@final
class CyclicElongation(AbstractImposedElongation):
    """Cycles of stepwise amplitudes, imposed on the specimen alone.

    Arguments:
        amplitudes: [m], in order; None with a protocol.
        rate: peak rate v [m/s].
        cycles: full cycles at each amplitude, by default 2; of a protocol None.
        protocol: a published one instead of amplitudes.
        reference: reference of the amplitudes of the protocol [m].
        steps: number of steps of the protocol, by default those of its table.
    """

    declared: ClassVar[Declared] = CYCLIC_ELONGATION

    amplitudes: tuple[Scalar, ...] | None
    rate: Scalar
    cycles: int | None = eqx.field(static=True, default=None)
    protocol: Protocol | None = eqx.field(static=True, default=None)
    reference: Scalar | None = None
    steps: int | None = eqx.field(static=True, default=None)

    @property
    def branches(self) -> int:
        """Number of quarters of a cycle, each with the same number of steps."""
        return int(self._ends[-1])

    @property
    def _levels(self) -> Float[Array, " levels"]:
        """The amplitudes in order [m]."""
        if self.protocol is None:
            return jnp.asarray(self.amplitudes)
        assert self.reference is not None
        relative = [level.amplitude for level in self.protocol.levels(self.steps)]
        return self.reference * jnp.asarray(relative)

    @property
    def _ends(self) -> np.ndarray:
        """Quarters of a cycle until the end of each amplitude."""
        if self.protocol is None:
            assert self.amplitudes is not None
            return np.cumsum([4 * (self.cycles or CYCLES)] * len(self.amplitudes))
        return np.cumsum([level.quarters for level in self.protocol.levels(self.steps)])

    @property
    def reach(self) -> Scalar:
        """The longest step of the elongation [m] times the steps of a branch: πa/2 of the largest amplitude."""
        return jnp.max(self._levels) * (0.5 * jnp.pi)

    @property
    def duration(self) -> Scalar:
        """Duration until the end of the last cycle [s]."""
        return self._starts[-1]

    @property
    def _starts(self) -> Float[Array, " levels_and_end"]:
        """The start of each amplitude, and the end [s]."""
        quarters = np.diff(self._ends, prepend=0)
        return jnp.concatenate([jnp.zeros(1), jnp.cumsum(0.5 * jnp.pi / self.rate * self._levels * quarters)])

    def step_length(self, timeline: Timeline) -> Float[Array, " steps"]:
        """Lengths of the steps [s]: those of one amplitude are equal."""
        borders = jnp.concatenate([jnp.zeros(1), jnp.asarray(self._ends, float)])
        return jnp.diff(jnp.interp(jnp.linspace(0, self.branches, timeline.steps + 1), borders, self._starts))

    def sample(self, time: Scalar) -> Imposed:
        """Elongation and rate at one instant [s]; at rest outside the protocol."""
        starts = self._starts
        level = jnp.clip(jnp.searchsorted(starts, time, side="right") - 1, 0, len(starts) - 2)
        amplitude = self._levels[level]
        phase = self.rate / amplitude * (time - starts[level])
        # The sum of all steps may exceed the end of the protocol by rounding.
        inside = (time >= 0) & (time <= starts[-1] * (1 + 1e-12))
        return Imposed(
            jnp.where(inside, amplitude * jnp.sin(phase), 0.0), jnp.where(inside, self.rate * jnp.cos(phase), 0.0)
        )

    def forcing(self, step: Float[Array, "..."] | float, steps: int) -> AbstractForcing:
        """The table of the protocol, exact at its reversals and zeros where `branches` divides `steps`."""
        branch, within = np.divmod(np.arange(2 * steps + 1) * self.branches, 2 * steps)
        turn = np.exp(0.25j * np.pi * within / steps) * np.asarray([1, 1j, -1, -1j])[branch % 4]
        ends = self._ends
        level = np.minimum(np.searchsorted(ends, branch, side="right"), len(ends) - 1)
        return Tabulated(Imposed(self._levels[level] * turn.imag, self.rate * jnp.asarray(turn.real)))
