"""What a calibrated model predicts for measured experiments, with bands, beside what was measured."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from hsed_jax.inference.likelihood import Data
from hsed_jax.measurements import Experiment
from hsed_jax.programs import program
from hsed_jax.tables import cell

if TYPE_CHECKING:
    # A report reads predictions and loads no sampler.
    from hsed_jax.inference.fit import Fit

_DRAWS = 64
_NAMED = 6
ABSURD = 100.0
"""A prediction beyond this many times the largest magnitude that was measured, or an error beyond this many times what was
measured, is none: no model of a specimen is off by two orders of magnitude, while a simulation that runs away passes them
within a few steps."""


def has_diverged(values: npt.ArrayLike, scale: npt.ArrayLike = 1.0) -> np.ndarray:
    """Where a prediction or an error is not finite, or absurd beside `scale`."""
    return np.asarray(~(np.abs(values) <= ABSURD * np.asarray(scale)))


def error_cell(error: float | None, look: str = ".3f") -> str:
    """A normalised error as a cell; a dash where there is none."""
    return "diverged" if error is not None and not np.isnan(error) and has_diverged(error) else cell(error, look)


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
        sigma: sd of the error alone at θ_MAP, as it is declared where it is, (n, J).
        converged: whether the simulation converged, (n,).
        draws_lost: share of the posterior's draws whose simulation diverged, (n,); mean and sd are those of the others.
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

    @cached_property
    def residual(self) -> np.ndarray:
        """Predicted less measured, SI, (n, J); zero where there is no measurement, or no prediction since it diverged."""
        return np.where(self.used & np.isfinite(self.shown), self.shown - self.measured, 0.0)

    @cached_property
    def diverged(self) -> np.ndarray:
        """Whether an experiment's simulation at θ_MAP is no prediction: it did not converge, or ran away, (n,)."""
        return ~self.converged | (self.used & self._absurd).any(axis=1)

    @cached_property
    def shown(self) -> np.ndarray:
        """`predicted` as it can be drawn: NaN where it diverged, (n, J)."""
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
            found.append(f"the simulation of {names} diverged at the MAP: its errors mean nothing, and it is not drawn")
        lost = np.broadcast_to(self.draws_lost, len(self.experiments))
        if (lost > 0).any():
            left = "leaves these draws out" if (lost < 1).all() else "leaves them out; without any other, there is none"
            found.append(
                f"the simulation of {_named(self.experiments, lost > 0)} diverged in up to {100 * lost.max():.0f} % of the "
                f"posterior's draws: the predictive band {left}"
            )
        return found

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
        """Measured, predicted (`shown`), predictive mean and sd of one channel of one experiment at its record's samples."""
        columns = self.columns(output)
        record = self.experiments[row].record
        length = int(columns.sum()) if record is None else len(record)
        return tuple(table[row, columns][:length] for table in (self.measured, self.shown, self.mean, self.sd))  # type: ignore[return-value]


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
    measured, used = np.asarray(data.values), np.asarray(data.weights) > 0
    limits = ABSURD * _largest(measured, used, posterior.groups)
    strangers = posterior.population.strangers(data.members, len(thetas))
    predicted, ok, sigma, mean, sd, lost = (
        np.asarray(x) for x in _predicted(posterior, thetas, strangers, data, limits)
    )
    if fit.inflation is not None:
        # What the model leaves widens the band, and is no noise.
        sigma = sigma / fit.inflation[posterior.groups]
    return Prediction(
        posterior.outputs,
        posterior.groups,
        tuple(experiments),
        measured,
        used,
        predicted,
        mean,
        sd,
        sigma,
        ok > 0,
        lost,
    )


def _largest(measured: np.ndarray, used: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """Largest magnitude measured of each column's output, (J,); infinite where nothing but zeros was measured."""
    largest = np.where(used, np.abs(measured), 0.0).max(axis=0, initial=0.0)
    by_output = np.asarray([largest[groups == group].max(initial=0.0) for group in range(int(groups.max()) + 1)])
    return np.where(by_output > 0, by_output, np.inf)[groups]


def _named(experiments: tuple[Experiment, ...], which: np.ndarray) -> str:
    """Ids of some experiments, the first few by name."""
    ids = [experiment.id for experiment, one in zip(experiments, which, strict=True) if one]
    return ", ".join(ids[:_NAMED]) + (f" and {len(ids) - _NAMED} more" if len(ids) > _NAMED else "")


@program
def _predicted(posterior, thetas, strangers, data, limits):
    """Predictions at the first parameters, whether they converged and their σ; mean and sd over those of the other parameters
    that stay within the limits (J,), and the share (n,) that does not."""

    def at(theta, strangers):
        return posterior.predict(posterior.by_experiment(theta, data, strangers), data.conditions, data.count)

    predicted, ok = jax.vmap(at)(thetas, strangers)
    at_map = posterior.sigma(thetas[0], predicted[0], ok[0], data)
    sigma = jax.vmap(lambda t, f: posterior.expected_sigma(t, f, data))(thetas[1:], predicted[1:])
    good = (ok[1:] > 0) & jnp.all(jnp.abs(predicted[1:]) <= limits, axis=-1)
    share = (good / jnp.sum(good, axis=0))[..., None]
    # What is left out may be too large to be multiplied by zero, or squared.
    values = jnp.where(good[..., None], predicted[1:], 0.0)
    errors = jnp.where(good[..., None], sigma, 0.0)
    mean = jnp.sum(share * values, axis=0)
    variance = jnp.sum(share * ((values - mean) ** 2 + errors**2), axis=0)
    return predicted[0], ok[0], at_map, mean, jnp.sqrt(variance), 1.0 - jnp.mean(good, axis=0)
