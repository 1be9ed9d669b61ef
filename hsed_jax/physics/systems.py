"""The system that is integrated: specimens in a shaken structure, or one specimen with an imposed elongation.

The state is a pytree of scalars.  Under `vmap` every component becomes one array over the batch, and XLA turns a whole
Runge–Kutta stage into one loop over it.  A stacked state vector is six times slower.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

import functools
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.excitations import AbstractForcing, Imposed, Tabulated, channels_of, driven
from hsed_jax.physics.laws.base import Memory
from hsed_jax.physics.names import named, spring_name
from hsed_jax.physics.specimen import Specimen
from hsed_jax.physics.structures import End, Spring, Structure, difference

Scalar = Float[Array, ""] | float

# Largest steepness of a system at its steps for which a response is accepted; at 2.8 the Runge–Kutta method is unstable.
RESOLVED = 2.0


class State(NamedTuple):
    """Displacements [m] and velocities [m/s] relative to the ground, and the memory of each specimen."""

    displacement: tuple[Scalar, ...]
    velocity: tuple[Scalar, ...]
    memory: tuple[Memory, ...]


class AbstractSystem(eqx.Module):
    """An initial-value problem for one experiment.

    Attributes:
        specimens: the springs with a memory.
        names: of the specimens; that of the only one is empty.
        measured: names of those that have sensors.
    """

    specimens: eqx.AbstractVar[tuple[Specimen, ...]]
    names: eqx.AbstractVar[tuple[str, ...]]
    measured: eqx.AbstractVar[tuple[str, ...]]

    @abstractmethod
    def start(self) -> State:
        """The state at rest."""

    @abstractmethod
    def rates(self, state: State, sample: Any, step: Scalar = 0.0) -> State:
        """Time derivative of the state under one sample of the excitation; values that jump within a step [s] are averaged."""

    @abstractmethod
    def kinematics(self, state: State, sample: Any) -> tuple[tuple[Scalar, Scalar], ...]:
        """Elongation of every specimen [m] and its rate [m/s]."""

    @abstractmethod
    def channels(self, state: State, sample: Any, names: tuple[str, ...]) -> dict[str, Scalar]:
        """The named channels (`hsed_jax.physics.outputs`) at one instant, SI units."""

    @abstractmethod
    def steepness(self, forcing: AbstractForcing, step_length: Float[Array, "..."] | float) -> Scalar:
        """The longest step times the fastest rate of the virgin specimens."""

    def _specimen_channels(self, state: State, sample: Any) -> dict[str, Scalar]:
        values: dict[str, Scalar] = {}
        moved = self.kinematics(state, sample)
        for name, specimen, (elongation, rate), memory in zip(
            self.names, self.specimens, moved, state.memory, strict=True
        ):
            values |= {
                named(name, "elongation"): elongation,
                named(name, "elongation_rate"): rate,
                named(name, "force"): specimen.force(elongation, rate, memory),
                named(name, "energy"): memory["energy"],
            }
        return values


@final
class ShakenStructure(AbstractSystem):
    """The structure with its specimens in it, driven by a ground acceleration [m/s²], by forces on masses, or both.

    Arguments:
        structure: masses and springs, and where the specimens sit.
        specimens: the spring laws with their effects, in the order of the structure.
        names: of the specimens; that of the only one is empty.
        damping: C [N·s/m], shape (m, m); None: that of the structure.
        yielding: linear springs of the structure that are specimens here, by their index: they have no sensors.
    """

    structure: Structure
    specimens: tuple[Specimen, ...]
    damping: tuple[tuple[Scalar, ...], ...]
    names: tuple[str, ...] = eqx.field(static=True)
    measured: tuple[str, ...] = eqx.field(static=True)
    _places: tuple[tuple[End, End], ...] = eqx.field(static=True)
    _linear: tuple[Spring, ...]

    def __init__(
        self,
        structure: Structure,
        specimens: Sequence[Specimen],
        names: Sequence[str] = ("",),
        damping: Float[Array, "m m"] | None = None,
        yielding: Mapping[int, Specimen] | None = None,
    ):
        softer = yielding or {}
        self.structure = structure
        self.specimens = (*specimens, *softer.values())
        self.names = (*names, *(spring_name(i) for i in softer))
        self.measured = tuple(names)
        self._places = (*structure.specimens, *(structure.springs[i].ends for i in softer))
        self._linear = tuple(spring for i, spring in enumerate(structure.springs) if i not in softer)
        matrix = structure.damping_matrix() if damping is None else damping
        count = len(structure.masses)
        self.damping = tuple(tuple(matrix[i, j] for j in range(count)) for i in range(count))

    def start(self) -> State:
        """The state at rest."""
        still = tuple(jnp.zeros(()) for _ in self.structure.masses)
        return State(still, still, tuple(specimen.start() for specimen in self.specimens))

    def rates(self, state: State, sample: Any, step: Scalar = 0.0) -> State:
        """ü = −M⁻¹(C u̇ + K u + Σ b r − p) − a_g, and the specimens' own rates."""
        moved = [
            specimen.force_and_rates(*motion, memory, step)
            for specimen, motion, memory in zip(
                self.specimens, self.kinematics(state, sample), state.memory, strict=True
            )
        ]
        forces, rates = zip(*moved, strict=True)
        return State(state.velocity, self._accelerations(state, sample, forces), rates)

    def kinematics(self, state: State, sample: Any) -> tuple[tuple[Scalar, Scalar], ...]:
        """Elongation of every specimen [m] and its rate [m/s]."""
        return tuple((difference(state.displacement, ends), difference(state.velocity, ends)) for ends in self._places)

    def channels(self, state: State, sample: Any, names: tuple[str, ...]) -> dict[str, Scalar]:
        """The named channels at one instant, SI units."""
        ground, _ = driven(sample)
        values = {"ground_acceleration": ground, **channels_of(sample), **self._specimen_channels(state, sample)}
        forces = [values[named(name, "force")] for name in self.names]
        for i, acceleration in enumerate(self._accelerations(state, sample, forces)):
            values[f"displacement_{i + 1}"] = state.displacement[i]
            values[f"velocity_{i + 1}"] = state.velocity[i]
            values[f"acceleration_{i + 1}"] = acceleration
            values[f"acceleration_{i + 1}_absolute"] = acceleration + ground
        return {name: jnp.asarray(values[name]) for name in names}

    def steepness(self, forcing: AbstractForcing, step_length: Float[Array, "..."] | float) -> Scalar:
        """The longest step times the frequency of the fastest specimen between the masses at its ends."""
        squares = [
            specimen.law.stiffness * sum((1 / self.structure.masses[end] for end in ends if end is not None), start=0.0)
            for specimen, ends in zip(self.specimens, self._places, strict=True)
        ]
        return jnp.max(jnp.asarray(step_length)) * jnp.sqrt(functools.reduce(jnp.maximum, squares))

    def _accelerations(self, state: State, sample: Any, forces: Sequence[Scalar]) -> tuple[Scalar, ...]:
        ground, pushed = driven(sample)
        pushes: list[Scalar] = [0.0] * len(self.structure.masses)
        for mass, applied in pushed.items():
            pushes[mass] = pushes[mass] - applied
        for ends, value in (
            *((s.ends, s.stiffness * difference(state.displacement, s.ends)) for s in self._linear),
            *zip(self._places, forces, strict=True),
        ):
            first, second = ends
            if first is not None:
                pushes[first] = pushes[first] - value
            if second is not None:
                pushes[second] = pushes[second] + value
        return tuple(
            -(sum(c * v for c, v in zip(row, state.velocity, strict=True)) + push) * (1 / mass) - ground
            for row, push, mass in zip(self.damping, pushes, self.structure.masses, strict=True)
        )


