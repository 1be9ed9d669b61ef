"""A study with a called model instead of a spring law: the common mechanics and simulation of such models."""

# A cached property implements an abstract property here.
# pyright: reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import Grid, conditions_of
from hsed_jax.inference.priors import Prior
from hsed_jax.models.differences import Free, failure
from hsed_jax.models.function import outputs_of
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.names import by_owner
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.physics.structures import Structure
from hsed_jax.physics.timeline import Timeline
from hsed_jax.study.elements import elements_of
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.simulation import AbstractSimulation
from hsed_jax.study.specimens import Naming
from hsed_jax.study.timelines import TOLD


@dataclass(frozen=True)
class CalledMechanics(AbstractMechanics):
    """A called model; it has its own parameters.

    Structure, specimens and laws are those of a virtual laboratory, if there is one.
    """

    @property
    @abstractmethod
    def words(self) -> str:
        """The kind of the model, for messages after the words `this one is`."""

    @cached_property
    def naming(self) -> Naming:
        """None: the names are the function's own.

        Raises:
            UserError: always; a called model does not have it.
        """
        where = f"model.{self.study.model.described[0]}"
        raise UserError(
            f"{where}: to look for missing effects and to add them (diagnose, improve) the model must be a spring law "
            f"(model.spring), and this one is {self.words}; calibrate, design, compare and locate work with any model"
        )

    @cached_property
    def structure(self) -> Structure | None:
        """The structure of a specimen that this package simulates; a function has its own."""
        laboratory = self.study.experiments.laboratory
        in_structure = laboratory is not None and laboratory.in_structure
        return self._described_structure() if self.study.structure is not None or in_structure else None

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The measured specimens; virtual specimens have their laws in `virtual`, and others need none."""
        virtual = self.study.experiments.specimen
        if virtual is not None and virtual.spring is None:
            raise UserError("experiments.virtual.spring: this key is required, as the model has no spring law")
        return elements_of(self.study, Element().law)

    @cached_property
    def laws(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws of the virtual specimens, for their scales and steps; none without virtual specimens."""
        if self.study.experiments.specimen is None:
            return ()
        elements, parameters = self.virtual
        owners = by_owner(parameters)
        return tuple(element.law(**element.parameters(owners)) for element in elements)

    @property
    def steepest(self) -> tuple[AbstractSpringLaw, ...]:
        """Nothing to check: the model determines the outputs itself."""
        return self.laws

    @property
    def has_specimens(self) -> bool:
        """Whether specimens in a structure are measured; otherwise the first call of the function shows its outputs."""
        return self.structure is not None or bool(self.laws)

    def refuse_other_parts(self) -> None:
        """Refuse priors of a structure, and models of specimens: a called model has its own.

        Raises:
            UserError: names the key.
        """
        if self.structure_priors:
            raise UserError(
                f"structure: {next(iter(self.structure_priors))} has a prior, but the model is {self.words}, which has its own "
                "structure; give a number here and the prior in model.parameters"
            )
        if own := [key for key in self.study.models if key != "model"]:
            raise UserError(f"{own[0]}: the model is {self.words}, which has its own specimens; leave this model out")

    def refuse_all_fixed(self, free: Mapping[str, Prior]) -> None:
        """Refuse a model that has nothing to calibrate.

        Raises:
            UserError: no parameter has a prior.
        """
        if not free:
            raise UserError("model.parameters: at least one parameter needs a prior, such as {uniform: [2.0e5, 9.0e5]}")

    def check(self) -> None:
        """Refuse steps that need effects."""
        design = self.study.design
        if {"diagnose", "improve"} & set(self.study.steps) or self.study.improve.add:
            _ = self.naming
        for asked, key in (
            (ACQUISITIONS[design.acquisition].of_rivals, "acquisition"),
            (design.stop.verdict, "stop.verdict"),
        ):
            if asked:
                raise UserError(f"design.{key}: this needs a diagnosis, but the model has no spring law")


@dataclass(frozen=True)
class CalledSimulation(AbstractSimulation):
    """The calls of a model. Nothing is integrated here, so the steps are the samples of the records."""

    @cached_property
    def longest_step(self) -> float:
        """The step of the integration of virtual specimens, or the interval of the record, or a share of the duration [s]."""
        if self.mechanics.laws:
            return super().longest_step
        excitation = self.experiments.excitation
        assert excitation is not None
        if "time" in excitation.arrays:
            return float(np.min(np.diff(excitation.arrays["time"])))
        return self.experiments.duration / TOLD

    @cached_property
    def grid(self) -> Grid | None:
        """Samples of the measured records, a step for each; None without them."""
        records = self.experiments.records
        return Grid(max(len(record) for record in records), 1, from_zero=False) if records else None

    @cached_property
    def planned(self) -> Timeline:
        """All times of an experiment without a record, because a function sees the motion at no other times."""
        return super().planned._replace(every=1)

    @cached_property
    def timeline(self) -> Timeline | None:
        """The times of an experiment; None if there are none, and the function gets only the inputs."""
        quantities = self.study.observe == "quantities"
        return None if quantities and self.grid is None and self.experiments.excitation is None else super().timeline

    @property
    def planned_simulator(self) -> AbstractModel:
        """The function for experiments to come; the function itself if nothing is planned."""
        return self.simulator if self.experiments.excitation is None else super().planned_simulator

    @property
    def first(self) -> Conditions:
        """The first measured experiment, or else one in the middle of the inputs."""
        measured = self.experiments.measured
        if measured is not None:
            experiment = self.experiments.taken(measured.completed.experiments[:1])[0]
            return conditions_of(experiment, measured, self.grid, self.experiments.excitation)
        return Conditions(self.experiments.space.middle())


def called(
    where: str, function: Any, parameters: Mapping[str, float], told: Any, wanted: tuple[str, ...]
) -> dict[str, Any]:
    """The checked output of the function at these parameters."""
    at = ", ".join(f"{name} {value:.4g}" for name, value in parameters.items())
    time = None if "time" not in told else np.asarray(told["time"])
    try:
        found = outputs_of(function(dict(parameters), told), time, wanted)
    except (Exception, SystemExit) as error:
        raise UserError(f"{where}: in the middle of the priors ({at}): {failure(error)}") from None
    for name, values in found.items():
        if not np.isfinite(values).all():
            raise UserError(f"{where}: in the middle of the priors ({at}) its {name} is no finite number")
    return found


def free_parameter(name: str, prior: Prior) -> Free:
    """A parameter to differentiate with respect to."""
    lower, upper = prior.bounds
    spread = 0.5 * float(prior.quantile(0.84) - prior.quantile(0.16))
    return Free(name, spread, -np.inf if lower is None else lower, np.inf if upper is None else upper)
