"""Where the experiments of a study are performed: its laboratory, what that is told, and the campaign that it fills."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hsed_jax.config.experiments import CommandEntry, FolderEntry, OpenSeesEntry, OwnMaterialEntry, VirtualEntry
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.laboratories import opensees
from hsed_jax.laboratories.base import ExperimentFailed, Laboratory, experiment_id
from hsed_jax.laboratories.command import CommandLaboratory, check_template
from hsed_jax.laboratories.folder import FolderLaboratory
from hsed_jax.laboratories.opensees import OpenSeesLaboratory
from hsed_jax.laboratories.python import PythonLaboratory, function_of
from hsed_jax.laboratories.request import Programme
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.measurements import Campaign, Experiment, Noise
from hsed_jax.study import parts, structures
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.laboratories import driver_of
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.observed import Observed
from hsed_jax.study.simulation import AbstractSimulation


@dataclass(frozen=True)
class Site:
    """Where experiments are performed.

    Attributes:
        study: what the user said.
        experiments: that are planned.
        mechanics: of the model.
        observed: what is observed.
        simulation: of the model, and of virtual specimens.
        workspace: folder for the folders of experiments; None: a temporary one.
        function: given from Python, for a laboratory that is a function.
    """

    study: Study
    experiments: Experiments
    mechanics: AbstractMechanics
    observed: Observed
    simulation: AbstractSimulation
    workspace: Path | None = None
    function: Callable[..., Any] | None = None

    @property
    def sensors(self) -> Sensors:
        """What is measured."""
        return self.observed.sensors

    @cached_property
    def programme(self) -> Programme:
        """What the experiments have in common."""
        timeline = self.simulation.planned
        assert self.experiments.excitation is not None
        return Programme(self.experiments.space.units, self.experiments.excitation, timeline)

    @cached_property
    def laboratory(self) -> Laboratory:
        """Where experiments are performed."""
        return laboratory_of(self)

    def empty_campaign(self) -> Campaign:
        """The campaign that the laboratory fills."""
        return Campaign(
            self.study.study,
            self.experiments.protocol,
            inputs=dict(self.experiments.space.units),
            channels=self.sensors.recorded,
            quantities=dict(self.sensors.quantities),
        )

    def perform(self) -> Campaign:
        """The laboratory's experiments at the initial design, and of a virtual one those for testing."""
        virtual, train = self.study.experiments.virtual, self.study.design.initial
        space, campaign = self.experiments.space, self.empty_campaign()
        test = 0 if virtual is None else virtual.test
        for number, inputs in enumerate(space.declared(space.initial_design(train + test))):
            si = {name: float(values[0]) for name, values in space.si(inputs[None]).items()}
            about: dict[str, Any] = {"split": "train" if number < train else "test"}
            try:
                measured = self.laboratory.perform(number, si)
                about |= {"record": measured.record, "quantities": measured.quantities}
            except ExperimentFailed as failure:
                about |= {"status": "failed", "reason": str(failure)}
            campaign = campaign.add(Experiment(experiment_id(number), si, **about))
        return campaign


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


def _virtual(site: Site) -> VirtualLaboratory:
    sensors, study = site.sensors, site.study
    return VirtualLaboratory(
        *site.simulation.virtual,
        tuple(study.quantities),
        tuple(name for name in sensors.channels if name != "time"),
        _noise(sensors),
        study.seed,
    )


def _opensees(site: Site, entry: OpenSeesEntry) -> OpenSeesLaboratory:
    if driver_of(site.study) != "ground_acceleration":
        raise UserError("experiments.opensees: it needs a ground motion, but the study has another excitation")
    assert site.study.structure is not None
    assert site.mechanics.structure is not None
    if len(site.mechanics.structure.specimens) > 1:
        raise UserError(
            "experiments.opensees: it performs tests of one specimen; use the laboratory virtual for several"
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
    told = structures.true_numbers("experiments.opensees.structure", entry.structure, site.mechanics.structure_priors)
    files = {"model.json": opensees.as_json(opensees.model(site.mechanics.structure.told(told), material, step))}
    command = CommandLaboratory(opensees.program(), site.programme, site.sensors, entry.timeout, site.workspace, files)
    return OpenSeesLaboratory(command, _noise(site.sensors), site.study.seed)


def _noise(sensors: Sensors) -> dict[str, Noise]:
    measured = {**sensors.channels, **sensors.quantities}
    return {name: channel.noise for name, channel in measured.items() if channel.noise is not None}
