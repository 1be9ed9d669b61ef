"""The laboratory that a study names, and what it measures; each fault names its key."""

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import TYPE_CHECKING

from hsed_jax.config.experiments import (
    MeasuredEntry,
    OpenSeesEntry,
    VirtualEntry,
)
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.laboratories import opensees
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.measurements import Channel, Noise
from hsed_jax.measurements.declaration import declared_channel
from hsed_jax.physics.outputs import is_driver, output, quantity
from hsed_jax.physics.structures import Structure
from hsed_jax.study import parts, structures
from hsed_jax.study.noise import per_output

if TYPE_CHECKING:
    pass


def responses(channels: Iterable[str], *, component_test: bool) -> tuple[str, ...]:
    """The channels that are a response to what drove the experiments."""
    return tuple(name for name in channels if not (is_driver(name) or (component_test and name == "elongation")))


def driver_of(study: Study) -> str:
    """The channel that measures what drives the planned experiments of a study."""
    return "ground_acceleration" if study.excitation is None else study.excitation.channel


def sensors_of(study: Study, outputs: tuple[str, ...], structure: Structure | None) -> Sensors:
    """What the laboratory of a study measures.

    Arguments:
        study: the study.
        outputs: the quantities or channels that it observes.
        structure: that the specimen is in.

    Raises:
        UserError: a channel or unit that is none, or something observed that is not measured.
    """
    entry, where = study.experiments.laboratory, f"experiments.{study.experiments.kind}"
    histories, driver = study.observe == "histories", driver_of(study)
    channels, quantities = (outputs, ()) if histories else ((), outputs)
    sources = {name: quantity(name).channels(structures.masses_of(structure)) for name in quantities}
    if isinstance(entry, OpenSeesEntry) and not histories:
        # What its program does not take from all its steps is taken from the record.
        channels = tuple(dict.fromkeys(["elongation", "force", *chain(*sources.values())]))
        quantities = tuple(name for name in quantities if name in opensees.QUANTITIES)
    if isinstance(entry, VirtualEntry | OpenSeesEntry):
        noise = sensor_noise(f"{where}.noise", entry, (*channels, *quantities))
        recorded = dict.fromkeys(("time", driver, *channels)) if channels else ()
        return Sensors(_si(recorded, noise), _si(quantities, noise), driver=driver)
    if not isinstance(entry, MeasuredEntry):
        raise UserError("experiments: there is no laboratory")
    if not entry.channels and not entry.quantities:
        recorded = ("time", *channels) if channels else ()
        return Sensors(_si(recorded, {}), _si(quantities, {}), driver=driver, at_sample_times=histories)
    made = {
        kind: {name: declared_channel(f"{where}.{kind}.{name}", name, given) for name, given in declared.items()}
        for kind, declared in (("channels", entry.channels), ("quantities", entry.quantities))
    }
    columns = {name: given.column or name for name, given in entry.channels.items()}
    found = parts.at(where, Sensors, made["channels"], made["quantities"], columns, driver, histories)
    for name in quantities:
        if name not in entry.quantities and not set(sources[name]) <= {*entry.channels, driver}:
            raise UserError(
                f"{where}: {name} is observed and not measured; declare it in quantities, or its source in channels "
                f"({', '.join(sources[name])})"
            )
    if histories and not entry.channels:
        raise UserError(f"{where}.channels: histories are observed, and the laboratory declares no channels")
    return found


def _si(names: Iterable[str], noise: Mapping[str, Noise]) -> dict[str, Channel]:
    return {name: Channel(name, output(name).unit, noise=noise.get(name)) for name in names}


def sensor_noise(where: str, entry: VirtualEntry | OpenSeesEntry, measured: tuple[str, ...]) -> dict[str, Noise]:
    """The noise of a simulated laboratory, per quantity or channel."""
    noise = {}
    for name, error in per_output(where, entry.noise, list(measured)).items():
        if error.unknown:
            raise UserError(f"{where}: the noise of {name} must be a number: relative or absolute")
        noise[name] = Noise(absolute=error.absolute, relative=error.relative)
    return noise
