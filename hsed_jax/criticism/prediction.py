"""Predictions of a calibrated model for measured experiments, with bands, beside the measurements."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from hsed_jax.criticism.shown_noise import shown_noise
from hsed_jax.inference.likelihood import Data, data_of
from hsed_jax.inference.simulations import outputs_of
from hsed_jax.measurements import Experiment
from hsed_jax.programs import program
from hsed_jax.tables import cell

if TYPE_CHECKING:
    # A report reads predictions, and needs no sampler.
    from hsed_jax.inference.fit import Fit
    from hsed_jax.inference.posterior import Posterior

_DRAWS = 64
_NAMED = 6
ABSURD = 100.0
"""A prediction or an error beyond this many times the largest measured magnitude counts as diverged: the error of a
usable model is smaller than two orders of magnitude, and an unstable simulation exceeds them within a few steps.
"""


def has_diverged(values: npt.ArrayLike, scale: npt.ArrayLike = 1.0) -> np.ndarray:
    """Where a prediction or an error is not finite, or absurdly larger than `scale`."""
    return np.asarray(~(np.abs(values) <= ABSURD * np.asarray(scale)))


def error_cell(error: float | None, look: str = ".3f") -> str:
    """A normalised error as a cell; a dash without one."""
    return "diverged" if error is not None and not np.isnan(error) and has_diverged(error) else cell(error, look)


def error_change(before: str, after: str) -> str:
    """The verb of a sentence on an error, from its cells before and after a change of the model."""
    return f"stays at {after}" if before == after else f"goes from {before} to {after}"


class Band(NamedTuple):
    """Moments of a predictive distribution: mean, and sd by part, whose squares add up, (n, J) each."""

    mean: Any
    parts: dict[str, Any]

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of all parts together."""
        return np.sqrt(sum(part**2 for part in self.parts.values()))


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted outputs of some experiments; n experiments, J columns (samples of channels, or quantities).

    Attributes:
        outputs: names of the outputs.
        groups: output of each column, (J,).
        experiments: the n experiments.
        measured: SI, (n, J); without meaning where `used` is false.
        used: where there is a measurement to compare with, (n, J).
        predicted: at θ_MAP, SI, (n, J).
        mean, sd: of the posterior predictive distribution, the error included, (n, J).
        sigma: sd of the error alone at θ_MAP, as it is declared where it is, (n, J).
        converged: whether the simulation converged, (n,).
        draws_lost: share of the posterior's draws whose simulation diverged, (n,); mean and sd are those of the others.
        parts: parts of the band, sd by part, each (n, J): their squares add up to that of `sd`.  `noise`, as declared;
            `parameters`, by the posterior; with a learned or inflated error of the model, `model`, from the uncertainty of
            its discrepancy, or from the inflation of the error.  An inferred error contains noise and model error. For a
            history, the noise is estimated from the record (`noise_sizes`).
        without: the band without the discrepancy, where one is learned.
    """

    outputs: tuple[str, ...]
    groups: np.ndarray
    experiments: tuple[Experiment, ...]
    measured: np.ndarray
    used: np.ndarray
    predicted: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    sigma: np.ndarray
    converged: np.ndarray
    draws_lost: npt.ArrayLike = 0.0
    parts: Mapping[str, np.ndarray] = field(default_factory=dict)
    without: Band | None = None

    @property
    def correction(self) -> np.ndarray:
        """Contribution of the discrepancy to the prediction, SI, (n, J); zero if none is learned."""
        return np.zeros_like(self.mean) if self.without is None else self.mean - self.without.mean

    @property
    def misfit(self) -> dict[str, np.ndarray]:
        """The expected error of the model itself, without a discrepancy, by part, (n, J): `parts`, and for the model
        the learned discrepancy and its remaining uncertainty.
        """
        if self.without is None:
            return dict(self.parts)
        return {**self.without.parts, "model": np.hypot(self.correction, self.parts["model"])}

    @cached_property
    def residual(self) -> np.ndarray:
        """Predicted minus measured, SI, (n, J); zero where there is no measurement, or no prediction since it diverged."""
        return np.where(self.used & np.isfinite(self.shown), self.shown - self.measured, 0.0)

    @cached_property
    def diverged(self) -> np.ndarray:
        """Whether the simulation of an experiment at θ_MAP diverged: it did not converge, or is unstable, (n,)."""
        return ~self.converged | (self.used & self._absurd).any(axis=1)

    @cached_property
    def shown(self) -> np.ndarray:
        """`predicted` for figures: NaN where it diverged, (n, J)."""
        return np.where(self.diverged[:, None] | self._absurd, np.nan, self.predicted)

    @cached_property
    def _absurd(self) -> np.ndarray:
        return has_diverged(self.predicted, _largest(self.measured, self.used, self.groups))

    @cached_property
    def warnings(self) -> list[str]:
        """Sentences on simulations that diverged."""
        found = []
        if self.diverged.any():
            names = _named(self.experiments, self.diverged)
            found.append(
                f"the simulation of {names} diverged at the MAP: its errors have no meaning, and it is not drawn"
            )
        lost = np.broadcast_to(self.draws_lost, len(self.experiments))
        if (lost > 0).any():
            left = (
                "leaves these draws out"
                if (lost < 1).all()
                else "leaves them out, and does not exist where no other draw is left"
            )
            found.append(
                f"the simulation of {_named(self.experiments, lost > 0)} diverged in up to {100 * lost.max():.0f} % of the "
                f"posterior's draws: the predictive band {left}"
            )
        return found

    @cached_property
    def gaps(self) -> np.ndarray:
        """Time since the previous sample of the same history [s], infinite without one, (n, J)."""
        gaps = np.full(self.used.shape, np.inf)
        for row, experiment in enumerate(self.experiments):
            for output in range(len(self.outputs)):
                (columns,) = np.nonzero(self.groups == output)
                if experiment.record is not None and len(columns) > 1:
                    steps = np.diff(experiment.record.time)[: len(columns) - 1]
                    gaps[row, columns[1 : len(steps) + 1]] = steps
        return np.where(self.used & np.pad(self.used[:, :-1], ((0, 0), (1, 0))), gaps, np.inf)

    def columns(self, output: str) -> np.ndarray:
        """The columns of an output, (J,) bool."""
        return self.groups == self.outputs.index(output)

    def histories(self, row: int, output: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Measured, predicted (`shown`), predictive mean and sd of one channel of one experiment at its record's samples."""
        columns = self.columns(output)
        record = self.experiments[row].record
        length = int(columns.sum()) if record is None else len(record)
        return tuple(table[row, columns][:length] for table in (self.measured, self.shown, self.mean, self.sd))  # type: ignore[return-value]


