"""The expected improvement over the largest discrepancy so far (Eq. 14), by the Student t of the Kriging model."""

import functools
import math
from collections.abc import Sequence
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from hsed_jax.design.acquisitions.base import LEAST_SCALE, AbstractAcquisition, deviation
from hsed_jax.design.kriging import Kriging
from hsed_jax.design.teaching import LEAST_SHARE
from hsed_jax.registry import register

# Distances 0 to ∞ below the best are mapped to −1 to 1, and this one to 0: where a polynomial comes closest.
_CENTRE, _DEGREE = 4.0, 22
# Chebyshev's points of −1 to 1, and two matrices: values there to coefficients of his polynomials, and these to those of powers.
_POINTS = np.cos((np.arange(_DEGREE + 1) + 0.5) * np.pi / (_DEGREE + 1))
_FITTED = np.linalg.inv(np.polynomial.chebyshev.chebvander(_POINTS, _DEGREE))
_POWERS = np.zeros((_DEGREE + 1, _DEGREE + 1))
for _k in range(_DEGREE + 1):
    _POWERS[: _k + 1, _k] = np.polynomial.Chebyshev.basis(_k).convert(kind=np.polynomial.Polynomial).coef
# Gauss and Legendre over 0 to 1.
_NODES, _SHARES = (
    0.5 * (half + shift) for half, shift in zip(np.polynomial.legendre.leggauss(100), (1, 0), strict=True)
)


@final
@register
class ExpectedImprovement(AbstractAcquisition):
    """Where model and measurement may differ most (Eq. 14)."""

    use: ClassVar[str] = "the paper; a calibration that covers the worst"

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """Log-expected improvement over the largest Kriging mean among the tested points."""
        del key
        mean, variance = kriging.predict(candidates)
        best = jnp.max(kriging.tested_means())
        return log_expected_improvement(mean, kriging.scale_share * deviation(variance), best, kriging.degrees)

    @staticmethod
    def lesson(value: float, discrepancies: Sequence[float | None]) -> str:
        """The improvement as a share of the largest discrepancy."""
        known = [one for one in discrepancies if one is not None and math.isfinite(one)]
        if not known or not max(known) > 0:
            return ""
        share = 100 * value / max(known) if value >= LEAST_SHARE * max(known) else 0.0
        return f"whether the discrepancy exceeds the largest one so far: by {share:.3g} % of it, on average"


def expected_improvement(
    mean: Float[Array, " M"], scale: Float[Array, " M"], best: ScalarLike, degrees: ScalarLike
) -> Float[Array, " M"]:
    """Expected improvement for maximisation (Eq. 14; Jones, Schonlau & Welch 1998, Journal of Global Optimization 13).

    E[max(Y − best, 0)] for Y = mean + scale·T, T a Student t of ν degrees of freedom with distribution Ψ and density ψ:
    (mean − best)Ψ(z) + scale·(ν + z²)/(ν − 1)·ψ(z), z = (mean − best)/scale.  With ν → ∞ it is Eq. 14.
    In the response's units, never negative.  Arguments as in `log_expected_improvement`.
    """
    return jnp.exp(log_expected_improvement(mean, scale, best, degrees))


@jax.jit
def log_expected_improvement(
    mean: Float[Array, " M"], scale: Float[Array, " M"], best: ScalarLike, degrees: ScalarLike
) -> Float[Array, " M"]:
    """Natural logarithm of the expected improvement, accurate where the improvement itself is zero in floats.

    The aim is that of Ament, Daulton, Eriksson, Balandat & Bakshy (2023, arXiv 2310.20708).  Values and gradients are finite,
    also at a scale of zero, where the improvement is mean − best if that is positive and otherwise too small to matter.

    **Arguments:** `mean`, `scale`: location and scale of the Kriging's Student t, (M,); `best`: largest Kriging mean among
    the tested points (μ_max), a scalar; all in the response's units; `degrees`: ν, above 1.

    **Returns:** log of the improvement, (M,).
    """
    scale = jnp.maximum(scale, LEAST_SCALE)
    improvement, log_unit = _standard_improvement((mean - best) / scale, degrees)
    # One logarithm of the product, not two: a logarithm is the most expensive operation here.
    return log_unit + jnp.log(scale * improvement)


@jax.jit
def log_standard_improvement(z: Float[Array, " M"], degrees: ScalarLike) -> Float[Array, " M"]:
    """The log-expectation of max(T + z, 0) for a standard Student t of so many degrees of freedom."""
    improvement, log_unit = _standard_improvement(z, degrees)
    return log_unit + jnp.log(improvement)


def _standard_improvement(z: Float[Array, " M"], degrees: ScalarLike) -> tuple[Float[Array, " M"], Float[Array, " M"]]:
    """E[max(T + z, 0)] in a unit that keeps it from vanishing, and the logarithm of the unit: ψ below zero, or else one.

    With t = |z| and H(t) = E[max(T − t, 0)] it is H(t) below zero and z + H(t) above: nothing cancels on either side.
    """
    below = z < 0
    t = jnp.where(below, -z, z)
    nu = jnp.asarray(degrees, dtype=z.dtype)
    wide = 1.0 + t**2 / nu
    log_density = _log_peak(nu) - 0.5 * (nu + 1.0) * jnp.log(wide)
    # One polynomial for every t: a separate formula for the tail would be evaluated for all candidates.
    coefficients, last = _ratio_of_tails(nu)
    share = _CENTRE / (t / jnp.sqrt(wide) + _CENTRE)
    y = 4.0 * (1.0 - share) / (last + 1.0) - 1.0
    ratio = wide * functools.reduce(lambda value, coefficient: value * y + coefficient, coefficients[::-1]) * share**2
    improvement = jnp.where(below, ratio, z + jnp.exp(log_density) * ratio)
    return improvement, jnp.where(below, log_density, 0.0)


def _log_peak(nu: Float[Array, ""]) -> Float[Array, ""]:
    """log ψ(0)."""
    return gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * jnp.log(nu * np.pi)


def _ratio_of_tails(nu: Float[Array, ""]) -> tuple[Float[Array, " q"], Float[Array, ""]]:
    """Coefficients of (1 + s/c)²H(t)/(ψ(t)(1 + t²/ν)) as a polynomial, lowest power first, and the last place v of its domain.

    The variable is s = t/√(1 + t²/ν), which goes from 0 to √ν, at v = (s − c)/(s + c), −1 to `last`, stretched to −1 to 1; c
    is `_CENTRE`. The ratio without its factor is ∫ x (1 + (2sx + x²)/ν)^(−(ν + 1)/2) dx over x > 0: smooth in s, and exact to
    1e-13 here.
    """
    last = (jnp.sqrt(nu) - _CENTRE) / (jnp.sqrt(nu) + _CENTRE)
    v = 0.5 * (_POINTS + 1.0) * (last + 1.0) - 1.0
    s = _CENTRE * (1.0 + v) / (1.0 - v)
    width = 3.0 / (1.0 + s[:, None])
    x = width * _NODES / (1.0 - _NODES)
    height = x * jnp.exp(-0.5 * (nu + 1.0) * jnp.log1p((2.0 * s[:, None] * x + x**2) / nu))
    values = (1.0 + s / _CENTRE) ** 2 * ((height * width) @ (_SHARES / (1.0 - _NODES) ** 2))
    # The product of both matrices is not used, because its large entries would cancel.
    return jnp.asarray(_POWERS @ (_FITTED @ values)), last
