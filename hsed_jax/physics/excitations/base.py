r"""What an excitation is: a function of time, what a study says of it, and its samples on the half-step grid.

An excitation is a class of its own and a line of the registry (`EXCITATIONS`).  It declares its settings as fields, with their
units; whether they are possible, how long it lasts, how fast it changes and how a report calls it are its methods.  Studies,
laboratories, figures and reports ask there.

The integrator asks for an excitation at the ends and the middle of every step, so each one is turned into a *forcing*: a carry
and an `advance` that moves it by half a step.
"""

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, PyTree

from hsed_jax.physics.timeline import Timeline

Scalar = Float[Array, ""] | float


class Imposed(NamedTuple):
    """Elongation [m] and its rate [m/s] imposed on the specimen at one instant."""

    elongation: Scalar
    rate: Scalar


class Applied(NamedTuple):
    """Forces [N] on masses (numbered from 0) at one instant, and the acceleration of the ground [m/s²], None where it rests.

    A ground motion alone is its acceleration by itself, a number.
    """

    forces: Mapping[int, Any]
    ground: Any = None


def driven(sample: Any) -> tuple[Scalar, Mapping[int, Scalar]]:
    """Acceleration of the ground [m/s²] and the forces on masses [N] of one sample of what drives a structure."""
    if isinstance(sample, Applied):
        return 0.0 if sample.ground is None else sample.ground, sample.forces
    return sample, {}


def channels_of(sample: Any) -> dict[str, Any]:
    """A sample of an excitation, or a table of them, by the names of the channels that would measure it."""
    if isinstance(sample, Imposed):
        return {"elongation": sample.elongation}
    if isinstance(sample, Applied):
        ground = {} if sample.ground is None else {"ground_acceleration": sample.ground}
        return {**ground, **{f"applied_force_{mass + 1}": force for mass, force in sample.forces.items()}}
    return {"ground_acceleration": sample}


class AbstractForcing(eqx.Module):
    """An excitation on the half-step grid, k = 0 … 2n."""

    @abstractmethod
    def start(self) -> tuple[PyTree, PyTree]:
        """The carry and the sample at t = 0."""

    @abstractmethod
    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        """The carry and the sample at grid point `index`, from the carry at `index - 1`."""


@final
class Tabulated(AbstractForcing):
    """Samples in a table; `samples` is a pytree of arrays of shape (2n+1,)."""

    samples: PyTree

    def start(self) -> tuple[PyTree, PyTree]:
        """No carry: the table is read by its index."""
        return None, self._at(0)

    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        """The sample in row `index`."""
        return None, self._at(index)

    def _at(self, index: ArrayLike) -> PyTree:
        return jax.tree.map(lambda samples: samples[index], self.samples)


@final
class Shaken(AbstractForcing):
    """A forcing whose ground motion is multiplied by a factor."""

    forcing: AbstractForcing
    factor: Scalar

    def start(self) -> tuple[PyTree, PyTree]:
        """The carry of the forcing and its first sample, scaled."""
        return self._times(*self.forcing.start())

    def advance(self, carry: PyTree, index: ArrayLike) -> tuple[PyTree, PyTree]:
        """The carry of the forcing and its sample, scaled."""
        return self._times(*self.forcing.advance(carry, index))

    def _times(self, carry: PyTree, sample: PyTree) -> tuple[PyTree, PyTree]:
        if not isinstance(sample, Applied):
            return carry, sample * self.factor
        return carry, sample if sample.ground is None else sample._replace(ground=sample.ground * self.factor)


