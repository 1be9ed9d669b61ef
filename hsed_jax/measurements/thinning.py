r"""Long records of component tests, thinned along the path of the elongation.

A quasi-static test is sampled in time, but far fewer samples describe its loops.  The kept samples are both ends, the ends of
all windows, every reversal, the largest force between two reversals, and between them samples at equal steps of

$$s = 0.8\,\frac{\sigma}{\sigma_{end}} + 0.2\,\frac{row}{rows}, \qquad d\sigma = \frac{|d\Delta u|}{\sqrt{w}},$$

with w the elongation from one reversal to the next.  Small cycles keep more than their share, because they show the stiffness,
and a hold keeps its relaxation.  Samples are left out and never averaged: every kept sample was measured.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements.experiment import Experiment, Record
from hsed_jax.measurements.noise import record_noise
from hsed_jax.measurements.turns import half_cycles

_EVENLY = 0.2


class Loss(NamedTuple):
    """The loss by thinning.

    Attributes:
        rows, kept: samples before and after.
        deviation: RMS of what was left out from a line between its neighbours, over the range; of the worst channel.
        energy: change of the dissipated energy, relative; 0 without force and elongation.
    """

    rows: int
    kept: int
    deviation: float
    energy: float

    def __str__(self) -> str:
        """Return the loss in words."""
        energy = f"the dissipated energy changes by {100 * self.energy:.2g} %"
        return (
            f"thinned from {self.rows} to {self.kept} samples along the path, reversals kept; the omitted samples are within "
            f"{100 * self.deviation:.2g} % of the range from a line through the others (RMS), {energy}"
        )


def thinned(experiment: Experiment, samples: int, others: Sequence[Experiment] = ()) -> Experiment:
    """Thin the record of a component test.

    Arguments:
        experiment: With an elongation in its record; not changed.
        samples: About how many to keep; a shorter record stays as it is.
        others: Experiments that may be further windows of the record.  All windows keep the same samples, so that one
            simulation serves them.

    Returns:
        The experiment with some samples of its record, at their own times, and its window.
    """
    record = experiment.record
    if record is None or len(record) <= samples or "elongation" not in record.channels:
        return experiment
    if not np.isfinite(record["elongation"]).all():
        return experiment  # the check of the data says so
    rows = len(record)
    turns = half_cycles(record["elongation"])
    kept = [turns, [0, rows - 1], *(_ends(one) for one in (experiment, *others) if one.record == record)]
    if "force" in record.channels:
        force = np.abs(record["force"])
        kept.append(np.asarray([a + int(np.argmax(force[a : b + 1])) for a, b in pairwise(turns)], dtype=int))
    swings = np.maximum(np.abs(np.diff(record["elongation"][turns])), 1e-300)
    swing = np.repeat(swings, np.diff(turns))
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(record["elongation"])) / np.sqrt(swing))])
    s = (1 - _EVENLY) * path / path[-1] + _EVENLY * np.arange(rows) / (rows - 1)
    fixed = np.unique(np.concatenate(kept))
    evenly = np.searchsorted(s, np.linspace(0, s[-1], max(samples - len(fixed), samples // 2)))
    chosen = np.union1d(fixed, np.minimum(evenly, rows - 1)).astype(int)
    # The samples that are left do not resolve the signal, whose curvature would count as noise.
    within = experiment.in_window
    unknown = {name: values[within] for name, values in record.channels.items() if name not in record.noise}
    noise = {**record.noise, **{name: record_noise(record.time[within], own) for name, own in unknown.items()}}
    thin = Record(record.time[chosen], {name: values[chosen] for name, values in record.channels.items()}, noise)
    return replace(experiment, record=thin)


def _ends(experiment: Experiment) -> np.ndarray:
    """The first and the last sample of a window."""
    return np.flatnonzero(experiment.in_window)[[0, -1]]


def loss(record: Record, thin: Record) -> Loss:
    """Compare a record with its kept samples."""
    deviations = [
        float(np.sqrt(np.mean((np.interp(record.time, thin.time, thin[name]) - values) ** 2)) / (np.ptp(values) or 1.0))
        for name, values in record.channels.items()
    ]
    energy = 0.0
    if {"force", "elongation"} <= record.channels.keys():
        before, after = (float(np.trapezoid(r["force"], r["elongation"])) for r in (record, thin))
        energy = abs(after - before) / (abs(before) or 1.0)
    return Loss(len(record), len(thin), max(deviations), energy)
