"""The sensors of a laboratory outside this program, and the check of its answers against them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.laboratories.request import Request
from hsed_jax.measurements import Campaign, Channel, Experiment, Record, check_campaign
from hsed_jax.physics.outputs import output


@dataclass(frozen=True)
class Sensors:
    """The channels and quantities of a laboratory, as `campaign.yaml` declares them.

    Attributes:
        channels: of its records, with the time; empty without records.
        quantities: numbers that it returns besides records.
        columns: by channel, the column of its record files: a name, or a position from 1 where they have no header.
        driver: the channel that measures the excitation of the experiments.
        at_sample_times: interpolate records linearly to the times at which the study compares histories.

    Raises:
        UserError: an unknown channel, a wrong unit, or channels without the time.
    """

    channels: Mapping[str, Channel] = field(default_factory=dict)
    quantities: Mapping[str, Channel] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)
    driver: str = "ground_acceleration"
    at_sample_times: bool = False

    def __post_init__(self):
        """Check the declaration."""
        self._header  # noqa: B018  (it refuses what cannot be)

    @cached_property
    def _header(self) -> Campaign:
        return Campaign("measured", "ground_motion", channels=dict(self.channels), quantities=dict(self.quantities))

    @property
    def recorded(self) -> dict[str, Channel]:
        """The channels of the stored records, including the requested excitation."""
        if not self.channels or self.driver in self.channels:
            return dict(self.channels)
        return {**self.channels, self.driver: Channel(self.driver, output(self.driver).unit)}

    def record(self, request: Request, columns: Mapping[str, Any], source: str, *, partial: bool = False) -> Record:
        """A record in SI.

        Arguments:
            request: of the experiment.
            columns: by channel, its samples (n,) in the declared unit.
            source: where they come from, for a message.
            partial: the record of a failed experiment: it is kept unchanged, even if it is short or clipped.

        Raises:
            ExperimentFailed: a channel is missing, has no numbers, stands still or runs backward in time, or the record is
                shorter than the compared duration.
        """
        if missing := [name for name in self.channels if name not in columns]:
            raise ExperimentFailed(f"{source}: there is no {missing[0]}; given are {', '.join(columns) or 'none'}")
        try:
            channels = {name: self._header.unit(name).to_si(_numbers(name, columns[name])) for name in self.channels}
            record = Record(channels.pop("time"), channels)
            findings = check_campaign(self._header.add(Experiment(request.id, record=record)))
        except UserError as error:
            raise ExperimentFailed(f"{source}: {error}") from None
        for finding in findings:
            if finding.level == "error" and not partial:
                when = "" if finding.time is None else f" at {finding.time:g} s"
                raise ExperimentFailed(f"{source}: {finding.channel}{when}: {finding.message}")
        if self.at_sample_times and not partial:
            record = _sampled(record, request.sample_times, source)
        if self.driver in record.channels:
            return record
        planned = np.interp(record.time, request.time, request.driver[self.driver], left=0.0, right=0.0)
        return replace(record, channels={**record.channels, self.driver: planned})

    def numbers(self, values: Mapping[str, Any], source: str) -> dict[str, float]:
        """The quantities in SI.

        Arguments:
            values: by quantity, a number in the declared unit.
            source: where they come from, for a message.

        Raises:
            ExperimentFailed: one is missing or not finite.
        """
        found = {}
        for name in self.quantities:
            if name not in values:
                raise ExperimentFailed(f"{source}: there is no {name}; given are {', '.join(values) or 'none'}")
            try:
                value = _numbers(name, values[name])
            except UserError as error:
                raise ExperimentFailed(f"{source}: {error}") from None
            if value.size != 1 or not np.isfinite(value).all():
                raise ExperimentFailed(f"{source}: {name} is {values[name]!r}; a quantity is one finite number")
            found[name] = float(self._header.unit(name).to_si(value.item()))
        return found


def _numbers(name: str, values: Any) -> np.ndarray:
    try:
        array = np.asarray(values)
    except ValueError as error:  # lists of different lengths
        raise UserError(f"{name} is no array ({error})") from None
    if array.dtype.kind not in "iuf":
        raise UserError(f"{name} is {values!r:.60}; numbers are wanted")
    return array.astype(float)


def _sampled(record: Record, times: np.ndarray, source: str) -> Record:
    """A record at the given times; it must cover them, except for one sampling step."""
    slack = times[1] - times[0]
    if record.time[0] > slack or record.time[-1] < times[-1] - slack:
        raise ExperimentFailed(
            f"{source}: the record lasts from {record.time[0]:g} to {record.time[-1]:g} s; "
            f"the study compares from 0 to {times[-1]:g} s"
        )
    return Record(times, {name: np.interp(times, record.time, values) for name, values in record.channels.items()})
