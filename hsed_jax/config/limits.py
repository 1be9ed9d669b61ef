"""The limits that a study sets to its experiments."""

import jax.numpy as jnp

from hsed_jax.config.schema import LimitsEntry
from hsed_jax.design.feasible import Limits
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.physics.outputs import QUANTITIES
from hsed_jax.physics.simulator import Conditions, Simulator


def limits_of(entry: LimitsEntry, simulator: Simulator, names: tuple[str, ...], space: InputSpace) -> Limits:
    """What specimen and actuator can bear.

    Arguments:
        entry: what the user said.
        simulator: of the planned ground motion.
        names: of the model's free parameters.
        space: of the inputs.

    Raises:
        UserError: no limit is given.
    """
    known = (entry.force, entry.stroke, entry.energy)
    most = {name: limit for name, limit in zip(QUANTITIES, known, strict=True) if limit is not None}
    if entry.velocity is not None:
        most["velocity"] = entry.velocity
    if not most:
        raise UserError("design.limits: give at least one of stroke, force, velocity, energy")
    channels = ("elongation_rate",) if "velocity" in most else ()

    def respond(theta, point):
        parameters = dict(zip(names, theta, strict=False))
        response = simulator.respond(parameters, Conditions(space.inputs(point)), channels)
        values = dict(response.quantities)
        if channels:
            values["velocity"] = jnp.max(jnp.abs(response.channels["elongation_rate"]))
        return values, response.ok

    return Limits(most, entry.probability, respond)
