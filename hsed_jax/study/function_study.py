"""A study with a function or a program as the model: its parameters and its calls."""

# A cached property implements an abstract property here.
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
from hsed_jax.errors import UserError, at
from hsed_jax.inference.priors import Prior
from hsed_jax.laboratories.command import check_template
from hsed_jax.measurements import parse_unit
from hsed_jax.models.differences import Differenced, failure, unpadded
from hsed_jax.models.function import FunctionModel, Respond, is_told, known_outputs
from hsed_jax.models.program import Program
from hsed_jax.physics.parameters import Parameter
from hsed_jax.physics.simulator import AbstractModel
from hsed_jax.plain import shown
from hsed_jax.python_files import module_of
from hsed_jax.sections import InputEntry
from hsed_jax.study import parts
from hsed_jax.study.called_study import CalledMechanics, CalledSimulation, called, free_parameter


@dataclass(frozen=True)
class FunctionMechanics(CalledMechanics):
    """A model that is a function or a program."""

    @property
    def words(self) -> str:
        """The kind of the model, for messages."""
        return "a function"

    def known(self, name: str) -> Parameter | None:
        """None: the parameters are the user's own."""
        return None

    @cached_property
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters with their priors, and the fixed ones with their values."""
        self.refuse_other_parts()
        free: dict[str, Prior] = {}
        fixed: dict[str, float] = {}
        for name, entry in _entry_of(self.study).parameters.items():
            if isinstance(entry, InputEntry):
                free[name] = parts.prior(f"model.parameters.{name}", entry.prior)
            else:
                fixed[name] = entry
        self.refuse_all_fixed(free)
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


@dataclass(frozen=True)
class FunctionSimulation(CalledSimulation):
    """The calls of a function or a program."""

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
            UserError: the file or function is missing, or its output cannot be used.
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

        told, wanted = model(function, ()).told(self.first), self.observed.outputs
        kind = self._entry.derivatives if self._entry.command is None else "differences"
        if kind != "differences":

            def traced(parameters: Any, told: Any) -> dict[str, Any]:
                returned = known_outputs(function({**fixed, **parameters}, told), wanted)
                return {name: jnp.asarray(value, dtype=float) for name, value in returned.items()}

            fault = _fault(traced, middle, told)
            if fault is None:
                return model(function, tuple(called(where, jax.jit(traced), middle, told, wanted)))
            if kind == "jax":
                raise UserError(
                    f"{where}: JAX cannot trace it ({fault}); leave model.derivatives out, or use differences"
                )
        plain = unpadded({name: np.asarray(value) if np.ndim(value) else float(value) for name, value in told.items()})
        outputs = tuple(called(where, function, {**middle, **fixed}, plain, wanted))
        workers = 1 if self._entry.command is None else cores()
        return model(
            Differenced(function, name, outputs, tuple(map(free_parameter, free, free.values())), workers), outputs
        )

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
            raise UserError(f"inputs.{taken[0]}: a function gets a history of this name; give the input another name")


def _entry_of(study: Study) -> FunctionEntry:
    """The entry of a study for a model that is a function."""
    assert isinstance(study.model, FunctionEntry)
    return study.model


def _fault(
    called: Callable[[Any, Any], dict[str, Any]], parameters: Mapping[str, float], told: Mapping[str, Any]
) -> str | None:
    """Why JAX cannot trace, batch and differentiate a function; None where it can."""

    def one(parameters: Any, told: Any) -> Any:
        def of_parameters(parameters: Any) -> Any:
            return called(parameters, told)

        return jax.jvp(of_parameters, (parameters,), (parameters,))

    def simulation(value: Any) -> Any:
        return jnp.asarray(value, dtype=float)[None]

    batch = jax.tree.map(simulation, (dict(parameters), dict(told)))
    try:
        jax.eval_shape(jax.vmap(one), *batch)
    except (Exception, SystemExit) as error:
        return failure(error).splitlines()[0]
    return None
