"""A study whose model is a function or a program: its mechanics and its simulation."""

# A cached property stands for an abstract property here.
# pyright: reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false
# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.backend import cores, limit_threads
from hsed_jax.config.functions import FunctionEntry
from hsed_jax.config.schema import Study
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.errors import UserError, at
from hsed_jax.inference.observation import Grid, conditions_of
from hsed_jax.inference.priors import Prior
from hsed_jax.laboratories.command import check_template
from hsed_jax.measurements import parse_unit
from hsed_jax.models.differences import Differenced, Free, failure, unpadded
from hsed_jax.models.function import FunctionModel, Respond, is_told, known_outputs, outputs_of
from hsed_jax.models.program import Program
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.names import by_owner
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.physics.structures import Structure
from hsed_jax.physics.timeline import Timeline
from hsed_jax.plain import shown
from hsed_jax.python_files import module_of
from hsed_jax.sections import InputEntry
from hsed_jax.study import parts
from hsed_jax.study.elements import elements_of
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.simulation import AbstractSimulation
from hsed_jax.study.specimens import Naming
from hsed_jax.study.timelines import TOLD


@dataclass(frozen=True)
class FunctionMechanics(AbstractMechanics):
    """A model that is a function or a program: its parameters are its own.

    Structure, specimens and laws are those of a virtual laboratory, if there is one.
    """

    @cached_property
    def naming(self) -> Naming:
        """There is none: its names are the function's own.

        Raises:
            UserError: always; what asks for it cannot be had.
        """
        where = f"model.{_entry_of(self.study).described[0]}"
        raise UserError(
            f"{where}: to look for missing effects and to add them (diagnose, improve) the model must be a spring law "
            "(model.spring), and this one is a function of its own; calibrate, design, compare and locate work with any model"
        )

    @cached_property
    def structure(self) -> Structure | None:
        """The structure of a specimen that this package simulates; a function has its own."""
        laboratory = self.study.experiments.laboratory
        in_structure = laboratory is not None and laboratory.in_structure
        return self._described_structure() if self.study.structure is not None or in_structure else None

    @cached_property
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters with their priors, and the fixed ones with their values."""
        if self.structure_priors:
            raise UserError(
                f"structure: {next(iter(self.structure_priors))} has a prior, but the model is a function, which has its own "
                "structure; give a number here and the prior in model.parameters"
            )
        if own := [key for key in self.study.models if key != "model"]:
            raise UserError(f"{own[0]}: the model is a function, which has its own specimens; leave this model out")
        free: dict[str, Prior] = {}
        fixed: dict[str, float] = {}
        for name, entry in _entry_of(self.study).parameters.items():
            if isinstance(entry, InputEntry):
                free[name] = parts.prior(f"model.parameters.{name}", entry.prior)
            else:
                fixed[name] = entry
        if not free:
            raise UserError("model.parameters: at least one parameter needs a prior, such as {uniform: [2.0e5, 9.0e5]}")
        return free, fixed

    @cached_property
    def units(self) -> dict[str, str]:
        """SI unit of every free parameter."""
        units: dict[str, str] = {}
        for name in self.parameters[0]:
            entry, where = _entry_of(self.study).parameters[name], f"model.parameters.{name}.unit"
            assert isinstance(entry, InputEntry)
            unit = at(where, parse_unit, entry.unit)
            if unit.factor != 1:
                raise UserError(
                    f"{where}: parameters of a model are in SI; give this one in {unit.si}, and its distribution too"
                )
            units[name] = entry.unit
        return units

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The specimens that are measured; of virtual ones `virtual` has the laws, and of others nothing asks for one."""
        virtual = self.study.experiments.specimen
        if virtual is not None and virtual.spring is None:
            raise UserError("experiments.virtual.spring: this key is required, as the model has no spring law")
        return elements_of(self.study, Element().law)

    @cached_property
    def laws(self) -> tuple[AbstractSpringLaw, ...]:
        """The laws of the virtual specimens, whose scales and steps are asked for here; none where there are none."""
        if self.study.experiments.specimen is None:
            return ()
        elements, parameters = self.virtual
        owners = by_owner(parameters)
        return tuple(element.law(**element.parameters(owners)) for element in elements)

    @property
    def steepest(self) -> tuple[AbstractSpringLaw, ...]:
        """The same: they are known."""
        return self.laws

    @property
    def has_specimens(self) -> bool:
        """Whether specimens in a structure are measured; else what the function gives is told by its first call."""
        return self.structure is not None or bool(self.laws)

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
class FunctionSimulation(AbstractSimulation):
    """The calls of a function or a program: nothing is integrated here, so that steps are the samples of the records."""

    @cached_property
    def longest_step(self) -> float:
        """That of the integration of virtual specimens, else the interval of the record or a share of the duration [s]."""
        if self.mechanics.laws:
            return super().longest_step
        excitation = self.experiments.excitation
        assert excitation is not None
        if "time" in excitation.arrays:
            return float(np.min(np.diff(excitation.arrays["time"])))
        return self.experiments.duration / TOLD

    @cached_property
    def grid(self) -> Grid | None:
        """Samples of the measured records, a step for each; None where there are none."""
        records = self.experiments.records
        return Grid(max(len(record) for record in records), 1) if records else None

    @cached_property
    def planned(self) -> Timeline:
        """The times of an experiment without a record: all that there are, as a function sees the motion at no others."""
        return super().planned._replace(every=1)

    @cached_property
    def timeline(self) -> Timeline | None:
        """The times of an experiment; None where there are none, and a function is told the inputs alone."""
        quantities = self.study.observe == "quantities"
        return None if quantities and self.grid is None and self.experiments.excitation is None else super().timeline

    @property
    def planned_simulator(self) -> AbstractModel:
        """The function for experiments to come; where nothing is planned, as it is."""
        return self.simulator if self.experiments.excitation is None else super().planned_simulator

    @property
    def _entry(self) -> FunctionEntry:
        return _entry_of(self.study)

    @property
    def _where(self) -> str:
        return f"model.{self._entry.described[0]}"

    @cached_property
    def simulator(self) -> AbstractModel:
        """The function as a model.

        It is called once, in the middle of the priors, for the first experiment or in the middle of the inputs.

        Raises:
            UserError: the file or function is missing, or what it returned cannot be used.
        """
        limit_threads()
        self._check_names()
        function, name = self._program if self._entry.command is not None else self._function
        where = f"{self._where}: {name}"
        free, fixed = self.mechanics.parameters
        middle = {name: float(prior.quantile(0.5)) for name, prior in free.items()}

        def model(function: Respond, given: tuple[str, ...]) -> FunctionModel:
            return FunctionModel(
                function=function,
                given=given,
                excitation=self.experiments.excitation,
                timeline=self.timeline,
                constants=tuple(fixed.items()),
            )

        told, wanted = model(function, ()).told(self._first), self.observed.outputs
        kind = self._entry.derivatives if self._entry.command is None else "differences"
        if kind != "differences":

            def traced(parameters: Any, told: Any) -> dict[str, Any]:
                returned = known_outputs(function({**fixed, **parameters}, told), wanted)
                return {name: jnp.asarray(value, dtype=float) for name, value in returned.items()}

            fault = _fault(traced, middle, told)
            if fault is None:
                return model(function, tuple(self._called(where, jax.jit(traced), middle, told, wanted)))
            if kind == "jax":
                raise UserError(
                    f"{where}: JAX cannot trace it ({fault}); leave model.derivatives out, or say differences"
                )
        plain = unpadded({name: np.asarray(value) if np.ndim(value) else float(value) for name, value in told.items()})
        outputs = tuple(self._called(where, function, {**middle, **fixed}, plain, wanted))
        workers = 1 if self._entry.command is None else cores()
        return model(Differenced(function, name, outputs, tuple(map(_free, free, free.values())), workers), outputs)

    def _called(
        self, where: str, function: Any, parameters: Mapping[str, float], told: Any, wanted: tuple[str, ...]
    ) -> dict[str, Any]:
        """What the function returns at these parameters, checked."""
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

    @property
    def _function(self) -> tuple[Respond, str]:
        """The function, and its name for messages."""
        file, name = self._entry.file_and_name
        module = at(f"{self._where}: {file}", module_of, self.study.folder / file)
        function = getattr(module, name, None)
        if not callable(function):
            raise UserError(f"{self._where}: {file}: it has no function {shown(name)}")
        return cast("Respond", function), f"{file}:{name}"

    @property
    def _program(self) -> tuple[Respond, str]:
        entry = self._entry.command
        assert entry is not None
        template = entry.words(self.study.folder)
        known = (*self._entry.parameters, *self.study.inputs)
        at("model.command.run", check_template, template, known, ("folder", "python"))
        return Program(template, self.observed.outputs, entry.timeout), entry.run

    def _check_names(self) -> None:
        measured = self.experiments.measured
        inputs = [*self.study.inputs, *(() if measured is None else measured.inputs)]
        if taken := [name for name in inputs if is_told(name)]:
            raise UserError(
                f"inputs.{taken[0]}: a function is told a history of this name; give the input another name"
            )

    @property
    def _first(self) -> Conditions:
        """The first experiment that was measured, or else one in the middle of the inputs."""
        measured = self.experiments.measured
        if measured is not None:
            experiment = self.experiments.taken(measured.completed.experiments[:1])[0]
            return conditions_of(experiment, measured, self.grid, self.experiments.excitation)
        return Conditions(self.experiments.space.middle())


def _entry_of(study: Study) -> FunctionEntry:
    """What a study says of a model that is a function."""
    assert isinstance(study.model, FunctionEntry)
    return study.model


def _free(name: str, prior: Prior) -> Free:
    """A parameter to differentiate with respect to."""
    lower, upper = prior.bounds
    spread = 0.5 * float(prior.quantile(0.84) - prior.quantile(0.16))
    return Free(name, spread, -np.inf if lower is None else lower, np.inf if upper is None else upper)


def _fault(
    called: Callable[[Any, Any], dict[str, Any]], parameters: Mapping[str, float], told: Mapping[str, Any]
) -> str | None:
    """Why JAX cannot trace, batch and differentiate a function; None where it can."""

    def one(parameters: Any, told: Any) -> Any:
        def of_parameters(parameters: Any) -> Any:
            return called(parameters, told)

        return jax.jvp(of_parameters, (parameters,), (parameters,))

    def lane(value: Any) -> Any:
        return jnp.asarray(value, dtype=float)[None]

    lanes = jax.tree.map(lane, (dict(parameters), dict(told)))
    try:
        jax.eval_shape(jax.vmap(one), *lanes)
    except (Exception, SystemExit) as error:
        return failure(error).splitlines()[0]
    return None
