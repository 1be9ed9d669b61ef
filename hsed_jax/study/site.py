"""The place where the experiments of a study are performed: its laboratory, the information for it, and the campaign that it
fills.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed, Laboratory, experiment_id
from hsed_jax.laboratories.request import Programme
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.measurements import Campaign, Experiment
from hsed_jax.physics.simulator import Simulator
from hsed_jax.physics.structures import Structure
from hsed_jax.study import structures
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.laboratories import driver_of
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.observed import Observed
from hsed_jax.study.simulation import AbstractSimulation


@dataclass(frozen=True)
class Site:
    """The place where experiments are performed, with the information that a laboratory may ask for
    (`hsed_jax.laboratories.kinds.base.Site`).

    Attributes:
        study: of the user.
        experiments: that are planned.
        mechanics: of the model.
        observed: observed outputs.
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
        """The sensors."""
        return self.observed.sensors

    @property
    def programme(self) -> Programme:
        """The common properties of the experiments."""
        timeline = self.simulation.planned
        assert self.experiments.excitation is not None
        return Programme(self.experiments.space.units, self.experiments.excitation, timeline)

    @cached_property
    def laboratory(self) -> Laboratory:
        """The laboratory that performs experiments.

        Raises:
            UserError: the study has no laboratory, or the laboratory cannot be made.
        """
        if (entry := self.study.experiments.laboratory) is None:
            raise UserError(
                "experiments: the step design needs a laboratory, such as virtual, to perform the requested experiments"
            )
        return entry.laboratory(self)

    @property
    def folder(self) -> Path:
        """The folder of the study, where relative paths start."""
        return self.study.folder

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self.study.inputs)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Quantities that the study names."""
        return tuple(self.study.quantities)

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.study.seed

    @property
    def driver(self) -> str:
        """The channel that measures the excitation."""
        return driver_of(self.study)

    @property
    def virtual(self) -> tuple[Simulator, Mapping[str, float]]:
        """The simulator of the virtual specimens, and their true parameters (SI)."""
        return self.simulation.virtual

    def structure_of(self, laboratory: str, numbers: Mapping[str, float]) -> Structure:
        """The structure with one specimen, in numbers.

        Arguments:
            laboratory: its name, for messages.
            numbers: true values of the numbers that have priors.

        Raises:
            UserError: there are several specimens, the damping follows the model, or a number is missing or unknown.
        """
        entry, structure = self.study.structure, self.mechanics.structure
        assert entry is not None
        assert structure is not None
        if len(structure.specimens) > 1:
            raise UserError(
                f"experiments.{laboratory}: it performs tests of one specimen; use the laboratory virtual for several"
            )
        if entry.damping.specimen_stiffness == "model":
            raise UserError(
                f"structure.damping.specimen_stiffness: the laboratory {laboratory} needs a number [N/m] to form C with"
            )
        where = f"experiments.{laboratory}.structure"
        return structure.told(structures.true_numbers(where, numbers, self.mechanics.structure_priors))

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
        """The laboratory's experiments at the initial design, and for a virtual laboratory those for testing."""
        entry, train = self.study.experiments.laboratory, self.study.design.initial
        space, campaign = self.experiments.space, self.empty_campaign()
        test = 0 if entry is None else entry.further
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
