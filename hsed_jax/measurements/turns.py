"""The turns of an elongation, and the cycles and branches between them.

A turn counts if it exceeds the noise.  A step back that is small compared with the path before or after it does not
count as a turn of the loading. Examples are a slip of the actuator and a correction by its controller.  A hold, in
which the elongation rests, has no turn.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements.noise import noise_estimate

_SLIP = 0.15
"""A step back below this share of the way beside it is a slip."""
_NOISE = 6.0
"""A turn exceeds the noise so many times."""
_LEAST, _MOST = 0.002, 0.02
"""Limits of the slack for the noise, as shares of the range."""
_REST = 0.1
"""A cycle begins and ends at zero within this share of its peak."""


class Span(NamedTuple):
    """A cycle in its record.

    Attributes:
        begin, end: first sample, and the one after the last.
        is_whole: whether it is complete, with a peak on either side.
        is_fragment: whether it is the end of a cycle that began before the record: it has no peak.
        is_about_zero: whether it goes about zero; otherwise it goes from a turn to the second turn after it, and each
            turn is a peak.
    """

    begin: int
    end: int
    is_whole: bool
    is_fragment: bool = False
    is_about_zero: bool = True


def half_cycles(elongation: np.ndarray) -> np.ndarray:
    """Samples at which the elongation turns, the first and the last sample included, (h+1,).

    A turn has at least 2 % of the range, so that noise does not make turns.
    """
    return _zigzag(elongation, 0.02 * float(np.ptp(elongation)))


def turns(elongation: np.ndarray) -> np.ndarray:
    """Samples at which the loading turns, the first and the last sample included, (h+1,); slips are left out.

    Cycles far below the largest have their turns, too, as long as they exceed the noise.
    """
    found = with_slips(elongation).tolist()
    while len(found) > 3:
        values = elongation[found]
        ways = np.abs(np.diff(values))
        inner, beside = ways[1:-1], np.stack([ways[:-2], ways[2:]])
        # A path from one side of zero to the other is never a slip, because cycles grow by any factor.
        is_slip = (inner <= beside.min(axis=0)) & (inner < _SLIP * beside.max(axis=0))
        is_slip &= values[1:-2] * values[2:-1] > 0
        if not is_slip.any():
            break
        least = 1 + int(np.flatnonzero(is_slip)[np.argmin(inner[is_slip])])
        del found[least : least + 2]
    return np.asarray(found)


def with_slips(elongation: np.ndarray) -> np.ndarray:
    """Samples at which the elongation turns by more than its noise, slips and both ends included, (h+1,)."""
    reach = float(np.ptp(elongation))
    noise = noise_estimate(np.arange(elongation.size), elongation) if elongation.size >= 8 else 0.0
    return _zigzag(elongation, float(np.clip(_NOISE * noise, _LEAST * reach, _MOST * reach)))


def spans(elongation: np.ndarray) -> list[Span]:
    """The cycles of a record, in order; together they hold every sample.

    A cycle has an excursion to the side of the first excursion, one to the other side, and the return: it ends where
    the elongation crosses zero in the direction of the first excursion. If most of the paths between two turns do not
    cross zero, because the test stays on one side or cycles about another mean, a cycle goes from a turn to the second
    turn after it.

    A record that begins in the middle of a cycle, as a window may, has its first cycle there. If it begins after the
    peak of an excursion, the rest of the excursion is a separate fragment, and the first cycle follows.
    """
    elongation = np.asarray(elongation, dtype=float)
    if elongation.size < 3 or not np.ptp(elongation) > 0:
        return [Span(0, elongation.size, False)]
    found = turns(elongation)
    if found.size < 3:
        return [Span(0, elongation.size, False)]
    values = elongation[found]
    crossing = np.count_nonzero(values[:-1] * values[1:] < 0)
    ways = len(found) - 1
    # The first path and the last one may begin and end at zero.
    ends = int(abs(values[0]) < _REST * abs(values[1])) + int(abs(values[-1]) < _REST * abs(values[-2]))
    if ways <= 2 or 2 * crossing >= ways - ends:
        return _about_zero(elongation, found)
    return _from_turn_to_turn(elongation, found)


def cycle_numbers(elongation: np.ndarray) -> np.ndarray:
    """Number of the cycle that each sample belongs to, from 0, (m,); `spans` defines a cycle."""
    return np.repeat(*np.asarray([(i, span.end - span.begin) for i, span in enumerate(spans(elongation))]).T)


def branches(force: np.ndarray, elongation: np.ndarray) -> np.ndarray:
    """Branch of the loop at each sample: `near zero`, `reversal`, `loading` or `unloading`.

    A force is near zero below a third of the largest in the half-cycle. A reversal is the first tenth of the path from
    one turn of the elongation to the next. Unloading is motion against the force.
    """
    ends = half_cycles(elongation)
    if ends.size < 2:
        return np.full(elongation.size, "loading", dtype="<U9")
    which = np.clip(np.searchsorted(ends, np.arange(elongation.size), side="right") - 1, 0, ends.size - 2)
    begin, way = elongation[ends[which]], np.diff(elongation[ends])[which]
    share = (elongation - begin) / np.where(way == 0, 1.0, way)
    peaks = np.maximum.reduceat(np.abs(force), ends[:-1])
    peaks = np.maximum(peaks, np.abs(force[ends[1:]]))[which]
    names = np.where(force * way >= 0, "loading", "unloading").astype("<U9")
    names[(share < 0.1) & (which > 0)] = "reversal"
    names[np.abs(force) < peaks / 3] = "near zero"
    return names


def frequencies(elongation: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Frequency of the half-cycle that each sample belongs to [Hz]; NaN where the elongation does not turn."""
    ends = half_cycles(elongation)
    if ends.size < 3:
        return np.full(elongation.size, np.nan)
    which = np.clip(np.searchsorted(ends, np.arange(elongation.size), side="right") - 1, 0, ends.size - 2)
    return (0.5 / np.diff(time[ends]))[which]


