r"""Draws of an approximate posterior moved by the simulator until they are draws of the posterior itself.

Weights make draws of the right density only where the approximation put some, and where many draws share few of the weights
little is left of a tail.  Steps that leave the posterior as it is mend both (resample and move; Gilks & Berzuini 2001): each draw
takes the step $x' = x + \gamma(x_a - x_b)$ along the difference of two others and is accepted by Metropolis' rule (differential
evolution; ter Braak 2006), so that steps are as long as the draws are wide, in every direction, and a step costs a simulation
and no derivative.  Draws that lack a tail widen as they move.  They have settled when nothing tells any more where each one was
half-way (Kantas, Beskos & Jasra 2014), and all of them together are as wide, and in the same place, as they were then.

Source: Gilks & Berzuini, J. R. Statist. Soc. B 63; ter Braak, Statistics and Computing 16; Kantas, Beskos & Jasra, SIAM/ASA J.
Uncertainty Quantification 2.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.inference.watch import Watch

# γ is this over √(2p), best for a Gaussian of p dimensions; of half of the steps a share of it, its logarithm uniform, since a
# thin bent ridge takes short steps alone; and of one in ten a whole difference, from a mode to another.
_LENGTH, _SHORTEST, _WHOLE = 2.38, 0.1, 0.1
# So many draws move at most; of more, places of these on their way take the place.
_WALKERS = 1000
# Rank correlation below which the place where a draw was is forgotten; sweeps between two looks, and the most of them.
_FORGOTTEN, _LOOK, _MOST = 0.1, 20, 800
# Moments that differ by fewer standard errors than this are the same.
_SAME = 2.0
# In units of the draws' standard deviation: what keeps steps from a lattice.
_JITTER = 1e-4


class Moved(NamedTuple):
    """Draws after their moves.

    Attributes:
        points: u, (N, p).
        height: log density there, (N,).
        settled: whether they have forgotten where they were half-way, and are as wide and in the same place as then.
        worth: how many independent draws they are at most.
    """

    points: Float[np.ndarray, "N p"]
    height: Float[np.ndarray, " N"]
    settled: bool
    worth: int


def moved(
    heights: Callable[[np.ndarray], np.ndarray],
    points: Float[np.ndarray, "N p"],
    height: Float[np.ndarray, " N"],
    random: np.random.Generator,
    watch: Watch,
    name: str,
    seconds: float | None = None,
) -> Moved:
    """Move draws until they have settled, or the budget of time or of sweeps ends.

    Arguments:
        heights: log density of many points, -inf where there is none.
        points, height: draws in u, and their log density.
        random: the source of the steps.
        watch: hears how far it is, and keeps the draws when they have moved.
        name: to keep them under.
        seconds: budget.
    """
    if (known := watch.recall(name)) is not None:
        return Moved(known[0], known[1], bool(known[2]), int(known[3]))
    began, wanted, settled = time.perf_counter(), len(points), False
    chosen = random.permutation(wanted)[:_WALKERS]
    points, height, count = points[chosen], height[chosen], points.shape[1]
    passed, kept = [points.copy()], [(points, height)]
    jitter = _JITTER * points.std(axis=0)
    watch.report("draws moved by the simulator")
    for sweep in range(1, _MOST + 1):
        # Those that move learn from those that stand: so every step leaves the posterior as it is.
        order = random.permutation(len(points))
        halves = order[: len(order) // 2], order[len(order) // 2 :]
        for going, standing in (halves, halves[::-1]):
            first = random.integers(len(standing), size=len(going))
            second = (first + random.integers(1, len(standing), size=len(going))) % len(standing)
            is_whole = random.uniform(size=len(going)) < _WHOLE
            share = _SHORTEST ** np.maximum(random.uniform(-1, 1, size=len(going)), 0.0)
            length = np.where(is_whole, 1.0, share * _LENGTH / np.sqrt(2 * count))
            step = points[standing[first]] - points[standing[second]]
            tried = points[going] + length[:, None] * step + jitter * random.standard_normal(step.shape)
            there = heights(tried)
            taken = np.log(random.uniform(size=len(going))) < there - height[going]
            points[going] = np.where(taken[:, None], tried, points[going])
            height[going] = np.where(taken, there, height[going])
        watch.count(sweep, _MOST)
        is_late = seconds is not None and time.perf_counter() - began > seconds
        if settled and (sweep % _LOOK == 0 or is_late):
            kept.append((points.copy(), height.copy()))
        elif sweep % _LOOK == 0:
            passed.append(points.copy())
            half = passed[len(passed) // 2]
            settled = _memory(half, points) < _FORGOTTEN and _are_alike(half, points)
            kept = [(points.copy(), height.copy())]
        if is_late or (settled and len(kept) * len(points) >= wanted):
            break
    rows = np.arange(wanted) % (len(kept) * len(points))
    of_points, of_height = (np.concatenate(part)[rows] for part in zip(*kept, strict=True))
    found = Moved(of_points, of_height, settled, min(wanted, len(points)))
    watch.keep(name, [np.asarray(part) for part in found])
    return found


def _memory(before: Float[np.ndarray, "N p"], after: Float[np.ndarray, "N p"]) -> float:
    """Largest rank correlation of a coordinate with itself (Spearman)."""
    ranks = (np.argsort(np.argsort(values, axis=0), axis=0) for values in (before, after))
    one, other = (rank - rank.mean(axis=0) for rank in ranks)
    return float(np.max(np.abs(np.sum(one * other, axis=0)) / np.sum(one**2, axis=0)))


def _are_alike(before: Float[np.ndarray, "N p"], after: Float[np.ndarray, "N p"]) -> bool:
    """Whether means and standard deviations of two sets of independent draws differ by no more than chance."""
    count, wide = len(after), after.std(axis=0)
    kurtosis = np.mean((after - after.mean(axis=0)) ** 4, axis=0) / wide**4
    of_means = np.abs(after.mean(axis=0) - before.mean(axis=0)) / (wide * np.sqrt(2 / count))
    of_widths = np.abs(np.log(wide / before.std(axis=0))) / np.sqrt((kurtosis - 1) / (2 * count))
    return bool(max(of_means.max(), of_widths.max()) < _SAME)
