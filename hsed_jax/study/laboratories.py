"""The laboratory that a study names, and what it measures; each fault names its key."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hsed_jax.config.experiments import (
    CommandEntry,
    FolderEntry,
    MeasuredEntry,
    OpenSeesEntry,
    OwnMaterialEntry,
    VirtualEntry,
)
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.laboratories import opensees
from hsed_jax.laboratories.base import ExperimentFailed, Laboratory, experiment_id
from hsed_jax.laboratories.command import CommandLaboratory, check_template
from hsed_jax.laboratories.folder import FolderLaboratory
from hsed_jax.laboratories.opensees import OpenSeesLaboratory
from hsed_jax.laboratories.python import PythonLaboratory, function_of
from hsed_jax.laboratories.request import Programme
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise
from hsed_jax.measurements.declaration import declared_channel
from hsed_jax.physics.outputs import is_driver, output, quantity
from hsed_jax.physics.simulator import Simulator
from hsed_jax.physics.structures import Structure
from hsed_jax.study import parts, structures
from hsed_jax.study.noise import per_output

if TYPE_CHECKING:
    from hsed_jax.study.build import Built


@dataclass(frozen=True)
class Site:
    """What a laboratory is built in.

    Attributes:
        study: what the user said.
        sensors: what is measured.
        programme: what the experiments have in common.
        structure: the numerical substructure.
        virtual: gives the simulator and the true parameters of a virtual specimen.
        of_structure: priors of the structure's numbers that are calibrated.
        workspace: folder for the folders of experiments; None: a temporary one.
        function: given from Python, for a laboratory that is a function.
    """

    study: Study
    sensors: Sensors
    programme: Programme
    structure: Structure | None
    virtual: Callable[[], tuple[Simulator, dict[str, float]]]
    of_structure: Mapping[str, Prior]
    workspace: Path | None
    function: Callable[..., Any] | None


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


def laboratory_of(site: Site) -> Laboratory:
    """The laboratory.

    Raises:
        UserError: a file or program is missing, a parameter is unknown, or what it needs is not installed.
    """
    study, entry = site.study, site.study.experiments.laboratory
    if isinstance(entry, VirtualEntry):
        return _virtual(site)
    if isinstance(entry, OpenSeesEntry):
        return _opensees(site, entry)
    if isinstance(entry, CommandEntry):
        template = entry.words(study.folder)
        parts.at("experiments.command.run", check_template, template, study.inputs)
        return CommandLaboratory(template, site.programme, site.sensors, entry.timeout, site.workspace)
    if isinstance(entry, FolderEntry):
        return FolderLaboratory()
    if entry is None:
        raise UserError("experiments: the step design needs a laboratory, such as virtual, to perform what it asks")
    function = site.function
    if function is None:
        if entry.file is None:
            raise UserError("experiments.python.file: this key is required, unless a function is given from Python")
        function = parts.at("experiments.python", function_of, study.folder / entry.file, entry.function)
    return PythonLaboratory(function, site.programme, site.sensors)


def performed(built: "Built") -> Campaign:
    """The laboratory's experiments at the initial design, and of a virtual one those for testing."""
    virtual, train = built.study.experiments.virtual, built.study.design.initial
    campaign, test = built.empty_campaign(), 0 if virtual is None else virtual.test
    for number, inputs in enumerate(built.space.declared(built.space.initial_design(train + test))):
        si = {name: float(values[0]) for name, values in built.space.si(inputs[None]).items()}
        about: dict[str, Any] = {"split": "train" if number < train else "test"}
        try:
            measured = built.laboratory.perform(number, si)
            about |= {"record": measured.record, "quantities": measured.quantities}
        except ExperimentFailed as failure:
            about |= {"status": "failed", "reason": str(failure)}
        campaign = campaign.add(Experiment(experiment_id(number), si, **about))
    return campaign


def _virtual(site: Site) -> VirtualLaboratory:
    sensors, study = site.sensors, site.study
    return VirtualLaboratory(
        *site.virtual(),
        tuple(study.quantities),
        tuple(name for name in sensors.channels if name != "time"),
        _noise(sensors),
        study.seed,
    )


def _opensees(site: Site, entry: OpenSeesEntry) -> OpenSeesLaboratory:
    if driver_of(site.study) != "ground_acceleration":
        raise UserError("experiments.opensees: it shakes the ground, and the excitation of the study is another")
    assert site.study.structure is not None
    assert site.structure is not None
    if len(site.structure.specimens) > 1:
        raise UserError(
            "experiments.opensees: it performs tests of one specimen; several are for the laboratory virtual"
        )
    if site.study.structure.damping.specimen_stiffness == "model":
        raise UserError(
            "structure.damping.specimen_stiffness: the laboratory opensees needs a number [N/m] to form C with"
        )
    if isinstance(entry.material, OwnMaterialEntry):
        file = site.study.folder / entry.material.file
        material = parts.at("experiments.opensees", opensees.own_material, file, entry.parameters)
    else:
        material = parts.at("experiments.opensees", opensees.built_in, entry.material, entry.parameters)
    opensees.require_openseespy()
    assert site.programme.timeline.step is not None
    step = site.programme.timeline.step / opensees.STEPS_PER_STEP if entry.step is None else entry.step
    told = structures.true_numbers("experiments.opensees.structure", entry.structure, site.of_structure)
    files = {"model.json": opensees.as_json(opensees.model(site.structure.told(told), material, step))}
    command = CommandLaboratory(opensees.program(), site.programme, site.sensors, entry.timeout, site.workspace, files)
    return OpenSeesLaboratory(command, _noise(site.sensors), site.study.seed)


def _noise(sensors: Sensors) -> dict[str, Noise]:
    measured = {**sensors.channels, **sensors.quantities}
    return {name: channel.noise for name, channel in measured.items() if channel.noise is not None}
