"""Characteristic values of a campaign, from its data: what makes amplitudes dimensionless and priors sensible."""

from typing import NamedTuple

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Experiment, Record


class Characteristics(NamedTuple):
    """Typical magnitudes over the experiments of a campaign; NaN where nothing tells.

    Attributes:
        force: median over experiments of the largest force [N].
        elongation: the same of the elongation [m].
        rate: the same of the elongation rate [m/s].
        energy: the same of the absorbed energy [J].
        stiffness: median initial stiffness [N/m].
    """

    force: float
    elongation: float
    rate: float
    energy: float
    stiffness: float


def characteristics(campaign: Campaign) -> Characteristics:
    """Characteristic values of the completed training experiments, from records or else from quantities."""
    rows = np.asarray([_of(e) for e in campaign.train.experiments]).reshape(-1, 5)
    with np.errstate(all="ignore"):
        values = [float(np.median(c[np.isfinite(c)])) if np.isfinite(c).any() else float("nan") for c in rows.T]
    return Characteristics(*values)


def initial_stiffness(record: Record) -> float:
    """Slope [N/m] of force against elongation while the elongation first grows to a tenth of its peak; NaN without both."""
    if not {"force", "elongation"} <= record.channels.keys():
        return float("nan")
    force, elongation = record["force"], record["elongation"]
    size = np.abs(elongation - elongation[0])
    beyond = np.flatnonzero(size > 0.1 * size.max())
    first = slice(0, max(int(beyond[0]) + 1 if beyond.size else 3, 3))
    du, dr = elongation[first] - elongation[0], force[first] - force[0]
    work = float(du @ du)
    slope = float(du @ dr) / work if work > 0 else float("nan")
    return slope if slope > 0 else float("nan")


def _of(experiment: Experiment) -> tuple[float, ...]:
    record, rate, stiffness = experiment.record, float("nan"), float("nan")
    if record is not None and "elongation" in record.channels:
        # A high quantile: single noisy differences are no rates.
        rate = float(np.quantile(np.abs(np.gradient(record["elongation"], record.time)), 0.98))
        stiffness = initial_stiffness(record)
    return (
        experiment.quantity("peak_force"),
        experiment.quantity("peak_elongation"),
        rate,
        abs(experiment.quantity("dissipated_energy")),
        stiffness,
    )
