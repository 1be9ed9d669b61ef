"""The numbers behind the charts of a report: plain columns, thinned to the resolution of a screen."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hsed_jax.criticism.coordinates import UNITS, coordinates_of
from hsed_jax.criticism.prediction import has_diverged
from hsed_jax.measurements import Experiment, Record
from hsed_jax.physics import display
from hsed_jax.physics.names import own_name
from hsed_jax.reporting import style
from hsed_jax.reporting.finished import SPLITS, FinishedRun

_90 = 1.6448536  # standard deviations on both sides hold 90 %
_ROWS = 12_000  # samples on the page
_FEWEST, _MOST = 120, 700  # of them, of one experiment
_BINS = 20
_IN_A_BIN = 8
_WORDS = {"amplitude": "elongation", "energy": "absorbed energy", "speed": "elongation rate"}

SERIES = {"measured": "measured", "before": "as it was", "after": "improved", "remainder": "with the remainder"}
"""Names of the drawn series by their keys in the tables."""

Table = dict[str, list]
"""Columns by name, all of one length; None without a number."""


class Axis(NamedTuple):
    """How an output is drawn: its name in words, the divisor of its SI numbers, and the resulting unit."""

    words: str
    divisor: float
    unit: str

    @property
    def label(self) -> str:
        """The title of an axis."""
        return f"{self.words} [{self.unit}]"


def unit_words(unit: str) -> str:
    """A unit in running text: m/s^2 → m/s², no unit → –."""
    raised = style.unit_text(unit).replace("^{", "").replace("}", "")
    parts = raised.split("$")
    return "".join(
        part.translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")) if i % 2 else part for i, part in enumerate(parts)
    )


def error_of(errors: Mapping[str, Mapping[str, float]]) -> float:
    """Error of one experiment over its outputs, averaged in the square; infinite where its simulation diverged."""
    # An error that is absent from the summary was not finite.
    values = [entry.get("nrmse", np.inf) for entry in errors.values()]
    error = float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")
    return np.inf if has_diverged(error) and values else error


def experiments_table(run: FinishedRun) -> Table:
    """A row per compared experiment and model: its inputs (declared units), and its error."""
    rows = []
    for split, id, models in run.errors():
        inputs = _declared(run, id)
        for model, errors in models.items():
            rows.append({"experiment": id, "split": split, "model": model, "error": error_of(errors), **inputs})
    return columns(rows)


def outputs_of(run: FinishedRun) -> list[str]:
    """The observed and compared outputs."""
    return list(run.comparisons.get("before", {}).get("train", {}).get("per_output", {}))


def axes_of(run: FinishedRun) -> dict[str, Axis]:
    """How each output is drawn; the elongation too, if it was imposed."""
    found: dict[str, list[np.ndarray]] = {}
    for split in SPLITS:
        for tree in run.predictions(split).values():
            for dataset in [tree.dataset, *(child.dataset for child in tree.children.values())]:
                for name in dataset.data_vars:
                    stem, _, kind = str(name).rpartition("_")
                    if kind in ("measured", "predicted"):
                        found.setdefault(stem, []).append(np.asarray(dataset[name]))
    if run.campaign.protocol == "displacement" and "elongation" not in found:
        found["elongation"] = [
            e.record["elongation"] for e in run.campaign if e.record is not None and "elongation" in e.record.channels
        ]
    axes, pair = {}, run.campaign.pair
    for name, values in found.items():
        divisor, unit = display.shown(pair, name, *values)
        axes[name] = Axis(pair.called(name).capitalize(), divisor, unit_words(unit))
    return axes


def samples_table(run: FinishedRun) -> Table:
    """Histories: a row per sample kept, measured and predicted by either model with its band, in the units of `axes_of`."""
    axes, parts = axes_of(run), []
    histories = list(_histories(run))
    for experiment, split, models in histories:
        id, record = experiment.id, experiment.record
        assert record is not None
        kept = thinned(
            [values for name, values in record.channels.items() if own_name(name) in ("force", "elongation")]
            or [*record.channels.values()],
            int(np.clip(_ROWS // max(len(histories), 1), _FEWEST, _MOST)),
        )
        part: dict[str, Any] = {"experiment": [id] * kept.size, "split": [split] * kept.size, "time": record.time[kept]}
        for name, axis in axes.items():
            if name in record.channels:
                part[f"{name}_measured"] = record.channels[name][kept] / axis.divisor
            for model, dataset in models.items():
                if f"{name}_predicted" not in dataset:
                    continue
                predicted, mean, sd = (
                    np.asarray(dataset[f"{name}_{kind}"])[kept] / axis.divisor for kind in ("predicted", "mean", "sd")
                )
                part[f"{name}_{model}"] = predicted
                part[f"{name}_{model}_low"], part[f"{name}_{model}_high"] = mean - _90 * sd, mean + _90 * sd
        parts.append(part)
    names = list(dict.fromkeys(name for part in parts for name in part))
    return {
        name: [value for part in parts for value in _plain(part.get(name, [None] * len(part["experiment"])))]
        for name in names
    }


def windows_table(run: FinishedRun) -> Table:
    """Begin and end of the scored part of an experiment, if it is not the whole record."""
    windows = {e.id: e.window for e in run.campaign if e.window is not None}
    return columns([{"experiment": id, "from": begin, "to": end} for id, (begin, end) in windows.items()])


def quantities_table(run: FinishedRun) -> Table:
    """Quantities: a row per experiment, quantity and model, measured and predicted with its band, in the units of `axes_of`."""
    axes, rows = axes_of(run), []
    for split in SPLITS:
        for model, tree in run.predictions(split).items():
            dataset = tree.dataset
            if "experiment" not in dataset.dims:
                continue
            for name in (str(name).removesuffix("_predicted") for name in dataset if str(name).endswith("_predicted")):
                measured, predicted, mean, sd = (
                    np.asarray(dataset[f"{name}_{kind}"]) / axes[name].divisor
                    for kind in ("measured", "predicted", "mean", "sd")
                )
                for i, id in enumerate(dataset["experiment"].values):
                    if np.isfinite(measured[i]):
                        rows.append(
                            {"experiment": str(id), "split": split, "model": model, "quantity": name, "measured": measured[i],
                             "predicted": predicted[i], "low": mean[i] - _90 * sd[i], "high": mean[i] + _90 * sd[i]}
                        )  # fmt: skip
    return columns(rows)


def residual_table(run: FinishedRun) -> Table:
    """RMS residual of each output and model along each coordinate, in bins of equally many samples, over RMS of the output."""
    gathered: dict[str, dict[str, list[np.ndarray]]] = {}
    scales = {
        name: values["scale"]
        for name, values in run.comparisons.get("before", {}).get("train", {}).get("per_output", {}).items()
    }
    for experiment, _, models in _histories(run):
        coordinates = coordinates_of(experiment, list(scales))
        for name, scale in scales.items():
            along = {key: values for key, values in coordinates[name].items() if key in UNITS}
            along |= {key: np.full(len(along["time"]), value) for key, value in _declared(run, experiment.id).items()}
            for model, dataset in models.items():
                if f"{name}_measured" not in dataset:
                    continue
                residual = (np.asarray(dataset[f"{name}_predicted"]) - np.asarray(dataset[f"{name}_measured"])) / scale
                entry = gathered.setdefault(f"{name}/{model}", {})
                for coordinate, values in {**along, "residual": residual}.items():
                    entry.setdefault(coordinate, []).append(values)
    rows = []
    for key, entry in gathered.items():
        name, model = key.split("/")
        joined = {coordinate: np.concatenate(values) for coordinate, values in entry.items()}
        residual = joined.pop("residual")
        for coordinate, values in joined.items():
            if coordinate == "speed" and not run.campaign.has_time:
                continue  # the row number is not a time
            label, divisor = _coordinate(run, coordinate, values)
            for low, high, size in _bins(values, residual):
                rows.append(
                    {"coordinate": label, "output": run.campaign.pair.called(name), "model": model, "from": low / divisor,
                     "to": high / divisor, "at": 0.5 * (low + high) / divisor, "residual": size}
                )  # fmt: skip
    return columns(rows)


def columns(rows: list[dict[str, Any]]) -> Table:
    """Rows as columns, numbers to five digits."""
    return {name: list(_plain([row.get(name) for row in rows])) for name in rows[0]} if rows else {}


def thinned(channels: list[np.ndarray], most: int) -> np.ndarray:
    """Indices of at most `most` samples that keep every extreme a screen can show: the ends of each channel in each bucket."""
    size = channels[0].size
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, max((most - 2) // (2 * len(channels)), 1) + 1).astype(int)
    kept = {0, size - 1}
    for start, end in pairwise(edges):
        for channel in channels:
            part = np.where(np.isfinite(channel[start:end]), channel[start:end], 0.0)
            kept |= {start + int(np.argmin(part)), start + int(np.argmax(part))}
    return np.sort(np.fromiter(kept, dtype=int))


def _predicted_part(record: Record, models: dict[str, Any]) -> Record:
    """The samples of a record that were predicted: a long record is thinned."""
    rows = np.searchsorted(record.time, np.asarray(next(iter(models.values()))["time"]))
    return Record(record.time[rows], {name: values[rows] for name, values in record.channels.items()})


def _histories(run: FinishedRun) -> Iterator[tuple[Experiment, str, dict[str, Any]]]:
    """Every experiment with predicted histories: with the samples that were predicted, its split, and predictions by model."""
    for split in SPLITS:
        trees = run.predictions(split)
        for id in trees["before"].children if "before" in trees else ():
            if id in run.campaign and (record := run.campaign[id].record) is not None:
                models = {model: tree[id].dataset for model, tree in trees.items() if id in tree.children}
                yield replace(run.campaign[id], record=_predicted_part(record, models)), split, models


def _declared(run: FinishedRun, id: str) -> dict[str, float]:
    """Inputs of an experiment in their declared units."""
    experiment = run.campaign[id]
    return {name: float(run.campaign.unit(name).from_si(experiment.inputs[name])) for name in run.campaign.inputs}


def _coordinate(run: FinishedRun, name: str, values: np.ndarray) -> tuple[str, float]:
    """The name of a coordinate with its unit, and the divisor of its numbers."""
    if name in run.campaign.inputs:
        return f"{name} [{unit_words(run.campaign.unit(name).text)}]", 1.0
    if name == "cycle" or (name == "time" and not run.campaign.has_time):
        return ("row" if name == "time" else "cycle"), 1.0
    divisor, unit = display.shown_in(run.campaign.pair, UNITS[name], values)
    return f"{run.campaign.pair.words(_WORDS.get(name, name))} [{unit_words(unit)}]", divisor


def _bins(values: np.ndarray, residual: np.ndarray) -> Iterator[tuple[float, float, float]]:
    """From, to and RMS residual of bins of nearly equally many samples; a bin per value where there are few."""
    known = np.isfinite(values) & np.isfinite(residual)
    values, residual = values[known], residual[known]
    levels = np.unique(values)
    if levels.size < 2:
        return
    if levels.size <= _BINS:
        for level in levels:
            yield float(level), float(level), float(np.sqrt(np.mean(residual[values == level] ** 2)))
        return
    count = int(np.clip(values.size // _IN_A_BIN, 1, _BINS))
    edges = np.unique(np.quantile(values, np.linspace(0, 1, count + 1)))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    for i in range(edges.size - 1):
        if (which == i).any():
            yield float(edges[i]), float(edges[i + 1]), float(np.sqrt(np.mean(residual[which == i] ** 2)))


def _plain(values: Any) -> Iterator[Any]:
    """Numbers to five digits, None where they are none; words as they are."""
    for value in values:
        if isinstance(value, int | float | np.number):
            yield float(f"{float(value):.5g}") if np.isfinite(value) else None
        else:
            yield value
