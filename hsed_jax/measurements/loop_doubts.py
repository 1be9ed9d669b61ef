"""Doubts of a loop, from force and elongation together, with a time or without.

* A specimen unloads when its elongation turns.  The largest force lies at that turn or before it.  A force is late if
  its extreme comes after the turn, and early if it always comes some samples before it and falls at once as on unloading.
* Drifting zeros move the middle of every cycle in proportion to the rows, beyond what the amplitude explains.
* A step back that is faster than the loading is a slip; an elongation that rests while the force relaxes is a hold.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Record
from hsed_jax.measurements.findings import Finding
from hsed_jax.measurements.noise import noise_estimate
from hsed_jax.measurements.turns import turns, with_slips
from hsed_jax.physics.display import amount
from hsed_jax.physics.names import named
from hsed_jax.physics.outputs import loops

FEWEST = 4  # least number of turns for a statement on their timing
LATE = 0.15  # share of late turns; measured specimens have up to 0.03
EARLY, CYCLE = 0.6, 0.025  # share of early turns, and their lead as a share of a cycle; specimens have up to 0.015
# An early force falls before the turn at least by this share of its fall in as many samples after the turn: by a third where the
# elongation is a sine, by all of it where its rate is constant.  A specimen that softens falls by less.
FALLEN = 0.25
SIZE = 0.02  # share of the force of a half cycle; a smaller change is not a turn of the force
LONGEST = 0.2  # share of a cycle; a longer lag does not count
CYCLES, LINE, BESIDE = 6, 0.85, 0.75  # number of middles for a drift, and least quality of their line
DRIFT = (0.05, 0.6)  # share of the largest magnitude; more is an asymmetry
SLIP, SLIPPED = 2.0, 0.02  # a slip is so many times as fast as nearly all steps, and this share of the range
HELD, HOLD, RELAXED = 20, 0.3, 0.05  # samples of a hold, as a share of half a cycle, and how far the force relaxes
BRANCH = 5  # samples of a branch


def loop_doubts(campaign: Campaign, id: str, record: Record) -> Iterator[Finding]:
    """Doubts of every loop of a record."""
    for owner in loops(record.channels):
        name = named(owner, "force")
        force, elongation = record.channels[name], record.channels[named(owner, "elongation")]
        if len(record) < 2 * BRANCH or not np.ptp(elongation) > 0 or not np.ptp(force) > 0:
            continue
        found = turns(elongation)
        if campaign.protocol == "displacement" and (said := _one_branch(elongation, found)):
            yield Finding("doubt", id, named(owner, "elongation"), None, said, "monotonic")
            continue
        sign = [*_energy(campaign, id, record, owner, found)]
        yield from sign
        if not sign:  # a late force that explains negative work is reported by the doubt `sign`
            yield from _timing(campaign, id, record, owner, found)
        yield from _drifts(campaign, id, record, owner, found)
        yield from _slips(campaign, id, record, owner)
        yield from _holds(campaign, id, record, owner, found)


def _one_branch(elongation: np.ndarray, found: np.ndarray) -> str | None:
    """The message on a record that never unloads."""
    # In an envelope, the return to the origin takes a sample or two: it was not measured.
    ways = [(a, b) for a, b in pairwise(found.tolist()) if b - a >= BRANCH]
    if len(ways) > 2:
        return None
    outwards = [(a, b) for a, b in ways if abs(elongation[b]) > abs(elongation[a])]
    through = len(ways) == 1 and elongation[ways[0][0]] * elongation[ways[0][1]] < 0
    if len(outwards) == len(ways) or through:
        branches = "one loading branch" if len(ways) == 1 and not through else "a loading branch of either side"
        return f"{branches}: no hysteresis to identify; is it a monotonic test, or an envelope?"
    return None


def timing(force: np.ndarray, elongation: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Number of samples from each turn of the elongation to the extreme of the force, (h,); negative if the extreme
    comes first.

    Arguments:
        force, elongation: (m,) each, any unit.
        found: the turns of the elongation, ends included, (h+2,).
    """
    rows = np.arange(elongation.size)
    slack, scatter = 3 * noise_estimate(rows, elongation), 5 * noise_estimate(rows, force)
    lags = []
    for before, at, after in zip(found[:-2].tolist(), found[1:-1].tolist(), found[2:].tolist(), strict=True):
        side = 1.0 if elongation[at] > elongation[before] else -1.0
        way = min(abs(elongation[at] - elongation[before]), abs(elongation[after] - elongation[at]))
        # All samples at the peak, as in a hold, are the turn.
        is_there = side * (elongation[at] - elongation[before : after + 1]) <= max(slack, 1e-3 * way)
        away = np.flatnonzero(~is_there)
        first = before + (int(away[away < at - before].max()) + 1 if (away < at - before).any() else 0)
        last = before + (int(away[away > at - before].min()) - 1 if (away > at - before).any() else after - before)
        begin, end = first - (first - before) // 2, last + (after - last) // 2
        part = side * force[begin : end + 1]
        top = begin + int(np.argmax(part))
        turned = part.max() - (side * force[first : last + 1]).max()
        if turned <= max(scatter, SIZE * float(np.ptp(force[before : after + 1]))):
            lags.append(0)
        else:
            lags.append(top - last if top > last else top - first)
    return np.asarray(lags, dtype=int)


