"""The noise of a record, from its samples alone."""

import numpy as np


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
