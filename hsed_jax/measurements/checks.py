"""Faults of measured data: errors that stop, doubts that are listed.  Nothing is repaired."""

import json
from collections.abc import Iterator, Set
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Experiment, Record
from hsed_jax.measurements.noise import difference_noise, noise_estimate
from hsed_jax.measurements.units import channel_dimension, quantity_dimension
from hsed_jax.physics.display import amount
from hsed_jax.physics.outputs import is_driver, loops, named, own_name, quantity
from hsed_jax.physics.pairs import Pair

PLAUSIBLE = {
    "length": (1e-6, 5.0),
    "velocity": (1e-5, 50.0),
    "acceleration": (1e-3, 500.0),
    "force": (1e-2, 1e9),
    "angle": (1e-6, 2.0),
    "moment": (1e-2, 1e10),
    "strain": (1e-6, 10.0),
    "stress": (1e3, 1e11),
}
"""Range of the largest magnitude [SI] by dimension; outside, the unit is suspect."""

PLAUSIBLE_GROUND_ACCELERATION = (1e-2, 40.0)
"""The same for the ground [m/s²]; the strongest records reach about 4 g."""

DoubtKind = Literal["unit", "constant", "gap", "jump", "clipped", "stuck", "noise", "offset", "sign"]
"""What may be doubted, as `measurements.accept` of a study names it."""

GAP = 8  # time steps this many times longer than the median are gaps, if they are rare
PLATEAU = 4  # equal samples at an extreme
STUCK = 20  # equal samples elsewhere
JUMP = 5  # a step of the elongation this many times as long as nearly all others
NOISE_FACTOR = 3  # estimated against declared
SAMPLES = 8  # fewer measured samples are no history: even their noise cannot be told
QUIET = 10  # samples before the motion that a base line needs


@dataclass(frozen=True)
class Finding:
    """One fault.

    Attributes:
        level: `error`: the data cannot be used so; `doubt`: they can, but somebody should look.
        experiment: Its id.
        channel: The channel or quantity.
        time: When it begins [s], where it has a time; the row, where rows stand for time.
        message: What was found.
        kind: What is doubted; None of an error.
        has_time: Whether the records have a time.
    """

    level: Literal["error", "doubt"]
    experiment: str
    channel: str
    time: float | None
    message: str
    kind: DoubtKind | None = None
    has_time: bool = True

    def __str__(self) -> str:
        """Return the finding as one line."""
        when = "" if self.time is None else f", t = {self.time:g} s" if self.has_time else f", row {self.time:.0f}"
        return f"{self.level}: {self.experiment}, {self.channel}{when}: {self.message}"


def check_campaign(campaign: Campaign) -> list[Finding]:
    """Look for faults in the records and quantities of completed experiments, and in planned ground motions.

    Args:
        campaign: Not changed.

    Returns:
        Findings by experiment, in order.  Errors are fewer than eight measured samples in the window, NaN, backward or
        duplicate time and constant channels; doubts are
        gaps in time, jumps of an elongation without time, clipped or stuck channels, absurd magnitudes, impossible energy
        (a flipped sign), noise unlike the declared one, and a base line that is not zero before the motion.
    """
    used = [e for e in campaign if e.status in ("completed", "pending")]
    return [replace(finding, has_time=campaign.has_time) for e in used for finding in _experiment(campaign, e)]


def stop_at_errors(campaign: Campaign, accepted: Set[tuple[str, str]] = frozenset()) -> None:
    """Refuse a campaign whose data have errors, or a sign that seems flipped.

    Arguments:
        campaign: the measurements.
        accepted: doubts that were looked at, each an experiment and a kind.

    Raises:
        UserError: names the first and says how many there are.
    """
    found = check_campaign(campaign)
    errors = [f for f in found if f.level == "error"] + [
        f for f in found if f.kind == "sign" and (f.experiment, "sign") not in accepted
    ]
    if errors:
        first, where = errors[0], campaign.source or campaign.name
        more = f" (and {len(errors) - 1} more: hsed check lists them)" if len(errors) > 1 else ""
        remedy = ""
        if first.kind == "sign":
            entries = ", ".join(f"{json.dumps(f.experiment)}: sign" for f in errors)
            remedy = f" If it is as it should be, say in the study: measurements: {{accept: [{entries}]}}"
        raise UserError(f"{where}: {str(first).removeprefix(f'{first.level}: ')}{more}{remedy}")


