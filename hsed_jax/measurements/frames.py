"""Campaigns from and to tables in memory: pandas and xarray."""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements.experiment import Channel, Experiment, Noise, Record, Split, Status, check_word
from hsed_jax.measurements.header import RESERVED_COLUMNS, Header
from hsed_jax.measurements.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr


def experiments_of(header: Header, experiments: Any, records: Mapping[str, Any]) -> tuple[Experiment, ...]:
    """The experiments of a campaign, from tables in its declared units; see `Campaign.from_frames`."""
    import pandas as pd

    records = {str(id): table for id, table in records.items()}
    table = pd.DataFrame({"id": list(records)} if experiments is None else experiments)
    if "id" not in table.columns:
        raise UserError(f"experiments: column 'id' is missing; the columns are {', '.join(map(str, table.columns))}")
    rows = [
        {str(name): value for name, value in row.items() if not pd.isna(value)}
        for row in table.to_dict(orient="records")
    ]
    if strange := records.keys() - {str(row.get("id", "")) for row in rows}:
        raise UserError(f"records: {sorted(strange)} are not ids of experiments; give one record per experiment, by id")
    return tuple(_experiment(header, row, records) for row in rows)


def _experiment(header: Header, row: dict[str, Any], records: Mapping[str, Any]) -> Experiment:
    id = str(row.get("id", ""))
    where = f"experiment {id!r}"

    def number(column: str, unit: str) -> float:
        value = row[column]
        try:
            if isinstance(value, str):
                raise ValueError
            return float(header.unit(unit).to_si(float(value)))
        except (TypeError, ValueError):
            raise UserError(f"{where}, column {column!r}: {value!r} is not a number") from None

    for name in header.inputs:
        if name not in row:
            raise UserError(
                f"{where}, column {name!r}: there is no value; every experiment has a number for each input"
            )
    status, split = row.get("status", "completed"), row.get("split", "train")
    check_word(status, get_args(Status), f"{where}, column 'status'")
    check_word(split, get_args(Split), f"{where}, column 'split'")
    known = {*RESERVED_COLUMNS, *header.inputs, *(q.column for q in header.quantities.values())}
    record = _record(header, records[id], where) if id in records else None
    window = None
    if "from" in row or "to" in row:
        if record is None:
            raise UserError(f"{where}: it has a window (from, to) and no record; a window selects part of a record")
        start = number("from", "time") if "from" in row else float(record.time[0])
        window = (start, number("to", "time") if "to" in row else float(record.time[-1]))
    return Experiment(
        id,
        {name: number(name, name) for name in header.inputs},
        record=record,
        quantities={k: number(q.column, k) for k, q in header.quantities.items() if q.column in row},
        status=status,
        reason=row.get("reason"),
        split=split,
        window=window,
        metadata={name: str(value) for name, value in row.items() if name not in known},
    )


def _record(header: Header, table, where: str) -> Record:
    import pandas as pd

    try:
        frame = pd.DataFrame(table)
    except ValueError as error:
        raise UserError(
            f"{where}: the record is not a table ({error}); each channel is an array of the same length"
        ) from None
    channels = {}
    for name, channel in header.channels.items():
        if channel.column in frame.columns:
            try:
                values = np.array(frame[channel.column], dtype=float)
            except (TypeError, ValueError):
                raise UserError(f"{where}: channel {name!r} of the record is not numeric; write numbers") from None
            channels[name] = header.unit(name).to_si(values)
    if header.has_time and "time" not in channels:
        column = header.channels["time"].column
        raise UserError(
            f"{where}: the record has no column {column!r} (time); it has {', '.join(map(str, frame.columns))}"
        )
    time = channels.pop("time", np.arange(len(frame), dtype=float))
    return Record(time, channels)


