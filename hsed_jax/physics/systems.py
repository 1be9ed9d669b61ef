"""What is integrated: a spring in a shaken structure, or a spring whose elongation is imposed.

The state is a pytree of scalars on purpose: under `vmap` every component becomes one array over the batch, and XLA turns
a whole Runge–Kutta stage into one loop over it.  A stacked state vector is six times slower.
"""

from abc import abstractmethod
from typing import Any, NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.excitations import AbstractForcing, Imposed, Tabulated, channels_of, driven
from hsed_jax.physics.laws.base import Memory
from hsed_jax.physics.specimen import Specimen
from hsed_jax.physics.structures import Structure, difference

Scalar = Float[Array, ""] | float

# Of the steepness of a system at its steps, up to which a response is a prediction; at 2.8 the Runge–Kutta method is unstable.
RESOLVED = 2.0


class State(NamedTuple):
    """Displacements [m] and velocities [m/s] relative to the ground, and the memory of the spring."""

    displacement: tuple[Scalar, ...]
    velocity: tuple[Scalar, ...]
    memory: Memory


class AbstractSystem(eqx.Module):
    """An initial-value problem for one experiment."""

    specimen: eqx.AbstractVar[Specimen]

    @abstractmethod
    def start(self) -> State:
        """The state at rest."""

    @abstractmethod
    def rates(self, state: State, sample: Any) -> State:
        """Time derivative of the state under one sample of the excitation."""

    @abstractmethod
    def kinematics(self, state: State, sample: Any) -> tuple[Scalar, Scalar]:
        """Elongation of the specimen [m] and its rate [m/s]."""

    @abstractmethod
    def channels(self, state: State, sample: Any, names: tuple[str, ...]) -> dict[str, Scalar]:
        """The named channels (`hsed_jax.physics.outputs`) at one instant, SI units."""

    @abstractmethod
    def steepness(self, forcing: AbstractForcing, step_length: Float[Array, "..."] | float) -> Scalar:
        """The longest step times the fastest rate of the virgin specimen."""

    def _specimen_channels(self, state: State, sample: Any) -> dict[str, Scalar]:
        elongation, rate = self.kinematics(state, sample)
        return {
            "elongation": elongation,
            "elongation_rate": rate,
            "force": self.specimen.force(elongation, rate, state.memory),
            "energy": state.memory["energy"],
        }


@final
class ShakenStructure(AbstractSystem):
    """The structure with the specimen in it, driven by a ground acceleration [m/s²], by forces on masses, or both.

    Arguments:
        structure: masses and springs, and where the specimen sits.
        specimen: the spring law with its effects.
        damping: C [N·s/m], shape (m, m); None: that of the structure.
    """

    structure: Structure
    specimen: Specimen
    damping: tuple[tuple[Scalar, ...], ...]

    def __init__(self, structure: Structure, specimen: Specimen, damping: Float[Array, "m m"] | None = None):
        self.structure = structure
        self.specimen = specimen
        matrix = structure.damping_matrix() if damping is None else damping
        count = len(structure.masses)
        self.damping = tuple(tuple(matrix[i, j] for j in range(count)) for i in range(count))

    def start(self) -> State:
        """The state at rest."""
        still = tuple(jnp.zeros(()) for _ in self.structure.masses)
        return State(still, still, self.specimen.start())

    def rates(self, state: State, sample: Any) -> State:
        """ü = −M⁻¹(C u̇ + K u + b r − p) − a_g, and the spring's own rates."""
        elongation, rate = self.kinematics(state, sample)
        force, rates = self.specimen.force_and_rates(elongation, rate, state.memory)
        return State(state.velocity, self._accelerations(state, sample, force), rates)

    def kinematics(self, state: State, sample: Any) -> tuple[Scalar, Scalar]:
        """Elongation of the specimen [m] and its rate [m/s]."""
        return self.structure.elongation(state.displacement), self.structure.elongation(state.velocity)

    def channels(self, state: State, sample: Any, names: tuple[str, ...]) -> dict[str, Scalar]:
        """The named channels at one instant, SI units."""
        ground, _ = driven(sample)
        values = {"ground_acceleration": ground, **channels_of(sample), **self._specimen_channels(state, sample)}
        for i, acceleration in enumerate(self._accelerations(state, sample, values["force"])):
            values[f"displacement_{i + 1}"] = state.displacement[i]
            values[f"velocity_{i + 1}"] = state.velocity[i]
            values[f"acceleration_{i + 1}"] = acceleration
            values[f"acceleration_{i + 1}_absolute"] = acceleration + ground
        return {name: jnp.asarray(values[name]) for name in names}

    def steepness(self, forcing: AbstractForcing, step_length: Float[Array, "..."] | float) -> Scalar:
        """The longest step times the frequency of the specimen between the masses at its ends."""
        freed = sum((1 / self.structure.masses[end] for end in self.structure.specimen if end is not None), start=0.0)
        return jnp.max(jnp.asarray(step_length)) * jnp.sqrt(self.specimen.law.stiffness * freed)

    def _accelerations(self, state: State, sample: Any, force: Scalar) -> tuple[Scalar, ...]:
        ground, forces = driven(sample)
        pushes: list[Scalar] = [0.0] * len(self.structure.masses)
        for mass, applied in forces.items():
            pushes[mass] = pushes[mass] - applied
        for ends, value in (
            *((s.ends, s.stiffness * difference(state.displacement, s.ends)) for s in self.structure.springs),
            (self.structure.specimen, force),
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

    specimen: Specimen

    def start(self) -> State:
        """The virgin spring."""
        return State((), (), self.specimen.start())

    def rates(self, state: State, sample: Imposed) -> State:
        """The spring's own rates."""
        return State((), (), self.specimen.rates(sample.elongation, sample.rate, state.memory))

    def kinematics(self, state: State, sample: Imposed) -> tuple[Scalar, Scalar]:
        """The imposed elongation [m] and its rate [m/s]."""
        return sample.elongation, sample.rate

    def channels(self, state: State, sample: Imposed, names: tuple[str, ...]) -> dict[str, Scalar]:
        """The named channels at one instant, SI units."""
        values = self._specimen_channels(state, sample)
        return {name: jnp.asarray(values[name]) for name in names}

    def steepness(self, forcing: AbstractForcing, step_length: Float[Array, "..."] | float) -> Scalar:
        """The longest step of the elongation over that on which the spring yields."""
        assert isinstance(forcing, Tabulated)
        return jnp.max(jnp.abs(jnp.diff(forcing.samples.elongation[::2]))) * self.specimen.law.steepness
