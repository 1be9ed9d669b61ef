"""Cycles, branches and energies of a measured loop."""

import numpy as np

from hsed_jax.measurements import half_cycles


def cycle_numbers(elongation: np.ndarray) -> np.ndarray:
    """Number of the cycle that each sample belongs to, from 0.

    A cycle is an excursion to the side of the first one and the return from the other side: it ends where the elongation
    crosses zero (or the middle of its range, where it keeps to one side) in the direction of the first excursion.  A small
    hysteresis (5 % of the largest) keeps noise from ending cycles.
    """
    swing = elongation - 0.5 * (elongation.max() + elongation.min())
    if np.abs(elongation).max() > 0 and elongation.min() < 0 < elongation.max():
        swing = elongation
    dead = 0.05 * np.abs(swing).max()
    state = np.where(swing > dead, 1, np.where(swing < -dead, -1, 0))
    excursions = np.flatnonzero(state)
    if not excursions.size:
        return np.zeros(state.size, dtype=int)
    # What comes before the first excursion belongs to it.
    known = np.maximum.accumulate(np.where(state != 0, np.arange(state.size), excursions[0]))
    settled = state[known] * state[excursions[0]]
    return np.cumsum(np.diff(settled, prepend=settled[:1]) > 0)


def absorbed_energy(force: np.ndarray, elongation: np.ndarray) -> np.ndarray:
    """Work done on the specimen up to each sample [J], by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(elongation))])


def energy_per_cycle(force: np.ndarray, elongation: np.ndarray) -> np.ndarray:
    """Energy absorbed in each cycle [J]."""
    cycles = cycle_numbers(elongation)
    work = np.diff(absorbed_energy(force, elongation), prepend=0.0)
    return np.bincount(cycles, weights=work)


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