def tree_of(header: Header, experiments: Sequence[Experiment], source: str | None) -> "xr.DataTree":
    """Lay a campaign out as a tree; see `Campaign.to_xarray`."""
    import xarray as xr

    dim = "experiment"
    variables: dict[str, Any] = {}
    for name, unit in header.inputs.items():
        values = np.array([e.inputs[name] for e in experiments], dtype=float)
        attributes = {"role": "input", "units": _si(header, name), "declared_unit": unit}
        variables[f"input_{name}"] = (dim, values, {"long_name": name, **attributes})
    for name, channel in header.quantities.items():
        values = np.array([e.quantities.get(name, np.nan) for e in experiments], dtype=float)
        variables[name] = (dim, values, {"role": "quantity", **_attributes(header, channel)})
    for name in ("status", "reason", "split"):
        variables[name] = (dim, np.array([getattr(e, name) or "" for e in experiments], dtype=str))
    variables["metadata"] = (dim, np.array([json.dumps(e.metadata) for e in experiments], dtype=str))
    for i, name in enumerate(("window_start", "window_end")):
        ends = np.array([np.nan if e.window is None else e.window[i] for e in experiments], dtype=float)
        variables[name] = (dim, ends, {"units": "s"})
    attributes = {"name": header.name, "protocol": header.protocol, "source": source or ""}
    attributes["channels"] = json.dumps({name: _attributes(header, c) for name, c in header.channels.items()})
    root = xr.Dataset(variables, coords={dim: np.array([e.id for e in experiments], dtype=str)}, attrs=attributes)
    nodes = {"/": root}
    for e in experiments:
        if e.record is not None:
            data = {n: ("time", v, _attributes(header, header.channels[n])) for n, v in e.record.channels.items()}
            nodes[f"/records/{e.id}"] = xr.Dataset(data, coords={"time": ("time", e.record.time, {"units": "s"})})
    return xr.DataTree.from_dict(nodes)


def fields_of(tree: "xr.DataTree") -> dict[str, Any]:
    """The fields of a campaign that was laid out as a tree; see `Campaign.from_xarray`."""
    try:
        return _fields(tree)
    except (KeyError, AttributeError, json.JSONDecodeError) as error:
        raise UserError(f"the tree lacks {error}; only a tree from Campaign.to_xarray can be read") from None


def _fields(tree: "xr.DataTree") -> dict[str, Any]:
    root = tree.to_dataset()
    by_role = {
        role: {str(k): v for k, v in root.data_vars.items() if v.attrs.get("role") == role}
        for role in ("input", "quantity")
    }
    channels = {name: _channel(name, a) for name, a in json.loads(root.attrs["channels"]).items()}
    quantities = {name: _channel(name, v.attrs) for name, v in by_role["quantity"].items()}
    inputs = {v.attrs["long_name"]: v.attrs["declared_unit"] for v in by_role["input"].values()}
    experiments = []
    records = tree.children["records"].children if "records" in tree.children else {}
    for i, id in enumerate(map(str, root["experiment"].values)):
        window = (float(root["window_start"][i]), float(root["window_end"][i]))
        record = None
        if id in records:
            node = records[id].to_dataset()
            record = Record(node["time"].values, {str(k): v.values for k, v in node.data_vars.items()})
        experiments.append(
            Experiment(
                id,
                {v.attrs["long_name"]: float(v[i]) for v in by_role["input"].values()},
                record=record,
                quantities={k: float(v[i]) for k, v in by_role["quantity"].items() if not np.isnan(v[i])},
                status=str(root["status"].values[i]),  # pyright: ignore[reportArgumentType]
                reason=str(root["reason"].values[i]),
                split=str(root["split"].values[i]),  # pyright: ignore[reportArgumentType]
                window=None if np.isnan(window[0]) else window,
                metadata=json.loads(str(root["metadata"].values[i])),
            )
        )
    attributes = root.attrs
    return {
        "name": attributes["name"],
        "protocol": attributes["protocol"],
        "inputs": inputs,
        "channels": channels,
        "quantities": quantities,
        "experiments": tuple(experiments),
        "source": attributes["source"] or None,
    }


def _si(header: Header, name: str) -> str:
    is_input = name in header.inputs
    return parse_unit(header.inputs[name]).si if is_input else header.pair.output(name).unit


def _attributes(header: Header, channel: Channel) -> dict[str, Any]:
    said: dict[str, Any] = {
        "units": _si(header, channel.name),
        "declared_unit": channel.unit,
        "column": channel.column,
    }
    if channel.noise is not None:
        kind = "absolute" if channel.noise.relative is None else "relative"
        said[f"noise_{kind}"] = getattr(channel.noise, kind)
    return said


def _channel(name: str, attributes: Mapping[str, Any]) -> Channel:
    absolute, relative = attributes.get("noise_absolute"), attributes.get("noise_relative")
    noise = None if absolute is None and relative is None else Noise(absolute, relative)
    return Channel(name, attributes["declared_unit"], attributes["column"], noise)
