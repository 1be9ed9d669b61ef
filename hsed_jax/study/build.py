"""From what a user said to the objects that compute: no `None` reaches the numerics."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from hsed_jax.backend import limit_threads, prepare
from hsed_jax.config.functions import FunctionEntry
from hsed_jax.config.mechanics import ModelEntry
from hsed_jax.config.schema import Study
from hsed_jax.design.feasible import Limits
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Data, Error
from hsed_jax.inference.observation import Grid, Histories, Observation, Outputs, Quantities, assemble
from hsed_jax.inference.population import Level
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.laboratories.base import Laboratory
from hsed_jax.laboratories.request import Programme
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.measurements import Campaign, Characteristics, Experiment, characteristics, parse_unit, read_campaign
from hsed_jax.measurements.header import Protocol
from hsed_jax.measurements.thinning import thinned
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.names import OWNER
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import AbstractModel, Parametrised, Simulator
from hsed_jax.physics.structures import Structure
from hsed_jax.physics.timeline import Timeline
from hsed_jax.study import laboratories, levels, observed, pairs, parts, structures
from hsed_jax.study.designs import design_of, settings_of
from hsed_jax.study.discrepancies import check_told
from hsed_jax.study.elements import elements_of, placed
from hsed_jax.study.excitations import excitation_of, protocol_of
from hsed_jax.study.limits import limits_of
from hsed_jax.study.noise import errors_of
from hsed_jax.study.own_effects import catalogue_of
from hsed_jax.study.plan import check_added, check_plan
from hsed_jax.study.scales import check_scales, scales_of
from hsed_jax.study.specimens import Naming, effects_of
from hsed_jax.study.spring_laws import law_of
from hsed_jax.study.timelines import longest_step, measured_grid, planned_timeline

if TYPE_CHECKING:
    # A check of a study samples nothing, and need not wait for what does.
    from hsed_jax.design.sequential import SequentialDesign
    from hsed_jax.inference.nuts import Settings


@dataclass(frozen=True)
class Built:
    """Everything a study needs to run; each part is built when it is first asked for.

    Of a study whose model is a function, `Built(study)` is one that builds that (`hsed_jax.study.function_model`).

    Attributes:
        study: what the user said.
        campaign: measured experiments; by default the campaign that the study names.
        workspace: folder in which the laboratory has its folders; by default a temporary one.
        function: the laboratory, where it is a function given from Python.
        open_forms: effects of which what tells their forms from one another is free, too: of a model that holds all forms.
    """

    study: Study
    campaign: Campaign | None = None
    workspace: Path | None = None
    function: Callable[..., Any] | None = None
    open_forms: tuple[str, ...] = ()

    def __new__(cls, study: Study | None = None, *rest: Any, **more: Any) -> "Built":
        """Of the kind that the model needs; of a copy the class says it."""
        if cls is Built and study is not None and isinstance(study.model, FunctionEntry):
            from hsed_jax.study.function_model import BuiltOfFunction  # which is a Built itself

            return object.__new__(BuiltOfFunction)
        return object.__new__(cls)

    def __post_init__(self):
        prepare()

    @cached_property
    def catalogue(self) -> Catalogue:
        """The effects that the study may name; its own files of effects are executed."""
        springs = [] if self.study.structure is None else self.study.structure.springs
        # What drives the experiments a campaign may have to tell, and a study without springs needs none for its catalogue.
        count = len(springs) if springs and not self.component_test else 0
        return placed(catalogue_of(self.study), self.elements, count)

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The specimens of the model; the files of own laws are executed."""
        assert isinstance(self.study.model, ModelEntry)
        return elements_of(self.study, law_of("model.spring", self.study.model.spring, self.study.folder))

    @cached_property
    def naming(self) -> Naming:
        """What the names of parameters and effects stand for."""
        return Naming(self.elements, self.catalogue)

    @cached_property
    def measured(self) -> Campaign | None:
        """The campaign of measurements, where the study has one."""
        path = self.study.experiments.campaign
        if self.campaign is not None or path is None:
            return self.campaign
        try:
            return read_campaign(self.study.folder / path)
        except UserError as error:
            raise parts.in_study(self.study.file, error) from None

    @property
    def protocol(self) -> Protocol:
        """What drives the experiments: the ground or a force, or the elongation of the specimen alone."""
        return protocol_of(self.study, self.measured)

    @property
    def component_test(self) -> bool:
        """Whether the elongation is imposed on the specimen alone."""
        return self.protocol == "displacement"

    @cached_property
    def pair(self) -> Pair:
        """What elongation and force of the specimen are, as whoever measures them declares."""
        return pairs.study_pair(self)

    def taken(self, experiments: Sequence[Experiment]) -> tuple[Experiment, ...]:
        """Experiments as they are fitted and scored: long records of a component test are thinned."""
        samples = self.study.measurements.samples
        return tuple(thinned(e, samples) for e in experiments) if self.component_test else tuple(experiments)

    @cached_property
    def space(self) -> InputSpace:
        """The variable inputs."""
        units = {name: parts.at(f"inputs.{name}.unit", parse_unit, e.unit) for name, e in self.study.inputs.items()}
        return InputSpace(
            {name: parts.prior(f"inputs.{name}", entry.prior) for name, entry in self.study.inputs.items()},
            {name: entry.unit for name, entry in self.study.inputs.items()},
            {name: float(unit.to_si(1.0)) for name, unit in units.items()},
        )

    @cached_property
    def structure(self) -> Structure | None:
        """The numerical substructure; None for a component test."""
        if self.component_test:
            return None
        if self.study.structure is None:
            raise UserError(
                "structure: this key is required, unless the elongation was imposed (protocol: displacement)"
            )
        return structures.structure(self.study.structure)

    @cached_property
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters of the model with their priors, and the fixed ones with their values."""
        return self.naming.model_parameters(self.study, self._of_structure, self.pair, self.open_forms)

    @cached_property
    def _of_structure(self) -> dict[str, Prior]:
        """Priors of the structure's numbers that are calibrated."""
        entry = self.study.structure
        return {} if entry is None or self.component_test else structures.priors_of(entry)

    @cached_property
    def steepest(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws where their priors make them stiffest and let them yield soonest."""
        return self.naming.laws(self.parameters, steepest=True)

    @cached_property
    def laws(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws in the middle of their priors; none of a model that has no law."""
        return self.naming.laws(self.parameters)

    @cached_property
    def stiffest(self) -> Structure:
        """The structure where its priors make its shortest period shortest."""
        return structures.stiffest(self.structure, self._of_structure)

    @cached_property
    def longest_step(self) -> float:
        """The longest one of the integration [s]."""
        return longest_step(self.stiffest, self.steepest, self.excitation, self.space)

    @cached_property
    def units(self) -> dict[str, str]:
        """SI unit of every free parameter."""
        free, fixed = self.parameters
        return self.naming.units(tuple(free), fixed, self.pair)

    @cached_property
    def excitation(self) -> Parametrised | None:
        """From inputs to what drives an experiment; None where every experiment brings its record."""
        return excitation_of(self.study)

    @cached_property
    def characteristics(self) -> Characteristics | None:
        """Characteristic values of the measured campaign."""
        return None if self.measured is None else characteristics(self.measured)

    @cached_property
    def scales(self) -> Scales:
        """Characteristic values for the effects: as given, else from the campaign, else from the plain model."""
        return scales_of(self)

    @cached_property
    def grid(self) -> Grid | None:
        """Samples and steps per sample of the measured records; None where there are none."""
        return measured_grid(self)

    @cached_property
    def timeline(self) -> Timeline:
        """The grid of the integration."""
        if self.grid is not None:
            return Timeline(None, self.grid.steps, self.grid.every)
        return self.planned

    @cached_property
    def planned(self) -> Timeline:
        """The grid of the integration for an experiment without a record."""
        return planned_timeline(self)

    @cached_property
    def simulator(self) -> AbstractModel:
        """The computational simulator."""
        return self._simulator(self.elements, tuple(effects_of(self.study)), tuple(self.parameters[1].items()))

    @cached_property
    def planned_simulator(self) -> AbstractModel:
        """The computational simulator of experiments to come, on their timeline: a study of records has another."""
        return dataclasses.replace(self.simulator, timeline=self.planned)

    @cached_property
    def sensors(self) -> Sensors:
        """What the laboratory measures."""
        return laboratories.sensors_of(self.study, self.outputs, self.structure)

    @cached_property
    def programme(self) -> Programme:
        """What the laboratory's experiments have in common."""
        timeline = self.planned
        assert self.excitation is not None
        return Programme(self.space.units, self.excitation, timeline)

    @cached_property
    def true_elements(self) -> tuple[Element, ...]:
        """The virtual specimens: the law of those that share the model's may be another one."""
        virtual = self.study.experiments.virtual
        if virtual is None or virtual.spring is None:
            return self.elements
        law = law_of("experiments.virtual.spring", virtual.spring, self.study.folder)
        return tuple(e if e.is_apart else e._replace(law=law) for e in self.elements)

    @cached_property
    def specimen(self) -> dict[str, float]:
        """The parameters of the virtual specimen."""
        virtual = self.study.experiments.virtual
        assert virtual is not None
        told = structures.true_numbers("experiments.virtual.structure", virtual.structure, self._of_structure)
        of_structure = {f"{OWNER}.{name}": value for name, value in told.items()}
        return Naming(self.true_elements, self.catalogue).true_parameters(self.study) | of_structure

    def _virtual(self) -> tuple[Simulator, dict[str, float]]:
        assert self.study.experiments.virtual is not None
        return self._simulator(self.true_elements, tuple(self.study.experiments.virtual.effects), ()), self.specimen

    @cached_property
    def laboratory(self) -> Laboratory:
        """Where experiments are performed."""
        known = self.study, self.sensors, self.programme, self.structure, self._virtual
        return laboratories.laboratory_of(laboratories.Site(*known, self._of_structure, self.workspace, self.function))

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Names of the observed quantities or channels."""
        return observed.outputs_of(self)

    def check_outputs(self, names: tuple[str, ...]) -> None:
        """Refuse quantities or channels that the model does not give."""
        observed.check_outputs(self, names)

    @cached_property
    def observation(self) -> Observation:
        """What is compared with the model."""
        if self.study.observe == "quantities":
            return Quantities(self.outputs, self.grid, self.excitation, structures.masses_of(self.structure))
        samples = self.timeline.samples if self.grid is None else self.grid.samples
        return Histories(self.outputs, samples, self.grid, self.excitation)

    @cached_property
    def errors(self) -> tuple[Error, ...]:
        """Of each output."""
        source = self.sensors if self.measured is None else self.measured
        declared = source.quantities if self.study.observe == "quantities" else source.channels
        return errors_of(self.study, self.outputs, declared, self.pair)

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the study."""
        free, _ = self.parameters
        respond = Outputs(self.simulator, self.observation, tuple(free))
        return Posterior(Predictor(respond), free, self.errors, self.outputs, self.observation.groups, self.levels)

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """What varies between specimens."""
        return levels.levels_of(self)

    def data(self, campaign: Campaign, experiments: Sequence[Experiment], size: int | None = None) -> Data:
        """Experiments of a campaign as data, padded to `size` rows."""
        pairs.check_same(campaign, self.pair)
        relative = np.asarray([error.is_relative for error in self.errors])
        data = assemble(self.observation, campaign, self.taken(experiments), relative, size)
        members = levels.members_of(self.levels, campaign, experiments, len(data.values))
        return data._replace(members=jnp.asarray(members))

    @property
    def settings(self) -> "Settings":
        """Sizes of NUTS for a calibration."""
        return settings_of(self.study.calibration)

    @cached_property
    def design(self) -> "SequentialDesign":
        """The sequential design."""
        return design_of(self)

    @cached_property
    def limits(self) -> Limits | None:
        """What specimen and actuator can bear; None where the study sets no limit."""
        if (entry := self.study.design.limits) is None:
            return None
        return limits_of(entry, self.planned_simulator, tuple(self.parameters[0]), self.space)

    def perform(self) -> Campaign:
        """The laboratory's experiments at the initial design, and of a virtual one those for testing."""
        return laboratories.performed(self)

    def empty_campaign(self) -> Campaign:
        """The campaign that the laboratory fills."""
        return Campaign(
            self.study.study,
            self.protocol,
            inputs=dict(self.space.units),
            channels=self.sensors.recorded,
            quantities=dict(self.sensors.quantities),
        )

    def check(self, *, performs: bool = True) -> None:
        """Build everything that can be wrong, and compute nothing; a `UserError` says what is.

        `performs` tells whether the laboratory is to perform experiments; else it is left alone, as it may be code.
        """
        try:
            check_plan(self.study, self.space)
            self._check_effects()
            self.study.measurements.accepted(self.measured)
            check_scales(self)
            for part in self._needed(performs):
                getattr(self, part)
            check_told(self)
        except UserError as error:
            raise parts.in_study(self.study.file, error) from None

    def _check_effects(self) -> None:
        """Refuse effects that cannot be added to the model."""
        check_added(self.study, self.study.improve.add or [], self.naming, "improve.add: ")

    def _needed(self, performs: bool) -> list[str]:
        """What a check builds: not the simulator, nor a specimen that is one, whose scales may take a simulation."""
        needed = ["pair", "space", "structure", "parameters", "excitation", "outputs", "timeline", "errors", "levels"]
        if self.study.experiments.laboratory is not None or "design" in self.study.steps:
            virtual = self.study.experiments.virtual is not None
            needed += ["sensors", "programme", *(["specimen"] if virtual else ["laboratory"] if performs else [])]
        return needed

    def _simulator(
        self, elements: tuple[Element, ...], effects: tuple[str, ...], constants: tuple[tuple[str, float], ...]
    ) -> Simulator:
        limit_threads()
        follows = self.study.structure is not None and self.study.structure.damping.specimen_stiffness == "model"
        present = self.catalogue.only(effects)
        return Simulator(
            structure=self.structure,
            excitation=self.excitation,
            timeline=self.timeline,
            effects=present,
            scales=self.scales,
            constants=constants,
            damping_follows_model=follows,
            elements=elements,
        )
