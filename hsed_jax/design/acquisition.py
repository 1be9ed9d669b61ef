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
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, ScalarLike

from hsed_jax.design.kriging import Kriging
from hsed_jax.programs import program

Acquisition = Callable[[Kriging, Float[Array, "M d"], PRNGKeyArray], Float[Array, " M"]]

# Two inputs of the unit cube closer than this are the same experiment.
SAME_POINT = 1e-6
# Floor of a standard deviation, below any response's rounding; with it (difference/deviation)² stays a finite number.
_LEAST_DEVIATION = 1e-60
# Distances 0 to ∞ below the best are mapped to −1 to 1, and this one to 0: where a polynomial comes closest.
_CENTRE = 4.0


def _ratio_of_tails(y: np.ndarray) -> np.ndarray:
    """(1 + t/c)²(φ(t) − tΦ(−t))/φ(t) at y = (t − c)/(t + c), where c is `_CENTRE`: smooth from t = 0 to ∞.

    The ratio of both is ∫ x exp(−tx − x²/2) dx over x > 0, here in s = (t + c)x.
    """
    nodes, weights = np.polynomial.legendre.leggauss(60)
    s, tail = 20.0 * (nodes + 1.0), 0.5 * (1.0 - y[:, None]) / _CENTRE
    return 20.0 / _CENTRE**2 * np.exp(-s * (1.0 - _CENTRE * tail) - 0.5 * (s * tail) ** 2) @ (s * weights)


# Highest power first; exact to 4e-15.
_RATIO = np.polynomial.Chebyshev.interpolate(_ratio_of_tails, 22).convert(kind=np.polynomial.Polynomial).coef[::-1]


def expected_improvement(
    mean: Float[Array, " M"], deviation: Float[Array, " M"], best: ScalarLike
) -> Float[Array, " M"]:
    """Expected improvement for maximisation (Eq. 14; Jones, Schonlau & Welch 1998, Journal of Global Optimization 13).

    E[max(Y − best, 0)] for Y ~ N(mean, deviation²): (mean − best)Φ(z) + deviation·φ(z), z = (mean − best)/deviation.
    In the response's units, never negative.  Arguments as in `log_expected_improvement`.
    """
    return jnp.exp(log_expected_improvement(mean, deviation, best))


@jax.jit
def log_expected_improvement(
    mean: Float[Array, " M"], deviation: Float[Array, " M"], best: ScalarLike
) -> Float[Array, " M"]:
    """Natural logarithm of the expected improvement of Eq. 14, accurate where the improvement itself is zero in floats.

    The aim is that of Ament, Daulton, Eriksson, Balandat & Bakshy (2023, arXiv 2310.20708); the tail is a continued
    fraction here.  Values and gradients are finite, also at a deviation of zero, where the improvement is mean − best
    if that is positive and otherwise too small to matter.

    **Arguments:** `mean`, `deviation`: Kriging mean and standard deviation, (M,); `best`: largest Kriging mean among
    the tested points (μ_max), a scalar; all in the response's units.

    **Returns:** log of the improvement, (M,).
    """
    deviation = jnp.maximum(deviation, _LEAST_DEVIATION)
    improvement, log_unit = _standard_improvement((mean - best) / deviation)
    # One logarithm of the product, not two: of all that is done to a candidate here, a logarithm takes longest.
    return log_unit + jnp.log(deviation * improvement)


@jax.jit
def log_standard_improvement(z: Float[Array, " M"]) -> Float[Array, " M"]:
    """log(φ(z) + zΦ(z)), the log-expectation of max(Z + z, 0) for a standard normal Z."""
    improvement, log_unit = _standard_improvement(z)
    return log_unit + jnp.log(improvement)


def _standard_improvement(z: Float[Array, " M"]) -> tuple[Float[Array, " M"], Float[Array, " M"]]:
    """φ(z) + zΦ(z) in a unit that keeps it from vanishing, and the logarithm of the unit: φ below zero, or else one.

    With t = |z| and H(t) = φ(t) − tΦ(−t) it is H(t) below zero and z + H(t) above: nothing cancels on either side.
    """
    below = z < 0
    t = jnp.where(below, -z, z)
    log_density = -0.5 * t**2 - 0.5 * np.log(2.0 * np.pi)
    # H/φ as a polynomial, the same for every t: no tail of its own, whose cost all candidates would bear.
    share = _CENTRE / (t + _CENTRE)
    y = 1.0 - 2.0 * share
    ratio = functools.reduce(lambda value, coefficient: value * y + coefficient, _RATIO) * share**2
    improvement = jnp.where(below, ratio, z + jnp.exp(log_density) * ratio)
    return improvement, jnp.where(below, log_density, 0.0)


def improvement(kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
    """Log-expected improvement over the largest Kriging mean among the tested points (Eq. 14)."""
    del key
    mean, variance = kriging.predict(candidates)
    return log_expected_improvement(mean, _deviation(variance), jnp.max(kriging.tested_means()))


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
    return jnp.sqrt(jnp.maximum(variance, _LEAST_DEVIATION**2))
