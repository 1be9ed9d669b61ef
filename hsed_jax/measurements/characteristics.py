"""Characteristic values of a campaign, from its data. Amplitudes are relative to them, and default priors use them."""

from typing import NamedTuple

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Experiment, Record
from hsed_jax.physics.names import named, owner_of
from hsed_jax.physics.outputs import loops


class Characteristics(NamedTuple):
    """Typical magnitudes over the experiments of a campaign; with several specimens, the largest; NaN if unknown.

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


START = 0.02
"""Share of the largest magnitude at which a record may begin."""

# A loaded specimen has at least this share of the secant stiffness to its peak, and has moved by at least this share of its
# motion between two samples.  Smaller values are a zero offset.
_SECANT, _MOVED = 0.5, 0.1


def characteristics(campaign: Campaign) -> Characteristics:
    """Characteristic values of the completed training experiments, from records or else from quantities."""
    rows = np.asarray([_of(e) for e in campaign.train.experiments]).reshape(-1, 5)
    with np.errstate(all="ignore"):
        values = [float(np.median(c[np.isfinite(c)])) if np.isfinite(c).any() else float("nan") for c in rows.T]
    return Characteristics(*values)


def initial_stiffness(record: Record, specimen: str = "") -> float:
    """Slope [N/m] of force against elongation while the elongation first grows to a tenth of its peak; NaN without both."""
    if specimen not in loops(record.channels):
        return float("nan")
    record = from_unloaded(record)
    force, elongation = record[named(specimen, "force")], record[named(specimen, "elongation")]
    size = np.abs(elongation - elongation[0])
    beyond = np.flatnonzero(size > 0.1 * size.max())
    first = slice(0, max(int(beyond[0]) + 1 if beyond.size else 3, 3))
    du, dr = elongation[first] - elongation[0], force[first] - force[0]
    work = float(du @ du)
    slope = float(du @ dr) / work if work > 0 else float("nan")
    return slope if slope > 0 else float("nan")


def from_unloaded(record: Record) -> Record:
    """A record that begins loaded, with one more sample before it, at which the specimen was neither moved nor loaded.

    Loggers often write no row of the virgin specimen: force and elongation of the first row then have one sign.  The added
    sample is zero, and its distance in time follows from the rate of the record.  If the force is much smaller than the
    elongation would need, the record begins with an offset and is returned unchanged.  The same holds for a record without a
    measured force.
    """
    if not {"elongation", "force"} <= record.channels.keys():
        return record
    elongation, force = record["elongation"], record["force"]
    moved, loaded = elongation[0], force[0]
    if not np.isfinite([moved, loaded]).all():
        return record
    with np.errstate(all="ignore"):
        share = loaded / np.nanmax(np.abs(force)) * np.sign(moved)
        if not share >= max(START, _SECANT * abs(moved) / np.nanmax(np.abs(elongation))):
            return record
        step = np.nanmean(np.abs(np.diff(elongation)))
        if not abs(moved) >= _MOVED * step:
            return record
        before = record.time[0] - abs(moved) / step * np.nanmean(np.diff(record.time))
    if not before < record.time[0]:
        return record
    zero = {name: np.concatenate([[0.0], values]) for name, values in record.channels.items()}
    return Record(np.concatenate([[before], record.time]), zero)


def _of(experiment: Experiment) -> np.ndarray:
    """The values of the specimen with the largest of each, (5,)."""
    record = experiment.record
    names = [*experiment.quantities, *([] if record is None else record.channels)]
    rows = [_of_specimen(experiment, specimen) for specimen in dict.fromkeys(["", *(owner_of(name) for name in names)])]
    return np.fmax.reduce(rows)


def _of_specimen(experiment: Experiment, specimen: str) -> tuple[float, ...]:
    record, rate, stiffness = experiment.record, float("nan"), float("nan")
    elongation = named(specimen, "elongation")
    if record is not None and elongation in record.channels:
        # A high quantile, because single noisy differences are not rates.
        with np.errstate(all="ignore"):  # the check of the data reports repeated times
            rate = float(np.quantile(np.abs(np.gradient(record[elongation], record.time)), 0.98))
        stiffness = initial_stiffness(record, specimen)
    return (
        experiment.quantity(named(specimen, "peak_force")),
        experiment.quantity(named(specimen, "peak_elongation")),
        rate,
        abs(experiment.quantity(named(specimen, "dissipated_energy"))),
        stiffness,
    )
