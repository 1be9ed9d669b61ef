"""The correction of the kink at a reversal, for laws that integrate their force."""

from collections.abc import Callable

import jax.numpy as jnp

from hsed_jax.physics.laws.base import Memory, Scalar, Turn

# At a reversal the rate is zero; this small rate [m/s] represents its two sides.
_CREEP = 1e-6


def mended_force(
    turn: Turn,
    before: Memory,
    flow: Memory,
    after: Memory,
    rates: Callable[[Scalar, Scalar, Memory], Memory],
) -> tuple[Memory, Memory]:
    """States at the turn (or else the end), and at the end of the step, z mended; arguments as of `AbstractSpringLaw.mended`."""
    loading = flow["hysteretic"] / jnp.where(turn.happens, turn.before, 1.0)
    z_turn = before["hysteretic"] + loading * (turn.elongation - turn.start)
    at_turn = {**after, "hysteretic": z_turn}
    falling, growing = (rates(turn.elongation, rate, at_turn)["hysteretic"] / rate for rate in (-_CREEP, _CREEP))
    # With their signs and not as magnitudes: one choice at the end, and so in the derivatives.
    exact = 0.5 * turn.before * turn.share
    simpson = (turn.before + jnp.where(turn.share > 0.5, 2 * (turn.before + turn.after), 0.0)) / 6
    missed = jnp.where(turn.before > 0, exact - simpson, simpson - exact)
    shift = jnp.where(turn.happens, turn.length * (growing - falling) * missed, 0.0)
    z_end = after["hysteretic"] + shift
    return {**after, "hysteretic": jnp.where(turn.happens, z_turn, z_end)}, {**after, "hysteretic": z_end}
