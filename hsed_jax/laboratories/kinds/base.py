"""The declaration of every laboratory: its section of a study, its sensors, and how the laboratory is made."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, runtime_checkable

from hsed_jax.errors import UserError, at
from hsed_jax.measurements import Channel, Noise
from hsed_jax.measurements.declaration import ChannelEntry, declared_channel
from hsed_jax.physics.outputs import output
from hsed_jax.plain import Number
from hsed_jax.sections import NoisesEntry, Section, per_output

if TYPE_CHECKING:
    # Reading a study does not load JAX.
    from hsed_jax.laboratories.base import Laboratory
    from hsed_jax.laboratories.request import Programme
    from hsed_jax.laboratories.sensors import Sensors
    from hsed_jax.physics.simulator import Simulator
    from hsed_jax.physics.structures import Structure


class Wanted(NamedTuple):
    """The observed outputs of the experiments of a study.

    Attributes:
        where: the key of the laboratory, for messages.
        channels: responses that are observed as histories; none where quantities are observed.
        quantities: quantities that are observed; none where histories are observed.
        sources: by quantity, the channels that it can be computed from.
        driver: the channel that measures the excitation of the experiments.
    """

    where: str
    channels: tuple[str, ...]
    quantities: tuple[str, ...]
    sources: Mapping[str, tuple[str, ...]]
    driver: str


@runtime_checkable
class Site(Protocol):
    """The information for a laboratory about the study whose experiments it performs (`hsed_jax.study.site.Site`)."""

    @property
    def folder(self) -> Path:
        """The folder of the study, where relative paths start."""
        ...

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        ...

    @property
    def quantities(self) -> tuple[str, ...]:
        """Quantities that the study names."""
        ...

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        ...

    @property
    def sensors(self) -> "Sensors":
        """The sensors of the laboratory."""
        ...

    @property
    def programme(self) -> "Programme":
        """The common properties of the experiments."""
        ...

    @property
    def driver(self) -> str:
        """The channel that measures the excitation of the experiments."""
        ...

    @property
    def workspace(self) -> Path | None:
        """Folder for the folders of experiments; None: a temporary one."""
        ...

    @property
    def function(self) -> Callable[..., Any] | None:
        """The function that performs an experiment, if Python gave one."""
        ...

    @property
    def virtual(self) -> "tuple[Simulator, Mapping[str, float]]":
        """The simulator of the virtual specimens, and their true parameters (SI)."""
        ...

    def structure_of(self, laboratory: str, numbers: Mapping[str, float]) -> "Structure":
        """The structure with one specimen, in numbers.

        Arguments:
            laboratory: its name, for messages.
            numbers: true values of the numbers that have priors.

        Raises:
            UserError: there are several specimens, the damping follows the model, or a number is missing or unknown.
        """
        ...


class AbstractLaboratoryEntry(Section):
    """The section of a laboratory; the documentation shows the first line of a subclass.

    A subclass is final, decorated by `register`, and its fields with their docstrings are the settings.

    Attributes:
        performer: of the experiments, for a report.
        use: its purpose, for the documentation.
        in_structure: whether it tests a specimen in the structure of the study.
        is_asked: whether people perform the requests of the step `design`, so that it cannot perform an initial design by
            itself.
        registered: whether it is a laboratory; `register` says so.
    """

    performer: ClassVar[str]
    use: ClassVar[str]
    in_structure: ClassVar[bool] = False
    is_asked: ClassVar[bool] = False
    registered: ClassVar[bool] = False

    @property
    def code(self) -> list[str]:
        """Files that are executed when the laboratory is made."""
        return []

    @property
    def further(self) -> int:
        """Number of experiments at further inputs that are performed for testing and never fitted."""
        return 0

    @property
    @abstractmethod
    def described(self) -> str:
        """The tested object, for a title."""

    def located(self, folder: Path) -> "AbstractLaboratoryEntry":
        """The same with absolute paths."""
        del folder
        return self

    @abstractmethod
    def sensors(self, wanted: Wanted) -> "Sensors":
        """The sensors of the laboratory.

        Raises:
            UserError: an unknown channel or unit, or an observed output that is not measured.
        """

    @abstractmethod
    def laboratory(self, site: Site) -> "Laboratory":
        """The laboratory.

        Raises:
            UserError: a file or program is missing, a parameter is unknown, or a package is not installed.
        """


class MeasuredEntry(AbstractLaboratoryEntry):
    """A laboratory outside this program: it declares its measurements as campaign.yaml does. Without a declaration it
    measures the observed outputs, in SI.
    """

    channels: dict[str, ChannelEntry] = {}
    """The channels of its records by name, including the time."""
    quantities: dict[str, ChannelEntry] = {}
    """The quantities that it returns as numbers, by name."""

    def sensors(self, wanted: Wanted) -> "Sensors":
        """Its declaration; without one, the observed outputs in SI."""
        from hsed_jax.laboratories.sensors import Sensors

        histories, where = bool(wanted.channels), wanted.where
        if not self.channels and not self.quantities:
            recorded = ("time", *wanted.channels) if histories else ()
            return Sensors(si(recorded, {}), si(wanted.quantities, {}), driver=wanted.driver, at_sample_times=histories)
        made = {
            kind: {name: declared_channel(f"{where}.{kind}.{name}", name, given) for name, given in declared.items()}
            for kind, declared in (("channels", self.channels), ("quantities", self.quantities))
        }
        columns = {name: given.column or name for name, given in self.channels.items()}
        found = at(where, Sensors, made["channels"], made["quantities"], columns, wanted.driver, histories)
        for name in wanted.quantities:
            if name not in self.quantities and not set(wanted.sources[name]) <= {*self.channels, wanted.driver}:
                raise UserError(
                    f"{where}: {name} is observed and not measured; declare it in quantities, or its source in channels "
                    f"({', '.join(wanted.sources[name])})"
                )
        if histories and not self.channels:
            raise UserError(f"{where}.channels: histories are observed, and the laboratory declares no channels")
        return found


class SimulatedEntry(AbstractLaboratoryEntry):
    """A laboratory that simulates: it measures the observed outputs, in SI, with the noise that the study declares."""

    in_structure: ClassVar[bool] = True

    structure: dict[str, Number] = {}
    """True values of the numbers of the structure that have priors (SI), by name without `structure.`, such as `mass_2`."""
    noise: NoisesEntry | None = None
    """Noise of its sensors, for all outputs or by output: `relative` (to the value of a quantity, to the RMS of a channel) or
    `absolute` (SI). Give it if a diagnosis follows."""

    def sensors(self, wanted: Wanted) -> "Sensors":
        """The observed outputs."""
        return self._measuring(wanted, wanted.channels, wanted.quantities)

    def _measuring(self, wanted: Wanted, channels: tuple[str, ...], quantities: tuple[str, ...]) -> "Sensors":
        from hsed_jax.laboratories.sensors import Sensors

        noise = self._noise(f"{wanted.where}.noise", (*channels, *quantities))
        recorded = dict.fromkeys(("time", wanted.driver, *channels)) if channels else ()
        return Sensors(si(recorded, noise), si(quantities, noise), driver=wanted.driver)

    def _noise(self, where: str, measured: tuple[str, ...]) -> dict[str, Noise]:
        noise: dict[str, Noise] = {}
        for name, error in per_output(where, self.noise, list(measured)).items():
            if error.unknown:
                raise UserError(f"{where}: the noise of {name} must be a number: relative or absolute")
            noise[name] = Noise(absolute=error.absolute, relative=error.relative)
        return noise


def si(names: Iterable[str], noise: Mapping[str, Noise]) -> dict[str, Channel]:
    """Channels or quantities of these names in SI, with their noise."""
    return {name: Channel(name, output(name).unit, noise=noise.get(name)) for name in names}


def noise_of(sensors: "Sensors") -> dict[str, Noise]:
    """The noise of the measured outputs, by name; empty without noise."""
    measured = {**sensors.channels, **sensors.quantities}
    return {name: channel.noise for name, channel in measured.items() if channel.noise is not None}
