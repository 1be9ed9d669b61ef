"""The inference of a study: its posterior, and measurements as data of it."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hsed_jax.config.functions import FunctionEntry
from hsed_jax.config.opensees import OpenSeesEntry
from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.inference.leaning import ANYTHING, Range
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.observation import Histories, Observation, Outputs, Quantities, assemble
from hsed_jax.inference.population import Level
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.measurements import Campaign, Experiment
from hsed_jax.physics.names import own_name
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study import structures
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.levels import levels_of, members_of
from hsed_jax.study.mechanics import AbstractMechanics
from hsed_jax.study.observed import Observed
from hsed_jax.study.simulation import AbstractSimulation

if TYPE_CHECKING:
    # A check of a study does not sample, so it does not import the samplers.
    from hsed_jax.inference.discrepancy.inputs import Support
    from hsed_jax.inference.nuts import Settings

# Inputs that represent their distribution: a simulation each.
_SPREAD = 128
# Fewer shaken experiments do not determine the variation of the best parameters between experiments.  With one, bands
# held 60 % of new records instead of 90 %; with two, 43 % in the worst of 20 campaigns, and the intervals held one
# value in two.
_LEAST_SHAKEN = 3


@dataclass(frozen=True)
class Inference:
    """The inference from the experiments of a study.

    Attributes:
        study: of the user.
        experiments: measured or planned.
        mechanics: of the model.
        observed: compared outputs.
        simulation: of the experiments.
    """

    study: Study
    experiments: Experiments
    mechanics: AbstractMechanics
    observed: Observed
    simulation: AbstractSimulation

    @cached_property
    def observation(self) -> Observation:
        """The outputs that are compared with the model."""
        outputs, grid, excitation = self.observed.outputs, self.simulation.grid, self.experiments.excitation
        if self.study.observe == "quantities":
            return Quantities(outputs, grid, excitation, structures.masses_of(self.mechanics.structure))
        if grid is not None:
            return Histories(outputs, grid.samples, grid, excitation)
        timeline = self.simulation.timeline
        assert timeline is not None
        return Histories(outputs, timeline.samples, grid, excitation)

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the study."""
        free, _ = self.mechanics.parameters
        respond = Outputs(self.simulation.simulator, self.observation, tuple(free))
        observed = self.observed
        return Posterior(
            Predictor(respond), free, observed.errors, observed.outputs, self.observation.groups, self.levels
        )

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """The parameters that vary between specimens."""
        free, _ = self.mechanics.parameters
        return levels_of(self.study.model.levels, self.experiments.measured, free, lambda: self.possible)

    def data(self, campaign: Campaign, experiments: Sequence[Experiment], size: int | None = None) -> Data:
        """Experiments of a campaign as data, padded to `size` rows.

        Raises:
            UserError: the pairs of the campaign and of the model differ.
        """
        if campaign.pair != (pair := self.mechanics.pair):
            raise UserError(f"the campaign {campaign.name!r} is measured in {campaign.pair}; the study is of {pair}")
        relative = np.asarray([error.is_relative for error in self.observed.errors])
        data = assemble(self.observation, campaign, self.experiments.taken(experiments), relative, size)
        members = members_of(self.levels, campaign, experiments, len(data.values))
        return data._replace(members=jnp.asarray(members))

    @property
    def settings(self) -> "Settings":
        """Sizes of the sample of a calibration."""
        from hsed_jax.inference.nuts import Settings

        sizes = self.study.calibration
        return Settings(sizes.chains, sizes.warmup, sizes.draws, sizes.target_acceptance, sizes.sampler)

    @property
    def search(self) -> int:
        """Simulations of a search without derivatives before the descents; none if the response has derivatives."""
        return self.study.model.search if isinstance(self.study.model, OpenSeesEntry) else 0

    @property
    def possible(self) -> dict[str, Range]:
        """Lowest and highest physical value of each free parameter, SI; unknown for the parameters of a function."""
        if isinstance(self.study.model, FunctionEntry):
            return {}
        free, _ = self.mechanics.parameters
        return {name: self._possible(name) for name in free}

    def _possible(self, name: str) -> Range:
        known = self.mechanics.known(name)
        if known is None:
            return ANYTHING
        bounds = (known.lower, known.upper)
        is_physical = known.physical is not None and own_name(name) == known.physical.name
        if not is_physical or all(bound == 0 or math.isinf(bound) for bound in bounds):
            return bounds
        assert known.physical is not None
        low, high = (bound * float(known.physical.factor(self.simulation.scales)) for bound in bounds)
        return low, high

    def check_told(self, experiments: int | None = None) -> None:
        """Refuse a discrepancy of histories from too few shaken experiments; a component test imposes the motion.

        Arguments:
            experiments: number of experiments of the calibration; by default the measured or planned ones.

        Raises:
            UserError: there are fewer than three experiments of a structure.
        """
        if experiments is None:
            design, measured = self.study.design, self.experiments.measured
            planned = design.initial + ("design" in self.study.steps) * design.iterations
            experiments = planned if measured is None else len(measured.train)
        wrong = self.study.observe == "histories" and self._has_discrepancy
        if wrong and 0 < experiments < _LEAST_SHAKEN and not self.experiments.component_test:
            many = "one experiment does" if experiments == 1 else "two experiments do"
            raise UserError(
                f"error.discrepancy: {many} not show how much the error of the model differs between experiments, and bands and "
                f"intervals would be too narrow; give at least {_LEAST_SHAKEN} experiments, or use inflate: true instead"
            )

    @property
    def support(self) -> "Support | None":
        """The variables of a discrepancy of quantities: the inputs, in the unit cube of their distributions.

        If the model can be simulated at any inputs, the orthogonality is taken over their distribution.  Otherwise it is taken
        over the experiments: if each brings its record, and if a program makes every prediction.  None without such a
        discrepancy, and for histories, whose discrepancy depends on the cycles of the response.

        Raises:
            UserError: the experiments lack one of them.
        """
        if self.study.observe == "histories" or not self._has_discrepancy:
            return None
        from hsed_jax.inference.discrepancy.inputs import Support

        space = self.experiments.space

        def cube(inputs: Mapping[str, Array]) -> np.ndarray:
            if missing := [name for name in space.names if name not in inputs]:
                raise UserError(f"error.discrepancy: the experiments do not give their input {missing[0]}")
            return space.cube(
                np.stack([np.asarray(inputs[name]) / space.factors[name] for name in space.names], axis=1)
            )

        is_program = isinstance(self.study.model, FunctionEntry) and self.study.model.command is not None
        if self.simulation.grid is not None or is_program:
            return Support(space.names, cube, None)
        inputs = space.si(space.declared(space.spread(_SPREAD)))
        return Support(space.names, cube, Conditions({name: jnp.asarray(values) for name, values in inputs.items()}))

    @property
    def _has_discrepancy(self) -> bool:
        return any(error.discrepancy for error in self.observed.errors)
