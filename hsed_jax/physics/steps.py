"""One step of an integration, for the quantities."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.systems import AbstractSystem, State

Scalar = Float[Array, ""] | float


class Step(NamedTuple):
    """A step; each property is computed when a quantity asks for it.

    Attributes:
        system: the integrated one.
        start, middle, end: the state and the sample of the excitation at these times.
        length: h [s]; zero of a padded step.
        turns: force [N] and elongation [m] of every specimen at its reversal within the step, otherwise at the end.
        specimen: index of the requested one.
    """

    system: AbstractSystem
    start: tuple[State, Any]
    middle: tuple[State, Any]
    end: tuple[State, Any]
    length: Scalar
    turns: tuple[tuple[Scalar, Scalar], ...]
    specimen: int = 0

    @property
    def force(self) -> Scalar:
        """[N] at the reversal within the step, or else at its end."""
        return self.turns[self.specimen][0]

    @property
    def elongation(self) -> Scalar:
        """[m] at the same place."""
        return self.turns[self.specimen][1]

    @property
    def last_elongation(self) -> Scalar:
        """Elongation at the end of the step [m]."""
        return self.system.kinematics(*self.end)[self.specimen][0]

    @property
    def absolute_acceleration(self) -> Scalar:
        """Largest absolute acceleration of any mass [m/s²]: the peak of a parabola through start, middle and end."""
        masses = range(1, len(self.start[0].displacement) + 1)
        names = tuple(f"acceleration_{mass}_absolute" for mass in masses)
        first, middle, last = (self.system.channels(*at, names) for at in (self.start, self.middle, self.end))
        return jnp.max(jnp.stack([_peak(first[name], middle[name], last[name]) for name in names]))

    @property
    def peak_energy(self) -> Scalar:
        """Largest work within the step [J]: the peak of a parabola through start, middle and end."""
        begin, end = (state.memory[self.specimen]["energy"] for state, _ in (self.start, self.end))
        return _peak(begin, self.energy(0.5 * self.length), end)

    def energy(self, elapsed: Scalar) -> Scalar:
        """Work [J] until a time [s] after the start of the step; the work at its end if the time is later."""
        share = jnp.clip(elapsed / jnp.where(self.length == 0, 1.0, self.length), 0.0, 1.0)
        begin, end = (state.memory[self.specimen]["energy"] for state, _ in (self.start, self.end))
        powers = (self._power(*self.start), self._power(*self.end))
        rest = 1 - share
        return (
            begin * (rest * rest * (1 + 2 * share))
            + end * (share * share * (3 - 2 * share))
            + self.length * share * rest * (rest * powers[0] - share * powers[1])
        )

    def _power(self, state: State, sample: Any) -> Scalar:
        """Power that the specimen takes [W]."""
        elongation, rate = self.system.kinematics(state, sample)[self.specimen]
        return self.system.specimens[self.specimen].force(elongation, rate, state.memory[self.specimen]) * rate


def _peak(first: Scalar, middle: Scalar, last: Scalar) -> Scalar:
    """Largest magnitude of the parabola through three values, at the end of a step or within it."""
    slope, curvature = 4 * middle - 3 * first - last, 2 * (first - 2 * middle + last)
    turns = jnp.where(curvature == 0, 0.0, -slope / jnp.where(curvature == 0, 1.0, 2 * curvature))
    inside = (turns > 0) & (turns < 1)
    return jnp.maximum(jnp.abs(last), jnp.where(inside, jnp.abs(first + 0.5 * slope * turns), 0.0))
