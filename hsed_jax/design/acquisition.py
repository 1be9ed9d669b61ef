"""Which candidate to test next: acquisition functions over a Kriging model, and the choice itself.

An acquisition gives every candidate a utility, on a logarithmic scale because the improvement still to be expected
falls far below the smallest float before a campaign ends.  `choose` takes the candidate of largest utility that has not
been tested yet.  A new acquisition is a function, or an `eqx.Module` with data of its own, called as
``acquisition(kriging, candidates, key)`` and returning one utility per candidate.
"""

import functools
from collections.abc import Callable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.scipy.special import gammaln
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, ScalarLike

from hsed_jax.design.kriging import Kriging
from hsed_jax.design.space import SAME_POINT
from hsed_jax.programs import program

Acquisition = Callable[[Kriging, Float[Array, "M d"], PRNGKeyArray], Float[Array, " M"]]

# Floor of a scale, below any response's rounding; with it (difference/scale)² stays a finite number.
_LEAST_SCALE = 1e-60
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
    scale = jnp.maximum(scale, _LEAST_SCALE)
    improvement, log_unit = _standard_improvement((mean - best) / scale, degrees)
    # One logarithm of the product, not two: of all that is done to a candidate here, a logarithm takes longest.
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
    # As a polynomial, the same for every t: no tail of its own, whose cost all candidates would bear.
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

    Of s = t/√(1 + t²/ν), which goes from 0 to √ν, at v = (s − c)/(s + c), −1 to `last`, stretched to −1 to 1; c is `_CENTRE`.
    The ratio without its factor is ∫ x (1 + (2sx + x²)/ν)^(−(ν + 1)/2) dx over x > 0: smooth in s, and exact to 1e-13 here.
    """
    last = (jnp.sqrt(nu) - _CENTRE) / (jnp.sqrt(nu) + _CENTRE)
    v = 0.5 * (_POINTS + 1.0) * (last + 1.0) - 1.0
    s = _CENTRE * (1.0 + v) / (1.0 - v)
    width = 3.0 / (1.0 + s[:, None])
    x = width * _NODES / (1.0 - _NODES)
    height = x * jnp.exp(-0.5 * (nu + 1.0) * jnp.log1p((2.0 * s[:, None] * x + x**2) / nu))
    values = (1.0 + s / _CENTRE) ** 2 * ((height * width) @ (_SHARES / (1.0 - _NODES) ** 2))
    # Not by the product of both matrices, whose entries are so large that they would cancel.
    return jnp.asarray(_POWERS @ (_FITTED @ values)), last


def improvement(kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
    """Log-expected improvement over the largest Kriging mean among the tested points (Eq. 14), of the Kriging's Student t."""
    del key
    mean, variance = kriging.predict(candidates)
    best = jnp.max(kriging.tested_means())
    return log_expected_improvement(mean, kriging.scale_share * _deviation(variance), best, kriging.degrees)


