"""Doubts of a campaign as a whole, from a comparison of its experiments."""

from collections.abc import Iterator

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Experiment
from hsed_jax.measurements.findings import Finding
from hsed_jax.physics.display import amount
from hsed_jax.physics.names import own_name
from hsed_jax.physics.outputs import is_driver

SHARED = 0.5  # share of the samples of the shorter record that are equal to those of another record
FEWEST = 30  # number of samples from which this is not chance
BORDER = 2  # allowed number of common samples at the boundary of two windows
BEYOND = 1.5  # test amplitudes over the largest fitted amplitude


def campaign_doubts(campaign: Campaign) -> Iterator[Finding]:
    """Samples that occur twice, and test experiments that go beyond all fitted ones."""
    yield from _copies(campaign)
    yield from _beyond(campaign)


def _copies(campaign: Campaign) -> Iterator[Finding]:
    measured = [e for e in campaign.completed if e.record is not None and any(map(_is_response, e.record.channels))]
    keys = [_samples(e) for e in measured]
    owners: dict[bytes, int] = {}
    for number, (experiment, own) in enumerate(zip(measured, keys, strict=True)):
        counts: dict[int, int] = {}
        for key in own:
            first = owners.setdefault(key, number)
            if first != number:
                counts[first] = counts.get(first, 0) + 1
        if not counts:
            continue
        other = max(counts, key=lambda i: counts[i])
        if counts[other] >= max(FEWEST, SHARED * min(len(own), len(keys[other]))):
            yield from _shared(campaign, measured[other], experiment, counts[other])


def _shared(campaign: Campaign, one: Experiment, other: Experiment, count: int) -> Iterator[Finding]:
    """The message on two experiments that share samples."""
    channel = next(name for name in other.record.channels if _is_response(name)) if other.record else ""
    if one.inputs != other.inputs:
        told = " and ".join(
            ", ".join(f"{n} = {campaign.unit(n).from_si(v):.3g} {campaign.unit(n).text}" for n, v in e.inputs.items())
            for e in (one, other)
        )
        message = f"it has {count} samples of {one.id}, but other inputs ({told}): one record with two inputs?"
        yield Finding("doubt", other.id, channel, None, message, "copy")
        return
    assert one.record is not None and other.record is not None
    shared = count
    if one.record == other.record:
        shared = int((one.in_window & other.in_window).sum())
    if shared <= BORDER:
        return  # windows of one record, one after the other
    if one.split != other.split:
        message = f"{shared} samples of the window are those of {one.id}: fitted samples cannot test a model"
        yield Finding("doubt", other.id, channel, None, message, "overlap")
    else:
        message = f"{shared} samples are those of {one.id}: is it there twice?"
        yield Finding("doubt", other.id, channel, None, message, "copy")


def _samples(experiment: Experiment) -> set[bytes]:
    """Keys that distinguish samples: a sample of all responses with the two that follow it."""
    assert experiment.record is not None
    columns = [values for name, values in experiment.record.channels.items() if _is_response(name)]
    table = np.stack(columns, axis=1)
    moves = np.abs(np.diff(table, axis=0)).min(axis=1) > 0  # rest is alike in all records
    rows = np.concatenate([table[:-2], table[1:-1], table[2:]], axis=1)[moves[:-1] & moves[1:]]
    return {row.tobytes() for row in np.ascontiguousarray(rows)}


def _beyond(campaign: Campaign) -> Iterator[Finding]:
    names = [name for name in campaign.channels if own_name(name) == "elongation"]
    for name in names:
        fitted = [_largest(e, name) for e in campaign.train]
        largest = max((value for value in fitted if value is not None), default=None)
        if not largest:
            continue
        for experiment in campaign.test:
            value = _largest(experiment, name)
            if value is not None and value > BEYOND * largest:
                there, ours = (amount(campaign.pair, name, size) for size in (value, largest))
                message = f"it reaches {there}, the fitted experiments reach {ours}: its prediction is an extrapolation"
                yield Finding("doubt", experiment.id, name, None, message, "beyond")


def _largest(experiment: Experiment, name: str) -> float | None:
    record = experiment.scored
    if record is None or name not in record.channels or not np.isfinite(record[name]).all():
        return None
    return float(np.abs(record[name]).max())


def _is_response(name: str) -> bool:
    return not is_driver(name)
