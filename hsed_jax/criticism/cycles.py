r"""Cycles and branches of a measured loop, and what engineers read from it.

Of cycle i with the largest elongation $u_i^+$ and the smallest $u_i^-$, and the forces $F_i^\pm$ there:

* the energy it absorbs, $E_i = \oint F\,\mathrm du$;
* its secant stiffness from peak to peak, $k_i = (F_i^+ - F_i^-)/(u_i^+ - u_i^-)$ (the effective stiffness of ASCE/SEI 41);
* the backbone, the line through the peaks $(u_i^\pm, F_i^\pm)$ at which the elongation exceeds that of all cycles before
  (FEMA 461).

Where a specimen unloads steeply, the force at the very sample of a reversal has fallen already.  So $F_i^\pm$ is the largest
force towards that side of the samples that lie within 0.5 % of the cycle's range of the peak, and of the two before the peak.  A
peak is a reversal: a record that begins beyond all that follows in its cycle has no peak there.

Cycles are those of the measured elongation; a prediction is read over the same samples.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements import half_cycles

# Samples that count as a peak: within this share of the range of the cycle, and so many before it.
_NEAR, _BEFORE = 0.005, 2
# A peak is reached from further away than this share of its size.
_REACHED = 0.05
# A further peak of the backbone exceeds those before by this share.
_FURTHER = 0.02
# A cycle that absorbs less than this share of the rectangle around it, below zero, returns more than it was given.
_RETURNED = 0.02


def cycle_numbers(elongation: np.ndarray) -> np.ndarray:
    """Number of the cycle that each sample belongs to, from 0.

    A cycle is an excursion to the side of the first one and the return from the other side: it ends where the elongation
    crosses zero (or the middle of its range, where it keeps to one side) in the direction of the first excursion.  A small
    hysteresis (5 % of the largest) keeps noise from ending cycles.
    """
    state = _sides(elongation)
    excursions = np.flatnonzero(state)
    if not excursions.size:
        return np.zeros(state.size, dtype=int)
    # What comes before the first excursion belongs to it.
    known = np.maximum.accumulate(np.where(state != 0, np.arange(state.size), excursions[0]))
    settled = state[known] * state[excursions[0]]
    return np.cumsum(np.diff(settled, prepend=settled[:1]) > 0)


def _sides(elongation: np.ndarray) -> np.ndarray:
    """Side of each sample: 1 and -1 beyond the hysteresis, 0 within."""
    swing = elongation - 0.5 * (elongation.max() + elongation.min())
    if np.abs(elongation).max() > 0 and elongation.min() < 0 < elongation.max():
        swing = elongation
    dead = 0.05 * np.abs(swing).max()
    return np.where(swing > dead, 1, np.where(swing < -dead, -1, 0))


def absorbed_energy(force: np.ndarray, elongation: np.ndarray) -> np.ndarray:
    """Work done on the specimen up to each sample [J], by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(elongation))])


