"""The choice of the next experiment by an acquisition (`hsed_jax.design.acquisitions`), among the allowed candidates.

`choose` takes the candidate of largest utility that has not been tested yet.
"""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from hsed_jax.design.acquisitions.base import Acquisition
from hsed_jax.design.kriging import Kriging
from hsed_jax.design.space import SAME_POINT
from hsed_jax.programs import program


@final
class Restricted(eqx.Module):
    """Another acquisition among the allowed candidates."""

    acquisition: Acquisition
    closed: Bool[Array, " M"]

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """The utilities, −∞ where a candidate is closed."""
        return jnp.where(self.closed, -jnp.inf, self.acquisition(kriging, candidates, key))


@final
class PerCost(eqx.Module):
    """Another acquisition over the cost of each candidate: for an improvement, the improvement per unit of cost (Snoek
    et al. 2012).
    """

    acquisition: Acquisition
    costs: Float[Array, " M"]

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """The utilities less the logarithm of the cost."""
        return self.acquisition(kriging, candidates, key) - jnp.log(self.costs)


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
    acquisition: Acquisition,
    key: PRNGKeyArray,
) -> Choice:
    """The untested candidate of largest utility; among equal ones the first.

    **Arguments:**

    - `kriging`: model fitted to the experiments so far.
    - `candidates`: points of the unit cube to choose from, (M, d).
    - `excluded`: points not to be chosen again, (K, d): tested, or asked and still pending.  A candidate within
      `SAME_POINT` of one of them is passed over.
    - `excluded_mask`: true for the rows of `excluded` that count, (K,).
    - `acquisition`: the utilities of the candidates.
    - `key`: for acquisitions that draw; equal keys give equal choices.

    **Returns:** a `Choice`.  Under `jit`, a `log_value` of −∞ means that no candidate is left.

    **Raises:** `ValueError`, outside `jit`, if no candidate is left.
    """
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
    # A utility that is not a number is a fault of the acquisition; its candidate is not chosen.
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
