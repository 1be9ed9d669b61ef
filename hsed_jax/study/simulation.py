"""The simulation of a study's experiments: their grids of time, the scales of effects, and the computational simulator."""

# A cached property implements an abstract property here.
# pyright: reportIncompatibleMethodOverride=false

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import cast

from hsed_jax.backend import limit_threads
from hsed_jax.config.schema import Study
from hsed_jax.inference.observation import Grid
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import AbstractExcitation
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import AbstractModel, Simulator
from hsed_jax.physics.timeline import Timeline
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.observed import Observed
from hsed_jax.study.scales import conditions, law_parameters, simulated_scales, told_scales
from hsed_jax.study.specimens import effects_of
from hsed_jax.study.timelines import (
    check_mass,
    imposed_timeline,
    longest_step,
    measured_grid,
    planned_timeline,
    required,
)


@dataclass(frozen=True)
class AbstractSimulation(ABC):
    """The simulation of the experiments of a study; each kind of model has its own class.

    Attributes:
        study: of the user.
        experiments: measured or planned.
        mechanics: of the model.
        observed: observed outputs of the model.
    """

    study: Study
    experiments: Experiments
    mechanics: AbstractMechanics
    observed: Observed

    @property
    @abstractmethod
    def grid(self) -> Grid | None:
        """Samples and steps per sample of the measured records; None without them."""

    @property
    @abstractmethod
    def simulator(self) -> AbstractModel:
        """The computational simulator."""

    @cached_property
    def longest_step(self) -> float:
        """The longest step of the integration [s]."""
        mechanics, experiments = self.mechanics, self.experiments
        return longest_step(mechanics.stiffest, mechanics.steepest, experiments)

    @cached_property
    def planned(self) -> Timeline:
        """The grid of the integration for an experiment without a record.

        Raises:
            UserError: there is no excitation, the step is longer than it, or there are too many steps.
        """
        entry, excitation = required(self.experiments)
        if self.experiments.component_test:
            return imposed_timeline(self.experiments, excitation, self.mechanics.laws, self.mechanics.steepest)
        where = f"excitation.{cast('type[AbstractExcitation]', excitation.constructor).declared.name}.mass"
        check_mass(where, entry.channel, self.mechanics.structure)
        return planned_timeline(self.experiments, self.longest_step if entry.step is None else entry.step)

    @cached_property
    def timeline(self) -> Timeline | None:
        """The grid of the integration; None for a function that gets only the inputs."""
        if self.grid is not None:
            return Timeline(None, self.grid.steps, self.grid.every)
        return self.planned

    @cached_property
    def scales(self) -> Scales:
        """Characteristic values that make amplitudes of effects dimensionless: given, or from the campaign or the plain model.

        Raises:
            UserError: neither the data nor the model determine them.
        """
        if self.study.scales is not None:
            return Scales(**self.study.scales.model_dump())
        told, plain = told_scales(self.experiments.characteristics), Scales()
        virtual = self.study.experiments.specimen
        if None in told and (effects_of(self.study) or (virtual and virtual.effects)):
            mechanics, timeline = self.mechanics, self.timeline
            assert timeline is not None
            simulator = Simulator(
                structure=mechanics.structure,
                excitation=self.experiments.excitation,
                timeline=timeline,
                elements=mechanics.elements,
            )
            middle = law_parameters(mechanics.elements, mechanics.laws)
            plain = simulated_scales(simulator, middle, conditions(self.experiments, self.grid))
        return Scales(*(simulated if value is None else value for value, simulated in zip(told, plain, strict=True)))

    @cached_property
    def planned_simulator(self) -> AbstractModel:
        """The simulator of experiments to come, on their timeline; a study of records has another one."""
        return dataclasses.replace(self.simulator, timeline=self.planned)

    def of_springs(
        self, elements: tuple[Element, ...], effects: tuple[str, ...], constants: Mapping[str, float]
    ) -> Simulator:
        """The simulator of spring laws with effects in the structure of the study.

        Arguments:
            elements: the specimens.
            effects: their names.
            constants: parameters that never change.
        """
        limit_threads()
        structure, timeline = self.study.structure, self.timeline
        assert timeline is not None
        return Simulator(
            structure=self.mechanics.structure,
            excitation=self.experiments.excitation,
            timeline=timeline,
            effects=self.mechanics.catalogue.only(effects),
            scales=self.scales,
            constants=tuple(constants.items()),
            damping_follows_model=structure is not None and structure.damping.specimen_stiffness == "model",
            elements=elements,
        )

    @cached_property
    def virtual(self) -> tuple[Simulator, dict[str, float]]:
        """The simulator of the virtual specimens, and their true parameters."""
        entry = self.study.experiments.specimen
        assert entry is not None
        elements, parameters = self.mechanics.virtual
        return self.of_springs(elements, tuple(entry.effects), {}), parameters


@dataclass(frozen=True)
class SpringSimulation(AbstractSimulation):
    """The integration of spring laws in a structure, or of one law under an imposed elongation."""

    @cached_property
    def grid(self) -> Grid | None:
        """Samples and steps per sample of the measured records; None without them."""
        return measured_grid(self.experiments, self.mechanics, lambda: self.longest_step)

    @cached_property
    def simulator(self) -> AbstractModel:
        """The computational simulator."""
        mechanics = self.mechanics
        return self.of_springs(mechanics.elements, tuple(effects_of(self.study)), mechanics.parameters[1])