@final
class DrivenSpring(AbstractSystem):
    """The specimen alone, its elongation imposed (a component test); samples are `Imposed`."""

    specimens: tuple[Specimen, ...]
    names: tuple[str, ...] = eqx.field(static=True, default=("",))
    measured: tuple[str, ...] = eqx.field(static=True, default=("",))

    def start(self) -> State:
        """The virgin spring."""
        return State((), (), (self._specimen.start(),))

    def rates(self, state: State, sample: Imposed, step: Scalar = 0.0) -> State:
        """The spring's own rates."""
        _, rates = self._specimen.force_and_rates(sample.elongation, sample.rate, state.memory[0], step)
        return State((), (), (rates,))

    def kinematics(self, state: State, sample: Imposed) -> tuple[tuple[Scalar, Scalar], ...]:
        """The imposed elongation [m] and its rate [m/s]."""
        return ((sample.elongation, sample.rate),)

    def channels(self, state: State, sample: Imposed, names: tuple[str, ...]) -> dict[str, Scalar]:
        """The named channels at one instant, SI units."""
        values = self._specimen_channels(state, sample)
        return {name: jnp.asarray(values[name]) for name in names}

    def steepness(self, forcing: AbstractForcing, step_length: Float[Array, "..."] | float) -> Scalar:
        """The longest step of the elongation over the yield elongation of the spring."""
        assert isinstance(forcing, Tabulated)
        return jnp.max(jnp.abs(jnp.diff(forcing.samples.elongation[::2]))) * self._specimen.law.steepness

    @property
    def _specimen(self) -> Specimen:
        (specimen,) = self.specimens
        return specimen
