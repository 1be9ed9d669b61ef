"""The measured experiments of a search over models: the residuals of predictions, and the errors that they are compared with."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from hsed_jax.criticism.compare import normalised_error
from hsed_jax.diagnosis.fit_state import Target
from hsed_jax.inference.correlation import NoiseEstimate, estimate_noise
from hsed_jax.inference.likelihood import Error, magnitudes


class Measured(NamedTuple):
    """The training experiments.

    Attributes:
        values: measured outputs, SI, (n, J).
        used: whether there is a measurement, (n, J).
        gaps: time since the previous sample of the same history [s], infinite without one, (n, J).
        groups: index of the output of each column, (J,).
        errors: the error of each output, (G,).
        noise: noise floor of the normalised error (`hsed_jax.criticism.compare`).
    """

    values: Float[np.ndarray, "n J"]
    used: Bool[np.ndarray, "n J"]
    gaps: Float[np.ndarray, "n J"]
    groups: Int[np.ndarray, " J"]
    errors: tuple[Error, ...]
    noise: float

    @property
    def declared(self) -> Float[np.ndarray, " G"]:
        """s of each output; NaN if it is not declared."""
        return np.asarray([float(e.size) if isinstance(e.size, int | float) else np.nan for e in self.errors])

    @property
    def scatter(self) -> float:
        """Standard deviation of the mean square of the noise, as a squared error: such a difference may be due to chance."""
        return self._scatter(float(self.used.sum()))

    def error(self, predicted: np.ndarray, scored: np.ndarray | None = None) -> float:
        """Normalised error of predictions (n, J) for the scored samples, by default for all measured ones."""
        return normalised_error(self.values, predicted, self.used if scored is None else scored, self.groups)

    def squares(self, predicted: np.ndarray, parts: Bool[np.ndarray, "F n J"]) -> Float[np.ndarray, " F"]:
        """Squared errors of predictions (n, J) in parts of the measurements, relative to the mean square of each output, (F,)."""
        whole = [self.used & (self.groups == group) for group in np.unique(self.groups)]
        wholes = [own for own in whole if own.any()]
        scales = [float(np.sqrt(np.mean(self.values[own] ** 2))) or 1.0 for own in wholes]
        found = np.zeros((len(parts), len(wholes)))
        for i, part in enumerate(parts):
            for j, (own, scale) in enumerate(zip(wholes, scales, strict=True)):
                counted = own & part
                if counted.any():
                    found[i, j] = np.mean((predicted[counted] - self.values[counted]) ** 2) / scale**2
        return found.mean(axis=1)

    def scales(self, predicted: Float[np.ndarray, "n J"]) -> Float[np.ndarray, "n J"]:
        """c in σ = s·c: one for an absolute error.  For a relative error, c is the predicted quantity or the RMS of the measured
        history, or the measured quantity if the error is relative to it."""
        of_measured = np.asarray([error.of_measured for error in self.errors], dtype=bool)[self.groups]
        is_predicted = (np.bincount(self.groups)[self.groups] == 1) & np.logical_not(of_measured)
        known = np.where(is_predicted, predicted, self.values)
        return self.expected_scales(known, self.used)

    def expected_scales(self, predicted: Float[np.ndarray, "r J"], used: np.ndarray) -> Float[np.ndarray, "r J"]:
        """c from values (r, J), such as predictions of experiments that are not made; `used` marks the values that count."""
        relative = np.asarray([error.is_relative for error in self.errors])
        members = (self.groups[:, None] == np.arange(len(self.errors))).astype(float)
        size = magnitudes(predicted, used.astype(float), members)
        return np.where(np.logical_and(relative[self.groups], size > 0), size, 1.0)

    def residual(self, predicted: np.ndarray) -> Float[np.ndarray, "n J"]:
        """Predictions minus measurements, divided by c; zero where there is no measurement."""
        return np.where(self.used, (predicted - self.values) / self.scales(predicted), 0.0)

    def left(self, predicted: np.ndarray) -> Float[np.ndarray, " G"]:
        """s of each output that explains the residual of predictions: the RMS of the residual over c, never zero."""
        residual, outputs = self.residual(predicted), range(len(self.errors))
        owns = [self.used & (self.groups == output) for output in outputs]
        found = [float(np.sqrt(np.mean(residual[own] ** 2))) if own.any() else 1.0 for own in owns]
        return np.maximum(found, 1e-9)

    def surprise(self, predicted: np.ndarray, standard: "Standard", parameters: int) -> float:
        r"""Minus the log density of the measurements, for predictions with errors of their own [nats], up to a constant:

        $$\sum_o n_o\Big(\big(1 - \tfrac pn\big)\log s_o + \tfrac12\,\hat s_o^2/s_o^2\Big),$$

        where $\hat s_o$ is the RMS residual of output o, $s_o$ the larger of $\hat s_o$ and the declared error, $n_o$ the
        effective number of its samples, n the sum of all $n_o$, and p the number of fitted parameters.  Each parameter removes
        one effective sample from the estimate of the errors (restricted likelihood, Patterson & Thompson 1971).

        Arguments:
            predicted: (n, J).
            standard: the effective numbers of samples, and the reference values of the errors.
            parameters: the number of fitted parameters.
        """
        left = self.left(predicted)
        errors = np.fmax(self.declared, left)
        counts = self._counts(standard)
        share = max(1 - parameters / float(counts.sum()), 0.0)
        return float(np.sum(counts * (share * np.log(errors / standard.errors) + 0.5 * (left / errors) ** 2)))

    def model_error(self, predicted: np.ndarray, standard: "Standard") -> float:
        r"""The error of a model itself, relative to the measurements: what is left beyond the noise, and what the noise may hide.

        With the normalised error E of the predictions, the noise floor s, and the effective number n of samples, it is

        $$e^2 = \max(E^2 - s^2,\,0) + s^2\sqrt{2/n}.$$

        The last term is the standard deviation of the mean square of the noise: a smaller error of the model has no visible
        effect on the residual.

        Arguments:
            predicted: (n, J).
            standard: the effective numbers of samples.
        """
        left, noise = self.error(predicted) ** 2, self.noise**2
        counts = self._counts(standard)
        return math.sqrt(max(left - noise, 0.0) + self._scatter(float(counts.sum())))

    def _scatter(self, samples: float) -> float:
        """The scatter for a number of independent samples."""
        return self.noise**2 * math.sqrt(2 / max(samples, 1.0))

    def _counts(self, standard: "Standard") -> np.ndarray:
        """The effective number of samples of each output, (G,)."""
        return standard.worth * np.asarray([int(self.used[:, self.groups == g].sum()) for g in range(len(self.errors))])

    def sigma(self, errors: Float[np.ndarray, " G"], predicted: np.ndarray) -> Float[np.ndarray, "n J"]:
        """σ = s·c of predictions, SI; one where there is no measurement."""
        return np.where(self.used, errors[self.groups] * self.scales(predicted), 1.0)

    def noise_estimate(self, predicted: np.ndarray) -> NoiseEstimate:
        """The noise estimate from the residual of predictions."""
        declared = ~np.isnan(self.declared)
        residual = self.residual(predicted) / np.where(declared, self.declared, self.left(predicted))[self.groups]
        correlated = [error.correlated for error in self.errors]
        return estimate_noise(residual, self.gaps, self.used, self.groups, declared, correlated)

    def standard(self, predicted: Float[np.ndarray, "n J"], fitted: Bool[np.ndarray, "M n J"]) -> "Standard":
        """The standard for several uses of the measurements, from the residual of predictions."""
        noise_estimate = self.noise_estimate(predicted)
        errors = np.fmax(self.declared, self.left(predicted))
        weights, samples = fitted * noise_estimate.worth[self.groups], self.samples(fitted)
        target = Target(self.values, self.sigma(errors, predicted), weights, noise_estimate.memory, samples)
        return Standard(errors, noise_estimate.worth, target)

    def samples(self, fitted: Bool[np.ndarray, "M n J"]) -> Int[np.ndarray, "M n"]:
        """Number of samples up to the last fitted one, the largest over the outputs, by use and experiment."""
        found = np.zeros(fitted.shape[:2], dtype=int)
        for group in np.unique(self.groups):
            own = fitted[:, :, self.groups == group]
            last = own.shape[2] - np.argmax(own[:, :, ::-1], axis=2)
            found = np.maximum(found, np.where(own.any(axis=2), last, 0))
        return found


class Standard(NamedTuple):
    """The errors and the data by which models are judged.

    Attributes:
        errors: s of each output, the larger of the declared error and the residual of a model, (G,).
        worth: effective number of each sample, by output, (G,).
        target: the data of the fits, with these errors.
    """

    errors: Float[np.ndarray, " G"]
    worth: Float[np.ndarray, " G"]
    target: Target
