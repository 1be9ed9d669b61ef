r"""The measured response, from the true one: gains, zero shifts and delays of the measured force and elongation.

$$F_{meas}(t) = g_F\,r(t-\tau_F) + F_0 + F_1 e^{-\lambda t} + \dot F_0\tfrac1s\ln[1 + s\max(t - t_0, 0)],\qquad
  \Delta u_{meas}(t) = g_u\,\Delta u(t-\tau_u)$$

In a component test, the imposed elongation is the measured one. $\Delta u_{meas}$ is known, and the elongation of the
specimen is $\Delta u_{meas}(t-\tau_F+\tau_u)/g_u$, on the clock of the force.  Gains act on the quantities, too.  Shifts of
time and of zero act only on histories, and not on energy.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.gates import gated, in_any_simulation
from hsed_jax.physics.names import own_name, owner_of
from hsed_jax.physics.outputs import output
from hsed_jax.physics.response import Response
from hsed_jax.physics.scales import Scalar, is_zero
from hsed_jax.physics.timeline import times


def measured(
    response: Response,
    slots: Callable[..., Any],
    step_length: Float[Array, " steps"] | float,
    every: int,
    *,
    is_imposed: bool,
    is_gated: bool,
) -> Response:
    """The measured response.

    Arguments:
        response: the true one.
        slots: the contributions of the effects, by slot, and for the sensors of one of several specimens by its name.
        step_length: [s], one number or one per step.
        every: histories are kept at every so many steps.
        is_imposed: the elongation is imposed (a component test), as `felt` says.
        is_gated: an effect that no simulation of the batch has is not computed (`hsed_jax.physics.gates`).
    """

    def delay_of(owner: str, own: str) -> Scalar:
        lag, late = slots("elongation_delay", owner), slots("force_delay", owner)
        # For an imposed elongation: back from the felt elongation to the requested one.
        of_elongation = lag - late if is_imposed else lag
        of_force = 0.0 if is_imposed else late
        return {"force": of_force, "elongation": of_elongation, "elongation_rate": of_elongation}.get(own, 0.0)

    def gain(name: str) -> Scalar:
        return math.prod(slots(slot, owner_of(name)) for slot in output(name).gains)

    def sensed(name: str, values: Float[Array, " samples"]) -> Float[Array, " samples"]:
        time = times(step_length, every, values.shape[0])
        owner, own = owner_of(name), own_name(name)
        delay = delay_of(owner, own)
        values = _if_late(delay, is_gated, lambda: shifted(values, time, delay), values) * gain(name)
        if own != "force":
            return values
        drifting = _slowing(jnp.maximum(time - slots("drift_onset", owner), 0.0), slots("drift_slowing", owner))
        settling = slots("settling_offset", owner) * jnp.exp(-slots("settling_rate", owner) * time)
        return values + slots("force_offset", owner) + settling + slots("force_drift", owner) * drifting

    quantities = {name: value * gain(name) for name, value in response.quantities.items()}
    channels = {name: sensed(name, values) for name, values in response.channels.items()}
    return response._replace(quantities=quantities, channels=channels)


def _slowing(time: Float[Array, " samples"], slowing: Scalar) -> Float[Array, " samples"]:
    """ln(1 + s t)/s; the time itself for s = 0."""
    if is_zero(slowing):
        return time
    s = jnp.where(slowing == 0, 1.0, slowing)
    return jnp.where(slowing == 0, time, jnp.log1p(s * time) / s)


def felt(
    forcing: Tabulated, slots: Callable[[str], Any], step_length: Float[Array, " steps"], *, is_gated: bool
) -> Tabulated:
    """The elongation of the specimen in a component test, from the measured (imposed) one; `is_gated` as in `measured`."""
    gain, delay = slots("elongation_gain"), slots("force_delay") - slots("elongation_delay")

    def later() -> Imposed:
        time = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.repeat(0.5 * step_length, 2))])
        # The elongation is shifted because it is smooth; the force has a corner at every reversal.
        elongation, rate = (shifted(values, time, delay) for values in forcing.samples)
        # The specimen rests before the path begins; after its end the motion continues unchanged.
        beyond = jnp.maximum(time - delay - time[-1], 0.0)
        return Imposed(elongation + rate * beyond, jnp.where(time - delay >= time[0], rate, 0.0))

    def divided(values: Array) -> Array:
        return values / gain

    return Tabulated(jax.tree.map(divided, _if_late(delay, is_gated, later, forcing.samples)))


def _if_late[T](delay: Scalar, is_gated: bool, later: Callable[[], T], unchanged: T) -> T:
    """The shifted values, if any simulation of the batch has a delay [s].  A shift takes as long as half a simulation."""
    if is_zero(delay):
        return unchanged
    return gated(in_any_simulation(jnp.asarray(delay) != 0) if is_gated else None, later, lambda: unchanged)


def shifted(
    values: Float[Array, " samples"], time: Float[Array, " samples"], delay: Scalar
) -> Float[Array, " samples"]:
    """A history later by `delay` [s] (either sign), constant beyond its ends.

    Cubic Hermite interpolation, the slope at a sample that of the parabola through it and its neighbours.  Samples may be
    uneven, and times may repeat (a padded step has length zero).  No delay gives the same values to the last bit.
    """
    gaps = jnp.diff(time)
    is_padding = gaps == 0
    lengths = jnp.where(is_padding, 1.0, gaps)
    rises = jnp.diff(values) / lengths
    before, after = gaps[:-1], gaps[1:]
    both = jnp.where(is_padding[:-1] & is_padding[1:], 1.0, before + after)
    inner = (after * rises[:-1] + before * rises[1:]) / both
    # Beside padding, the slope is that of the side that has a length.
    inner = jnp.where(is_padding[1:], rises[:-1], jnp.where(is_padding[:-1], rises[1:], inner))
    slopes = jnp.concatenate([rises[:1], inner, rises[-1:]])
    wanted = jnp.clip(time - delay, time[0], time[-1])
    i = jnp.clip(jnp.searchsorted(time, wanted, side="right") - 1, 0, gaps.shape[0] - 1)
    share = (wanted - time[i]) / lengths[i]
    rest = 1 - share
    # In this form, shares 0 and 1 give the sample itself, without rounding.
    return (
        values[i] * (rest * rest * (1 + 2 * share))
        + values[i + 1] * (share * share * (3 - 2 * share))
        + lengths[i] * share * rest * (rest * slopes[i] - share * slopes[i + 1])
    )