def _experiment(campaign: Campaign, experiment: Experiment) -> Iterator[Finding]:
    id, record = experiment.id, experiment.record
    for name, value in experiment.quantities.items():
        dimension = quantity_dimension(name, campaign.pair)
        low, high = PLAUSIBLE.get(dimension.name, (0.0, np.inf))
        low = 0.0 if quantity(name).is_signed else low
        if not low <= abs(value) <= high:
            yield Finding("doubt", id, name, None, _absurd(campaign.pair, name, abs(value), low, high), "unit")
    if record is None:
        return
    errors = [*_length(experiment, record), *_time(id, record)]
    errors += [f for name in record.channels for f in _finite(id, record, name)]
    yield from errors
    if any(finding.level == "error" for finding in errors):
        return  # what follows needs a time that runs and numbers that are numbers
    for name, values in record.channels.items():
        if np.ptp(values) == 0:
            # A free vibration has a constant ground and no force; any other constant channel measured nothing.
            message = f"it is constant ({amount(campaign.pair, name, values[0])}) over the whole record; a dead sensor?"
            if is_driver(name):
                yield Finding("doubt", id, name, None, message, "constant")
            else:
                yield Finding("error", id, name, None, message)
            continue
        yield from _plateaus(campaign.pair, id, record, name)
        yield from _magnitude(campaign.pair, id, record, name)
        yield from _noise(campaign, id, record, name)
    if not campaign.has_time:
        yield from _jumps(campaign.pair, id, record)
    yield from _base_lines(campaign.pair, id, record)
    yield from _energy(campaign.pair, id, record)


def _length(experiment: Experiment, record: Record) -> Iterator[Finding]:
    measured = [name for name in record.channels if not is_driver(name)]
    count = int(experiment.in_window.sum())
    if measured and count < SAMPLES:
        where = "record" if experiment.window is None else "window"
        message = f"the {where} has {count} samples; a history that is fitted has {SAMPLES} at least"
        yield Finding("error", experiment.id, measured[0], None, message)


