"""A reference for posteriors: differential evolution Markov chains (ter Braak 2006) on the simulator, from all over a Gaussian.

Many walkers, each of which steps along the difference of two walkers of the other half: no derivative, no emulator, no frame.
Slow, and right wherever it is run for long enough.
"""

from collections.abc import Callable

import numpy as np

_EVERY = 10


def walk(
    log_density: Callable[[np.ndarray], np.ndarray], centre: np.ndarray, covariance: np.ndarray, steps: int, seed: int,
    walkers: int = 192,
) -> np.ndarray:  # fmt: skip
    """Every tenth place of the walkers after a quarter of the steps, (steps kept, walkers, p)."""
    random, p, half = np.random.default_rng(seed), len(centre), walkers // 2
    places = random.multivariate_normal(centre, covariance, walkers)
    heights, kept, spread = log_density(places), [], 1e-5 * np.sqrt(np.diag(covariance))
    for step in range(steps):
        for going, standing in ((slice(0, half), slice(half, None)), (slice(half, None), slice(0, half))):
            others = places[standing]
            first = random.integers(half, size=half)
            second = (first + random.integers(1, half, size=half)) % half
            length = np.where(random.uniform(size=half) < 0.1, 1.0, 2.38 / np.sqrt(2 * p))
            tried = places[going] + length[:, None] * (others[first] - others[second])
            tried = tried + spread * random.standard_normal((half, p))
            there = log_density(tried)
            taken = np.log(random.uniform(size=half)) < there - heights[going]
            places[going] = np.where(taken[:, None], tried, places[going])
            heights[going] = np.where(taken, there, heights[going])
        if step >= steps // 4 and step % _EVERY == 0:
            kept.append(places.copy())
    return np.asarray(kept)
