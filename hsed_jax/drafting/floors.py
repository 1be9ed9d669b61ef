"""A first model of a shaken building from its floor sensors, without a measured force."""

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements import Campaign, Record

# Frequencies at which the ground has less than this share of its largest power carry no information on the building.
# Frequencies with fewer periods in the record than this carry none, either.
_LEAST_POWER, _LEAST_PERIODS = 0.01, 4


class Floors(NamedTuple):
    """The information of floor sensors on a building of equal storeys.

    Attributes:
        frequency: the first one [Hz].
        stiffness: of a storey, per mean mass of a floor [N/m/kg].
        strength: largest force in the lowest storey, per mean mass of a floor [N/kg].
    """

    frequency: float
    stiffness: float
    strength: float


def floor_count(campaign: Campaign) -> int:
    """The highest floor with a sensor; 1 without one."""
    return max((number for number, _ in map(_floor, campaign.channels)), default=1)


def top_channel(campaign: Campaign) -> str | None:
    """The channel that measures the motion of the highest floor most directly; None if no floor has a sensor."""
    return max((name for name in campaign.channels if _floor(name)[0]), key=_floor, default=None)


def floors_of(campaign: Campaign, masses: Sequence[float] = ()) -> Floors | None:
    """Frequency, stiffness and strength by the highest sensor, medians over the training experiments; None without one.

    Arguments:
        campaign: of a shaken building.
        masses: of the floors from the lowest up [kg], as many as the floor of the highest sensor; equal ones if they are
            unknown.

    The first frequency is that of the largest ratio between the velocity of this floor, relative to the ground, and the
    ground motion. In accelerations a yielding first mode is lower than the second; in displacements a drift is higher than
    both.  All floors move in the first mode of a shear building of n storeys with one stiffness; for equal masses this is
    $\\phi_i = \\sin\\frac{i\\pi}{2n+1}$, $\\omega_1 = 2\\sqrt{k/m}\\sin\\frac{\\pi}{4n+2}$.
    """
    if (name := top_channel(campaign)) is None:
        return None
    count, _ = _floor(name)
    rows = [_top(e.record, name) for e in campaign.train if e.record is not None and name in e.record.channels]
    if not rows:
        return None
    frequency, acceleration = (float(value) for value in np.median(rows, axis=0))
    relative = np.asarray(masses or np.ones(count), dtype=float)
    relative = relative / relative.mean()
    squared, mode = _first_mode(relative)
    stiffness = (2 * math.pi * frequency) ** 2 / squared
    return Floors(frequency, stiffness, acceleration * float(relative @ mode / mode[-1]))


def _first_mode(masses: np.ndarray) -> tuple[float, np.ndarray]:
    """Square of the first circular frequency, and the mode (n,), of masses (n,) on springs of stiffness 1, one on another."""
    count = len(masses)
    springs = np.diag([2.0] * (count - 1) + [1.0]) - np.diag(np.ones(count - 1), 1) - np.diag(np.ones(count - 1), -1)
    root = np.sqrt(masses)
    squared, modes = np.linalg.eigh(springs / np.outer(root, root))
    mode = modes[:, 0] / root
    return float(squared[0]), mode * np.sign(mode[-1])


def _floor(name: str) -> tuple[int, int]:
    """Number of the floor of a channel, and a rank of how directly it measures accelerations; 0 for a channel without a
    floor.
    """
    if name == "elongation":
        return 1, 0  # the specimen of the first model is its lowest storey
    found = re.fullmatch(r"(displacement|velocity|acceleration)_(\d+)(_absolute)?", name)
    if found is None:
        return 0, 0
    return int(found[2]), {"displacement": 0, "velocity": 1, "acceleration": 2}[found[1]] + (found[3] is not None)


def _top(record: Record, name: str) -> tuple[float, float]:
    """First frequency [Hz] by one sensor of a record, and the largest absolute acceleration there [m/s²]."""
    motion, ground = record[name], record.channels.get("ground_acceleration")
    kind, is_absolute = name.partition("_")[0], name.endswith("_absolute")
    # From a motion to a velocity, in powers of the frequency.
    order = {"acceleration": -1, "velocity": 0}.get(kind, 1)
    is_relative_known = kind == "acceleration" and is_absolute and ground is not None
    time = np.linspace(record.time[0], record.time[-1], len(record))
    interval = float(np.ptp(time)) / (len(record) - 1)
    frequencies = np.fft.rfftfreq(len(record), interval)[1:]
    window = np.sin(np.pi * np.arange(len(record)) / len(record)) ** 2

    def power(values: np.ndarray) -> np.ndarray:
        even = np.interp(time, record.time, values)
        straight = np.polynomial.Polynomial.fit(time, even, 1)(time)
        found = np.abs(np.fft.rfft(window * (even - straight))) ** 2
        found[0] /= 2  # the mean has no frequency of the other sign
        return np.convolve(found, np.ones(5) / 5, "same")[1:]

    response = power(motion - ground if is_relative_known else motion) * frequencies ** (2 * order)
    if ground is not None:
        shaken = power(ground)
        response = np.where(shaken > _LEAST_POWER * shaken.max(), response / np.maximum(shaken, 1e-300), 0.0)
    counts = frequencies * np.ptp(time) >= _LEAST_PERIODS
    frequency = float(frequencies[np.argmax(np.where(counts, response, 0.0))])
    if kind == "acceleration":
        total = motion if is_absolute or ground is None else motion + ground
        return frequency, float(np.abs(total).max())
    return frequency, float(np.abs(motion - motion[0]).max()) * (2 * math.pi * frequency) ** (1 + order)
