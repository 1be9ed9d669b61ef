"""The noise of a record, from its samples alone."""

from typing import NamedTuple

import numpy as np

_MOST_CORRELATED = 0.93
"""The largest correlation of the noise of neighbouring samples that is considered: its differences show a fifth of it."""


class RecordNoise(NamedTuple):
    """The noise of a channel, from its record.

    Attributes:
        size: standard deviation if the noise is white (`noise_estimate`), in the unit of the channel.
        largest: the largest standard deviation that the record allows; autocorrelated noise may be larger than `size`.
    """

    size: float
    largest: float


def record_noise(time: np.ndarray, values: np.ndarray) -> RecordNoise:
    r"""Estimate the noise of a record, and how large it may be if it is autocorrelated.

    A correlation ρ of neighbours (autoregression of first order) reduces the variance of third differences by the factor
    $v(\rho) = 1 - 1.5\rho + 0.6\rho^2 - 0.1\rho^3$, and that of every second sample by $v(\rho^2)$.  The ratio of the two
    estimates of the noise therefore shows ρ.  Ratio and estimate count with two standard deviations, 2.4/√n and 1.7/√n of
    their values for n samples.  A signal that the sampling does not resolve has a large ratio, too.

    Arguments:
        time: sample times (n,), increasing.
        values: samples (n,).

    Returns:
        Both in the unit of `values`; NaN if there are too few samples.
    """
    size, doubt = noise_estimate(time, values), 2 / np.sqrt(len(time))
    sparse = float(np.mean([noise_estimate(time[start::2], values[start::2]) for start in (0, 1)]))
    rho = np.linspace(0.0, _MOST_CORRELATED, 94)
    ratio = (sparse / size if size > 0 else 1.0) + 2.4 * doubt
    correlated = float(np.interp(ratio, np.sqrt(_shown(rho**2) / _shown(rho)), rho)) if np.isfinite(ratio) else rho[-1]
    return RecordNoise(size, size * (1 + 1.7 * doubt) / float(np.sqrt(_shown(correlated))))


def _shown(rho):
    """Share of the variance of autocorrelated noise that third differences show."""
    return 1 - 1.5 * rho + 0.6 * rho**2 - 0.1 * rho**3


def noise_estimate(time, values) -> float:
    """Estimate the standard deviation of white noise on a smooth signal.

    The median magnitude of third divided differences, scaled for Gaussian noise. Cubics cancel, rare jumps have no
    influence, and sampling may be uneven.  Where the sampling does not resolve the signal it is an upper bound.

    Arguments:
        time: Sample times (n,), increasing.
        values: Samples (n,), n ≥ 8.

    Returns:
        The standard deviation in the unit of `values`; NaN if there are too few samples.
    """
    return difference_noise(np.asarray(time, dtype=float), np.asarray(values, dtype=float), 3)


def difference_noise(time: np.ndarray, values: np.ndarray, order: int) -> float:
    """The same from divided differences of any order; for white noise every order gives the same estimate."""
    if time.size < order + 5:
        return float("nan")
    windows = np.lib.stride_tricks.sliding_window_view(time, order + 1)
    gaps = windows[:, :, None] - windows[:, None, :] + np.eye(order + 1)
    # A divided difference is a weighted sum of samples; weights of unit length keep the noise's standard deviation.
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = 1.0 / np.prod(gaps / np.abs(gaps).max(axis=(1, 2), keepdims=True), axis=2)
        weights /= np.linalg.norm(weights, axis=1, keepdims=True)
        differences = np.sum(weights * np.lib.stride_tricks.sliding_window_view(values, order + 1), axis=1)
    # Exact zeros are a record at rest that was rounded or padded: they carry no information on the sensor.
    informative = np.abs(differences[np.isfinite(differences) & (differences != 0)])
    return float(1.4826 * np.median(informative)) if informative.size else 0.0
