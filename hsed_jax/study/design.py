"""The design of a study's experiments: the sequential design, its sample sizes, and its limits."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
from jaxtyping import Array

from hsed_jax.config.schema import LimitsEntry, Study
from hsed_jax.design.cost import Cost
from hsed_jax.design.feasible import Limits
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.physics.names import named, of_each, owner_of
from hsed_jax.physics.outputs import QUANTITIES, further, is_quantity
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.study.inference import Inference

if TYPE_CHECKING:
    # A check of a study does not sample, so it does not import the samplers.
    from hsed_jax.design.sequential import SequentialDesign


@dataclass(frozen=True)
class Design:
    """The design of a study's experiments.

    Attributes:
        study: of the user.
        inference: of the parameters.
    """

    study: Study
    inference: Inference

    @cached_property
    def sequential(self) -> "SequentialDesign":
        """The sequential design; each of its steps has a smaller sample than a calibration."""
        from hsed_jax.design.sequential import SequentialDesign

        entry, sizes, space = self.study.design, self.study.calibration, self.inference.experiments.space
        return SequentialDesign(
            posterior=self.inference.posterior,
            space=space,
            size=entry.initial + entry.iterations,
            gaps=self.inference.observation.gaps(None),
            settings=self.inference.settings._replace(warmup=sizes.step_warmup, draws=sizes.step_draws),
            starts=sizes.starts,
            candidates=entry.candidates,
            acquisition=entry.acquisition,
            kriging=entry.kriging.model_dump(),
            variance_over_parameters=entry.variance == "inputs_and_parameters",
            seed=self.study.seed,
            exceeding=self.limits,
            cost=None if entry.cost is None else Cost(entry.cost.fixed, entry.cost.per, space),
            replicates=entry.replicates,
        )

    @cached_property
    def limits(self) -> Limits | None:
        """The limits of specimen and actuator; None if the study sets no limit."""
        if (entry := self.study.design.limits) is None:
            return None
        free, _ = self.inference.mechanics.parameters
        return limits_of(
            entry, self.inference.simulation.planned_simulator, tuple(free), self.inference.experiments.space
        )


def limits_of(entry: LimitsEntry, model: AbstractModel, names: tuple[str, ...], space: InputSpace) -> Limits:
    """The limits of specimen and actuator.

    Arguments:
        entry: of the study.
        model: of the planned experiments.
        names: of the model's free parameters.
        space: of the inputs.

    Raises:
        UserError: no limit is given, or the model does not predict the limited output.
    """
    known = {known.limit: name for name, known in QUANTITIES.items() if known.limit is not None}
    given = entry.model_dump(include=set(known), exclude_none=True)
    most = {name: value for limit, value in given.items() for name in _of_all(known[limit], model.owners)}
    quantities = further(tuple(most))
    if entry.velocity is not None:
        most |= dict.fromkeys(of_each(model.owners, ("velocity",)), entry.velocity)
    if not most:
        raise UserError(f"design.limits: give at least one of {', '.join([*known, 'velocity'])}")
    channels = of_each(model.owners, ("elongation_rate",)) if entry.velocity is not None else ()

    for name in (*channels, *(name for name in most if is_quantity(name))):
        if not model.gives(name):
            raise UserError(f"design.limits: the model does not give {name}")

    def respond(theta: Array, point: Array) -> tuple[dict[str, Array], Any]:
        parameters: dict[str, Array] = dict(zip(names, theta, strict=False))
        response = model.respond(parameters, Conditions(space.inputs(point)), channels, quantities)
        values = dict(response.quantities)
        for name in channels:
            values[named(owner_of(name), "velocity")] = jnp.max(jnp.abs(response.channels[name]))
        return values, response.ok

    return Limits(most, entry.probability, respond)


def _of_all(quantity: str, owners: Sequence[str]) -> tuple[str, ...]:
    """A quantity of each specimen, or of the structure."""
    return of_each(owners, (quantity,)) if QUANTITIES[quantity].of_specimen else (quantity,)
