"""The noise of a record, from its samples alone."""

import math

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
    count = time.size - order
    at, sampled = ([of[k : k + count] for k in range(order + 1)] for of in (time, values))
    # A divided difference is a weighted sum of samples; weights of unit length keep the noise's standard deviation.
    with np.errstate(divide="ignore", invalid="ignore"):
        # Gaps relative to their window: products of small ones would underflow.
        gaps = [[(here - there) / (at[-1] - at[0]) for there in at] for here in at]
        weights = [1.0 / math.prod(own[:k] + own[k + 1 :]) for k, own in enumerate(gaps)]
        length = np.sqrt(sum(weight**2 for weight in weights))
        differences = sum(weight * one for weight, one in zip(weights, sampled, strict=True)) / length
    # Exact zeros are a record at rest that was rounded or padded: they carry no information on the sensor.
    informative = np.abs(differences[np.isfinite(differences) & (differences != 0)])
    return float(1.4826 * np.median(informative)) if informative.size else 0.0
