r"""Elastic response spectrum of a sampled ground motion.

The oscillator $\ddot x+2\zeta\omega\dot x+\omega^2x=-a_g$ has a closed solution while $a_g$ is linear in time, so a
recurrence from sample to sample is exact for the motion that is drawn through its samples (Nigam & Jennings 1969).  In
$y=\omega^2x$ and $w=\omega\dot x$, both accelerations, its coefficients stay near one from stiff to soft oscillators.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

# A stiff oscillator can peak between two samples of the motion, so the exact solution is also read at the quarters.
_PER_STEP = 4


class _State(NamedTuple):
    y: Float[Array, " k"]
    w: Float[Array, " k"]


@jax.jit
def response_spectrum(
    acceleration: Float[ArrayLike, " m"],
    step: ArrayLike,
    periods: Float[ArrayLike, " k"],
    damping_ratio: ArrayLike = 0.05,
) -> Float[Array, " k"]:
    r"""Elastic pseudo-acceleration $S_a(T)=(2\pi/T)^2\max_t|x|$ of one ground motion, shape (k,) [m/s²].

    The oscillator starts at rest and is evaluated until the last sample; append zeros to include the later response.  A batch
    of motions is `jax.vmap(response_spectrum, (0, None, None))(accelerations, step, periods)`.

    Source: Nigam & Jennings, Bull. Seism. Soc. Am. 59 (1969) 909–922.

    Arguments:
        acceleration: ground acceleration [m/s²] at constant step, linear in between, shape (m,).
        step: sampling interval [s].
        periods: natural periods T [s], shape (k,); at T = 0 the spectrum is the peak ground acceleration.
        damping_ratio: ζ, fraction of critical damping, 0 ≤ ζ < 1.
    """
    motion, periods, damping_ratio = jnp.asarray(acceleration), jnp.asarray(periods), jnp.asarray(damping_ratio)
    samples = jnp.arange(_PER_STEP * (motion.size - 1) + 1) / _PER_STEP
    fine = jnp.interp(samples, jnp.arange(motion.size), motion)

    is_rigid = periods == 0
    angle = 2 * jnp.pi * step / _PER_STEP / jnp.where(is_rigid, 1.0, periods)  # ω × step
    damped = jnp.sqrt(1 - jnp.square(damping_ratio))
    decay, c, s = jnp.exp(-damping_ratio * angle), jnp.cos(damped * angle), jnp.sin(damped * angle) / damped

    def advance(carry: tuple[_State, Array], ends: tuple[Array, Array]) -> tuple[tuple[_State, Array], None]:
        (y, w), peak = carry
        start, end = ends
        # Particular solution for a load that is linear in time: y = −a + 2ζ a′, w = −a′, with a′ = Δa / (ω × step).
        slope = (end - start) / angle
        y, w = y + start - 2 * damping_ratio * slope, w + slope
        y, w = (
            decay * ((c + damping_ratio * s) * y + s * w) - end + 2 * damping_ratio * slope,
            decay * ((c - damping_ratio * s) * w - s * y) - slope,
        )
        return (_State(y, w), jnp.maximum(peak, jnp.abs(y))), None

    rest = jnp.zeros_like(angle)
    (_, peak), _ = jax.lax.scan(advance, (_State(rest, rest), rest), (fine[:-1], fine[1:]))
    return jnp.where(is_rigid, jnp.max(jnp.abs(motion)), peak)
