"""Faults of measured data: errors stop a calculation, and doubts are listed.  Nothing is repaired."""

from collections.abc import Iterator, Set
from dataclasses import replace

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.campaign_doubts import campaign_doubts
from hsed_jax.measurements.channel_doubts import channel_doubts, quantity_doubts
from hsed_jax.measurements.experiment import Experiment, Record
from hsed_jax.measurements.findings import Finding, yaml_key
from hsed_jax.measurements.loop_doubts import loop_doubts
from hsed_jax.measurements.unit_doubts import factor_doubts, specimen_doubts
from hsed_jax.physics.outputs import is_driver

GAP = 8  # time steps this many times longer than the median are gaps, if they are rare
THOUSANDFOLD = 300.0  # larger changes of the time steps mean another unit
SAMPLES = 8  # least number of measured samples of a history; the noise of fewer cannot be estimated
FEWEST = 10  # least number of time steps for a usual step


def check_campaign(campaign: Campaign) -> list[Finding]:
    """Look for faults in the records and quantities of completed experiments, and in planned ground motions.

    Arguments:
        campaign: Not changed.

    Returns:
        Findings by experiment, in order; those of a record that several experiments share in windows, once.  Errors are fewer
        than eight measured samples in the window, NaN, backward or duplicate time and constant channels.  Doubts are those of
        single channels (`hsed_jax.measurements.channel_doubts`), of loops (`loop_doubts`), of units (`unit_doubts`) and of the
        campaign (`campaign_doubts`).

    Example:
        >>> hx.check_campaign(hx.read_campaign("my_campaign"))
        []
    """
    used = [e for e in campaign if e.status in ("completed", "pending")]
    found, seen = [], []
    for experiment in used:
        found += quantity_doubts(campaign, experiment)
        record = experiment.record
        if record is None:
            continue
        found += _length(experiment, record)
        if not any(record == other for other in seen):
            found += _record(campaign, experiment.id, record)
        seen.append(record)
    if not any(finding.level == "error" for finding in found):
        found += [*factor_doubts(campaign), *campaign_doubts(campaign)]
    return [replace(finding, has_time=campaign.has_time) for finding in found]


def stop_at_errors(campaign: Campaign, accepted: Set[tuple[str, str]] = frozenset(), needs_loops: bool = False) -> None:
    """Refuse a campaign if its data have errors, a sign seems flipped, or a required loop is missing.

    Arguments:
        campaign: the measurements.
        accepted: doubts that the user has accepted, each an experiment and a kind.
        needs_loops: a diagnosis follows, so at least one fitted test must have a loop.

    Raises:
        UserError: with the first fault and the number of faults.
    """
    found, where = check_campaign(campaign), campaign.source or campaign.name
    errors = [f for f in found if f.level == "error"] + [
        f for f in found if f.kind == "sign" and (f.experiment, "sign") not in accepted
    ]
    branches = {f.experiment: f for f in found if f.kind == "monotonic" and (f.experiment, f.kind) not in accepted}
    fitted = [experiment.id for experiment in campaign.train]
    if needs_loops and not errors and fitted and branches.keys() >= {*fitted}:
        said = branches[fitted[0]].line.removeprefix("doubt: ")
        key = "all" if len(fitted) > 1 else yaml_key(fitted[0])
        raise UserError(
            f"{where}: {said} Every fitted test is like this, so a diagnosis has nothing to find. Use the steps [calibrate, "
            f"compare], or accept it in the study: measurements: {{accept: {{{key}: monotonic}}}}"
        )
    if errors:
        first = errors[0]
        more = f" (and {len(errors) - 1} more: hsed check lists them)" if len(errors) > 1 else ""
        remedy = ""
        if first.kind == "sign":
            key = "all" if len(errors) > 1 else yaml_key(first.experiment)
            remedy = f" If it is correct, accept it in the study: measurements: {{accept: {{{key}: sign}}}}"
            more += "" if first.message.endswith("?") and not more else "."
        raise UserError(f"{where}: {first.line.removeprefix(f'{first.level}: ')}{more}{remedy}")


def _record(campaign: Campaign, id: str, record: Record) -> Iterator[Finding]:
    errors = [*_time(id, record)]
    errors += [f for name in record.channels for f in _finite(id, record, name)]
    yield from errors
    if any(finding.level == "error" for finding in errors):
        return  # the following checks need an increasing time and finite numbers
    of_channels = [*channel_doubts(campaign, id, record)]
    yield from of_channels
    if not any(finding.kind == "unit" for finding in of_channels):  # an absurd channel makes its stiffness absurd, too
        yield from specimen_doubts(campaign, id, record)
    yield from loop_doubts(campaign, id, record)


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
    if (steps <= 0).any() or steps.size < FEWEST:
        return
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    if 0 < gaps.size <= max(3, steps.size // 100):  # many long steps are uneven sampling
        longest = steps[gaps].max()
        message = f"{gaps.size} gaps, the longest {longest:g} s where the usual step is {np.median(steps):g} s"
        spans = tuple((i, i + 2) for i in gaps.tolist())
        yield Finding("doubt", id, "time", float(time[gaps[0]]), message, "gap", spans=spans)
    ratio = steps[1:] / steps[:-1]
    at = int(np.argmax(np.maximum(ratio, 1 / ratio)))
    before, after = np.median(steps[max(at + 1 - FEWEST, 0) : at + 1]), np.median(steps[at + 1 : at + 1 + FEWEST])
    if max(before / after, after / before) > THOUSANDFOLD:
        message = f"the step changes from {before:g} s to {after:g} s: are ms and s in one column?"
        yield Finding("doubt", id, "time", float(time[at + 1]), message, "unit", spans=((at + 1, time.size),))


def _finite(id: str, record: Record, name: str) -> Iterator[Finding]:
    bad = ~np.isfinite(record.channels[name])
    if bad.any():
        first = int(np.argmax(bad))
        message = f"{int(bad.sum())} of {len(record)} samples are not numbers, the first is sample {first + 1}"
        good = np.flatnonzero(~bad)
        if good.size and good.size == good[-1] - good[0] + 1:
            message += "; all of them are at an end of the record: delete these rows, or have hsed init read the file"
        yield Finding("error", id, name, float(record.time[first]), message)
