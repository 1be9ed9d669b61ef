"""The coordinates of a misfit: for every sample of a history, when and where on the loop it was measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hsed_jax.criticism.prediction import Prediction, noise_sizes
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Experiment, Record
from hsed_jax.measurements.turns import branches, cycle_numbers, frequencies, half_cycles
from hsed_jax.physics.names import named, owner_of
from hsed_jax.physics.outputs import absorbed_energy, channel


@dataclass(frozen=True)
class Samples:
    """All compared samples of all experiments, one row each.

    Attributes:
        share: squared standardised residual of each sample, summing to 1, (m,).
        expected: the same for a residual in proportion to the motion, plus the noise: the misfit is then not concentrated,
            (m,).
        signed: predicted minus measured in the direction of the measurement (positive: the model is too strong), over the
            RMS of its output about its mean, minus the part that the noise explains, (m,).
        experiment: index of the experiment, (m,).
        numbers: ordered coordinates by name, SI, each (m,); NaN where unknown.
        words: coordinates without order by name, each (m,).
    """

    share: np.ndarray
    expected: np.ndarray
    signed: np.ndarray
    experiment: np.ndarray
    numbers: dict[str, np.ndarray]
    words: dict[str, np.ndarray]


# A residual whose square is within this factor of that of the noise is noise, because the noise is not known better.
_NOISE_FACTOR = 1.25
UNITS = {"time": "s", "cycle": "1", "amplitude": "m", "energy": "J", "speed": "m/s"}


def samples_of(prediction: Prediction, campaign: Campaign) -> Samples:
    """Collect the residual of histories with its coordinates."""
    parts: list[dict] = []
    beyond, noise = {}, {}
    for output in prediction.outputs:
        beyond[output], noise[output] = _beyond_noise(prediction, output)
    for row, experiment in enumerate(prediction.experiments):
        coordinates = coordinates_of(experiment, prediction.outputs)
        for output in prediction.outputs:
            columns = prediction.columns(output)
            used = prediction.used[row, columns]
            length = int(used.size) if experiment.record is None else len(experiment.record)
            inside = np.flatnonzero(used[:length])
            if not inside.size:
                continue
            towards = np.where(prediction.measured[row, columns][inside] < 0, -1.0, 1.0)
            part = {name: values[inside] for name, values in coordinates[output].items()}
            part |= {
                "signed": beyond[output] * towards * prediction.residual[row, columns][inside],
                "motion": _motion(prediction.measured[row, columns][inside]),
                "experiment_index": np.full(inside.size, row),
                "experiment": np.full(inside.size, experiment.id),
                "output": np.full(inside.size, output),
            }
            parts.append(part)
    if not parts:
        raise UserError("these experiments have no measurement of an observed output, so a misfit cannot be located")
    names = parts[0].keys()
    joined = {name: np.concatenate([part[name] for part in parts]) for name in names}
    squares = joined["signed"] ** 2
    share = squares / squares.sum() if squares.sum() > 0 else np.full(squares.size, 1 / squares.size)
    expected = np.empty(squares.size)
    for output in np.unique(joined["output"]):
        own = joined["output"] == output
        motion = joined["motion"][own] / (joined["motion"][own].mean() or 1.0)
        expected[own] = (noise[output] + (1 - noise[output]) * motion) / squares.size
    numbers = {name: joined[name] for name in UNITS if np.isfinite(joined[name].astype(float)).any()}
    if not campaign.has_time or not _rates_vary(joined["frequency"]):
        # The row number is not a time.  If all cycles take equally long, the rate is a function of the place on the
        # loop.
        numbers.pop("speed", None)
    words = {name: joined[name] for name in ("branch", "sign of the force", "output", "experiment")}
    return Samples(share, expected, joined["signed"], joined["experiment_index"], numbers, words)


def quantities_of(prediction: Prediction) -> Samples:
    """Collect the residual of quantities: a row per experiment and quantity, with only these two coordinates."""
    row, column = np.nonzero(prediction.used)
    measured, residual = prediction.measured[row, column], prediction.residual[row, column]
    # Every output is relative to its RMS, and within an output to its error: a relative error grows with the measurement.
    scales, of = np.ones(row.size), prediction.groups[column]
    for group in np.unique(of):
        one = of == group
        sigma = prediction.sigma[row, column][one]
        shape = sigma / np.sqrt(np.mean(sigma**2)) if np.all(sigma > 0) else np.ones(sigma.size)
        scales[one] = shape * (np.sqrt(np.mean(measured[one] ** 2)) or 1.0)
    signed = residual * np.where(measured < 0, -1.0, 1.0) / scales
    squares = signed**2
    share = squares / squares.sum() if squares.sum() > 0 else np.full(squares.size, 1 / max(squares.size, 1))
    words = {
        "output": np.asarray(prediction.outputs, dtype=str)[prediction.groups[column]],
        "experiment": np.asarray([e.id for e in prediction.experiments], dtype=str)[row],
    }
    return Samples(share, np.full(share.size, 1 / max(share.size, 1)), signed, row, {}, words)


def _motion(measured: np.ndarray) -> np.ndarray:
    """Mean square of a history over the half cycle that each sample belongs to: a measure of the motion."""
    ends = half_cycles(measured)
    cycle = np.searchsorted(ends[1:-1], np.arange(measured.size), side="right")
    return (np.bincount(cycle, measured**2) / np.maximum(np.bincount(cycle), 1))[cycle]


def _beyond_noise(prediction: Prediction, output: str) -> tuple[float, float]:
    """The scale of the residual of an output: 1/RMS of the output, times the root of the share that is not noise; and
    the share of the noise.
    """
    columns = prediction.columns(output)
    used = prediction.used[:, columns]
    if not used.any():
        return 0.0, 1.0
    residual = prediction.residual[:, columns][used]
    scale = float(np.std(prediction.measured[:, columns][used])) or float(np.sqrt(np.mean(residual**2))) or 1.0
    # The inferred error contains the misfit, too; the noise is the part that no smooth signal explains.
    noise = noise_sizes(prediction, output, False)[used]
    size, floor = float(np.mean(residual**2)), float(np.mean(noise**2))
    return (np.sqrt(1 - floor / size) / scale, floor / size) if size > _NOISE_FACTOR * floor else (0.0, 1.0)


def _rates_vary(frequency: np.ndarray) -> bool:
    """Whether cycles differ in frequency, so that the rate is not determined by the position on the loop."""
    known = frequency[np.isfinite(frequency)]
    if not known.size:
        return False
    slow, fast = np.quantile(known, [0.1, 0.9])
    return bool(fast > 1.5 * slow)


def coordinates_of(experiment: Experiment, outputs: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
    """By output, the coordinates of every sample: its time, and its position on the loop of its specimen. Outputs without a
    specimen have the position on the loop of the first specimen.
    """
    record = experiment.record
    assert record is not None
    first = next((owner_of(name) for name in record.channels if channel(name).of_specimen), "")
    owners = {output: owner_of(output) or first for output in outputs}
    along = {owner: _along_loop(record, owner) for owner in dict.fromkeys(owners.values())}
    return {output: along[owner] for output, owner in owners.items()}


def _along_loop(record: Record, owner: str) -> dict[str, np.ndarray]:
    """The coordinates of every sample of a record on the loop of one specimen."""
    size = len(record)
    unknown = np.full(size, np.nan)
    force, elongation = (record.channels.get(named(owner, name)) for name in ("force", "elongation"))
    along = {name: unknown for name in (*UNITS, "frequency")}
    along["time"] = record.time
    along["branch"] = along["sign of the force"] = np.full(size, "unknown")
    if elongation is not None:
        along["cycle"] = cycle_numbers(elongation) + 1.0
        along["amplitude"] = np.abs(elongation)
        along["speed"] = np.abs(np.gradient(elongation, record.time)) if size > 1 else unknown
        along["frequency"] = frequencies(elongation, record.time)
    if force is not None:
        along["sign of the force"] = np.where(force >= 0, "positive", "negative")
    if force is not None and elongation is not None:
        along["energy"] = absorbed_energy(force, elongation)
        along["branch"] = branches(force, elongation)
    return along
