r"""The error of the model, compared with the error of the noise alone.

`error` is the normalised root-mean-square error: for each output the RMS residual over the RMS of that output about its mean,
outputs averaged in the square.  `noise_floor` is the same figure for the noise, and `from_parameters` and `from_model` are
those for the uncertainty of the parameters and for the error of the model. The squares of these parts add up to approximately
the square of the error.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from scipy.special import chdtrc

from hsed_jax.criticism.prediction import Prediction, error_cell, largest_noise, noise_sizes
from hsed_jax.criticism.shown_noise import HISTORY
from hsed_jax.errors import UserError
from hsed_jax.inference.correlation import SIGNIFICANT, estimate_noise, size_p_value
from hsed_jax.inference.likelihood import whitened
from hsed_jax.measurements.cycles import Cycles, cycles_of, returned
from hsed_jax.physics.names import named, own_name, owner_of
from hsed_jax.tables import Table, Tabular, cell

# Errors up to this multiple of the noise count as noise for any significance: the size of a noise is not known better.
_MATERIAL = 1.05
# No law is exact: an error of this size, relative to the measurements, is not distinguished from noise of unknown size. Two
# laws of the same steel differ by as much.
_OF_LAW = 0.02
_CYCLES = 6  # number of named cycles
WITHOUT = "coverage_90_without"
"""Coverage of the band without the discrepancy, if one is learned."""


@dataclass(frozen=True)
class Split:
    """Errors over the training or the test experiments.

    Attributes:
        error, noise_floor: over all outputs; the error of an experiment whose simulation diverged is infinite.
        per_output: nrmse, noise_floor and other parts, bias, r2, peak_error, coverage_90 by output.
        per_experiment: the same by experiment and output, and energy_error where force and elongation are known.
        diverged: experiments whose simulation diverged.
        parts: sources of the error besides the noise, over all outputs.
    """

    error: float
    noise_floor: float
    per_output: dict[str, dict[str, float]]
    per_experiment: dict[str, dict[str, dict[str, float]]]
    diverged: list[str]
    parts: Mapping[str, float] = field(default_factory=dict)

    @property
    def attributed(self) -> str | None:
        """The sources of the error, in words; None without a statement on the error of the model."""
        if "model" not in self.parts or not np.isfinite(self.error):
            return None
        parts = ", ".join(f"{name} {size:.3f}" for name, size in {"noise": self.noise_floor, **self.parts}.items())
        return f"an error of {self.error:.3f} is to be expected from {parts}"


@dataclass(frozen=True, repr=False)
class Comparison(Tabular):
    """A calibrated model against its measurements.

    Attributes:
        train, test: errors over the experiments that were fitted and over those that were not.
        p_value: probability of such a residual from the noise alone; None if the noise is unknown.
        adequate: whether the noise explains the residual: p_value at least 0.01, or an immaterial excess of the error over
            the noise.
        worst: experiment, output and error of the largest errors.
        notes: sentences on the method of the comparison.
        train_prediction, test_prediction: the compared predictions.
    """

    train: Split
    test: Split | None
    p_value: float | None
    adequate: bool
    worst: list[dict[str, Any]]
    notes: list[str]
    train_prediction: Prediction
    test_prediction: Prediction | None

    def splits(self) -> Iterator[tuple[str, Split, Prediction]]:
        """The compared splits: `train`, and `test` where there is one."""
        yield "train", self.train, self.train_prediction
        if self.test is not None and self.test_prediction is not None:
            yield "test", self.test, self.test_prediction

    def summary(self) -> dict[str, Any]:
        """The key `comparison` of `summary.json`."""
        content: dict[str, Any] = {"train": _plain(self.train), "adequate": self.adequate, "worst": self.worst}
        if self.test is not None:
            content["test"] = _plain(self.test)
        if self.p_value is not None:
            content["p_value"] = self.p_value
        content["notes"] = [*self.attributed, *self.notes]
        if self.warnings:
            content["warnings"] = self.warnings
        return content

    @property
    def warnings(self) -> list[str]:
        """Warnings: sentences on diverged simulations."""
        predictions = (self.train_prediction, self.test_prediction)
        return [text for prediction in predictions if prediction is not None for text in prediction.warnings]

    def _table(self) -> Table:
        rows = []
        for name, split in (("train", self.train), ("test", self.test)):
            if split is None:
                continue
            for output, v in split.per_output.items():
                errors = (error_cell(v["nrmse"]), cell(v["noise_floor"]), cell(v["bias"], "+.3f"))
                covered = [f"{cell(100 * v[key], '.0f')} %" for key in ("coverage_90", WITHOUT) if key in v]
                rows.append((name, output, *errors, f"{cell(100 * v['peak_error'], '+.1f')} %", " / ".join(covered)))
            if len(split.per_output) > 1:
                rows.append((name, "all", error_cell(split.error), cell(split.noise_floor), "", "", ""))
        both = any(WITHOUT in v for v in self.train.per_output.values())
        band = "in the 90 % band" + (", with / without discrepancy" if both else "")
        heads = ("split", "output", "error", "noise", "bias", "peak", band)
        return Table(self.verdict, heads, rows, [*self.attributed, *self.notes, *self.warnings])

    @property
    def attributed(self) -> list[str]:
        """The sources of the errors of the splits, in sentences, if the error of the model is known."""
        return [f"{name}: {split.attributed}" for name, split, _ in self.splits() if split.attributed]

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.p_value is None:
            return "no noise is declared, so it is unknown whether the noise explains the residual"
        if self.adequate:
            return f"the residual is explained by the noise (p = {self.p_value:.2g})"
        return f"the residual is not explained by the noise (p = {self.p_value:.1g})"


def compare(
    train: Prediction, test: Prediction | None, declared: np.ndarray, parameters: int, notes: list[str]
) -> Comparison:
    """Compare predictions with measurements.

    Arguments:
        train, test: predictions of the fitted and of the held-out experiments.
        declared: per output, whether its noise is declared (else inferred from the residual itself).
        parameters: how many parameters were fitted.
        notes: sentences to carry along.
    """
    splits = [_split(p, declared) if p is not None and p.used.any() else None for p in (train, test)]
    if splits[0] is None:
        raise UserError(
            "the training experiments have no measurement of an observed output; there is nothing to compare"
        )
    worst = sorted(
        (
            {"experiment": experiment, "output": output, "error": values["nrmse"]}
            for split in splits
            if split is not None
            for experiment, outputs in split.per_experiment.items()
            for output, values in outputs.items()
        ),
        key=lambda entry: -entry["error"],
    )[:5]
    notes = [*notes, *(text for p in (train, test) if p is not None for text in _of_cycles(p))]
    p_value = discrepancy_p_value(train, declared, parameters)
    adequate = p_value is not None and (
        p_value >= SIGNIFICANT or (bool(declared.all()) and not is_material(splits[0].error, splits[0].noise_floor))
    )
    return Comparison(splits[0], splits[1], p_value, adequate, worst, notes, train, test)


def is_material(error: float, noise_floor: float) -> bool:
    """Whether the excess of an error over the noise is material; with enough samples any excess is significant."""
    return error > _MATERIAL * noise_floor


def is_noise(p_value: float | None, error: float, noise_floor: float) -> bool:
    """Whether the noise explains the residual: it is not significant, or not material; False if this is unknown."""
    return p_value is not None and (p_value >= SIGNIFICANT or not is_material(error, noise_floor))


def discrepancy_p_value(prediction: Prediction, declared: np.ndarray, parameters: int) -> float | None:
    r"""Probability that the noise alone causes such a residual; None if the noise is unknown.

    With a declared noise, the *size* of the residual is tested, $\sum (r/\sigma)^2$ with the variance from autocorrelation
    and kurtosis of the noise (`hsed_jax.inference.correlation.size_p_value`): the noise of a sensor may be autocorrelated
    without an error of the model. Without a declared noise, the size of the residual of a history is not informative. The
    residual is then tested for autocorrelated noise: for whiteness (Ljung & Box 1978 over ten lags) after the removal of a
    first-order autoregression. This test has little power for a short record. Therefore a residual that is larger than
    the largest noise that the record allows (`largest_noise`) and an error of 2 % does not count as noise.  The smallest p
    of k such (nearly independent) tests counts: $1-(1-p)^k$ (Šidák 1967).
    """
    if prediction.diverged.any():
        return 0.0
    z = prediction.residual / np.where(prediction.used, prediction.sigma, 1.0)
    correlated = [None if known else True for known in declared]
    noise_estimate = estimate_noise(z, prediction.gaps, prediction.used, prediction.groups, declared, correlated)
    noises = {g: noise for g, noise in enumerate(noise_estimate.noises) if declared[g]}
    values = [size_p_value(z, prediction.used, noise_estimate.memory, noises, prediction.groups, parameters)]
    new = whitened(z, noise_estimate.memory)
    for group in np.flatnonzero(~declared):
        columns = prediction.groups == group
        statistic, lags = 0.0, 0
        for row, used in zip(new[:, columns], prediction.used[:, columns], strict=True):
            residual = row[used]
            if residual.size >= HISTORY and np.ptp(residual) > 0:
                statistic += _ljung_box(residual)
                lags += 10
        if lags:
            used = prediction.used[:, columns]
            largest = largest_noise(prediction, prediction.outputs[group])
            limit = np.hypot(_rms(largest[used]), _OF_LAW * _scale(prediction.measured[:, columns][used]))
            is_small = _rms(prediction.residual[:, columns][used]) <= limit
            values.append(float(chdtrc(lags - 1, statistic)) if is_small else 0.0)
    known = [value for value in values if value is not None]
    if not known:
        return None
    return 1.0 if min(known) >= 1 else float(-np.expm1(len(known) * np.log1p(-min(known))))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _ljung_box(residual: np.ndarray) -> float:
    m = residual.size
    centred = residual - residual.mean()
    power = centred @ centred
    rho = np.asarray([centred[k:] @ centred[:-k] for k in range(1, 11)]) / power
    return float(m * (m + 2) * np.sum(rho**2 / (m - np.arange(1, 11))))


def _split(prediction: Prediction, declared: np.ndarray) -> Split:
    per_output: dict[str, dict[str, float]] = {}
    per_experiment: dict[str, dict[str, dict[str, float]]] = {}
    predicted = np.where(prediction.diverged[:, None], np.inf, prediction.predicted)
    for number, output in enumerate(prediction.outputs):
        columns = prediction.columns(output)
        used = prediction.used[:, columns]
        if not used.any():
            continue
        tables = {key: getattr(prediction, key)[:, columns] for key in ("measured", "mean", "sd")}
        tables |= {"predicted": predicted[:, columns], "noise": noise_sizes(prediction, output, bool(declared[number]))}
        tables |= {f"from_{name}": part[:, columns] for name, part in prediction.misfit.items() if name != "noise"}
        if (plain := prediction.without) is not None:
            tables |= {"plain_mean": plain.mean[:, columns], "plain_sd": plain.sd[:, columns]}
        every = {key: np.where(used, table, np.nan) for key, table in tables.items()}
        per_output[output] = _errors(every)
        for row, experiment in enumerate(prediction.experiments):
            if used[row].any() and (columns.sum() > 1 or len(prediction.experiments) > 1):
                scale = per_output[output]["scale"] if columns.sum() == 1 else None
                entry = _errors({key: table[row : row + 1] for key, table in every.items()}, scale)
                per_experiment.setdefault(experiment.id, {})[output] = entry
    _add_energy_errors(prediction, per_experiment)
    names = next(iter(per_output.values()), {})
    error, floor, *parts = (
        float(np.sqrt(np.mean([values[key] ** 2 for values in per_output.values()])))
        for key in ("nrmse", "noise_floor", *(name for name in names if name.startswith("from_")))
    )
    diverged = [e.id for e, has in zip(prediction.experiments, prediction.diverged, strict=True) if has]
    said = [name.removeprefix("from_") for name in names if name.startswith("from_")]
    return Split(error, floor, per_output, per_experiment, diverged, dict(zip(said, parts, strict=True)))


def _errors(tables: Mapping[str, np.ndarray], scale: float | None = None) -> dict[str, float]:
    """The figures of one output over some experiments, from measured, predicted, mean, sd, noise and other sources of
    the error; NaN: not measured.
    """
    measured, predicted = tables["measured"], tables["predicted"]
    known = np.isfinite(measured)
    residual = (predicted - measured)[known]
    scale = _scale(measured[known]) if scale is None else scale
    largest = float(np.max(np.abs(measured[known])))

    def inside(mean: str, sd: str) -> float:
        return float((np.abs(measured - tables[mean])[known] <= 1.6448536 * tables[sd][known]).mean())

    def share(part: str) -> float:
        return float(np.sqrt(np.mean(tables[part][known] ** 2))) / scale

    return {
        "nrmse": float(np.sqrt(np.mean(residual**2))) / scale,
        "noise_floor": share("noise"),
        **{part: share(part) for part in tables if part.startswith("from_")},
        "bias": float(residual.mean()) / scale,
        "r2": 1 - float(np.mean(residual**2)) / scale**2,
        "peak_error": (float(np.max(np.abs(predicted[known]))) - largest) / (largest or 1.0),
        "coverage_90": inside("mean", "sd"),
        **({WITHOUT: inside("plain_mean", "plain_sd")} if "plain_mean" in tables else {}),
        "scale": scale,
    }


def _scale(measured: np.ndarray) -> float:
    """RMS of an output about its mean; for a single number, its magnitude."""
    about_mean = float(np.sqrt(np.mean((measured - measured.mean()) ** 2)))
    return about_mean if about_mean > 0 else float(np.sqrt(np.mean(measured**2))) or 1.0


def normalised_error(measured: np.ndarray, predicted: np.ndarray, used: np.ndarray, groups: np.ndarray) -> float:
    """The error of predictions (n, J), over all outputs; NaN without a measurement."""
    squares = []
    for group in np.unique(groups):
        own = used & (groups == group)
        if own.any():
            squares.append(np.mean((predicted[own] - measured[own]) ** 2) / _scale(measured[own]) ** 2)
    return float(np.sqrt(np.mean(squares))) if squares else float("nan")


def _add_energy_errors(prediction: Prediction, per_experiment: dict[str, dict[str, dict[str, float]]]) -> None:
    """RMS error of the energy absorbed per cycle over its RMS, where force and elongation are both known."""
    for id, name, measured, predicted, *_ in _loops(prediction):
        if id not in per_experiment:
            continue
        rms = float(np.sqrt(np.mean(measured.energy**2)))
        if rms > 0:
            # A diverged simulation has no energy.
            error = np.inf if predicted is None else float(np.sqrt(np.mean((predicted.energy - measured.energy) ** 2)))
            per_experiment[id][name]["energy_error"] = error / rms


def _loops(prediction: Prediction) -> Iterator[tuple[str, str, Cycles, Cycles | None, np.ndarray, np.ndarray]]:
    """Every known loop: experiment, name of the force, measured and predicted cycles (None without finite numbers), and
    measured elongation and force, (m,) each.
    """
    forces = [name for name in prediction.outputs if own_name(name) == "force"]
    for (row, experiment), name in product(enumerate(prediction.experiments), forces):
        if experiment.record is None:
            continue
        force, predicted, _, _ = prediction.histories(row, name)
        along = named(owner_of(name), "elongation")
        if along in prediction.outputs:
            elongation, stretched, _, _ = prediction.histories(row, along)
        elif along in experiment.record.channels:
            elongation = stretched = experiment.record[along]
        else:
            continue
        used = prediction.used[row, prediction.columns(name)][: len(force)]
        if used.sum() < 3 or not np.ptp(elongation[used]) > 0:
            continue
        force, elongation, predicted, stretched = (c[used] for c in (force, elongation, predicted, stretched))
        is_finite = bool(np.isfinite(predicted + stretched).all())
        ours = cycles_of(predicted, stretched, elongation) if is_finite else None
        yield experiment.id, name, cycles_of(force, elongation), ours, elongation, force


def _of_cycles(prediction: Prediction) -> list[str]:
    """Sentences on cycles whose measured energy is negative."""
    found = []
    for id, name, measured, _, elongation, force in _loops(prediction):
        if numbers := returned(measured, elongation, force):
            which = ", ".join(map(str, numbers[:_CYCLES])) + (" and more" if len(numbers) > _CYCLES else "")
            found.append(
                f"{id}: the measured {name} does negative work over cycle {which}; no specimen returns more energy than it was "
                "given: check the sign and the zero of the channels and whether they are simultaneous"
            )
    return found


def _plain(split: Split) -> dict[str, Any]:
    return {
        "error": split.error,
        "noise_floor": split.noise_floor,
        "per_output": split.per_output,
        "per_experiment": split.per_experiment,
        "parts": {"noise": split.noise_floor, **split.parts},
    } | ({"diverged": split.diverged} if split.diverged else {})