def late_by(force: np.ndarray, elongation: np.ndarray, found: np.ndarray) -> int | None:
    """The shift of the force, in samples, after which its extremes come no later than the turns; None where no lag does."""
    cycle = 2 * float(np.median(np.diff(found)))

    def is_late(lag: int) -> bool:
        there = found[found < elongation.size - lag]
        return there.size < FEWEST or float(np.mean(timing(force[lag:], elongation[:-lag], there) > 0)) >= LATE / 3

    low, high = 0, max(int(LONGEST * cycle), 1)
    if high >= elongation.size // 2 or is_late(high):
        return None
    while high - low > 1:  # the further the force is shifted, the fewer turns are late
        middle = (low + high) // 2
        low, high = (middle, high) if is_late(middle) else (low, middle)
    return high


def _timing(campaign: Campaign, id: str, record: Record, owner: str, found: np.ndarray) -> Iterator[Finding]:
    if found.size < FEWEST + 2:
        return
    name = named(owner, "force")
    force, elongation = record.channels[name], record.channels[named(owner, "elongation")]
    lags = timing(force, elongation, found)
    is_late, words = lags > 0, campaign.pair.words
    if is_late.mean() > LATE and is_late.sum() >= 3:
        lag = late_by(force, elongation, found) or int(np.median(lags[is_late]))
        first = int(found[1:-1][is_late][0])
        message = words(
            f"its extreme comes after the reversal of the elongation at {100 * is_late.mean():.0f} % of {lags.size} reversals: "
            f"does the force come late? A lag of about {_lag(campaign, record, lag)} would explain it"
        )
        spans = tuple(
            (at, at + late + 1) for at, late in zip(found[1:-1].tolist(), lags.tolist(), strict=True) if late > 0
        )
        yield Finding("doubt", id, name, float(record.time[first]), message, "timing", spans=spans)
        return
    cycle = 2 * float(np.median(np.diff(found)))
    leads = zip(found[1:-1].tolist(), (-lags).tolist(), strict=True)
    early = [(at, lead) for at, lead in leads if _falls_at_once(force, at, lead)]
    usual = float(np.median([lead for _, lead in early])) if early else 0.0
    # A viscous force is early, too, so with a time this is not a doubt.
    is_long = usual >= CYCLE * cycle and (usual >= 2 or usual >= 2 * CYCLE * cycle)
    if not campaign.has_time and len(early) > EARLY * lags.size and is_long:
        message = words(
            f"its extreme comes before the reversal of the elongation at {100 * len(early) / lags.size:.0f} % of {lags.size} "
            f"reversals, by {usual:.0f} samples: does the force come early?"
        )
        spans = tuple((at - lead, at + 1) for at, lead in early)
        yield Finding("doubt", id, name, float(record.time[early[0][0]]), message, "timing", spans=spans)


def _falls_at_once(force: np.ndarray, at: int, lead: int) -> bool:
    """Whether a force with its extreme some samples before a turn has begun to unload there."""
    if lead <= 0 or at + lead >= force.size:
        return False
    before, after = force[at - lead] - force[at], force[at] - force[at + lead]
    # After the turn a force that slides does not fall any more.
    return bool(abs(before) >= FALLEN * np.sign(before) * after)


def _lag(campaign: Campaign, record: Record, samples: int) -> str:
    """A lag in seconds, or in samples without a time."""
    if not campaign.has_time:
        return f"{samples} sample{'s' if samples > 1 else ''}"
    return f"{samples * float(np.median(np.diff(record.time))):.2g} s"