def energy_per_cycle(force: np.ndarray, elongation: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Energy E absorbed in each cycle [J], (c,).

    Arguments:
        force, elongation: [N] and [m], (m,).
        cycles: number of the cycle of each sample, as `cycle_numbers` gives it, (m,).
    """
    work = np.diff(absorbed_energy(force, elongation), prepend=0.0)
    return np.bincount(cycles, weights=work)


def secant_stiffness(force: np.ndarray, elongation: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Stiffness k from peak to peak of each cycle [N/m], (c,); NaN of a cycle that is not on both sides.

    Arguments: as of `energy_per_cycle`.
    """
    peaks = _peaks(force, elongation, cycles)
    low, high = _sides(elongation)[peaks.at]
    is_whole = (low < 0) & (high > 0) & peaks.is_reversal.all(axis=0)
    (swing,), (rise,) = np.diff(peaks.elongation, axis=0), np.diff(peaks.force, axis=0)
    return np.where(is_whole, rise, np.nan) / np.where(is_whole, swing, 1.0)


def returned(force: np.ndarray, elongation: np.ndarray, cycles: np.ndarray) -> list[int]:
    """Numbers, from 1, of the cycles that return more energy than they were given, which no specimen does.

    Only cycles that are whole count: the last one, and one that is not on both sides, may end before it has taken up anything.

    Arguments: as of `energy_per_cycle`.
    """
    energy, peaks = energy_per_cycle(force, elongation, cycles), _peaks(force, elongation, cycles)
    low, high = _sides(elongation)[peaks.at]
    (swing,) = np.diff(peaks.elongation, axis=0)
    ranges = np.asarray([np.ptp(force[cycles == number]) for number in range(energy.size)])
    is_whole = (low < 0) & (high > 0) & peaks.is_reversal.all(axis=0)
    is_whole[-1] = False
    return [int(i) + 1 for i in np.flatnonzero(is_whole & (energy < -_RETURNED * swing * ranges))]


def backbone(force: np.ndarray, elongation: np.ndarray, cycles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elongation [m] and force [N] of the peaks beyond all cycles before, from the smallest elongation to the largest, (p,).

    A peak is one to the side of zero that it lies on; elongations that keep to one side have a backbone of one side.

    Arguments: as of `energy_per_cycle`.
    """
    peaks = _peaks(force, elongation, cycles)
    found = []
    for side, u, f, is_reversal in zip((-1.0, 1.0), peaks.elongation, peaks.force, peaks.is_reversal, strict=True):
        size = side * u
        before = np.concatenate([[0.0], np.maximum.accumulate(np.maximum(size, 0.0))[:-1]])
        further = is_reversal & (size > (1 + _FURTHER) * before)
        found += zip(u[further], f[further], strict=True)
    points = np.asarray(sorted(found)).reshape(-1, 2)
    return points[:, 0], points[:, 1]


class _Peaks(NamedTuple):
    """The smallest and the largest elongation of each cycle, (2, c) each: sample, elongation, force, and whether it is reached
    from elsewhere."""

    at: np.ndarray
    elongation: np.ndarray
    force: np.ndarray
    is_reversal: np.ndarray


def _peaks(force: np.ndarray, elongation: np.ndarray, cycles: np.ndarray) -> _Peaks:
    starts = np.flatnonzero(np.diff(cycles, prepend=-1))
    parts = [slice(a, b) for a, b in pairwise([*starts, cycles.size])]
    at, forces = np.zeros((2, len(parts)), dtype=int), np.zeros((2, len(parts)))
    for number, part in enumerate(parts):
        near = _NEAR * np.ptp(elongation[part])
        for row, side in enumerate((-1.0, 1.0)):
            size = side * elongation[part]
            top = int(np.argmax(size))
            is_peak = size >= size[top] - near
            is_peak[max(top - _BEFORE, 0) : top + 1] = True
            at[row, number] = part.start + top
            forces[row, number] = side * np.max(side * force[part][is_peak])
    reached = elongation[at]
    furthest = np.maximum(
        reached - np.minimum.accumulate(elongation)[at], np.maximum.accumulate(elongation)[at] - reached
    )
    return _Peaks(at, reached, forces, furthest > _REACHED * np.abs(reached))


def branches(force: np.ndarray, elongation: np.ndarray) -> np.ndarray:
    """Branch of the loop at each sample: `near zero`, `reversal`, `loading` or `unloading`.

    Near zero is a force below a third of the largest in the half-cycle; a reversal is the first tenth of the way from one
    turn of the elongation to the next; unloading is a force against the motion.
    """
    turns = half_cycles(elongation)
    if turns.size < 2:
        return np.full(elongation.size, "loading", dtype="<U9")
    which = np.clip(np.searchsorted(turns, np.arange(elongation.size), side="right") - 1, 0, turns.size - 2)
    begin, way = elongation[turns[which]], np.diff(elongation[turns])[which]
    share = (elongation - begin) / np.where(way == 0, 1.0, way)
    peaks = np.maximum.reduceat(np.abs(force), turns[:-1])
    peaks = np.maximum(peaks, np.abs(force[turns[1:]]))[which]
    names = np.where(force * way >= 0, "loading", "unloading").astype("<U9")
    names[(share < 0.1) & (which > 0)] = "reversal"
    names[np.abs(force) < peaks / 3] = "near zero"
    return names


def frequencies(elongation: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Frequency of the half-cycle that each sample belongs to [Hz]; NaN where the elongation does not turn."""
    turns = half_cycles(elongation)
    if turns.size < 3:
        return np.full(elongation.size, np.nan)
    which = np.clip(np.searchsorted(turns, np.arange(elongation.size), side="right") - 1, 0, turns.size - 2)
    return (0.5 / np.diff(time[turns]))[which]