def _time(id: str, record: Record) -> Iterator[Finding]:
    time = record.time
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        yield Finding("error", id, "time", None, f"sample {row + 1} has no time")
        return
    steps = np.diff(time)
    for bad, word in ((steps < 0, "runs backward"), (steps == 0, "is repeated")):
        if bad.any():
            first = int(np.argmax(bad))
            message = f"the time {word} at sample {first + 2}, {int(bad.sum())} times in all"
            yield Finding("error", id, "time", float(time[first + 1]), message)
    if (steps <= 0).any() or steps.size < QUIET:
        return
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    if 0 < gaps.size <= max(3, steps.size // 100):  # many long steps are uneven sampling
        longest = steps[gaps].max()
        message = f"{gaps.size} gaps, the longest {longest:g} s where the usual step is {np.median(steps):g} s"
        yield Finding("doubt", id, "time", float(time[gaps[0]]), message, "gap")


def _jumps(pair: Pair, id: str, record: Record) -> Iterator[Finding]:
    """Steps of the elongation that missing rows leave, where no time shows the gap."""
    for name, values in record.channels.items():
        steps = np.abs(np.diff(values))
        if own_name(name) != "elongation" or not (steps > 0).sum() >= QUIET:
            continue
        usual = float(np.quantile(steps[steps > 0], 0.95))
        jumps = np.flatnonzero(steps > max(JUMP * usual, 0.05 * float(np.ptp(values))))
        if jumps.size:
            message = (
                f"it jumps by {amount(pair, name, steps[jumps].max())} where nearly all steps are below "
                f"{amount(pair, name, usual, 2)}, {jumps.size} times in all: are rows missing?"
            )
            yield Finding("doubt", id, name, float(record.time[jumps[0] + 1]), message, "jump")


def _finite(id: str, record: Record, name: str) -> Iterator[Finding]:
    bad = ~np.isfinite(record.channels[name])
    if bad.any():
        first = int(np.argmax(bad))
        message = f"{int(bad.sum())} of {len(record)} samples are not numbers, the first is sample {first + 1}"
        yield Finding("error", id, name, float(record.time[first]), message)


def _plateaus(pair: Pair, id: str, record: Record, name: str) -> Iterator[Finding]:
    values = record.channels[name]
    changes = np.flatnonzero(np.diff(values)) + 1
    runs = [(a, b) for a, b in pairwise([0, *changes.tolist(), values.size]) if b - a >= PLATEAU]
    steps = np.abs(np.diff(values))
    quantum = steps[steps > 0].min()
    clipped, stuck = [], []
    for start, end in runs:
        if start == 0 or end == values.size:
            continue  # rest before and after the motion
        # Rounding flattens a smooth peak too, but then the samples beside it are one or two digits away.
        sharp = max(steps[start - 1], steps[end - 1]) > 5 * quantum
        if values[start] in (values.max(), values.min()):
            if sharp and values[start] != values[0]:
                clipped.append((start, end))
        elif sharp and end - start >= STUCK and values[start] != 0:  # an open gap holds exactly no force
            stuck.append((start, end))
    for found, word in ((clipped, "stays at its extreme"), (stuck, "does not change")):
        if found:
            start, end = max(found, key=lambda run: run[1] - run[0])
            size = amount(pair, name, float(values[start]))
            message = f"{word} ({size}) for {end - start} samples, {len(found)} such stretches"
            reason = "clipped, or held there?" if found is clipped else "a stuck sensor, or held there?"
            kind = "clipped" if found is clipped else "stuck"
            yield Finding("doubt", id, name, float(record.time[found[0][0]]), f"{message}: {reason}", kind)


def _magnitude(pair: Pair, id: str, record: Record, name: str) -> Iterator[Finding]:
    dimension = channel_dimension(name, pair)
    low, high = PLAUSIBLE.get(dimension.name, (0.0, np.inf))
    if name == "ground_acceleration":
        low, high = PLAUSIBLE_GROUND_ACCELERATION
    peak = int(np.argmax(np.abs(record.channels[name])))
    value = float(np.abs(record.channels[name][peak]))
    if not low <= value <= high:
        yield Finding("doubt", id, name, float(record.time[peak]), _absurd(pair, name, value, low, high), "unit")


def _absurd(pair: Pair, name: str, value: float, low: float, high: float) -> str:
    least, most = amount(pair, name, low, 6).split()[0], amount(pair, name, high, 6)
    return f"the largest magnitude is {amount(pair, name, value)}, plausible is {least} to {most}: is the unit right?"


def _noise(campaign: Campaign, id: str, record: Record, name: str) -> Iterator[Finding]:
    noise, values = campaign.channels[name].noise, record.channels[name]
    if noise is None or len(record) < 50:
        return
    declared = noise.standard_deviation(values)
    second, third, fourth = (difference_noise(record.time, values, order) for order in (2, 3, 4))
    # On white noise every order estimates the same; a signal that is not resolved by the samples tells them apart.
    if not 0.75 * third < fourth < 1.33 * third and third > declared:
        return
    if third > NOISE_FACTOR * declared or NOISE_FACTOR * min(second, third) < declared:
        scatter, known = (amount(campaign.pair, name, size, 2) for size in (third, declared))
        message = f"the samples scatter by about {scatter}, the declared noise is {known}"
        yield Finding("doubt", id, name, None, message, "noise")


def _base_lines(pair: Pair, id: str, record: Record) -> Iterator[Finding]:
    driver = next(
        (name for name in (*filter(is_driver, record.channels), "elongation") if name in record.channels), None
    )
    if driver is None:
        return
    drive = record.channels[driver] - np.median(record.channels[driver][:QUIET])
    # A first small loading is a motion, too: it begins where the driver leaves its own noise.
    noise = 5 * noise_estimate(record.time, record.channels[driver])
    quiet = int(np.argmax(np.abs(drive) > min(max(noise, 1e-6 * np.abs(drive).max()), 0.01 * np.abs(drive).max())))
    if quiet < QUIET:
        return
    for name, values in record.channels.items():
        if name.endswith("_absolute") or name.startswith(("displacement", "velocity")):
            continue
        offset, scatter = float(np.mean(values[:quiet])), float(np.std(values[:quiet]))
        # Drift and hum are not independent from sample to sample, so no 1/sqrt(n): the offset must stand out by itself.
        if abs(offset) > max(0.02 * float(np.abs(values).max()), scatter):
            size = amount(pair, name, offset)
            message = f"it is {size} on average before the motion starts ({quiet} samples): an offset?"
            yield Finding("doubt", id, name, float(record.time[0]), message, "offset")


def _energy(pair: Pair, id: str, record: Record) -> Iterator[Finding]:
    for owner in loops(record.channels):
        force, elongation = (record.channels[named(owner, name)] for name in ("force", "elongation"))
        work = 0.5 * (force[1:] + force[:-1]) * np.diff(elongation)
        # A passive specimen gives back at most what it held at the start; a twentieth is left for noise and delay.
        allowed = 0.05 * float(np.abs(work).sum()) + abs(float(force[0] * elongation[0]))
        if work.sum() < -allowed:
            what = pair.words("the work of force on elongation")
            size = amount(pair, named(owner, "dissipated_energy"), work.sum())
            message = f"{what} is {size}: a specimen cannot give energy; is a sign flipped?"
            yield Finding("doubt", id, named(owner, "force"), None, message, "sign")
