"""The limits that a study sets to its experiments."""

import jax.numpy as jnp

from hsed_jax.config.schema import LimitsEntry
from hsed_jax.design.feasible import Limits
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.physics.outputs import QUANTITIES, further
from hsed_jax.physics.simulator import AbstractModel, Conditions


def limits_of(entry: LimitsEntry, model: AbstractModel, names: tuple[str, ...], space: InputSpace) -> Limits:
    """What specimen and actuator can bear.

    Arguments:
        entry: what the user said.
        model: of the planned ground motion.
        names: of the model's free parameters.
        space: of the inputs.

    Raises:
        UserError: no limit is given, or one is of what the model does not predict.
    """
    known = {known.limit: name for name, known in QUANTITIES.items() if known.limit is not None}
    most = {known[limit]: value for limit, value in entry.model_dump(include=set(known), exclude_none=True).items()}
    quantities = further(tuple(most))
    if entry.velocity is not None:
        most["velocity"] = entry.velocity
    if not most:
        raise UserError(f"design.limits: give at least one of {', '.join([*known, 'velocity'])}")
    channels = ("elongation_rate",) if "velocity" in most else ()

    for name in (*channels, *(name for name in most if name in QUANTITIES)):
        if not model.gives(name):
            raise UserError(f"design.limits: the model does not give {name}")

    def respond(theta, point):
        parameters = dict(zip(names, theta, strict=False))
        response = model.respond(parameters, Conditions(space.inputs(point)), channels, quantities)
        values = dict(response.quantities)
        if channels:
            values["velocity"] = jnp.max(jnp.abs(response.channels["elongation_rate"]))
        return values, response.ok

    return Limits(most, entry.probability, respond)
