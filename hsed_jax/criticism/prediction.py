"""What a calibrated model predicts for measured experiments, with bands, beside what was measured."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.inference.likelihood import Data
from hsed_jax.measurements import Experiment

if TYPE_CHECKING:
    # A report reads predictions and loads no sampler.
    from hsed_jax.inference.fit import Fit

_DRAWS = 64


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted outputs of some experiments; n experiments, J columns (samples of channels, or quantities).

    Attributes:
        outputs: names of the outputs.
        groups: output of each column, (J,).
        experiments: the n experiments.
        measured: SI, (n, J); meaningless where `used` is false.
        used: where there is a measurement to compare with, (n, J).
        predicted: at θ_MAP, SI, (n, J).
        mean, sd: of the posterior predictive distribution, the error included, (n, J).
        sigma: sd of the error alone at θ_MAP, (n, J).
        converged: whether the simulation converged, (n,).
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

    @cached_property
    def residual(self) -> np.ndarray:
        """Predicted less measured, SI, (n, J); zero where there is no measurement."""
        return np.where(self.used, self.predicted - self.measured, 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """Time since the sample before of the same history [s], infinite where there is none, (n, J)."""
        gaps = np.full(self.used.shape, np.inf)
        for row, experiment in enumerate(self.experiments):
            for output in range(len(self.outputs)):
                (columns,) = np.nonzero(self.groups == output)
                if experiment.record is not None and len(columns) > 1:
                    steps = np.diff(experiment.record.time)[: len(columns) - 1]
                    gaps[row, columns[1 : len(steps) + 1]] = steps
        return np.where(self.used & np.pad(self.used[:, :-1], ((0, 0), (1, 0))), gaps, np.inf)

    def columns(self, output: str) -> np.ndarray:
        """Which columns belong to an output, (J,) bool."""
        return self.groups == self.outputs.index(output)

    def histories(self, row: int, output: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Measured, predicted, predictive mean and sd of one channel of one experiment at the samples of its record."""
        columns = self.columns(output)
        record = self.experiments[row].record
        length = int(columns.sum()) if record is None else len(record)
        return tuple(table[row, columns][:length] for table in (self.measured, self.predicted, self.mean, self.sd))  # type: ignore[return-value]


def predict(fit: "Fit", data: Data, experiments: tuple[Experiment, ...]) -> Prediction:
    """Predict experiments with a calibrated model.

    Arguments:
        fit: the calibrated model.
        data: the experiments as data, as the fit's own were made.
        experiments: the same experiments.
    """
    posterior = fit.posterior
    draws = fit.chains.theta.reshape(-1, fit.chains.theta.shape[-1])
    thetas = jnp.concatenate([fit.maximum.theta[None], draws[:: max(1, draws.shape[0] // _DRAWS)][:_DRAWS]])
    predicted, ok, sigma, mean, sd = (np.asarray(x) for x in _predicted(posterior, thetas, data))
    return Prediction(
        posterior.outputs,
        posterior.groups,
        tuple(experiments),
        np.asarray(data.values),
        np.asarray(data.weights) > 0,
        predicted,
        mean,
        sd,
        sigma,
        ok > 0,
    )


@eqx.filter_jit
def _predicted(posterior, thetas, data):
    """Predictions at the first parameters, whether they converged and their σ; mean and sd over the other parameters."""
    predicted, ok = jax.vmap(lambda t: posterior.predict(posterior.of_model(t), data.conditions, data.count))(thetas)
    sigma = jax.vmap(lambda t, f, good: posterior.sigma(t, f, good, data))(thetas, predicted, ok)
    good = ok[1:, :, None] / jnp.maximum(ok[1:].sum(axis=0), 1.0)[None, :, None]
    mean = jnp.sum(good * predicted[1:], axis=0)
    variance = jnp.sum(good * ((predicted[1:] - mean) ** 2 + sigma[1:] ** 2), axis=0)
    return predicted[0], ok[0], sigma[0], mean, jnp.sqrt(variance)
