"""Cycles, branches and energies of a measured loop."""

import numpy as np


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
    """Branch of the loop at each sample: `reversal`, `near zero`, `loading` or `unloading`.

    Near zero is a force below 15 % of the largest; a reversal is the 10 % of the amplitude after a turn of the elongation.
    """
    steps = np.gradient(elongation)
    towards = np.sign(steps)
    names = np.where(force * towards >= 0, "loading", "unloading").astype("<U9")
    turns = np.flatnonzero(np.diff(towards) != 0) + 1
    last = np.zeros(elongation.size, dtype=int)
    last[turns] = turns
    since = np.abs(elongation - elongation[np.maximum.accumulate(last)])
    names[
        (since < 0.1 * np.abs(elongation).max()) & (np.arange(elongation.size) >= (turns[0] if turns.size else np.inf))
    ] = "reversal"
    names[np.abs(force) < 0.15 * np.abs(force).max()] = "near zero"
    return names