def max_variance(kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
    """Log of the Kriging variance (Eq. 11): learn the response everywhere rather than find its maximum."""
    del key
    return 2.0 * jnp.log(_deviation(kriging.predict(candidates)[1]))


def random_order(kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
    """Candidates in an order that `key` shuffles; the utility says nothing but the order."""
    del kriging
    return jnp.log(jax.random.uniform(key, (candidates.shape[0],), minval=jnp.finfo(candidates.dtype).tiny))


def given_order(kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
    """Candidates in the order they come, a space-filling design if that is Sobol's; the utility is only the order."""
    del kriging, key
    return -jnp.log1p(jnp.arange(candidates.shape[0], dtype=candidates.dtype))


@final
class Given(eqx.Module):
    """Log utilities that were computed elsewhere, of the first candidates; the others are not to be chosen."""

    log_utilities: Float[Array, " m"]

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """The utilities, padded to the candidates."""
        del kriging, key
        more = candidates.shape[0] - self.log_utilities.shape[0]
        return jnp.pad(self.log_utilities, (0, more), constant_values=-jnp.inf)


@final
class Restricted(eqx.Module):
    """Another acquisition among the candidates that may be asked."""

    acquisition: Acquisition
    closed: Bool[Array, " M"]

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """The utilities, −∞ where a candidate is closed."""
        return jnp.where(self.closed, -jnp.inf, self.acquisition(kriging, candidates, key))


@final
class PerCost(eqx.Module):
    """Another acquisition over what each candidate costs: of an improvement, that per unit of cost (Snoek et al. 2012)."""

    acquisition: Acquisition
    costs: Float[Array, " M"]

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """The utilities less the logarithm of the cost."""
        return self.acquisition(kriging, candidates, key) - jnp.log(self.costs)


ACQUISITIONS: dict[str, Acquisition] = {
    "expected_improvement": improvement,
    "max_variance": max_variance,
    "random": random_order,
    "sobol": given_order,
}


@final
class Choice(eqx.Module):
    """The candidate chosen: its index, its utility, the Kriging mean and standard deviation there."""

    index: Int[Array, ""]
    log_value: Float[Array, ""]
    value: Float[Array, ""]
    mean: Float[Array, ""]
    sd: Float[Array, ""]


def choose(
    kriging: Kriging,
    candidates: Float[Array, "M d"],
    excluded: Float[Array, "K d"],
    excluded_mask: Bool[Array, " K"],
    acquisition: str | Acquisition,
    key: PRNGKeyArray,
) -> Choice:
    """The untested candidate of largest utility; among equal ones the first.

    **Arguments:**

    - `kriging`: model fitted to the experiments so far.
    - `candidates`: points of the unit cube to choose from, (M, d).
    - `excluded`: points not to be chosen again, (K, d): tested, or asked and still pending.  A candidate within
      `SAME_POINT` of one of them is passed over.
    - `excluded_mask`: true for the rows of `excluded` that count, (K,).
    - `acquisition`: a name in `ACQUISITIONS` or a callable like those there.
    - `key`: for acquisitions that draw; equal keys give equal choices.

    **Returns:** a `Choice`.  Under `jit`, a `log_value` of −∞ says that no candidate was left.

    **Raises:** `ValueError` for an unknown name and, outside `jit`, if no candidate is left.
    """
    if isinstance(acquisition, str):
        if acquisition not in ACQUISITIONS:
            raise ValueError(
                f"Argument `acquisition` must be one of {', '.join(ACQUISITIONS)}, but is {acquisition!r}."
            )
        acquisition = ACQUISITIONS[acquisition]
    choice = _choose(kriging, candidates, excluded, excluded_mask, acquisition, key)
    if not isinstance(choice.log_value, Tracer) and float(choice.log_value) == -np.inf:
        raise ValueError(
            "Argument `candidates` must hold a point that has not been tested, but all"
            f" {candidates.shape[0]} have been. Draw more candidates."
        )
    return choice


@program
def _choose(kriging, candidates, excluded, excluded_mask, acquisition, key) -> Choice:
    utilities = acquisition(kriging, candidates, key)
    # A utility that is not a number is a failure of the acquisition there, and no reason to experiment.
    utilities = jnp.where(jnp.isnan(utilities), -jnp.inf, utilities)

    def is_repeated(state):
        utilities, index = state
        near = jnp.sum(jnp.square(excluded - candidates[index]), axis=1) < SAME_POINT**2
        return (utilities[index] > -jnp.inf) & jnp.any(near & excluded_mask)

    def next_best(state):
        utilities, index = state
        utilities = utilities.at[index].set(-jnp.inf)
        return utilities, _largest(utilities)

    # Only the best ones are compared with the excluded points, not all candidates.
    utilities, index = jax.lax.while_loop(is_repeated, next_best, (utilities, _largest(utilities)))
    mean, variance = kriging.predict(candidates[index][None])
    return Choice(index, utilities[index], jnp.exp(utilities[index]), mean[0], jnp.sqrt(variance[0]))


def _largest(utilities: Float[Array, " M"]) -> Int[Array, ""]:
    """Index of the first of the largest; `argmax` alone compares one after the other, a maximum several at once."""
    return jnp.argmax(utilities == jnp.max(utilities))


def sobol_candidates(count: int, dimensions: int, seed: int) -> Float[Array, "count dimensions"]:
    """The first `count` points of a scrambled Sobol sequence in the unit cube, (count, dimensions).

    A longer sequence of the same seed starts with the shorter one.

    **Raises:** `ValueError` if `count` or `dimensions` is less than 1.
    """
    if count < 1 or dimensions < 1:
        raise ValueError(f"Arguments `count` and `dimensions` must be at least 1, but are {count} and {dimensions}.")
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, scramble=True, rng=seed)
    # Sobol' sets are balanced at powers of two; SciPy warns about any other number.
    return jax.device_put(sequence.random_base2((count - 1).bit_length())[:count])


def _deviation(variance: Float[Array, " M"]) -> Float[Array, " M"]:
    # The square root's own derivative at zero is infinite.
    return jnp.sqrt(jnp.maximum(variance, _LEAST_SCALE**2))
