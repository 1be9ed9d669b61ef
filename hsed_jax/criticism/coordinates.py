"""The coordinates of a misfit: for every sample of a history, when and where on the loop it was measured."""

from dataclasses import dataclass

import numpy as np

from hsed_jax.criticism.cycles import absorbed_energy, branches, cycle_numbers
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.measurements import Campaign, Experiment


@dataclass(frozen=True)
class Samples:
    """All compared samples of all experiments, one row each.

    Attributes:
        share: squared standardised residual of each sample, summing to 1, (m,).
        signed: residual over the RMS of its output, predicted less measured, (m,).
        experiment: index of the experiment, (m,).
        numbers: ordered coordinates by name, SI, each (m,); NaN where unknown.
        words: coordinates without order by name, each (m,).
    """

    share: np.ndarray
    signed: np.ndarray
    experiment: np.ndarray
    numbers: dict[str, np.ndarray]
    words: dict[str, np.ndarray]


UNITS = {"time": "s", "cycle": "1", "amplitude": "m", "energy": "J", "speed": "m/s"}


def samples_of(prediction: Prediction, campaign: Campaign) -> Samples:
    """Collect the residual of histories with its coordinates."""
    parts: list[dict] = []
    for row, experiment in enumerate(prediction.experiments):
        along = _along(experiment)
        for output in prediction.outputs:
            columns = prediction.columns(output)
            used = prediction.used[row, columns]
            length = int(used.size) if experiment.record is None else len(experiment.record)
            inside = np.flatnonzero(used[:length])
            if not inside.size:
                continue
            residual = prediction.residual[row, columns][inside]
            measured = prediction.measured[:, columns][prediction.used[:, columns]]
            scale = float(np.std(measured)) or 1.0
            part = {name: values[inside] for name, values in along.items()}
            part |= {
                "signed": residual / scale,
                "experiment_index": np.full(inside.size, row),
                "experiment": np.full(inside.size, experiment.id),
                "output": np.full(inside.size, output),
            }
            # Every experiment counts by its samples' length in time, whatever its sampling.
            parts.append(part)
    names = parts[0].keys()
    joined = {name: np.concatenate([part[name] for part in parts]) for name in names}
    squares = joined["signed"] ** 2
    share = squares / squares.sum() if squares.sum() > 0 else np.full(squares.size, 1 / squares.size)
    numbers = {name: joined[name] for name in UNITS if np.isfinite(joined[name].astype(float)).any()}
    if not campaign.has_time:
        # The row number is no time, and the rate of a quasi-static test no speed.
        numbers.pop("speed", None)
    words = {name: joined[name] for name in ("branch", "sign of the force", "output", "experiment")}
    return Samples(share, joined["signed"], joined["experiment_index"], numbers, words)


def _along(experiment: Experiment) -> dict[str, np.ndarray]:
    """Coordinates of every sample of a record."""
    record = experiment.record
    assert record is not None
    size = len(record)
    unknown = np.full(size, np.nan)
    force, elongation = record.channels.get("force"), record.channels.get("elongation")
    along = {name: unknown for name in UNITS}
    along["time"] = record.time
    along["branch"] = along["sign of the force"] = np.full(size, "unknown")
    if elongation is not None:
        along["cycle"] = cycle_numbers(elongation).astype(float)
        along["amplitude"] = np.abs(elongation)
        along["speed"] = np.abs(np.gradient(elongation, record.time))
    if force is not None:
        along["sign of the force"] = np.where(force >= 0, "positive", "negative")
    if force is not None and elongation is not None:
        along["energy"] = absorbed_energy(force, elongation)
        along["branch"] = branches(force, elongation)
    return along
