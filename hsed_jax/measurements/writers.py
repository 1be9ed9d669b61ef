"""Writing a campaign folder, whole or one experiment at a time."""

import csv
import io
from pathlib import Path

from hsed_jax.drafts import write_whole
from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.declaration import write_declaration
from hsed_jax.measurements.experiment import Experiment


def write_campaign(campaign: Campaign, folder: str | Path) -> None:
    """Write a campaign as a folder that `read_campaign` reads back to the same numbers.

    Records are CSV in the declared units; experiments that share a record share its file.  Every file is complete
    before it takes its name, and experiments.csv comes last, so that a reader never finds an incomplete campaign.

    Arguments:
        campaign: The campaign.
        folder: The folder; it is created if it does not exist.  Files of the same names are replaced.

    Example:
        >>> hx.write_campaign(hx.read_files("wall.csv"), "my_campaign")
    """
    owners = _owners(campaign)
    for experiment in campaign:
        if owners[experiment.id] == experiment.id:
            _write_record(campaign, experiment, Path(folder))
    _write_tables(campaign, Path(folder))


def write_experiment(campaign: Campaign, id: str, folder: str | Path) -> None:
    """Write one experiment of a campaign into its folder, leaving the records of the others alone.

    Arguments:
        campaign: The campaign, with the experiment in it.
        id: The experiment that is new or has changed.
        folder: The campaign's folder.

    Raises:
        UserError: The campaign has no such experiment.
    """
    owners = _owners(campaign)
    for owner in dict.fromkeys(owners.values()):
        # An experiment that shared its record with this one so far has no separate file.
        if owner == owners[id] or (
            campaign[owner].record is not None and not (Path(folder) / _record_name(owner)).exists()
        ):
            _write_record(campaign, campaign[owner], Path(folder))
    _write_tables(campaign, Path(folder))


def _write_record(campaign: Campaign, experiment: Experiment, folder: Path) -> None:
    record = experiment.record
    if record is None:
        return
    columns = {}
    for name, channel in campaign.channels.items():
        if name == "time" or name in record.channels:
            values = record.time if name == "time" else record.channels[name]
            # repr is the shortest text that reads back as the same double
            columns[channel.column] = [repr(value) for value in campaign.unit(name).from_si(values).tolist()]
    _write(folder / _record_name(experiment.id), _csv(list(columns), zip(*columns.values(), strict=True)))


def _write_tables(campaign: Campaign, folder: Path) -> None:
    _write(folder / "campaign.yaml", write_declaration(campaign))
    free = list(dict.fromkeys(name for experiment in campaign for name in experiment.metadata))
    heads = ["id", *campaign.inputs, *(q.column for q in campaign.quantities.values())]
    heads += ["record", "status", "reason", "split", "from", "to", *free]
    owners = _owners(campaign)
    _write(folder / "experiments.csv", _csv(heads, [_row(campaign, e, owners[e.id], free) for e in campaign]))


def _row(campaign: Campaign, experiment: Experiment, owner: str, free: list[str]) -> list[str]:
    def text(name: str, value: float | None) -> str:
        return "" if value is None else repr(float(campaign.unit(name).from_si(value)))

    return [
        experiment.id,
        *(text(name, experiment.inputs[name]) for name in campaign.inputs),
        *(text(name, experiment.quantities.get(name)) for name in campaign.quantities),
        "" if experiment.record is None else _record_name(owner),
        experiment.status,
        experiment.reason or "",
        experiment.split,
        *(text("time", end) for end in experiment.window or (None, None)),
        *(experiment.metadata.get(name, "") for name in free),
    ]


def _owners(campaign: Campaign) -> dict[str, str]:
    """By id, the first experiment that has the same record."""
    first: dict[int, str] = {}
    return {e.id: e.id if e.record is None else first.setdefault(id(e.record), e.id) for e in campaign}


def _record_name(id: str) -> str:
    return f"records/{id}.csv"


def _csv(heads: list[str], rows) -> str:
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(heads)
    writer.writerows(rows)
    return buffer.getvalue()


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text)