def _zigzag(elongation: np.ndarray, slack: float) -> np.ndarray:
    """Samples of turns of more than `slack`, the first and the last sample included."""
    found, highest, lowest, towards = [0], 0, 0, 0
    values = elongation.tolist()  # NumPy's own numbers cost this loop several times as much
    for i, value in enumerate(values):
        if towards >= 0 and value > values[highest]:
            highest = i
        if towards <= 0 and value < values[lowest]:
            lowest = i
        if towards >= 0 and values[highest] - value > slack:
            found.append(highest)
            towards, lowest = -1, i
        elif towards <= 0 and value - values[lowest] > slack:
            found.append(lowest)
            towards, highest = 1, i
    return np.unique([*found, elongation.size - 1])


def _about_zero(elongation: np.ndarray, found: np.ndarray) -> list[Span]:
    """Cycles between crossings of zero."""
    values = elongation[found]
    # Excursions: turns on one side of zero, as [side, first turn, last turn].
    excursions: list[list[int]] = []
    for turn, value in enumerate(values):
        is_end = turn in (0, values.size - 1)
        beside = values[1] if turn == 0 else values[-2]
        if is_end and values.size > 2 and abs(value) <= _REST * abs(beside):
            continue  # a record begins and ends near zero, and that is no excursion
        side = 1 if value > 0 else -1
        if excursions and excursions[-1][0] == side:
            excursions[-1][2] = turn
        else:
            excursions.append([side, turn, turn])
    begins = [0]
    for (side, _, last), (_, first, _) in pairwise(excursions):
        between = side * elongation[found[last] : found[first] + 1]
        begins.append(int(found[last]) + int(np.flatnonzero(between >= 0)[-1]) + 1)
    ends = [*begins[1:], elongation.size]
    # An excursion without a turn besides the first sample is the return from a peak before the record.
    is_fragment = len(excursions) > 1 and excursions[0][1:] == [0, 0]
    result = [Span(0, ends[0], False, True)] if is_fragment else []
    for first in range(int(is_fragment), len(excursions), 2):
        pair = excursions[first : first + 2]
        begin, end = begins[first], ends[first + len(pair) - 1]
        tops = [float(np.abs(values[a : b + 1]).max()) for _, a, b in pair]
        starts = first > 0 or abs(elongation[0]) <= _REST * tops[0]
        stops = end < elongation.size or abs(elongation[-1]) <= _REST * tops[-1]
        result.append(Span(begin, end, bool(len(pair) == 2 and starts and stops)))
    return result


def _from_turn_to_turn(elongation: np.ndarray, found: np.ndarray) -> list[Span]:
    """Cycles from a turn to the second turn after it."""
    values, result = elongation[found], []
    for first in range(0, len(found) - 1, 2):
        last = min(first + 2, len(found) - 1)
        end = elongation.size if last == len(found) - 1 else int(found[last])
        back = abs(values[last] - values[first + 1]) if last > first + 1 else 0.0
        is_whole = bool(back >= 0.5 * abs(values[first + 1] - values[first]))
        result.append(Span(int(found[first]), end, is_whole, is_about_zero=False))
    return result
