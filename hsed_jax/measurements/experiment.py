"""One experiment: its inputs, its record, its quantities, all in SI."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Literal, get_args

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.noise import RecordNoise
from hsed_jax.measurements.units import parse_unit
from hsed_jax.physics.outputs import quantity
from hsed_jax.plain import MOST, name_fault, shown

Status = Literal["completed", "pending", "failed", "abandoned"]
Split = Literal["train", "test"]


@dataclass(frozen=True)
class Noise:
    """Measurement noise: a standard deviation, `absolute` [SI] or `relative` to the RMS of the measurement."""

    absolute: float | None = None
    relative: float | None = None

    def __post_init__(self):
        """Check that exactly one of the two is given, finite and not negative."""
        given = [v for v in (self.absolute, self.relative) if v is not None]
        if len(given) != 1 or not 0 <= given[0] < np.inf:
            raise UserError(
                f"noise is absolute={self.absolute}, relative={self.relative}; give one of them, finite, not negative"
            )

    def standard_deviation(self, values) -> float:
        """Return the standard deviation [SI] for measured `values` (n,), or for one scalar quantity."""
        if self.absolute is not None:
            return self.absolute
        assert self.relative is not None
        return self.relative * float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class Channel:
    """A channel or quantity: canonical `name`, declared `unit`, its `column` in the files, its `noise` [SI]."""

    name: str
    unit: str
    column: str = ""
    noise: Noise | None = None

    def __post_init__(self):
        """By default, name the column like the channel; round the noise to a number that the unit can write."""
        object.__setattr__(self, "column", self.column or self.name)
        if self.noise is not None and self.noise.absolute is not None:
            unit = parse_unit(self.unit)
            object.__setattr__(self, "noise", Noise(absolute=float(unit.snap(self.noise.absolute))))


@dataclass(frozen=True, eq=False)
class Record:
    """A time history: `time` (n,) [s] and `channels`, each (n,) [SI].  The arrays are made read-only.

    `noise` has the noise of channels [SI] that was estimated before samples were left out.

    Raises:
        UserError: There are fewer than two samples, the length of a channel differs from that of the time, or a number
            is impossible, such as infinity.
    """

    time: np.ndarray
    channels: dict[str, np.ndarray]
    noise: Mapping[str, RecordNoise] = field(default_factory=dict)

    def __post_init__(self):
        """Freeze the arrays and check their lengths."""
        object.__setattr__(self, "time", _frozen(self.time))
        object.__setattr__(self, "channels", {name: _frozen(values) for name, values in self.channels.items()})
        if self.time.ndim != 1 or self.time.size < 2:
            raise UserError(
                f"time has shape {self.time.shape}; a record needs one time per sample and at least two samples"
            )
        for name, values in self.channels.items():
            if values.shape != self.time.shape:
                raise UserError(
                    f"channel {name!r} has shape {values.shape}; time has {self.time.shape}, they must agree"
                )
        for name, values in {"time": self.time, **self.channels}.items():
            if (beyond := np.abs(values) > MOST).any():
                sample = int(np.argmax(beyond))
                raise UserError(
                    f"{name} is {values[sample]:g} at sample {sample + 1}, out of range; where a sample is missing, "
                    "write nan"
                )

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.time.size

    def __getitem__(self, channel: str) -> np.ndarray:
        """Return a channel, (n,) [SI]."""
        if channel not in self.channels:
            raise UserError(f"the record has no channel {channel!r}; it has {', '.join(self.channels)}")
        return self.channels[channel]

    def __eq__(self, other: object) -> bool:
        """Return whether times and channels are the same numbers (NaN equals NaN)."""
        return self is other or (
            isinstance(other, Record)
            and self.channels.keys() == other.channels.keys()
            and np.array_equal(self.time, other.time, equal_nan=True)
            and all(np.array_equal(v, other.channels[k], equal_nan=True) for k, v in self.channels.items())
        )

    def __repr__(self) -> str:
        """Return length, duration and channels."""
        return f"Record({len(self)} samples, {self.time[0]:g} to {self.time[-1]:g} s: {', '.join(self.channels)})"


@dataclass(frozen=True)
class Experiment:
    """One experiment of a campaign.

    Attributes:
        id: Its name, unique in the campaign; also the name of its record file.
        inputs: Value of each variable input [SI].
        record: The measured time histories.  A pending experiment may hold the ground motion that is planned.
        quantities: Measured scalar quantities [SI], instead of or beside the record.
        status: `completed`, `pending`, `failed` or `abandoned`.
        reason: Reason of a failure or of abandoning it.
        split: `train`, or `test`: never used for fitting.
        window: First and last time [s] to fit or score; the simulation always starts with the record.
        metadata: Free text by column name.

    Raises:
        UserError: A field has a value that is not allowed.
    """

    id: str
    inputs: dict[str, float] = field(default_factory=dict)
    _: KW_ONLY
    record: Record | None = None
    quantities: dict[str, float] = field(default_factory=dict)
    status: Status = "completed"
    reason: str | None = None
    split: Split = "train"
    window: tuple[float, float] | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        """Check the fields of one experiment, without its campaign."""
        check_id(self.id)
        where = f"experiment {self.id!r}: "
        check_word(self.status, get_args(Status), f"{where}status")
        check_word(self.split, get_args(Split), f"{where}split")
        for kind in ("inputs", "quantities"):
            numbers = {str(name): float(value) for name, value in getattr(self, kind).items()}
            object.__setattr__(self, kind, numbers)
            for name, value in numbers.items():
                if not abs(value) <= MOST:
                    raise UserError(f"{where}{name} is {value:g}; {kind} are finite numbers of sensible size")
        # A table cannot distinguish a blank cell from an absent one, and ignores blanks around a text.
        texts = {str(name): str(text).strip() for name, text in self.metadata.items()}
        object.__setattr__(self, "metadata", {name: text for name, text in texts.items() if text})
        object.__setattr__(self, "reason", (self.reason or "").strip() or None)
        if self.status == "pending" and self.quantities:
            raise UserError(f"{where}it is pending but has {', '.join(self.quantities)}; set its status to completed")
        if self.window is not None:
            self._check_window(where)

    def _check_window(self, where: str) -> None:
        assert self.window is not None
        start, end = float(self.window[0]), float(self.window[1])
        object.__setattr__(self, "window", (start, end))
        if self.record is None:
            raise UserError(f"{where}it has a window (from, to) and no record; a window selects part of a record")
        first, last, slack = float(np.min(self.record.time)), float(np.max(self.record.time)), self._slack
        if not first - slack <= start < end <= last + slack:
            raise UserError(
                f"{where}the window from {start:g} to {end:g} does not lie in the record; "
                f"'from' must be less than 'to', and both between {first:g} and {last:g}"
            )
        if not self.in_window.any():
            raise UserError(f"{where}no sample lies in the window from {start:g} to {end:g}; widen 'from' and 'to'")

    def quantity(self, name: str, masses: int = 0) -> float:
        """Return a quantity [SI] from the table, otherwise from the record; NaN without both.

        Arguments:
            name: Of the quantity (`hsed_jax.physics.outputs`).
            masses: Number of masses of the structure; without them, no quantity of the masses is available.
        """
        if name in self.quantities:
            return self.quantities[name]
        known = quantity(name)
        needed = known.channels(masses)
        if self.record is None or not needed or not set(needed) <= self.record.channels.keys():
            return float("nan")
        return known.measured(self.record.time, {channel: self.record[channel] for channel in needed})

    @property
    def in_window(self) -> np.ndarray:
        """The samples of the record to fit or score, (n,) bool."""
        if self.record is None:
            raise UserError(f"experiment {self.id!r} has no record")
        if self.window is None:
            return np.ones(len(self.record), dtype=bool)
        start, end = self.window[0] - self._slack, self.window[1] + self._slack
        return (self.record.time >= start) & (self.record.time <= end)

    @property
    def scored(self) -> Record | None:
        """The part of the record to fit or score; None without one."""
        if self.record is None or self.window is None:
            return self.record
        inside = self.in_window
        return Record(self.record.time[inside], {name: values[inside] for name, values in self.record.channels.items()})

    @property
    def _slack(self) -> float:
        # A tolerance: a table says 0.3, and the record's third step of 0.1 is 0.30000000000000004.
        return 0.0 if self.record is None else 1e-9 * float(np.ptp(self.record.time))


def check_id(id: object) -> None:
    """Raise `UserError` unless `id` can name an experiment and its record file."""
    rule = "an id is a short text that can name a file: no / or \\, no line break, not starting with a dot, # or %"
    if not isinstance(id, str) or name_fault(id) or len(id) > 100 or "\\" in id or id[0] in ".#%":
        raise UserError(f"{shown(id)} is not an id; {rule}")


def check_word(word: object, allowed: tuple[str, ...], where: str) -> None:
    """Raise `UserError` unless `word` is one of those allowed."""
    if word not in allowed:
        raise UserError(f"{where}: {shown(word)} is not allowed; allowed: {', '.join(allowed)}")


def _frozen(values) -> np.ndarray:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array
