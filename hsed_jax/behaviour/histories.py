r"""The numerical experiments on a fitted specimen: a loading history, then a loop that shows the behaviour.

Two sets of histories are imposed.  The first fills the range of the data: amplitude, path, rest and speed of each history are
a point of a Sobol' sequence, so that the influences of these variables can be separated.  The second follows the reversals of
a test up to several places along its path.  Every history ends with the same loop,

    0 → a → −a → a, and a rest at a.

A cycle to the largest elongations of both sides may follow, a → A⁺ → A⁻.  It shows the strength: in a pinched specimen, the
force at the smaller a falls although the strength stays.

Legs have a constant speed, except for a short stretch at both ends, where the speed changes linearly. The elongation is
therefore smooth at a reversal, and a force that depends on the rate has a jump there.
"""

import itertools
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.measurements.turns import half_cycles

# Shares of the time of a leg: for the acceleration, and for small steps of the force; each has an eighth of the steps.
_RAMP, _CLOSE = 0.01, 0.04
# Amplitude of the loop over the largest elongation; a smaller loop lets the largest elongation differ between
# histories.
_LOOP = 0.5
# Amplitudes of histories over the largest elongation, and speeds of the loop over the characteristic rate.
_AMPLITUDES, _SPEEDS = (0.1, 1.0), (0.1, 1.0)
# Reversals of a history at most; smaller ones of a test are left out.
_MOST = 200
# Steps of a leg at least, and of a rest at most; one of a rest is this share of the time that the largest elongation takes.
_LEAST, _RESTING, _REST_STEP = 32, 240, 0.1
# Places along the path of a test.
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)


class Range(NamedTuple):
    """The range of the data.

    Attributes:
        turns: elongations at the reversals of the test with the longest path, from zero on [m], (r,).
        rate: characteristic rate of the elongation [m/s].
        has_time: whether rates and rests are known.
    """

    turns: Float[np.ndarray, " r"]
    rate: float
    has_time: bool = True

    @property
    def elongation(self) -> float:
        """The largest one [m]."""
        return float(np.abs(self.turns).max())

    @property
    def path(self) -> float:
        """Its length [m]."""
        return float(np.abs(np.diff(self.turns)).sum())


class Imposition(NamedTuple):
    """Imposed elongations.

    Attributes:
        elongation, rate: on the half-step grid [m], [m/s], (B, 2n+1).
        lengths: of the steps [s], zero before a history begins, (B, n).
    """

    elongation: Float[np.ndarray, "B half"]
    rate: Float[np.ndarray, "B half"]
    lengths: Float[np.ndarray, "B n"]


class Histories(NamedTuple):
    """Imposed elongations that end with the same loop.

    Attributes:
        imposed: the elongations of B histories.
        ends: number of the step at which the loop begins, and at which its legs and its rest end, (5,); with a cycle to the
            largest elongation also those at its two turns, (7,).
        speed: of the loop [m/s], (B,).
        rest: before the loop [s], (B,).
    """

    imposed: Imposition
    ends: tuple[int, ...]
    speed: Float[np.ndarray, " B"]
    rest: Float[np.ndarray, " B"]


class _Leg(NamedTuple):
    start: float
    end: float
    duration: float
    steps: int


def range_of(elongation: Float[np.ndarray, " n"], rate: float, has_time: bool = True) -> Range:
    """The path of a record of the elongation, from zero on [m]."""
    u = np.concatenate([[0.0], elongation[np.isfinite(elongation)]])
    return Range(u[half_cycles(u)], rate, has_time)


def over_the_range(visited: Range, step: float, count: int = 32, *, to_largest: bool = False) -> Histories:
    """Histories that fill the range.

    Arguments:
        visited: by the data.
        step: the longest change of the elongation in a step [m].
        count: a power of two.
        to_largest: a cycle to the largest elongation follows each loop.
    """
    from scipy.stats import qmc

    points = qmc.Sobol(4, rng=0).random(count)
    low, high = _AMPLITUDES
    amplitudes = visited.elongation * (low + (high - low) * points[:, 0])
    counts = np.minimum(visited.path * points[:, 1] / (2 * amplitudes), _MOST).astype(int)
    rests = _longest_rest(visited) * points[:, 2] * visited.has_time
    slow, fast = _SPEEDS
    speeds = visited.rate * (fast * (slow / fast) ** points[:, 3] if visited.has_time else np.full(count, fast))
    runs = [
        [
            *_through(
                np.asarray([0.0, *(amplitude * (-1) ** k for k in range(number)), 0.0]), 0.5 * visited.rate, step
            ),
            *_rest(0.0, rest, visited),
            *_loop(visited, speed, step, to_largest),
        ]
        for amplitude, number, rest, speed in zip(amplitudes, counts, rests, speeds, strict=True)
    ]
    return _joined(runs, speeds, rests, to_largest)


def along_the_test(visited: Range, step: float) -> Histories:
    """The reversals of the test up to each of `PLACES` along its path, with a cycle to the largest elongation; arguments as of
    `over_the_range`."""
    turns = largest_changes(visited.turns, _MOST)
    passed = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(turns)))])
    runs = []
    for place in PLACES:
        done = turns[passed <= place * passed[-1] * (1 + 1e-12)]
        settled = _settled(done, _LOOP * visited.elongation)
        runs.append([*_through(settled, 0.5 * visited.rate, step), *_loop(visited, visited.rate, step, True)])
    return _joined(runs, np.full(len(PLACES), visited.rate), np.zeros(len(PLACES)), True)