class Kind(NamedTuple):
    """What of an experiment is driven.

    Attributes:
        protocol: of a campaign of such experiments.
        channel: that measures it, in terms of the settings.
        file: that a laboratory is given, without its ending.
        column: of that file.
        noun: for reports and figures.
    """

    protocol: Literal["ground_motion", "displacement"]
    channel: str
    file: str
    column: str
    noun: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that a laboratory is given."""
        return tuple(f"{self.file}.{ending}" for ending in ("csv", *(("AT2",) if self.file == "ground_motion" else ())))


GROUND_MOTION = Kind("ground_motion", "ground_acceleration", "ground_motion", "ag", "ground motion")
APPLIED_FORCE = Kind("ground_motion", "applied_force_{mass}", "applied_force", "p", "applied force")
IMPOSED_ELONGATION = Kind("displacement", "elongation", "imposed_elongation", "du", "imposed elongation")


@dataclasses.dataclass(frozen=True)
class Setting:
    """Metadata of a field that a study gives.

    Attributes:
        meaning: a noun.
        unit: SI unit, or "1".
        kind: `number`: a number or the name of an input; `numbers`: a list of these; `whole`: a fixed whole number, at least 1.
        default: None: it must be given.
        is_positive: whether it must be.
    """

    meaning: str
    unit: str
    kind: Literal["number", "numbers", "whole"] = "number"
    default: float | None = None
    is_positive: bool = False


_KEY = "setting"


def setting(meaning: str, unit: str, **details: Any) -> Any:
    """A field of an excitation that a study gives."""
    told = Setting(meaning, unit, **details)
    more: dict[str, Any] = {} if told.default is None else {"default": told.default}
    # A whole number decides how much is computed.
    return eqx.field(metadata={_KEY: told}, static=told.kind == "whole", **more)


def settings_of(excitation: type["AbstractExcitation"]) -> dict[str, Setting]:
    """The settings that a class of excitations declares, by name, in order."""
    return {f.name: f.metadata[_KEY] for f in dataclasses.fields(excitation) if _KEY in f.metadata}


class AbstractExcitation(eqx.Module):
    """What drives an experiment.

    Attributes:
        name: its key in a study.
        kind: what it drives.
        of_file: its fields that are read from a record, the time first: its setting `file`; none of an excitation without one.
        is_endless: whether only the study says how long to simulate.
    """

    name: ClassVar[str]
    kind: ClassVar[Kind]
    of_file: ClassVar[tuple[str, ...]] = ()
    is_endless: ClassVar[bool] = False

    @abstractmethod
    def sample(self, time: Scalar) -> Any:
        """What drives the experiment at one instant [s]: an acceleration of the ground [m/s²], `Applied` or `Imposed`."""

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
        """How long it lasts [s]."""

    @property
    def shortest_period(self) -> Scalar:
        """The period that its steps must resolve [s]."""
        return float("inf")

    @classmethod
    def impossible(cls, settings: Mapping[str, Any]) -> tuple[str, str] | None:
        """A setting that is impossible and why; None where there is none.  Of names of inputs nothing is known here."""
        del settings
        return None

    @classmethod
    @abstractmethod
    def sentence(cls, settings: Mapping[str, Any], duration: float | None) -> str:
        """What is done to the specimen, without a full stop.

        Arguments:
            settings: as they stand in the study.
            duration: [s] as it stands in the study.
        """


class AbstractRecord(AbstractExcitation):
    """What was recorded; an excitation of this kind is interpolated between its samples.

    Attributes:
        time: sample times [s], increasing, shape (m,).
    """

    time: Float[Array, " m"] = eqx.field(converter=jnp.asarray)

    @property
    def duration(self) -> Scalar:
        """When the record ends [s]."""
        return self.time[-1]

    def forcing(self, step: Scalar, steps: int) -> AbstractForcing:
        """The record, interpolated on the half-step grid once, before the integration."""
        return Tabulated(jax.vmap(self.sample)(0.5 * step * jnp.arange(2 * steps + 1)))


class AbstractImposedElongation(AbstractExcitation):
    """An elongation that is imposed on the specimen alone; its samples are `Imposed`."""

    @property
    @abstractmethod
    def branches(self) -> int:
        """Parts with the same number of steps each, whatever the inputs."""

    @property
    @abstractmethod
    def reach(self) -> Scalar:
        """The longest step of the elongation [m] times the steps of a branch."""
