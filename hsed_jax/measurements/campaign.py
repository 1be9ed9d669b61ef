"""A campaign: experiments that share a specimen and sensors, in SI, with the units they were declared in."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.experiment import Channel, Experiment, Record
from hsed_jax.measurements.frames import experiments_of, fields_of, tree_of
from hsed_jax.measurements.header import RESERVED_COLUMNS, Header, Protocol, check_column
from hsed_jax.physics.outputs import is_driver
from hsed_jax.tables import Table, Tabular

if TYPE_CHECKING:
    import xarray as xr

MOTION = ("time", "ground_acceleration")
"""Channels that impose a ground motion and measure no response."""


@dataclass(frozen=True, repr=False)
class Campaign(Header, Tabular):
    """Experiments that share a specimen, a protocol, inputs and channels.  Values are SI, units as declared.

    Attributes:
        name: Name of the tested object.
        protocol: `ground_motion`, or `displacement`: the elongation was imposed and the force measured.
        inputs: Unit of each variable input.
        channels: Channels of the records by canonical name.  Without `time` the row number is the time.
        quantities: Quantities of experiments.csv by canonical name.
        pair: The kind of elongation and force, from their units: rotation and moment, strain and stress, or just these.
        experiments: The experiments, in order.
        source: Where it was read from.

    Raises:
        UserError: An unknown channel, a wrong unit, units of no pair, a duplicate id, or an experiment that does not fit.
    """

    experiments: tuple[Experiment, ...] = ()
    source: str | None = field(default=None, compare=False)

    def __post_init__(self):
        """Check the declaration, then round every value to one that its declared unit can write."""
        super().__post_init__()
        records: dict[int, Record] = {}  # of experiments that share a record, one
        object.__setattr__(self, "experiments", tuple(self._settled(e, records) for e in self.experiments))
        seen = set()
        for experiment in self.experiments:
            if experiment.id in seen:
                raise UserError(f"experiment {experiment.id!r} appears twice; an id is unique in its campaign")
            seen.add(experiment.id)

    def _settled(self, experiment: Experiment, records: dict[int, Record]) -> Experiment:
        where = f"experiment {experiment.id!r}"
        if experiment.inputs.keys() != self.inputs.keys():
            raise UserError(
                f"{where} has the inputs {sorted(experiment.inputs)}; the campaign declares {sorted(self.inputs)}"
            )
        if strange := experiment.quantities.keys() - self.quantities.keys():
            raise UserError(
                f"{where} has {sorted(strange)}; the campaign declares the quantities {sorted(self.quantities)}"
            )
        columns = {*RESERVED_COLUMNS, *self.inputs, *(q.column for q in self.quantities.values())}
        for name in experiment.metadata:
            check_column(name, f"{where}: metadata")
            if name in columns:
                raise UserError(
                    f"{where}: metadata {name!r} has the name of a column that means something else; rename it"
                )
        changes: dict[str, Any] = {
            "inputs": {k: float(self.unit(k).snap(experiment.inputs[k])) for k in self.inputs},
            "quantities": {k: float(self.unit(k).snap(v)) for k, v in experiment.quantities.items()},
        }
        if experiment.record is not None:
            key = id(experiment.record)
            if key not in records:
                records[key] = self._settled_record(experiment.record, where)
            changes["record"] = records[key]
        if experiment.window is not None:
            changes["window"] = tuple(float(self.unit("time").snap(t)) for t in experiment.window)
        changes = {k: v for k, v in changes.items() if v != getattr(experiment, k)}
        return replace(experiment, **changes) if changes else experiment

    def _settled_record(self, record: Record, where: str) -> Record:
        if not self.has_time and not np.array_equal(record.time, np.arange(len(record))):
            raise UserError(
                f"{where}: the record has a time but the campaign no channel time; declare it with its unit"
            )
        responses = {name for name in self.channels if not is_driver(name)}
        if strange := record.channels.keys() - self.channels.keys():
            raise UserError(f"{where}: the record has {sorted(strange)}; the campaign declares {sorted(self.channels)}")
        missing = self.channels.keys() - record.channels.keys() - {"time"}
        # Either all declared channels, or the excitation alone (planned, or beside scalar quantities).
        if missing and (missing != responses or self.channels.keys() - responses <= {"time"}):
            raise UserError(f"{where}: the record lacks {sorted(missing)}; every declared channel must be there")
        time = self.unit("time").snap(record.time)
        channels = {k: self.unit(k).snap(record.channels[k]) for k in self.channels if k in record.channels}
        settled = Record(time, channels)
        return record if settled == record and list(channels) == list(record.channels) else settled

    def __len__(self) -> int:
        """Return the number of experiments."""
        return len(self.experiments)

    def __iter__(self) -> Iterator[Experiment]:
        """Iterate over the experiments in order."""
        return iter(self.experiments)

    def __contains__(self, id: object) -> bool:
        """Return whether there is an experiment with this id."""
        return any(e.id == id for e in self.experiments)

    def __getitem__(self, id: str) -> Experiment:
        """Return the experiment with this id.

        Raises:
            UserError: There is none.
        """
        for experiment in self.experiments:
            if experiment.id == id:
                return experiment
        raise UserError(f"no experiment {id!r}; the campaign has {', '.join(e.id for e in self.experiments) or 'none'}")

    @property
    def completed(self) -> "Campaign":
        """The completed experiments."""
        return replace(self, experiments=tuple(e for e in self if e.status == "completed"))

    @property
    def train(self) -> "Campaign":
        """The completed experiments to fit to."""
        return replace(self, experiments=tuple(e for e in self.completed if e.split == "train"))

    @property
    def test(self) -> "Campaign":
        """The completed experiments that are never fitted."""
        return replace(self, experiments=tuple(e for e in self.completed if e.split == "test"))

    def add(self, experiment: Experiment) -> "Campaign":
        """Return the campaign with one experiment more."""
        return replace(self, experiments=(*self.experiments, experiment))

    def update(self, experiment: Experiment) -> "Campaign":
        """Return the campaign with the experiment of the same id replaced, for example a pending one by its outcome."""
        self[experiment.id]
        return replace(self, experiments=tuple(experiment if e.id == experiment.id else e for e in self))

    @classmethod
    def from_frames(
        cls,
        experiments=None,
        records: Mapping[str, Any] | None = None,
        *,
        name: str = "campaign",
        protocol: Protocol,
        inputs: Mapping[str, str] | None = None,
        channels: Mapping[str, str | Channel] | None = None,
        quantities: Mapping[str, str | Channel] | None = None,
    ) -> "Campaign":
        """Build a campaign from tables in memory, in the declared units.

        Arguments:
            experiments: A table with the columns of experiments.csv (`id`, inputs, quantities, `status`, ...): a pandas
                DataFrame, a dict of columns, or a list of dicts.  Without it, the ids are those of `records`.
            records: By id, a table of the channels: a DataFrame or a dict of arrays (n,).
            name: Name of the tested object.
            protocol: `ground_motion` or `displacement`.
            inputs: Unit of each input column.
            channels: Unit of each channel, or a `Channel` where the column is named otherwise or noise is known.
            quantities: The same for quantities.

        Raises:
            UserError: Something is missing, unknown, or not a number; the message names experiment and column.
        """
        header = cls(
            name,
            protocol,
            dict(inputs or {}),
            {k: v if isinstance(v, Channel) else Channel(k, v) for k, v in (channels or {}).items()},
            {k: v if isinstance(v, Channel) else Channel(k, v) for k, v in (quantities or {}).items()},
        )
        return replace(header, experiments=experiments_of(header, experiments, records or {}))

    def to_xarray(self) -> "xr.DataTree":
        """Return everything as a tree: experiments at the root, ``records/<id>`` below; values SI, units in `attrs`."""
        return tree_of(self, self.experiments, self.source)

    @classmethod
    def from_xarray(cls, tree: "xr.DataTree") -> "Campaign":
        """Rebuild a campaign from the tree of `to_xarray`.

        Raises:
            UserError: The tree was not made by `to_xarray`.
        """
        return cls(**fields_of(tree))

    def _table(self) -> Table:
        heads = ["experiment", *(f"{k} [{u}]" for k, u in self.inputs.items())]
        heads += [*(f"{k} [{q.unit}]" for k, q in self.quantities.items()), "record", "status", "split"]
        rows = []
        for e in self:
            values = [f"{self.unit(k).from_si(e.inputs[k]):.6g}" for k in self.inputs]
            values += [
                f"{self.unit(k).from_si(e.quantities[k]):.6g}" if k in e.quantities else "" for k in self.quantities
            ]
            rows.append([e.id, *values, "" if e.record is None else f"{len(e.record)} samples", e.status, e.split])
        channels = ", ".join(f"{k} [{c.unit}]" for k, c in self.channels.items()) or "no records"
        counts = (
            f"{len(self)} experiment{'' if len(self) == 1 else 's'}, {len(self.train)} train, {len(self.test)} test"
        )
        return Table(f"{self.name} ({self.protocol}): {counts}; {channels}", heads, rows)
