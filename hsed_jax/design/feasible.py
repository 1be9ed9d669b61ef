r"""The allowed inputs of experiments. Excluded are inputs that exceed a limit of the specimen, inputs near failed
experiments, and inputs next to performed experiments.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hsed_jax.design.space import SAME_POINT
from hsed_jax.physics.batch import tiled_map

# A failure excludes candidates within about this distance of it in the unit cube, unless more experiments there succeeded.
_REACH = 0.1
_DRAWS = 8
# Share of the mean distance of so many experiments: balls of this radius never cover the cube.
_APART = 1 / 3


def near_failures(
    candidates: Float[np.ndarray, "M d"], failed: Float[np.ndarray, "F d"], succeeded: Float[np.ndarray, "S d"]
) -> np.ndarray:
    r"""Candidates where failure is more likely than success, (M,) bool.

    The probability of failure is that of a kernel classifier, $\sum_f k / (\tfrac12 + \sum_f k + \sum_s k)$ with
    $k = \exp(-\|x-x_i\|^2/2\ell^2)$ over failed f and completed s experiments (Nadaraya 1964; Watson 1964), the half being a
    prior success: far from every failure nothing is closed.

    Arguments:
        candidates: in the unit cube.
        failed, succeeded: experiments in the unit cube.
    """
    if not len(failed):
        return np.zeros(len(candidates), dtype=bool)

    def weight(points: np.ndarray) -> np.ndarray:
        squared = np.sum((candidates[:, None] - points[None]) ** 2, axis=-1)
        return np.exp(-0.5 * squared / _REACH**2).sum(axis=1)

    failures, successes = weight(failed), weight(succeeded)
    return failures > 0.5 * (0.5 + failures + successes)


def too_near(
    candidates: Float[np.ndarray, "M d"], tested: Float[np.ndarray, "n d"], size: int, closed: Bool[np.ndarray, " M"]
) -> Bool[np.ndarray, " M"]:
    r"""Candidates next to an experiment, (M,): within $\tfrac13 N^{-1/d}$ of one, N experiments being planned over d inputs.

    The measurement of a nearby experiment is already known except for its noise.  If the distance would exclude all remaining
    candidates, it is halved until one is left.

    Arguments:
        candidates: in the unit cube.
        tested: experiments that were made or asked, in the unit cube.
        size: N.
        closed: candidates that are excluded for another reason.
    """
    from scipy.spatial import KDTree

    if not len(tested):
        return np.zeros(len(candidates), dtype=bool)
    distance, least = KDTree(tested).query(candidates)[0], _APART * size ** (-1 / candidates.shape[1])
    while (closed | (distance < least)).all() and least > SAME_POINT:
        least /= 2
    return distance < least


@dataclass(frozen=True)
class Limits:
    """The limits of specimen and actuator.

    Attributes:
        most: largest allowed value, SI, by name of the outputs that `respond` gives.
        probability: accepted probability of exceeding any of them.
        respond: from parameters of the model (p,) and a point of the unit cube (d,) to the peaks by name and whether the
            simulation converged.
    """

    most: Mapping[str, float]
    probability: float
    respond: Callable[[Array, Array], tuple[dict[str, Array], Array]]

    def __call__(self, draws: np.ndarray, candidates: Array) -> np.ndarray:
        """Candidates predicted to exceed a limit with more than the accepted probability, (M,) bool.

        Arguments:
            draws: of the posterior, (n, p); a few of them, spread over the chain, are used.
            candidates: in the unit cube, (M, d).
        """
        few = jnp.asarray(draws[:: max(1, len(draws) // _DRAWS)][:_DRAWS])
        broken = np.zeros(len(candidates))
        for theta in few:
            broken += np.asarray(self._broken(theta, candidates))
        return broken / len(few) > self.probability

    @cached_property
    def _broken(self):
        def one(theta, point):
            peaks, ok = self.respond(theta, point)
            over = jnp.stack([peaks[name] > limit for name, limit in self.most.items()]).any()
            # If the simulation diverges, the response is unknown.
            return over | ~(ok > 0)

        return jax.jit(lambda theta, points: tiled_map(jax.vmap(lambda point: one(theta, point)), points))
