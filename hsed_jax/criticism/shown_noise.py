"""The undeclared noise of measured histories, estimated from their records."""

from collections.abc import Sequence

import numpy as np

from hsed_jax.measurements import Experiment
from hsed_jax.measurements.noise import RecordNoise, record_noise

HISTORY = 30
"""Least number of values of an output for an estimate of an undeclared noise."""
_SEEN = 8  # least number of samples for an estimate of the noise


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
