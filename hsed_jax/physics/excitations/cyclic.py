r"""A planned component test: the elongation of the specimen is imposed in cycles of stepwise amplitudes.

$$\Delta u(t) = a_j\,\sin\frac{v\,t'}{a_j},\qquad \Delta\dot u(t) = v\,\cos\frac{v\,t'}{a_j},\qquad T_j = \frac{2\pi a_j}{v}$$

with $t'$ the time since the first cycle of amplitude $a_j$: the peak rate $v$ is the same at all amplitudes, so elongation and
rate are continuous where one amplitude follows another.  How long it lasts depends on the amplitudes; a quarter of a cycle has
the same number of steps at each of them, so that every reversal is the end of a step.

Source of the sequence, two cycles at each of growing amplitudes: FEMA 461 (2007), Section 2.8.
"""

from typing import ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.physics.declared import CYCLIC_ELONGATION, Declared
from hsed_jax.physics.excitations.base import AbstractForcing, AbstractImposedElongation, Imposed, Scalar, Tabulated
from hsed_jax.physics.timeline import Timeline


@final
class CyclicElongation(AbstractImposedElongation):
    """Cycles of stepwise amplitudes, imposed on the specimen alone.

    Arguments:
        amplitudes: [m], in order.
        rate: peak rate v [m/s].
        cycles: full cycles at each amplitude.
    """

    declared: ClassVar[Declared] = CYCLIC_ELONGATION

    amplitudes: tuple[Scalar, ...]
    rate: Scalar
    cycles: int = eqx.field(static=True, default=CYCLIC_ELONGATION.default("cycles"))

    @property
    def branches(self) -> int:
        """Quarters of a cycle, of which each has the same number of steps."""
        return 4 * self.cycles * len(self.amplitudes)

    @property
    def reach(self) -> Scalar:
        """The longest step of the elongation [m] times the steps of a branch: πa/2 of the largest amplitude."""
        return jnp.max(jnp.asarray(self.amplitudes)) * (0.5 * jnp.pi)

    @property
    def duration(self) -> Scalar:
        """Until the last cycle is closed [s]."""
        return self._starts[-1]

    @property
    def _periods(self) -> Float[Array, " levels"]:
        return 2 * jnp.pi / self.rate * jnp.asarray(self.amplitudes)

    @property
    def _starts(self) -> Float[Array, " levels_and_end"]:
        """When each amplitude begins, and the end [s]."""
        return jnp.concatenate([jnp.zeros(1), self.cycles * jnp.cumsum(self._periods)])

    def step_length(self, timeline: Timeline) -> Float[Array, " steps"]:
        """Lengths of the steps [s]: those of one amplitude are equal."""
        levels = len(self.amplitudes)
        ends = jnp.interp(jnp.linspace(0, levels, timeline.steps + 1), jnp.arange(levels + 1.0), self._starts)
        return jnp.diff(ends)

    def sample(self, time: Scalar) -> Imposed:
        """Elongation and rate at one instant [s]; at rest outside the protocol."""
        starts = self._starts
        level = jnp.clip(jnp.searchsorted(starts, time, side="right") - 1, 0, len(self.amplitudes) - 1)
        amplitude = jnp.asarray(self.amplitudes)[level]
        phase = self.rate / amplitude * (time - starts[level])
        # A sum of steps that ends with the protocol may do so some rounding later.
        inside = (time >= 0) & (time <= starts[-1] * (1 + 1e-12))
        return Imposed(
            jnp.where(inside, amplitude * jnp.sin(phase), 0.0), jnp.where(inside, self.rate * jnp.cos(phase), 0.0)
        )

    def forcing(self, step: Float[Array, " steps"], steps: int) -> AbstractForcing:
        """The table of the protocol, exact at its reversals and zeros where `branches` divides `steps`."""
        branch, within = np.divmod(np.arange(2 * steps + 1) * self.branches, 2 * steps)
        turn = np.exp(0.25j * np.pi * within / steps) * np.asarray([1, 1j, -1, -1j])[branch % 4]
        level = np.minimum(branch // (4 * self.cycles), len(self.amplitudes) - 1)
        return Tabulated(Imposed(jnp.asarray(self.amplitudes)[level] * turn.imag, self.rate * jnp.asarray(turn.real)))