def predict(fit: "Fit", data: Data, experiments: tuple[Experiment, ...]) -> Prediction:
    """Predict experiments with a calibrated model.

    Arguments:
        fit: the calibrated model.
        data: the experiments as data, as the fit's own were made; rows beyond its count are padding.
        experiments: the same experiments.
    """
    posterior = fit.posterior
    draws = np.asarray(fit.chains.theta).reshape(-1, fit.chains.theta.shape[-1])
    best = np.asarray(fit.maximum.theta)[None]
    thetas = jax.device_put(np.concatenate([best, draws[:: max(1, len(draws) // _DRAWS)][:_DRAWS]]))
    measured, used = np.asarray(data.values), np.asarray(data.weights) > 0
    limits = ABSURD * _largest(measured, used, posterior.groups)
    strangers = posterior.population.strangers(data.members, len(thetas))
    # By the program of the calibration: another one with simulations takes seconds to compile.
    simulated = outputs_of(posterior, data, np.asarray(_by_experiment(posterior, thetas, strangers, data)))
    found = _predicted(posterior, thetas, *simulated, data, limits, _shortfall(fit, data))
    measured, used, found = jax.tree.map(lambda values: np.asarray(values)[: int(data.count)], (measured, used, found))
    predicted, ok, sigma, plain, corrected, lost = found
    parts = dict(corrected.parts)
    if fit.inflation is not None:
        # The error of the model widens the band, but does not count as noise.
        factors, whole = fit.inflation[posterior.groups], parts["noise"]
        sigma, noise = sigma / factors, whole / factors
        shown = shown_noise(experiments, measured, used, posterior.groups, posterior.outputs)[0]
        noise = np.where(posterior.is_declared[posterior.groups], noise, np.fmin(noise, shown))
        parts |= {"noise": noise, "model": np.sqrt(np.maximum(whole**2 - noise**2, 0.0))}
    return Prediction(
        posterior.outputs,
        posterior.groups,
        tuple(experiments),
        measured,
        used,
        predicted,
        corrected.mean,
        corrected.sd,
        sigma,
        ok > 0,
        lost,
        parts,
        None if fit.discrepancy is None else plain,
    )


def noise_sizes(prediction: Prediction, output: str, declared: bool) -> np.ndarray:
    """Sd of the noise of an output, (n, J): declared; or for histories estimated from the non-smooth part of the
    record, and at most the inferred error, which includes it.
    """
    sigma = prediction.sigma[:, prediction.columns(output)]
    return sigma if declared else np.fmin(_shown_by(prediction, output)[0], sigma)


def largest_noise(prediction: Prediction, output: str) -> np.ndarray:
    """The largest sd of an undeclared noise that the records allow, (n, J); infinite if they do not show it."""
    largest = _shown_by(prediction, output)[1]
    return np.where(np.isnan(largest), np.inf, largest)


def _shown_by(prediction: Prediction, output: str) -> np.ndarray:
    columns = prediction.columns(output)
    measured, used = prediction.measured[:, columns], prediction.used[:, columns]
    one = np.zeros(int(columns.sum()), dtype=int)
    return shown_noise(prediction.experiments, measured, used, one, (output,))


def learned_misfit(fit: "Fit", fitted: Prediction) -> Prediction:
    """The misfit that a calibrated model expects of itself, without noise, in the form of a measurement.

    For quantities it covers the distribution of the inputs. For histories, and if the model cannot be simulated at any
    inputs, it covers the fitted experiments.

    Arguments:
        fit: the calibrated model.
        fitted: predictions of the experiments that it was fitted to; returned if no discrepancy is learned.
    """
    if fit.discrepancy is None:
        return fitted
    if fit.support is None:
        wrong = np.asarray(fit.discrepancy.amplitudes)[fitted.groups] > 0
        return replace(fitted, measured=np.where(fitted.used & wrong, fitted.mean, fitted.measured))
    if fit.support.spread is None:
        return fitted
    inputs = {name: np.asarray(values) for name, values in fit.support.spread.inputs.items()}
    count, columns = len(next(iter(inputs.values()))), len(fit.posterior.groups)
    rows = [{name: float(values[i]) for name, values in inputs.items()} for i in range(count)]
    experiments = tuple(Experiment(f"X{i + 1:03d}", row) for i, row in enumerate(rows))
    nothing = np.full((count, columns), np.inf)
    made = predict(fit, data_of(fit.support.spread, nothing, nothing < 0, nothing, count), experiments)
    measured = made.predicted + made.correction
    return replace(made, measured=measured, used=np.isfinite(measured), sigma=made.parts["noise"])


class Shortfall(NamedTuple):
    """The expected error of quantities of other experiments, from the residuals of the fitted ones.

    Attributes:
        fitted: the experiments that were fitted.
        weights: matrix from their standardised residuals to the expected error of predictions, (nJ, mJ).
        variance: of that, in units of the error, (n, J).
    """

    fitted: Data
    weights: np.ndarray
    variance: np.ndarray

    def corrected(self, posterior: "Posterior", theta: Any, values: Any, at_map: Any, data: Data) -> tuple[Any, Any]:
        """Predictions at θ with the discrepancy, and its variance, SI."""
        by: Any = (self.weights @ posterior.compared(theta, self.fitted).ravel()).reshape(values.shape)
        moved, slopes = posterior.displaced(theta, values, by, data)
        return moved, slopes**2 * self.variance


class ShortfallOfHistories(NamedTuple):
    """The expected error of histories, fitted and new ones, from the residuals of the fitted ones.

    Attributes:
        fitted: 1 in a fitted experiment: the sum of model and discrepancy is known there, (n, J).
        mean: expected error of the prediction at the MAP, SI, (n, J).
        variance: of that, SI, (n, J).
    """

    fitted: np.ndarray
    mean: np.ndarray
    variance: np.ndarray

    def corrected(self, posterior: "Posterior", theta: Any, values: Any, at_map: Any, data: Data) -> tuple[Any, Any]:
        """Predictions at θ with the discrepancy, and its variance, SI."""
        return jnp.where(self.fitted > 0, at_map, values) + self.mean, self.variance


def _shortfall(fit: "Fit", data: Data) -> Shortfall | ShortfallOfHistories | None:
    if fit.discrepancy is None:
        return None
    from hsed_jax.inference.discrepancy.inputs import Process
    from hsed_jax.inference.discrepancy.predicting import OverCycles, shortfall

    if isinstance(fit.discrepancy, Process):
        assert fit.support is not None
        points = jnp.asarray(fit.support.cube(data.conditions.inputs))
        return Shortfall(fit.data, *map(np.asarray, fit.discrepancy.conditional(points)))
    assert isinstance(fit.discrepancy, OverCycles)
    return ShortfallOfHistories(*shortfall(fit.discrepancy, fit.posterior, fit.data, fit.maximum.u, data))


def _largest(measured: np.ndarray, used: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Largest magnitude measured of each column's output, (J,); infinite if all measured values are zero."""
    largest = np.where(used, np.abs(measured), 0.0).max(axis=0, initial=0.0)
    by_output = np.asarray([largest[groups == group].max(initial=0.0) for group in range(int(groups.max()) + 1)])
    return np.where(by_output > 0, by_output, np.inf)[groups]


def _named(experiments: tuple[Experiment, ...], which: np.ndarray) -> str:
    """Ids of some experiments, the first few by name."""
    ids = [experiment.id for experiment, one in zip(experiments, which, strict=True) if one]
    return ", ".join(ids[:_NAMED]) + (f" and {len(ids) - _NAMED} more" if len(ids) > _NAMED else "")


@program
def _by_experiment(posterior, thetas, strangers, data):
    """The parameters of the model, for all experiments or of each its own, (S, m, q)."""
    return jax.vmap(lambda theta, strangers: posterior.by_experiment(theta, data, strangers))(thetas, strangers)


@program
def _predicted(posterior, thetas, predicted, ok, data, limits, shortfall):
    """Predictions at the first parameters, whether they converged and their σ; bands over those of the other parameters that
    stay within the limits (J,), without and with the discrepancy, and the share (n,) that does not."""
    at_map = posterior.sigma(thetas[0], predicted[0], ok[0], data)
    good = (ok[1:] > 0) & jnp.all(jnp.abs(predicted[1:]) <= limits, axis=-1)
    share = (good / jnp.sum(good, axis=0))[..., None]

    def band(values, more):
        sigma = jax.vmap(lambda t, f: posterior.expected_sigma(t, f, data))(thetas[1:], values)
        # Values that are left out may be too large to be multiplied by zero, or squared.
        values, sigma = (jnp.where(good[..., None], each, 0.0) for each in (values, sigma))
        mean = jnp.sum(share * values, axis=0)
        parts = {"noise": sigma**2, "parameters": (values - mean) ** 2} | {
            name: jnp.where(good[..., None], each, 0.0) for name, each in more.items()
        }
        return Band(mean, {name: jnp.sqrt(jnp.sum(share * each, axis=0)) for name, each in parts.items()})

    plain = corrected = band(predicted[1:], {})
    if shortfall is not None:

        def moved(theta, values):
            return shortfall.corrected(posterior, theta, values, predicted[0], data)

        values, variance = jax.vmap(moved)(thetas[1:], predicted[1:])
        corrected = band(values, {"model": variance})
    return predicted[0], ok[0], at_map, plain, corrected, 1.0 - jnp.mean(good, axis=0)