def _energy(campaign: Campaign, id: str, record: Record, owner: str, found: np.ndarray) -> Iterator[Finding]:
    name = named(owner, "force")
    force, elongation = record.channels[name], record.channels[named(owner, "elongation")]
    done = 0.5 * (force[1:] + force[:-1]) * np.diff(elongation)
    # A passive specimen returns at most the energy that it held at the start; a twentieth is allowed for noise and delay.
    allowed = 0.05 * float(np.abs(done).sum()) + abs(float(force[0] * elongation[0]))
    if done.sum() < -allowed:
        what, size = (
            campaign.pair.words("the work of force on elongation"),
            amount(campaign.pair, named(owner, "dissipated_energy"), float(done.sum())),
        )
        message = f"{what} is {size}: a specimen cannot give energy; "
        least = late_by(force, elongation, found) if found.size >= FEWEST else None
        longest = int(2 * LONGEST * float(np.median(np.diff(found))))
        lags = range(least, longest + 1) if least is not None else ()
        lag = next((lag for lag in lags if np.trapezoid(force[lag:], elongation[:-lag]) > -allowed), None)
        if lag is not None:
            late = campaign.pair.words("the force comes late")
            message += f"is a sign flipped, or {late}? A lag of {_lag(campaign, record, lag)} would explain it"
        else:
            message += "is a sign flipped?"
        yield Finding("doubt", id, name, None, message, "sign")


def _drifts(campaign: Campaign, id: str, record: Record, owner: str, found: np.ndarray) -> Iterator[Finding]:
    """Zeros that drift with the rows."""
    force, elongation = (record.channels[named(owner, name)] for name in ("force", "elongation"))
    at = found[1:-1]
    values = elongation[at]
    if at.size < CYCLES + 2 or 4 * np.count_nonzero(values[:-1] * values[1:] < 0) < 3 * (at.size - 1):
        return  # without cycles about zero there is no drift of the zero
    crossings = np.asarray([_at_zero(force, elongation, a, b) for a, b in pairwise(at.tolist())])
    for name, ends, where, scale in (
        ("elongation", values, at, float(np.abs(values).max())),
        ("force", crossings, at[:-1], float(np.abs(force).max())),
    ):
        amplitude = np.abs(values[: ends.size]) / np.abs(values).max()
        drift = _drift(where, ends / scale, amplitude, len(record))
        if drift is not None:
            channel = named(owner, name)
            message = (
                f"the middle of its cycles moves by {amount(campaign.pair, channel, drift * scale)} in proportion to the rows, "
                f"{100 * abs(drift):.0f} % of its largest magnitude: does its zero drift?"
            )
            spans = tuple((row, row + 1) for row in at.tolist())
            yield Finding("doubt", id, channel, None, message, "drift", spans=spans)


def _at_zero(force: np.ndarray, elongation: np.ndarray, begin: int, end: int) -> float:
    """The force where the elongation crosses zero between two turns; NaN where it does not."""
    part = elongation[begin : end + 1]
    crossing = np.flatnonzero(part[:-1] * part[1:] <= 0)
    if not crossing.size:
        return float("nan")
    i = begin + int(crossing[0])
    step = elongation[i + 1] - elongation[i]
    return float(force[i] + (force[i + 1] - force[i]) * (-elongation[i] / step if step else 0.0))


def _drift(rows: np.ndarray, ends: np.ndarray, amplitude: np.ndarray, samples: int) -> float | None:
    """Rise of the middles between ends of cycles over a record, in proportion to the rows; None without one, or if amplitudes
    explain it.
    """
    # If amplitudes grow in steps, the middle is that of the ends of one cycle; if they grow all the time, it is that of an end
    # and both its neighbours.  The straightest line is the right one.
    found = [_line(rows, ends, amplitude, samples, weights, step) for weights, step in
             (((0.5, 0.5), 2), ((0.0, 0.5, 0.5), 2), ((0.25, 0.5, 0.25), 1))]  # fmt: skip
    lines = [line for line in found if line is not None]
    # A growing amplitude moves the middles of the two pairings apart, a drift moves both.
    if len(lines) < 3 or lines[0].slope * lines[1].slope < (0.5 * DRIFT[0]) ** 2:
        return None
    best = min(lines, key=lambda line: line.scatter)
    return best.slope if best.is_drift else None


class _Line(NamedTuple):
    """A line through the middles of cycles: their scatter about it, its rise over the record, whether that is a drift."""

    scatter: float
    slope: float
    is_drift: bool


