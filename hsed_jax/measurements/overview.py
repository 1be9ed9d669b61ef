"""The data of a campaign in a few numbers in their declared units, so that a wrong unit (kN for N) is visible."""

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.characteristics import initial_stiffness
from hsed_jax.measurements.experiment import Record
from hsed_jax.measurements.units import DIMENSIONLESS
from hsed_jax.physics.names import named
from hsed_jax.physics.outputs import loops
from hsed_jax.tables import Table


def overview(campaign: Campaign) -> Table:
    """Largest magnitude of every channel and quantity, initial stiffness and dissipated energy of completed experiments.

    If only a part of a record is fitted or scored, the numbers are those of this part. A part that begins later has no
    initial stiffness.
    """
    channels = [name for name in campaign.channels if name != "time"]
    owners = loops(campaign.channels)
    heads = ["experiment", *(["samples"] if channels else [])]
    heads += [f"{name} [{campaign.unit(name).text}]" for name in (*channels, *campaign.quantities)]
    for owner in owners:
        force, elongation = (campaign.unit(named(owner, name)).text for name in ("force", "elongation"))
        over, times = ("", "") if elongation in DIMENSIONLESS else (f"/{elongation}", f" {elongation}")
        of = f" of {owner}" if owner else ""
        heads += [f"initial stiffness{of} [{force}{over}]", f"dissipated energy{of} [{force}{times}]"]
    rows = []
    for experiment in campaign.completed:
        record = experiment.scored
        cells = [_number(campaign, name, _peak(record, name)) for name in channels]
        cells += [_number(campaign, name, experiment.quantities.get(name)) for name in campaign.quantities]
        if channels:
            cells.insert(0, "–" if record is None else str(len(record)))
        for owner in owners:
            is_virgin = record is not None and bool(experiment.in_window[0])
            cells += ["–", "–"] if record is None else _loop(campaign, record, owner, is_virgin)
        rows.append([experiment.id, *cells])
    return Table("the data in declared units, channels by their largest magnitude:", heads, rows)


def _peak(record: Record | None, name: str) -> float | None:
    return None if record is None or name not in record.channels else float(np.abs(record[name]).max())


def _number(campaign: Campaign, name: str, value: float | None) -> str:
    return "–" if value is None else f"{campaign.unit(name).from_si(value):.4g}"


def _loop(campaign: Campaign, record: Record, owner: str, is_virgin: bool) -> list[str]:
    """Stiffness and energy of a specimen in the units of its force and elongation."""
    if owner not in loops(record.channels):
        return ["–", "–"]
    names = {name: named(owner, name) for name in ("elongation", "force")}
    declared = {name: campaign.unit(channel).from_si(record[channel]) for name, channel in names.items()}
    stiffness = initial_stiffness(Record(record.time, declared)) if is_virgin else np.nan
    energy = float(np.trapezoid(declared["force"], declared["elongation"]))
    return [f"{stiffness:.4g}" if np.isfinite(stiffness) else "–", f"{energy:.4g}"]
