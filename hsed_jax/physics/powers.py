r"""Powers and the natural logarithm, as arithmetic that XLA vectorises.

XLA calls the C library for the logarithm of each double, one after the other.  A spring law raises its force to a power in each
stage of each step, so that these calls would take a seventh of a simulation.  Here $x = 2^k m$ with $\sqrt{1/2} \le m < \sqrt 2$,

$$\ln x = k\ln 2 + 2\,\mathrm{artanh}\,s,\qquad s = \frac{m - 1}{m + 1},$$

and artanh is its series up to $s^{19}$: since $|s| < 0.172$, the rest is below 3e-17 of the value.

Only the laws use it.  A program of the whole catalogue has thirty more logarithms, mostly of absent effects, and with this
arithmetic it would take half as long again to compile.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from hsed_jax.physics.scales import Scalar

# Bits of a double's significand, of √½ and of 2⁵², and the bias of its exponent.
_BITS, _ROOT, _WHOLE, _BIAS = 52, 0x3FE6A09E667F3BCD, 0x4330000000000000, 1023
_TERMS = 9


@jax.custom_jvp
def log(x: Scalar) -> Array:
    """ln x of a normal positive double, within three units in the last place; infinity and NaN stay."""
    x = jnp.asarray(x, float)
    bits = lax.bitcast_convert_type(x, jnp.int64)
    # The exponent keeps its bias until it is a double: AVX2 neither shifts negative integers of 64 bits nor converts them.
    biased = lax.shift_right_logical(bits - _ROOT + (_BIAS << _BITS), jnp.int64(_BITS))
    k = _double(biased | _WHOLE) - (2.0**_BITS + _BIAS)
    m = _double(bits - lax.shift_left(biased - _BIAS, jnp.int64(_BITS)))
    s = (m - 1) / (m + 1)
    z, series = s * s, 1 / (2 * _TERMS + 1)
    for i in reversed(range(_TERMS)):
        series = series * z + 1 / (2 * i + 1)
    return jnp.where(x < math.inf, k * math.log(2) + 2 * s * series, x)


@log.defjvp
def _slope(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    (x,), (change,) = primals, tangents
    return log(x), change / x


def power(base: Scalar, exponent: Scalar) -> Array:
    """A normal positive number to a real power."""
    return jnp.exp(exponent * log(base))


def _double(bits: Array) -> Array:
    return lax.bitcast_convert_type(bits, jnp.float64)
