r"""The correction of the kink at a reversal, for laws that integrate their force.

Along the elongation the force z of such a law has the slope g₊ where the elongation grows and g₋ where it falls, so its rate
$\dot z = g_\pm v$, v = Δu̇, has a kink where v passes zero, and Runge–Kutta loses its order in the step of length h that holds it.

Let v be linear in that step, from v₀ to v₁ of the other sign, zero at the share θ of it, and let g be constant on each side: g_b
before the turn, g_a after it.  The **exact** integral is that of two triangles,

$$\Delta z = h\,\big(g_b\,\tfrac12\theta v_0 + g_a\,\tfrac12(1-\theta)v_1\big).$$

The classical Runge–Kutta method integrates a right-hand side that does not depend on the state by **Simpson's rule**, which
takes the middle of the step, v = (v₀+v₁)/2, with the slope of the side it is on,

$$\Delta z_S = \tfrac h6\big(g_b v_0 + 4\,g_m\tfrac{v_0+v_1}2 + g_a v_1\big),\qquad
  g_m = g_b\ \text{if}\ \theta>\tfrac12\ \text{else}\ g_a.$$

In both, the factors of g_b and g_a add up to h(v₀+v₁)/2, so the difference is a multiple of the jump of the slope:

$$\Delta z - \Delta z_S = h\,(g_b-g_a)\Big[\tfrac12\theta v_0-\tfrac16\big(v_0+2(v_0+v_1)\,[\theta>\tfrac12]\big)\Big]
  = h\,(g_+-g_-)\Big[\tfrac12\theta|v_0|-\tfrac16\big(|v_0|+2(|v_0|-|v_1|)\,[\theta>\tfrac12]\big)\Big],$$

for both directions of the reversal.  It is added to z.  The slopes are those at the turn, where z follows the branch before
it, $z_{turn} = z_0 + \frac{dz}{d\Delta u}\big|_0\,(\Delta u_{turn}-\Delta u_0)$, which is also the force at the peak.
"""

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
