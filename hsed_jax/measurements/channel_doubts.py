"""Doubts of single channels: magnitudes, plateaus, jumps, noise and base lines."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.characteristics import START, from_unloaded
from hsed_jax.measurements.experiment import Experiment, Record
from hsed_jax.measurements.findings import Finding
from hsed_jax.measurements.noise import difference_noise, noise_estimate
from hsed_jax.measurements.units import channel_dimension, quantity_dimension
from hsed_jax.physics.display import amount
from hsed_jax.physics.names import own_name
from hsed_jax.physics.outputs import is_driver, quantity

PLAUSIBLE = {
    "length": (1e-6, 5.0),
    "velocity": (1e-5, 50.0),
    "acceleration": (1e-3, 500.0),
    "force": (1e-2, 2e8),
    "angle": (1e-6, 2.0),
    "moment": (1e-2, 1e10),
    "strain": (1e-6, 10.0),
    "stress": (1e3, 1e11),
}
"""Range of the largest magnitude [SI] by dimension; outside, the unit is suspect.

The largest testing machine of NIST, according to NIST the largest of the world, has 53.4 MN. The limit is four times
this force.
"""

PLAUSIBLE_GROUND_ACCELERATION = (1e-2, 40.0)
"""The same for the ground [m/s²]; the strongest records reach about 4 g."""
LEAST_GROUND_VELOCITY = 1.0
"""Velocity [m/s] below which a larger acceleration is accepted: small models are shaken with large accelerations, and a
wrong unit would multiply both.
"""

PLATEAU = 4  # equal samples at an extreme
STUCK = 20  # equal samples elsewhere
JUMP = 5  # a step of the elongation this many times as long as nearly all others, and as those around it
AROUND = 10  # number of steps on either side of a jump for comparison
NOISE_FACTOR = 3  # estimated over declared noise
QUIET = 10  # least number of samples before the motion for a base line
THOUSANDFOLD = 300.0  # larger changes of the steps from one sample to the next mean another unit


def quantity_doubts(campaign: Campaign, experiment: Experiment) -> Iterator[Finding]:
    """Quantities of an absurd magnitude."""
    for name, value in experiment.quantities.items():
        low, high = PLAUSIBLE.get(quantity_dimension(name, campaign.pair).name, (0.0, np.inf))
        low = 0.0 if quantity(name).is_signed else low
        if not low <= abs(value) <= high:
            yield Finding("doubt", experiment.id, name, None, _absurd(campaign, name, abs(value), low, high), "unit")


def channel_doubts(campaign: Campaign, id: str, record: Record) -> Iterator[Finding]:
    """Doubts of every single channel, and the error of a channel that measured nothing."""
    for name, values in record.channels.items():
        if np.ptp(values) == 0:
            # A free vibration has a constant ground and no force; any other constant channel measured nothing.
            shown = amount(campaign.pair, name, float(values[0]))
            message = f"it is constant ({shown}) over the whole record; a dead sensor?"
            if is_driver(name):
                yield Finding("doubt", id, name, None, message, "constant")
            else:
                yield Finding("error", id, name, None, message)
            continue
        yield from _plateaus(campaign, id, record, name)
        yield from _magnitude(campaign, id, record, name)
        yield from _noise(campaign, id, record, name)
        yield from _thousandfold(campaign, id, record, name)
        yield from _jumps(campaign, id, record, name)
    yield from _base_lines(campaign, id, record)


def _plateaus(campaign: Campaign, id: str, record: Record, name: str) -> Iterator[Finding]:
    values = record.channels[name]
    changes = np.flatnonzero(np.diff(values)) + 1
    runs = [(a, b) for a, b in pairwise([0, *changes.tolist(), values.size]) if b - a >= PLATEAU]
    steps = np.abs(np.diff(values))
    quantum = steps[steps > 0].min()
    clipped, stuck = [], []
    for start, end in runs:
        if start == 0 or end == values.size:
            continue  # rest before and after the motion
        # Rounding also flattens a smooth peak, but then the neighbouring samples differ by one or two digits.
        sharp = max(steps[start - 1], steps[end - 1]) > 5 * quantum
        if values[start] in (values.max(), values.min()):
            if sharp and values[start] != values[0]:
                clipped.append((start, end))
        elif sharp and end - start >= STUCK and values[start] != 0:  # an open gap holds exactly no force
            stuck.append((start, end))
    for found, word in ((clipped, "stays at its extreme"), (stuck, "does not change")):
        if found:
            start, end = max(found, key=lambda run: run[1] - run[0])
            shown = amount(campaign.pair, name, float(values[start]))
            message = f"{word} ({shown}) for {end - start} samples, {len(found)} such stretches"
            reason = "clipped, or held there?" if found is clipped else "a stuck sensor, or held there?"
            kind = "clipped" if found is clipped else "stuck"
            begins = float(record.time[found[0][0]])
            yield Finding("doubt", id, name, begins, f"{message}: {reason}", kind, spans=tuple(found))


def _magnitude(campaign: Campaign, id: str, record: Record, name: str) -> Iterator[Finding]:
    low, high = PLAUSIBLE.get(channel_dimension(name, campaign.pair).name, (0.0, np.inf))
    if name == "ground_acceleration":
        low, high = PLAUSIBLE_GROUND_ACCELERATION
    peak = int(np.argmax(np.abs(record.channels[name])))
    value = float(np.abs(record.channels[name][peak]))
    if name == "ground_acceleration" and value > high and _ground_velocity(record) < LEAST_GROUND_VELOCITY:
        return
    if not low <= value <= high:
        message, at = _absurd(campaign, name, value, low, high), float(record.time[peak])
        yield Finding("doubt", id, name, at, message, "unit", spans=((peak, peak + 1),))


def _ground_velocity(record: Record) -> float:
    """Largest velocity of the ground [m/s], without the linear trend from an offset of the acceleration."""
    steps = 0.5 * (record["ground_acceleration"][1:] + record["ground_acceleration"][:-1]) * np.diff(record.time)
    velocity = np.concatenate([[0.0], np.cumsum(steps)])
    line = np.polynomial.Polynomial.fit(record.time, velocity, 1)
    return float(np.abs(velocity - line(record.time)).max())


def _absurd(campaign: Campaign, name: str, value: float, low: float, high: float) -> str:
    plausible = f"{amount(campaign.pair, name, low, 6).split(' ')[0]} to {amount(campaign.pair, name, high, 6)}"
    return (
        f"the largest magnitude is {amount(campaign.pair, name, value)}, plausible is {plausible}: is the unit right?"
    )


def _noise(campaign: Campaign, id: str, record: Record, name: str) -> Iterator[Finding]:
    noise, values = campaign.channels[name].noise, record.channels[name]
    if noise is None or len(record) < 50:
        return
    declared = noise.standard_deviation(values)
    second, third, fourth = (difference_noise(record.time, values, order) for order in (2, 3, 4))
    # For white noise every order gives the same estimate; an under-resolved signal gives different ones.
    if not 0.75 * third < fourth < 1.33 * third and third > declared:
        return
    if third > NOISE_FACTOR * declared or NOISE_FACTOR * min(second, third) < declared:
        message = (
            f"the samples scatter by about {amount(campaign.pair, name, third, 2)}, "
            f"the declared noise is {amount(campaign.pair, name, declared, 2)}"
        )
        yield Finding("doubt", id, name, None, message, "noise")


def _thousandfold(campaign: Campaign, id: str, record: Record, name: str) -> Iterator[Finding]:
    """Steps that change a thousandfold from one sample to the next: the unit changes there."""
    steps = np.diff(record.channels[name])
    if steps.size < 4 * AROUND:
        return
    windows = np.lib.stride_tricks.sliding_window_view(steps, AROUND)
    typical = np.median(np.abs(windows), axis=1)
    # Noise changes its direction, and a motion keeps it: a rest before a motion is not a change of unit.
    moves = np.abs(windows.sum(axis=1)) > 0.5 * np.abs(windows).sum(axis=1)
    before, after = typical[: -AROUND - 1], typical[AROUND + 1 :]  # the step between is that of the change
    counts = moves[: -AROUND - 1] & moves[AROUND + 1 :] & (before > 0) & (after > 0)
    # With another unit, the values change as much as their steps: a motion that comes to rest is not a change of unit.
    values = np.abs(record.channels[name])
    here, there = values[AROUND : AROUND + before.size], values[AROUND + 1 : AROUND + 1 + before.size]
    counts &= np.abs(there - here) > 0.5 * np.maximum(np.maximum(here, there), 1e-300)
    ratio = np.where(counts, after / np.where(before > 0, before, 1.0), 1.0)
    factor = np.maximum(ratio, 1 / ratio)
    if factor.max() > THOUSANDFOLD:
        with np.errstate(divide="ignore", invalid="ignore"):
            apart = np.abs(np.log(there / here) - np.log(ratio))  # where the value changes as its steps do
        at = int(np.nanargmin(np.where(factor > THOUSANDFOLD, apart, np.inf))) + AROUND
        word = "grow" if ratio[at - AROUND] > 1 else "shrink"
        message = (
            f"its steps {word} {factor[at - AROUND]:.2g}-fold from one sample to the next: does the unit change there?"
        )
        yield Finding("doubt", id, name, float(record.time[at + 1]), message, "unit", spans=((at + 1, values.size),))


def _jumps(campaign: Campaign, id: str, record: Record, name: str) -> Iterator[Finding]:
    """Steps of the elongation that missing rows leave; if a time shows the gap, there is no jump."""
    values = record.channels[name]
    steps = np.abs(np.diff(values))
    if own_name(name) != "elongation" or not (steps > 0).sum() >= QUIET:
        return
    interval = np.diff(record.time)
    steps = steps / np.maximum(interval / np.median(interval), 1.0)
    usual = float(np.quantile(steps[steps > 0], 0.95))
    jumps = np.flatnonzero(steps > max(JUMP * usual, 0.05 * float(np.ptp(values))))
    # A pulse after a rest also has long steps, but they follow one another.
    padded = np.pad(steps, AROUND)
    beside = np.lib.stride_tricks.sliding_window_view(padded, 2 * AROUND + 1)[jumps].copy()
    beside[:, AROUND] = 0.0
    jumps = jumps[steps[jumps] > JUMP * np.quantile(beside, 0.9, axis=1)] if jumps.size else jumps
    if jumps.size:
        message = (
            f"it jumps by {amount(campaign.pair, name, steps[jumps].max())} where nearly all steps are below "
            f"{amount(campaign.pair, name, usual, 2)}, {jumps.size} times in all: are rows missing?"
        )
        spans = tuple((i, i + 2) for i in jumps.tolist())
        yield Finding("doubt", id, name, float(record.time[jumps[0] + 1]), message, "jump", spans=spans)


def _base_lines(campaign: Campaign, id: str, record: Record) -> Iterator[Finding]:
    driver = next(
        (name for name in (*filter(is_driver, record.channels), "elongation") if name in record.channels), None
    )
    if driver is None:
        return
    drive = record.channels[driver] - np.median(record.channels[driver][:QUIET])
    # A small first loading is a motion, too: it begins when the driver leaves its own noise.
    noise = 5 * noise_estimate(record.time, record.channels[driver])
    quiet = int(np.argmax(np.abs(drive) > min(max(noise, 1e-6 * np.abs(drive).max()), 0.01 * np.abs(drive).max())))
    if quiet < QUIET:
        yield from _starts(campaign, id, record)
        return
    for name, values in record.channels.items():
        if name.endswith("_absolute") or name.startswith("velocity"):
            continue
        offset, scatter = float(np.mean(values[:quiet])), float(np.std(values[:quiet]))
        # Drift and hum are autocorrelated, so there is no factor 1/sqrt(n): the offset alone must exceed the noise.
        if abs(offset) > max(0.02 * float(np.abs(values).max()), scatter):
            size = amount(campaign.pair, name, offset)
            message = f"it is {size} on average before the motion starts ({quiet} samples): an offset?"
            yield Finding("doubt", id, name, float(record.time[0]), message, "offset", spans=((0, quiet),))


def _starts(campaign: Campaign, id: str, record: Record) -> Iterator[Finding]:
    """An elongation that begins elsewhere while the force begins at zero, or a record that begins loaded."""
    if not {"force", "elongation"} <= record.channels.keys():
        return
    elongation, force = record["elongation"], record["force"]
    at, under = (amount(campaign.pair, name, float(record[name][0])) for name in ("elongation", "force"))
    begins = np.abs(elongation[0]) > START * np.abs(elongation).max()
    scatter = 5 * noise_estimate(np.arange(len(record)), elongation)
    if begins and abs(elongation[0]) > scatter and np.abs(force[0]) < START * np.abs(force).max():
        message = f"it begins at {at} while the {campaign.pair.force} begins at {under}: an offset?"
        yield Finding("doubt", id, "elongation", float(record.time[0]), message, "offset", spans=((0, 1),))
    elif len(from_unloaded(record)) > len(record):
        message = f"it begins at {under} and {at}; the simulation loads a new specimen from zero to there before the first sample"
        yield Finding("doubt", id, "force", float(record.time[0]), message, "offset", spans=((0, 1),))
