"""The noise of the histories of a prediction: declared, or estimated from their records."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hsed_jax.measurements import Experiment
from hsed_jax.measurements.noise import RecordNoise, record_noise

if TYPE_CHECKING:
    from hsed_jax.criticism.prediction import Prediction

HISTORY = 30
"""Least number of values of an output for an estimate of an undeclared noise."""
_SEEN = 8  # least number of samples for an estimate of the noise


def noise_sizes(prediction: "Prediction", output: str, declared: bool) -> np.ndarray:
    """Sd of the noise of an output, (n, J): declared; or for histories estimated from the non-smooth part of the
    record, and at most the inferred error, which includes it.
    """
    sigma = prediction.sigma[:, prediction.columns(output)]
    return sigma if declared else np.fmin(_shown_by(prediction, output)[0], sigma)


def largest_noise(prediction: "Prediction", output: str) -> np.ndarray:
    """The largest sd of an undeclared noise that the records allow, (n, J); infinite if they do not show it."""
    largest = _shown_by(prediction, output)[1]
    return np.where(np.isnan(largest), np.inf, largest)


def _shown_by(prediction: "Prediction", output: str) -> np.ndarray:
    columns = prediction.columns(output)
    measured, used = prediction.measured[:, columns], prediction.used[:, columns]
    one = np.zeros(int(columns.sum()), dtype=int)
    return shown_noise(prediction.experiments, measured, used, one, (output,))


def shown_noise(
    experiments: Sequence[Experiment],
    measured: np.ndarray,
    used: np.ndarray,
    groups: np.ndarray,
    outputs: Sequence[str],
) -> np.ndarray:
    """The noise of each history from its record, (2, n, J): its sd, and the largest one that the record allows
    (`record_noise`); NaN if it cannot be estimated.

    Where a history is too short, it is the median of the other experiments: one sensor measures all of them.
    """
    found = np.full((2, *measured.shape), np.nan)
    for group in np.unique(groups):
        (columns,) = np.nonzero(groups == group)
        if columns.size < HISTORY:
            continue
        noises = [
            _noise_of(one, outputs[int(group)], values, own)
            for one, values, own in zip(experiments, measured[:, columns], used[:, columns], strict=True)
        ]
        seen = np.asarray([noise for noise in noises if noise is not None])
        if seen.size:
            usual = np.median(seen, axis=0)
            each = np.asarray([usual if noise is None else noise for noise in noises])
            found[:, :, columns] = each.T[:, :, None]
    return found


def _noise_of(experiment: Experiment, output: str, values: np.ndarray, used: np.ndarray) -> RecordNoise | None:
    """The noise of one history; None if it cannot be estimated."""
    record = experiment.record
    if record is None:
        return None
    known = record.noise.get(output)
    if known is None and used.sum() >= _SEEN:
        known = record_noise(record.time[used[: len(record)]], values[used])
    return known if known is not None and np.isfinite(known.size) else None
