"""A study with a material of OpenSees as the model, along imposed elongations: its parameters and its simulator."""

# A cached property implements an abstract property here.
# pyright: reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hsed_jax.backend import cores, limit_threads
from hsed_jax.config.opensees import OpenSeesEntry
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Campaign, characteristics
from hsed_jax.models.differences import Differenced, unpadded
from hsed_jax.models.function import FunctionModel
from hsed_jax.models.opensees import MATERIALS
from hsed_jax.models.opensees.base import NOTHING, AbstractMaterial, Marks, MaterialParameter
from hsed_jax.models.opensees.simulated import Simulated
from hsed_jax.models.opensees.workers import workers
from hsed_jax.physics.outputs import is_quantity
from hsed_jax.physics.parameters import Parameter
from hsed_jax.physics.simulator import AbstractModel
from hsed_jax.study import parts
from hsed_jax.study.called_study import CalledMechanics, CalledSimulation, called, free_parameter


@dataclass(frozen=True)
class OpenSeesMechanics(CalledMechanics):
    """A model that is a material of OpenSees."""

    @property
    def words(self) -> str:
        """The kind of the model, for messages."""
        return f"the material {self.material.name} of OpenSees"

    def known(self, name: str) -> Parameter | None:
        """The declaration of a parameter in the table."""
        known = self.material.parameters.get(name)
        if known is None:
            return None
        return Parameter(name, known.symbol, known.unit, known.meaning, lower=known.lower, upper=known.upper)

    @property
    def material(self) -> type[AbstractMaterial]:
        """The material."""
        return MATERIALS[entry_of(self.study).opensees]

    @cached_property
    def parameters(self) -> tuple[dict[str, Prior], dict[str, float]]:
        """Free parameters with their priors, and the fixed ones with their values; an omitted parameter has its value or
        prior of the table.

        Raises:
            UserError: a parameter is unknown, impossible, or has no prior; or the specimen is in a structure.
        """
        self.refuse_other_parts()
        if not self.experiments.component_test:
            raise UserError(
                "model.opensees: a material of OpenSees is calibrated along elongations that were imposed (protocol: "
                "displacement); for a specimen in a structure choose a spring law (model.spring)"
            )
        given, known = entry_of(self.study).parameters, self.material.parameters
        parts.check_names("model.parameters", given, known)
        free: dict[str, Prior] = {}
        fixed: dict[str, float] = {}
        for name, one in known.items():
            where, said = f"model.parameters.{name}", given.get(name, {} if one.value is None else one.value)
            if isinstance(said, dict):
                free[name] = parts.prior(where, said or self._prior(where, one))
            elif not one.lower <= said <= one.upper:
                raise UserError(f"{where}: {said:g} is outside the allowed range, {one.range}")
            else:
                fixed[name] = said
        self.refuse_all_fixed(free)
        return free, fixed

    @cached_property
    def units(self) -> dict[str, str]:
        """SI unit of every free parameter."""
        return {name: self.pair.unit(self.material.parameters[name].unit) for name in self.parameters[0]}

    def _prior(self, where: str, known: MaterialParameter) -> dict[str, Any]:
        measured = self.experiments.measured
        prior = known.prior_of(NOTHING if measured is None else marks_of(measured))
        if prior is None:
            raise UserError(
                f"{where}: neither the table nor a record of the training experiments determines a prior; give one, such as "
                "{uniform: [2.0e5, 9.0e5]}"
            )
        return prior


@dataclass(frozen=True)
class OpenSeesSimulation(CalledSimulation):
    """Simulations of a material in processes of OpenSees."""

    @cached_property
    def simulator(self) -> AbstractModel:
        """The material as a model.

        It is simulated once, in the middle of the priors, along the first experiment or one in the middle of the inputs.

        Raises:
            UserError: openseespy cannot be imported, or OpenSees refuses the material there.
        """
        limit_threads()
        free, fixed = self.mechanics.parameters
        material, wanted = entry_of(self.study).opensees, self.observed.outputs
        _ = workers().version()
        middle = {name: float(prior.quantile(0.5)) for name, prior in free.items()}
        excitation, timeline = self.experiments.excitation, self.timeline
        bare = FunctionModel(function=Simulated(material), given=(), excitation=excitation, timeline=timeline)
        told = {name: np.asarray(v) if np.ndim(v) else float(v) for name, v in bare.told(self.first).items()}
        found = called(f"model.opensees: {material}", Simulated(material), {**middle, **fixed}, unpadded(told), wanted)
        given = tuple(name for name in found if is_quantity(name) or name in ("force", *wanted))
        parameters = tuple(free_parameter(name, prior) for name, prior in free.items())
        return FunctionModel(
            function=Differenced(Simulated(material), material, given, parameters, cores()),
            given=given,
            excitation=excitation,
            timeline=timeline,
            constants=tuple(fixed.items()),
        )


def marks_of(campaign: Campaign) -> Marks:
    """Characteristic points of the specimen, from the training experiments of a campaign."""
    found = characteristics(campaign)
    stiffness = found.stiffness if np.isfinite(found.stiffness) else 2 * found.force / found.elongation
    return Marks(stiffness, found.force, found.elongation, found.energy / found.force)


def entry_of(study: Study) -> OpenSeesEntry:
    """The entry of a study for a model that is a material of OpenSees."""
    assert isinstance(study.model, OpenSeesEntry)
    return study.model
