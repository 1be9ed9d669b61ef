"""Errors of the test rig: what the record says is not what the specimen did.

A sensor is a function (reading, δ, rng) on histories of the fine grid; in a component test an error of the elongation acts on the
imposed motion instead: the record keeps the programme, the specimen gets something else.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.signal

from .catalogue import OFFSET, TIME, add


@dataclass(frozen=True)
class Reading:
    """Histories (n, lanes) on the uniform grid `time` (n,): elongation [m], force [N]; F_c [N], and the unit of times [s]."""

    time: np.ndarray
    u: np.ndarray
    force: np.ndarray
    scale: float
    unit: float


@dataclass(frozen=True)
class Program:
    """Growing cycles: u = D τ sin φ, τ = t/T, φ = 2π f t; (n, lanes) from times (n, 1), with two derivatives.

    Attributes:
        amplitude, frequency: D [m] at the end, f [Hz], per lane.
        duration: T [s].
        lead: the specimen gets the motion this much earlier [s].
        lag: the specimen gets u + lag·u̇ [s]: what is measured is its first-order lag.
        gain: the specimen gets u/gain.
    """

    amplitude: np.ndarray
    frequency: np.ndarray
    duration: float
    lead: np.ndarray | float = 0.0
    lag: np.ndarray | float = 0.0
    gain: np.ndarray | float = 1.0

    def __call__(self, time) -> tuple[np.ndarray, np.ndarray]:
        """Elongation of the specimen [m] and its rate [m/s]."""
        u, v, a = self._derivatives(time + self.lead)
        return (u + self.lag * v) / self.gain, (v + self.lag * a) / self.gain

    def recorded(self, time) -> np.ndarray:
        """The elongation as it was commanded and recorded [m]."""
        return self._derivatives(time)[0]

    def _derivatives(self, t) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slope, omega = self.amplitude / self.duration, 2 * np.pi * self.frequency
        sine, cosine = np.sin(omega * t), np.cos(omega * t)
        return (
            slope * t * sine,
            slope * (sine + omega * t * cosine),
            slope * (2 * omega * cosine - omega**2 * t * sine),
        )


def shifted(time: np.ndarray, values: np.ndarray, delay) -> np.ndarray:
    """values(t − delay), linear between samples and zero before the start; `delay` (lanes,) or (n, lanes) [s]."""
    position = (time[:, None] - delay) / (time[1] - time[0])
    place = np.clip(position, 0, len(time) - 1.000001)
    below = place.astype(int)
    lanes = np.arange(values.shape[1])
    part = place - below
    moved = (1 - part) * values[below, lanes] + part * values[below + 1, lanes]
    return np.where(position < 0, values[0], moved)


def _delayed(reading, delta, rng):
    return replace(reading, u=shifted(reading.time, reading.u, np.broadcast_to(delta * reading.unit, reading.u.shape)))


def _lagged(reading, delta, rng):
    """First-order lag τ ṁ + m = u of the measured elongation."""
    step, lagged = reading.time[1] - reading.time[0], np.empty_like(reading.u)
    for i, tau in enumerate(np.broadcast_to(delta * reading.unit, reading.u.shape[1:])):
        # The trapezoidal rule: m is exact for u linear in a step up to the square of step/τ.
        b, a = [step, step], [2 * tau + step, step - 2 * tau]
        lagged[:, i] = scipy.signal.lfilter(b, a, reading.u[:, i])
    return replace(reading, u=lagged)


def _force_later(jitter: float) -> Callable:
    """The clock of the force is late by τ, with a jitter of so many τ from sample to sample."""

    def act(reading, delta, rng):
        n = len(reading.time)
        # Independent at the samples that are kept, constant between them; the same in every lane.
        noise = np.repeat(rng.standard_normal(n // 10 + 1), 10)[:n, None]
        return replace(reading, force=shifted(reading.time, reading.force, delta * reading.unit * (1 + jitter * noise)))

    return act


def _scaled_force(reading, delta, rng):
    return replace(reading, force=reading.force * (1 + delta))


def _scaled_elongation(reading, delta, rng):
    return replace(reading, u=reading.u * (1 + delta))


def _added_force(shape: Callable) -> Callable:
    def act(reading, delta, rng):
        return replace(reading, force=reading.force + delta * reading.scale * shape(reading.time)[:, None])

    return act


def _drive_lead(program, tau):
    return replace(program, lead=program.lead + tau)


def _drive_lag(program, tau):
    return replace(program, lag=program.lag + tau)


def _drive_gain(program, delta):
    return replace(program, gain=program.gain * (1 + delta))


RATE = ("drift", "N/s", lambda c: c.force / 10.0)
SENSOR = {"place": "sensor"}
add("actuator_delay", "same", _delayed, 2.0, TIME, drive=_drive_lead, **SENSOR)
add("actuator_delay", "first-order lag", _lagged, 2.0, TIME, drive=_drive_lag, **SENSOR)
add("time_offset", "same", _force_later(0.0), 2.0, TIME, **SENSOR)
add("time_offset", "with jitter", _force_later(0.2), 2.0, TIME, **SENSOR)
add("force_gain", "same", _scaled_force, 0.9, is_signed=True, **SENSOR)
add("elongation_gain", "same", _scaled_elongation, 0.9, drive=_drive_gain, is_signed=True, **SENSOR)
add("force_offset", "same", _added_force(np.ones_like), 1.0, OFFSET, is_signed=True, **SENSOR)
add("force_offset", "settling", _added_force(lambda t: -np.expm1(-t / 0.3)), 1.0, OFFSET, is_signed=True, **SENSOR)
add("force_drift", "same", _added_force(lambda t: t / 10.0), 2.0, RATE, is_signed=True, **SENSOR)
add("force_drift", "square", _added_force(lambda t: (t / 10.0) ** 2), 2.0, OFFSET, is_signed=True, **SENSOR)
add(
    "force_drift", "log", _added_force(lambda t: np.log1p(t / 2.0) / np.log(6.0)), 2.0, OFFSET, is_signed=True, **SENSOR
)
add(
    "force_drift",
    "from 4 s on",
    _added_force(lambda t: np.maximum(t - 4.0, 0.0) / 6.0),
    2.0,
    OFFSET,
    is_signed=True,
    **SENSOR,
)
add(
    "force_drift",
    "logistic",
    _added_force(lambda t: 1 / (1 + np.exp((5.0 - t) / 0.8))),
    2.0,
    OFFSET,
    is_signed=True,
    **SENSOR,
)
