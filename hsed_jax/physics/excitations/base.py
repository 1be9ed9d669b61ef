"""The interface of excitations: a function of time, and its samples on the half-step grid.

An excitation is a class, declared for studies in `hsed_jax.physics.declared` and listed in `EXCITATIONS`.  Its methods give
its duration, its rate of change and its value at an instant.

The integrator asks for an excitation at the ends and the middle of every step, so each one is turned into a *forcing*: a carry
and an `advance` that moves it by half a step.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hsed_jax.physics.declared import Declared
from hsed_jax.physics.timeline import Timeline

Scalar = Float[Array, ""] | float


class Imposed(NamedTuple):
    """Elongation [m] and its rate [m/s] imposed on the specimen at one instant."""

    elongation: Scalar
    rate: Scalar


class Applied(NamedTuple):
    """Forces [N] on masses (numbered from 0) at one instant, and the acceleration of the ground [m/s²], None if it rests.

    A ground motion alone is a plain number, its acceleration.
    """

    forces: Mapping[int, Any]
    ground: Any = None


def driven(sample: Any) -> tuple[Scalar, Mapping[int, Scalar]]:
    """Acceleration of the ground [m/s²] and the forces on masses [N], from one sample of the excitation of a structure."""
    if isinstance(sample, Applied):
        return 0.0 if sample.ground is None else sample.ground, sample.forces
    return sample, {}


def channels_of(sample: Any) -> dict[str, Any]:
    """A sample of an excitation, or a table of samples, by the names of its channels."""
    if isinstance(sample, Imposed):
        return {"elongation": sample.elongation}
    if isinstance(sample, Applied):
        ground = {} if sample.ground is None else {"ground_acceleration": sample.ground}
        return {**ground, **{f"applied_force_{mass + 1}": force for mass, force in sample.forces.items()}}
    return {"ground_acceleration": sample}


class AbstractForcing(eqx.Module):
    """An excitation on the half-step grid, k = 0 … 2n."""

    @abstractmethod
    def start(self) -> tuple[Any, Any]:
        """The carry and the sample at t = 0."""

    @abstractmethod
    def advance(self, carry: Any, index: ArrayLike) -> tuple[Any, Any]:
        """The carry and the sample at grid point `index`, from the carry at `index - 1`."""


@final
class Tabulated(AbstractForcing):
    """Samples in a table; `samples` is a pytree of arrays of shape (2n+1,)."""

    samples: Any

    def start(self) -> tuple[Any, Any]:
        """No carry: the table is read by its index."""
        return None, self._at(0)

    def advance(self, carry: Any, index: ArrayLike) -> tuple[Any, Any]:
        """The sample in row `index`."""
        return None, self._at(index)

    def _at(self, index: ArrayLike) -> Any:
        def row(samples: Any) -> Any:
            return samples[index]

        return jax.tree.map(row, self.samples)


@final
class Shaken(AbstractForcing):
    """A forcing whose ground motion is multiplied by a factor."""

    forcing: AbstractForcing
    factor: Scalar

    def start(self) -> tuple[Any, Any]:
        """The carry of the forcing and its first sample, scaled."""
        return self._times(*self.forcing.start())

    def advance(self, carry: Any, index: ArrayLike) -> tuple[Any, Any]:
        """The carry of the forcing and its sample, scaled."""
        return self._times(*self.forcing.advance(carry, index))

    def _times(self, carry: Any, sample: Any) -> tuple[Any, Any]:
        if not isinstance(sample, Applied):
            return carry, sample * self.factor
        return carry, sample if sample.ground is None else sample._replace(ground=sample.ground * self.factor)


class AbstractExcitation(eqx.Module):
    """The excitation of an experiment.

    Attributes:
        declared: its declaration; its settings are fields of the same names. Whole numbers are static, because they determine
            the size of the computation.
    """

    declared: ClassVar[Declared]

    @abstractmethod
    def sample(self, time: Scalar) -> Any:
        """The excitation at one instant [s]: an acceleration of the ground [m/s²], `Applied` or `Imposed`."""

    @abstractmethod
    def forcing(self, step: Float[Array, "..."] | float, steps: int) -> AbstractForcing:
        """The excitation on the half-step grid of `steps` steps of length `step` [s]."""

    def step_length(self, timeline: Timeline) -> Any:
        """Lengths of the steps [s], one for all or one for each, shape (steps,)."""
        assert timeline.step is not None
        return timeline.step

    @property
    @abstractmethod
    def duration(self) -> Scalar:
        """Duration [s]."""

    @property
    def shortest_period(self) -> Scalar:
        """The period that its steps must resolve [s]."""
        return float("inf")


def samples_of(values: ArrayLike | Sequence[float]) -> Array:
    """The samples of a record as an array."""
    return jnp.asarray(values)


class AbstractRecord(AbstractExcitation):
    """A recorded excitation; it is interpolated between its samples.

    Attributes:
        time: sample times [s], increasing, shape (m,).
    """

    time: Float[Array, " m"] = eqx.field(converter=samples_of)

    @property
    def duration(self) -> Scalar:
        """The end of the record [s]."""
        return self.time[-1]

    def forcing(self, step: Scalar, steps: int) -> AbstractForcing:
        """The record, interpolated on the half-step grid once, before the integration."""
        return Tabulated(jax.vmap(self.sample)(0.5 * step * jnp.arange(2 * steps + 1)))


class AbstractImposedElongation(AbstractExcitation):
    """An elongation that is imposed on the specimen alone; its samples are `Imposed`."""

    @property
    @abstractmethod
    def branches(self) -> int:
        """Number of parts with the same number of steps each, for any inputs."""

    @property
    @abstractmethod
    def reach(self) -> Scalar:
        """The longest step of the elongation [m] times the steps of a branch."""
