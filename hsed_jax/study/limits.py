"""The limits that a study sets to its experiments."""

from collections.abc import Sequence

import jax.numpy as jnp

from hsed_jax.config.schema import LimitsEntry
from hsed_jax.design.feasible import Limits
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.physics.names import named, of_each, owner_of
from hsed_jax.physics.outputs import QUANTITIES, further, is_quantity
from hsed_jax.physics.simulator import AbstractModel, Conditions


def limits_of(entry: LimitsEntry, model: AbstractModel, names: tuple[str, ...], space: InputSpace) -> Limits:
    """What specimen and actuator can bear.

    Arguments:
        entry: what the user said.
        model: of the planned experiments.
        names: of the model's free parameters.
        space: of the inputs.

    Raises:
        UserError: no limit is given, or one is of what the model does not predict.
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

    def respond(theta, point):
        parameters = dict(zip(names, theta, strict=False))
        response = model.respond(parameters, Conditions(space.inputs(point)), channels, quantities)
        values = dict(response.quantities)
        for name in channels:
            values[named(owner_of(name), "velocity")] = jnp.max(jnp.abs(response.channels[name]))
        return values, response.ok

    return Limits(most, entry.probability, respond)


def _of_all(quantity: str, owners: Sequence[str]) -> tuple[str, ...]:
    """A quantity of each specimen, or of the structure."""
    return of_each(owners, (quantity,)) if QUANTITIES[quantity].of_specimen else (quantity,)
