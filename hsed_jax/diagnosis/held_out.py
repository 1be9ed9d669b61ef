"""Errors on what was not fitted: experiments left out in turn, and of one or two what comes later."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hsed_jax.diagnosis.descent import Descent, Target, Task
from hsed_jax.diagnosis.measured import WRONG, Measured
from hsed_jax.diagnosis.nested import NestedModels

# Of more experiments than so few, they are left out in turn: two parts say nothing of how sure their mean is.
_FEW = 2
_FOLDS = 6
_BLOCKS = 4
# Share of the squared held-out error, less the noise, that an effect takes away; the first may take less, if that is all.
# A textbook formula is off by a third of its effect: the last that is left beside an effect, if smaller, is no other physics.
_MATERIAL, _FORMULA = 0.05, 0.1
# Where what is left is far above the noise, this share of it is enough: the model is wrong, and prediction decides.
_PART = 0.05
# Where what is left is so many times the noise, squared, one that leaves nothing is no accident (second: no more parameters).
_CLEAR, _SEEN = 2.0, 1.2


class Folds(NamedTuple):
    """What to fit and what to predict from it, (F, n, J) each; the first fold is all the data and nothing left out."""

    fitted: Bool[np.ndarray, "F n J"]
    left_out: Bool[np.ndarray, "F n J"]


class Gain(NamedTuple):
    """Squared normalised errors that a model takes away from predictions of what was not fitted.

    Attributes:
        parts: of every part that was left out, (F,); minus infinity where a simulation fails.
    """

    parts: Float[np.ndarray, " F"]

    @property
    def mean(self) -> float:
        """Over the parts."""
        return float(np.mean(self.parts)) if np.isfinite(self.parts).all() else -math.inf

    @property
    def standard_error(self) -> float:
        """Of the mean; infinite where that is."""
        return _standard_error(self.parts)

    def is_as_good_as(self, lead: "Gain") -> bool:
        """Whether it is no more than one standard error of the difference behind."""
        return math.isfinite(self.mean) and lead.mean - self.mean <= _standard_error(lead.parts - self.parts)


def _standard_error(parts: np.ndarray) -> float:
    if not np.isfinite(parts).all():
        return math.inf
    return float(np.std(parts, ddof=1) / math.sqrt(len(parts))) if len(parts) > 1 else 0.0


def by_prediction(gains: Sequence[Gain], sizes: Sequence[int]) -> list[int]:
    """The order of models: those that predict as well as the best of them, by one standard error, the one of fewest parameters
    first (Breiman et al. 1984), and then the others by what they gain.

    Arguments:
        gains: of each model over another one.
        sizes: how many parameters each has.
    """
    lead = max(gains, key=lambda gain: gain.mean, default=None)

    def place(i: int) -> tuple[bool, float]:
        is_alike = lead is not None and gains[i].is_as_good_as(lead)
        return not is_alike, sizes[i] if is_alike else -gains[i].mean

    return sorted(range(len(gains)), key=place)


def to_take_away(before: float, now: float, noise: float, is_first: bool, is_last: bool, is_as_large: bool) -> float:
    """The squared error on what was left out that a further effect has to take away.

    Arguments:
        before, now, noise: error of the model as it is, of the one that it is added to, and the noise floor.
        is_first: there is no other effect.
        is_last: it leaves no more than the noise.
        is_as_large: the model has no more parameters with it, as another form of what there was has fewer.
    """
    if not is_last:
        needed = _MATERIAL * (before**2 - noise**2)
        return min(needed, _PART * (now**2 - noise**2)) if now > WRONG * noise else needed
    # Two effects that leave nothing are no more than one that leaves something, and needs as many parameters for it.
    is_clear = now**2 > (_SEEN if is_as_large else _CLEAR) * noise**2
    return 0.0 if is_first or is_clear else _FORMULA * (before**2 - noise**2)


def folds_of(used: Bool[np.ndarray, "n J"], groups: np.ndarray) -> Folds:
    """Several experiments are left out in turn.

    Of one or two the past predicts the future: the blocks of time before each block are fitted, since a specimen that has been
    damaged is another one.  Two of which there are no histories are left out in turn, too.
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
    """What models predict of data that they were not fitted to.

    Arguments:
        models: the large model.
        measured: the experiments that are fitted.
        test: experiments that nothing is fitted to, the rows after those measured.
    """

    def __init__(self, models: NestedModels, measured: Measured, test: Measured | None):
        self.models, self.measured, self.test = models, measured, test
        self.folds = folds_of(measured.used, measured.groups)
        # What the last target's fits predict, by identity; the fit is kept with it, so that no other one gets its number.
        self._target: Target | None = None
        self._predicted: dict[int, tuple[Descent, np.ndarray | None]] = {}

    def unseen(self, target: Target, fits: Sequence[Descent]) -> list[float]:
        """Error of fits on the test experiments; without any, on those left out in turn (on what comes later, where there
        are one or two).  Infinite where a simulation fails: what cannot be predicted is no improvement."""
        if self.test is None:
            return [self.error(predicted) for predicted in self.left_out(target, fits)]
        rows = len(self.measured.values) + np.arange(len(self.test.values))
        outputs, ok = self.models.predict([(f.x, f.member) for f in fits], rows)
        return [
            self.test.error(predicted) if converged.all() else math.inf
            for predicted, converged in zip(outputs, ok, strict=True)
        ]

    def left_out(self, target: Target, fits: Sequence[Descent]) -> list[np.ndarray | None]:
        """Of each model what it predicts of every part that is left out, (n, J), as `left_out_predictions` says."""
        if target is not self._target:
            self._target, self._predicted = target, {}
        new = list({id(fit): fit for fit in fits if id(fit) not in self._predicted}.values())
        if new:
            found = left_out_predictions(self.models, target, self.folds, new)
            self._predicted |= {id(fit): (fit, one) for fit, one in zip(new, found, strict=True)}
        return [self._predicted[id(fit)][1] for fit in fits]

    def foremost(self, target: Target, options: Sequence[Sequence[Descent]]) -> list[int]:
        """Of each of several choices between fits the one that predicts best what is left out, by `by_prediction`."""
        every = [fit for fits in options for fit in fits]
        predicted = iter(self.left_out(target, every))
        found = []
        for fits in options:
            gains = [Gain(-self.squares(next(predicted))) for _ in fits]
            found.append(by_prediction(gains, [len(fit.free) for fit in fits])[0])
        return found

    def error(self, predicted: np.ndarray | None) -> float:
        """Error of what a model predicts of the folds."""
        return math.inf if predicted is None else self.measured.error(predicted, self.folds.left_out.any(axis=0))

    def squares(self, predicted: np.ndarray | None) -> np.ndarray:
        """Squared errors of it, fold by fold, (F,)."""
        parts = self.folds.left_out[1:]
        return np.full(len(parts), np.inf) if predicted is None else self.measured.squares(predicted, parts)


def left_out_predictions(
    models: NestedModels, target: Target, folds: Folds, fits: Sequence[Descent]
) -> list[np.ndarray | None]:
    """Of each model what it predicts of every fold from the others, (n, J); None where a simulation failed.

    Arguments:
        models: of the fits.
        target: with a use of the data for each fold.
        folds: what each fold fits and leaves out.
        fits: of the models to all the data, where those to the folds start.
    """
    count = len(folds.fitted) - 1
    tasks = [Task(fit.member, fit.x, use, known=fit) for fit in fits for use in range(1, count + 1)]
    ends = models.fit(target, tasks)
    outputs, ok = models.predict([(f.x, f.member) for f in ends], np.arange(len(target.values)))
    found: list[np.ndarray | None] = []
    for number in range(len(fits)):
        predicted, is_whole = np.zeros_like(target.values), True
        for fold in range(count):
            out = folds.left_out[fold + 1]
            predicted = np.where(out, outputs[number * count + fold], predicted)
            is_whole = is_whole and bool(np.all(ok[number * count + fold][out.any(axis=1)] > 0))
        found.append(predicted if is_whole else None)
    return found