def _line(
    rows: np.ndarray, ends: np.ndarray, amplitude: np.ndarray, samples: int, weights: tuple[float, ...], step: int
) -> _Line | None:
    """The line through the middles of ends with these weights; None if there are too few."""
    x, y, size = (np.convolve(values, weights[::-1], "valid")[::step] for values in (rows, ends, amplitude))
    known = np.isfinite(y)
    if known.sum() < CYCLES:
        return None
    x, y, size = x[known] / samples, y[known], size[known]
    one, left, slopes = np.ones_like(x), [], []
    for columns in ([one, size, size**2], [one, size, size**2, x], [one], [one, x]):
        table = np.stack(columns, axis=1)
        solution, *_ = np.linalg.lstsq(table, y, rcond=None)
        left.append(float(np.sum((y - table @ solution) ** 2)))
        slopes.append(float(solution[-1]))
    beside, alone = slopes[1], slopes[3]
    fits = left[3] <= (1 - LINE) * left[2] and left[1] <= (1 - BESIDE) * left[0]
    agrees = alone * beside > 0 and 0.4 < abs(alone / beside) < 2.5
    is_drift = fits and agrees and min(abs(alone), abs(beside)) > DRIFT[0] and abs(alone) < DRIFT[1]
    return _Line(left[3] / x.size, alone, bool(is_drift))


def _slips(campaign: Campaign, id: str, record: Record, owner: str) -> Iterator[Finding]:
    """Steps back that are faster than the loading."""
    name = named(owner, "elongation")
    elongation = record.channels[name]
    steps = np.abs(np.diff(elongation))
    usual, reach = float(np.quantile(steps[steps > 0], 0.95)), float(np.ptp(elongation))
    all_turns = with_slips(elongation)
    left_out = np.setdiff1d(all_turns, turns(elongation))
    found = [
        (int(a), int(b), float(abs(elongation[b] - elongation[a])))
        for a, b in zip(left_out[:-1:2], left_out[1::2], strict=False)
        if abs(elongation[b] - elongation[a]) > max(SLIP * usual * (b - a), SLIPPED * reach)
    ]
    if found:
        largest = amount(campaign.pair, name, max(size for *_, size in found))
        message = f"it steps back by {largest}, faster than it is loaded, {len(found)} times in all: does it slip?"
        spans = tuple((a, b + 1) for a, b, _ in found)
        yield Finding("doubt", id, name, float(record.time[found[0][0]]), message, "slip", spans=spans)


def _holds(campaign: Campaign, id: str, record: Record, owner: str, found: np.ndarray) -> Iterator[Finding]:
    """Rests during which the force relaxes."""
    name = named(owner, "elongation")
    force, elongation = record.channels[named(owner, "force")], record.channels[name]
    if campaign.protocol != "displacement" or found.size < 3:
        return
    reach, half = float(np.ptp(elongation)), float(np.median(np.diff(found)))
    slack = max(3 * noise_estimate(np.arange(elongation.size), elongation), 1e-3 * reach)
    holds = [
        (a, b)
        for a, b in _rests(elongation, slack)
        if a > 0 and b < elongation.size - 1 and b - a >= max(HELD, HOLD * half)
        if np.ptp(force[a : b + 1]) > RELAXED * np.ptp(force)
    ]
    if holds:
        a, b = max(holds, key=lambda rest: np.ptp(force[rest[0] : rest[1] + 1]))
        relaxed = amount(campaign.pair, named(owner, "force"), float(np.ptp(force[a : b + 1])))
        message = campaign.pair.words(
            f"it rests at {amount(campaign.pair, name, float(elongation[a]))} for {b - a + 1} samples while the force changes by "
            f"{relaxed}, {len(holds)} such rests: was it held? A law without relaxation cannot follow"
        )
        spans = tuple((a, b + 1) for a, b in holds)
        yield Finding("doubt", id, name, float(record.time[holds[0][0]]), message, "hold", spans=spans)


def _rests(values: np.ndarray, slack: float) -> list[tuple[int, int]]:
    """First and last samples of the stretches that keep within a slack."""
    rests, begin, low, high = [], 0, float(values[0]), float(values[0])
    for i, value in enumerate(values.tolist()):
        if max(high, value) - min(low, value) > slack:
            rests.append((begin, i - 1))
            begin, low, high = i, value, value
        else:
            low, high = min(low, value), max(high, value)
    return [*rests, (begin, values.size - 1)]
