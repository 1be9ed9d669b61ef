r"""The score of models: the log density of measurements that they were not fitted to.

The measurements are left out part by part.  A model is fitted to the rest, predicts the part, and has the score

$$s = -\tfrac12\sum_{i}\Big(\frac{y_i - f_i(\hat\theta)}{\sigma_i}\Big)^2$$

nats, up to a constant that all models share.  σ is the largest of three: the declared noise, the residual of the best fit of the
round, and the residual of the model that predicts this part of an experiment best.  A part that no model predicts therefore does
not outweigh all others.

The scatter of the score between pieces of the data gives its uncertainty.  Samples of a smooth residual are not independent, but
pieces of a history are nearly independent.  The probabilities of the models are therefore averages over the Bayesian bootstrap of
the pieces, with the prior probabilities π of the models (pseudo-BMA+, Yao et al. 2018):

$$p_M = \mathrm E_b\,\frac{\pi_M\,e^{\sum_p b_p s_{Mp}}}{\sum_N \pi_N\,e^{\sum_p b_p s_{Np}}},
  \qquad b\sim P\,\mathrm{Dirichlet}(1).$$
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import softmax

from hsed_jax.diagnosis.fit_state import FitState, Target, Task
from hsed_jax.diagnosis.measured import Measured
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.inference.likelihood import whitened

ODDS = 4.0
"""Least odds of a model with more effects or more parameters: it predicts better in four of five resamplings of the pieces."""

MATERIAL = 0.1
"""An effect is material if it removes this share of the squared error beyond the noise, about the error of a formula."""

# More experiments than this are left out in turn: two parts do not give the uncertainty of their mean.
_FEW = 2
_FOLDS = 6
_BLOCKS = 4
# Number of pieces of a history that is left out.
_PIECES = 8
# Draws of the bootstrap: the accuracy of a weight is about 0.01.
_DRAWS = 2000


class Folds(NamedTuple):
    """The fitted and the held-out data of each fold, (F, n, J) each; the first fold fits all data and leaves nothing out."""

    fitted: Bool[np.ndarray, "F n J"]
    left_out: Bool[np.ndarray, "F n J"]

    def pieces(self, groups: Int[np.ndarray, " J"]) -> Int[np.ndarray, "n J"]:
        """Number of the piece of each sample, −1 if it is never left out; a piece is within one fold, experiment and output."""
        found, count = np.full(self.left_out.shape[1:], -1), 0
        for part in self.left_out[1:]:
            for row in np.flatnonzero(part.any(axis=1)):
                for own in (part[row] & (groups == group) for group in np.unique(groups)):
                    size = int(own.sum())
                    found[row, own] = count + (np.arange(size) * _PIECES // size if size >= _PIECES else 0)
                count += _PIECES
        return found


class Gain(NamedTuple):
    """The gain of a model over another one in the log density of held-out data.

    Attributes:
        parts: gain of each piece of the held-out data [nats], (P,); minus infinity if a simulation fails.
    """

    parts: Float[np.ndarray, " P"]

    @property
    def total(self) -> float:
        """Sum over the pieces; minus infinity if a simulation fails."""
        return float(np.sum(self.parts)) if np.isfinite(self.parts).all() else -math.inf

    @property
    def standard_error(self) -> float:
        """Standard error of the total; infinite if a simulation fails."""
        if not np.isfinite(self.parts).all():
            return math.inf
        count = len(self.parts)
        return float(np.std(self.parts, ddof=1) * math.sqrt(count)) if count > 1 else 0.0


def weights_of(
    densities: Float[np.ndarray, "M P"], log_priors: Float[np.ndarray, " M"], draws: int = _DRAWS
) -> Float[np.ndarray, " M"]:
    """Probabilities of models from their scores.

    Arguments:
        densities: log densities of each model by piece; minus infinity if a simulation fails.
        log_priors: of the models.
        draws: number of draws of the Bayesian bootstrap.
    """
    able = np.isfinite(densities).all(axis=1)
    found = np.zeros(len(densities))
    if not able.any():
        return np.full(len(densities), 1 / len(densities))
    count = densities.shape[1]
    shares = count * np.random.default_rng(0).dirichlet(np.ones(count), size=draws)
    found[able] = softmax(shares @ densities[able].T + log_priors[able], axis=1).mean(axis=0)
    return found


def material(noise: float, before: float, now: float) -> float:
    """The squared error on held-out data that a further effect has to remove.

    It is the smaller of two values: a share of the squared error of the first model beyond the noise; and the squared noise plus
    this share of the squared error of the model without the effect beyond the noise.

    Arguments:
        noise: noise floor of the outputs, as an error.
        before: error of the first model.
        now: error of the model without the effect.
    """
    return min(MATERIAL * max(before**2 - noise**2, 0.0), noise**2 + MATERIAL * max(now**2 - noise**2, 0.0))


def largest_alike(noise: float, before: float, now: float) -> float:
    """The largest error on held-out data that is not materially larger than that of another model.

    Arguments:
        noise, before: as in `material`.
        now: error of the other model.
    """
    return math.sqrt(now**2 + material(noise, before, now))


def explained_share(noise: float, before: float, after: float) -> float:
    """Share of the squared error of the first model beyond the noise that another model removes, from 0 to 1.

    Arguments:
        noise, before: as in `material`.
        after: error of the other model; infinite if a simulation fails.
    """
    if not np.isfinite(after):
        return 0.0
    beyond = max(before**2 - noise**2, 0.0)
    return float(np.clip(1 - max(after**2 - noise**2, 0.0) / beyond, 0.0, 1.0)) if beyond else 1.0


def folds_of(used: Bool[np.ndarray, "n J"], groups: np.ndarray) -> Folds:
    """The folds: more than two experiments are left out in turn, in six groups at most.

    With one or two experiments, the past predicts the future: each block of time is predicted from all earlier blocks, because
    damage changes a specimen.  Two experiments without histories are left out in turn as well.
    """
    n = len(used)
    if n > _FEW or (n > 1 and np.bincount(groups)[groups].min() < _BLOCKS):
        fold = np.broadcast_to((np.arange(n) % min(n, _FOLDS))[:, None], used.shape)
        fitted = [used & (fold != k) for k in range(int(fold.max()) + 1)]
        left_out = [used & (fold == k) for k in range(int(fold.max()) + 1)]
    else:
        block = np.zeros(used.shape, dtype=int)
        for own in (groups == g for g in np.unique(groups)):
            order, count = np.cumsum(used[:, own], axis=1) - 1, used[:, own].sum(axis=1, keepdims=True)
            block[:, own] = np.clip(order * _BLOCKS // np.maximum(count, 1), 0, _BLOCKS - 1)
        fitted = [used & (block < k) for k in range(1, _BLOCKS)]
        left_out = [used & (block == k) for k in range(1, _BLOCKS)]
    return Folds(np.stack([used, *fitted]), np.stack([np.zeros_like(used), *left_out]))


class HeldOut:
    """Predictions of data that the models were not fitted to.

    Arguments:
        models: the large model.
        measured: the fitted experiments.
        test: experiments that are never fitted; their rows follow those of the measured ones.
    """

    def __init__(self, models: NestedModels, measured: Measured, test: Measured | None):
        self.models, self.measured, self.test = models, measured, test
        self.folds = folds_of(measured.used, measured.groups)
        self._pieces = self.folds.pieces(measured.groups)
        # Predictions for the last target by the identity of the fit; the fit is stored as well, so that its number stays unique.
        self._target: Target | None = None
        self._predicted: dict[int, tuple[FitState, np.ndarray | None]] = {}

    def unseen(self, target: Target, fits: Sequence[FitState]) -> list[float]:
        """Error of fits on the test experiments; without any, on the data that are left out in turn (the later blocks of time for
        one or two experiments).  Infinite if a simulation fails, so that a failed prediction is no improvement."""
        if self.test is None:
            return self.errors(target, fits)
        rows = len(self.measured.values) + np.arange(len(self.test.values))
        outputs, ok = self.models.predict([(f.x, f.submodel) for f in fits], rows)
        return [
            self.test.error(predicted) if converged.all() else math.inf
            for predicted, converged in zip(outputs, ok, strict=True)
        ]

    def errors(self, target: Target, fits: Sequence[FitState]) -> list[float]:
        """Error of each model on all data that are left out in turn."""
        scored = self.folds.left_out.any(axis=0)
        predicted = self._left_out(target, fits)
        return [math.inf if one is None else self.measured.error(one, scored) for one in predicted]

    def densities(
        self, target: Target, fits: Sequence[FitState], moved: Sequence[np.ndarray | None] | None = None
    ) -> Float[np.ndarray, "M P"]:
        """Log density of the held-out data by model and piece [nats], up to a constant; minus infinity if a simulation fails.

        Arguments:
            target: the data of the fits.
            fits: of the models.
            moved: by model, a change that is added to its predictions, (n, J), or None; by default None for all models.
        """
        kept = self._pieces >= 0
        # Only the pieces that contain measurements.
        pieces, piece = np.unique(self._pieces[kept], return_inverse=True)
        squares = np.full((len(fits), len(pieces)), np.inf)
        changes = moved or [None] * len(fits)
        for own, predicted, change in zip(squares, self._left_out(target, fits), changes, strict=True):
            if predicted is not None:
                shifted = predicted if change is None else predicted + change
                off = np.where(kept, (shifted - target.values) / target.sigma, 0.0)
                own[:] = np.bincount(piece, whitened(off, target.memory)[kept] ** 2)
        # The part of the data that each piece belongs to: one fold, one experiment and one output.
        _, part = np.unique(pieces // _PIECES, return_inverse=True)
        lowest = np.min([np.bincount(part, own) for own in squares], axis=0) / np.bincount(part, np.bincount(piece))
        return -0.5 * squares / np.where(np.isfinite(lowest), np.maximum(lowest, 1.0), 1.0)[part]

    def _left_out(self, target: Target, fits: Sequence[FitState]) -> list[np.ndarray | None]:
        """The held-out predictions of each model, (n, J), as from `left_out_predictions`."""
        if target is not self._target:
            self._target, self._predicted = target, {}
        new = list({id(fit): fit for fit in fits if id(fit) not in self._predicted}.values())
        if new:
            found = left_out_predictions(self.models, target, self.folds, new)
            self._predicted |= {id(fit): (fit, one) for fit, one in zip(new, found, strict=True)}
        return [self._predicted[id(fit)][1] for fit in fits]


def left_out_predictions(
    models: NestedModels, target: Target, folds: Folds, fits: Sequence[FitState]
) -> list[np.ndarray | None]:
    """The predictions of each model for every part of the data, from a fit without this part, (n, J); None if one fails.

    Arguments:
        models: of the fits.
        target: with one use of the data for each fold.
        folds: the fitted and the held-out data of each fold.
        fits: of the models to all data; the fits to the folds start from them.
    """
    count = len(folds.fitted) - 1
    tasks = [Task(fit.submodel, fit.x, use, known=fit) for fit in fits for use in range(1, count + 1)]
    ends = models.fit(target, tasks)
    outputs, ok = models.predict([(f.x, f.submodel) for f in ends], np.arange(len(target.values)))
    found: list[np.ndarray | None] = []
    for number in range(len(fits)):
        predicted, is_whole = np.zeros_like(target.values), True
        for fold in range(count):
            out = folds.left_out[fold + 1]
            predicted = np.where(out, outputs[number * count + fold], predicted)
            is_whole = is_whole and bool(np.all(ok[number * count + fold][out.any(axis=1)] > 0))
        found.append(predicted if is_whole else None)
    return found