def _settled(turns: Float[np.ndarray, " r"], loop: float) -> Float[np.ndarray, " k"]:
    """The reversals to zero; after the last one beyond the loop, over a half cycle to the other side, with an amplitude between
    both.  Otherwise the force at zero, and with it the loop, would depend on the branch that the test ended on."""
    beyond = turns[np.abs(turns) > loop]
    if not beyond.size:
        return np.asarray([*turns, 0.0])
    side = np.sign(beyond[-1])
    most = max(np.max(-side * turns), loop)
    return np.asarray([*turns, -side * min(0.5 * (abs(beyond[-1]) + loop), most), 0.0])


def largest_changes(turns: Float[np.ndarray, " r"], most: int) -> Float[np.ndarray, " k"]:
    """Reversals from zero on, of which the largest changes are kept in their order, if there are more than `most`."""
    if len(turns) <= most:
        return turns
    kept = np.sort(np.argsort(-np.abs(np.diff(turns)), kind="stable")[:most])
    return np.concatenate([[0.0], turns[kept + 1]])


def imposed(turns: Sequence[np.ndarray], rates: Sequence[float], step: float) -> Imposition:
    """Histories through given reversals.

    Arguments:
        turns: elongations from zero on [m], by history, (r,) each.
        rates: of the elongation [m/s], by history.
        step: the longest change of the elongation in a step [m].
    """
    return _padded([_through(own, rate, step) for own, rate in zip(turns, rates, strict=True)])[0]


def _through(turns: np.ndarray, rate: float, step: float) -> list[_Leg]:
    return [_leg(a, b, rate, step) for a, b in itertools.pairwise(turns) if a != b]


def _loop(visited: Range, speed: float, step: float, to_largest: bool) -> list[_Leg]:
    a = _LOOP * visited.elongation
    # Each side as far as it was tested, at least to the end of the loop.
    highest, lowest = max(visited.turns.max(), a), min(visited.turns.min(), -a)

    def through(*turns: float) -> list[_Leg]:
        return [_leg(start, end, speed, step) for start, end in itertools.pairwise(turns)]

    rest = _rest(a, _longest_rest(visited), visited) or [_Leg(a, a, 0.0, 8)]
    return [*through(0.0, a, -a, a), *rest, *(through(a, highest, lowest) if to_largest else [])]


def _longest_rest(visited: Range) -> float:
    return _RESTING * _REST_STEP * visited.elongation / visited.rate


def _rest(at: float, duration: float, visited: Range) -> list[_Leg]:
    if not (duration > 0 and visited.has_time):
        return []
    return [_Leg(at, at, duration, math.ceil(duration / (_REST_STEP * visited.elongation / visited.rate)))]


def _leg(start: float, end: float, speed: float, step: float) -> _Leg:
    size = abs(end - start)
    # Half of the steps are for all but the ends.
    steps = max(math.ceil(2 * size / step), _LEAST)
    return _Leg(start, end, size / speed / (1 - _RAMP), 8 * math.ceil(steps / 8))


def _joined(runs: Sequence[list[_Leg]], speeds: np.ndarray, rests: np.ndarray, to_largest: bool) -> Histories:
    imposition, size = _padded(runs)
    ends = size - np.cumsum([leg.steps for leg in reversed(runs[0][-6 if to_largest else -4 :])])
    return Histories(imposition, (*reversed(ends.tolist()), size), speeds, rests)


def _padded(runs: Sequence[list[_Leg]]) -> tuple[Imposition, int]:
    """Legs of each history as one course, all with the same number of steps."""
    steps = max(sum(leg.steps for leg in legs) for legs in runs)
    # A few sizes, so that a compiled program serves many specimens.
    size = 1 << max(steps - 1, 2047).bit_length()
    found = []
    for legs in runs:
        u, v, h = (np.concatenate(parts) for parts in zip(*map(_course, legs), strict=True))
        before = size - len(h)
        found.append((np.pad(u, (2 * before + 1, 0)), np.pad(v, (2 * before + 1, 0)), np.pad(h, (before, 0))))
    return Imposition(*(np.stack(rows) for rows in zip(*found, strict=True))), size


def _course(leg: _Leg) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Elongation and rate at the middle and the end of every step, and the lengths of the steps."""
    if leg.start == leg.end:
        still = np.full(2 * leg.steps, leg.start)
        return still, np.zeros(2 * leg.steps), np.full(leg.steps, leg.duration / leg.steps)
    nodes, passed, speed = _unit_leg(leg.steps)
    size = leg.end - leg.start
    return leg.start + size * passed, size / (leg.duration * (1 - _RAMP)) * speed, leg.duration * np.diff(nodes)


@lru_cache(256)
def _unit_leg(steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A leg from 0 to 1 in a time of 1: the ends of its steps; the way and the share of the speed at their middles and ends."""
    shares = [0.0, _RAMP, _CLOSE, 1 - _CLOSE, 1 - _RAMP, 1.0]
    nodes = np.interp(np.arange(steps + 1), steps * np.asarray([0, 1, 2, 6, 7, 8]) / 8, shares)
    at = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))[1:]
    speed = np.clip(np.minimum(at, 1 - at) / _RAMP, 0.0, 1.0)
    return nodes, np.where(at < 0.5, _ramped(at), (1 - _RAMP) - _ramped(1 - at)) / (1 - _RAMP), speed


def _ramped(share: np.ndarray) -> np.ndarray:
    """The integral of the speed over a share of the time, in units of the full speed."""
    return 0.5 * np.minimum(share, _RAMP) ** 2 / _RAMP + np.maximum(share - _RAMP, 0.0)
