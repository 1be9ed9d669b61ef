r"""Predicted gains of candidates before they are fitted, from a linearisation of a fitted model.

Let r be the residual, and M the projection onto what remains after the fitted parameters have adjusted to first order.  A
candidate that differs from the fit by d explains

$$\max_s\; s\,d^\top M r - \tfrac12 s^2\,d^\top M d$$

nats of the residual.  The factor s gives the size from which a fit starts.  At a finite size, d is the simulated influence of the
effect, which may be nonlinear or without a derivative at its neutral value (a gap, a window, an exponential), and s is at most
one.  At a vanishing size, d is a derivative, and s extends over the prior of the amplitude.  If the noise explains the residual,
every effect is small, and both sizes are tried: where the fitted parameters adjust to most of a finite effect, their first order
is not enough, and the derivative shows the rest.

The maximum at a vanishing size is half of the statistic of Rao's score test (1948).  A test of the size of the residual detects
any error, and spreads its power over all samples.  A score test examines one direction only, and detects an effect there that is
a hundred times smaller.  With K candidates, the smallest of K p-values counts as $1-(1-p)^K$ (Šidák 1967).
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc

from hsed_jax.diagnosis.fit_state import FitState, Submodel, Target
from hsed_jax.diagnosis.fits import spread
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Forms, of_fewest_parameters

# Step of a finite difference, in coordinates of order one.
_STEP = 1e-3
# A fit starts at no less than this share of a size that was tried.
_LEAST = 0.05
# Number of trials of a form per parameter, and for one more: a smaller number may not find the time of a step in a record.
_TRIALS = 4
# The experiments with this share of the squared residual of a fit, and with this number of values, select the candidates to fit.
_HALF, _VALUES = 0.5, 30


class Trial(NamedTuple):
    """A fitted model with a candidate added.

    Attributes:
        submodel: the model with the candidate.
        x: the fit, with the candidate at some size, (P,).
        amplitude: index of the coordinate of this size.
        factors: the least and the largest multiple of this size to which the linearisation extends.
    """

    submodel: Submodel
    x: Float[np.ndarray, " P"]
    amplitude: int
    factors: tuple[float, float] = (0.0, 1.0)


class PredictedGain(NamedTuple):
    """The gain that the linearisation predicts for a trial.

    Attributes:
        gain: nats, with the fitted parameters adjusted to first order.
        start: the start of a fit, (P,).
    """

    gain: float
    start: Float[np.ndarray, " P"]


class Linearisation:
    """A fitted model to first order: its residual, and the part of a change that its own parameters cannot explain.

    Arguments:
        models: of the fit.
        target: the data of the fit.
        fit: the fit state of the model.
        rows: indices of the experiments; by default all.
    """

    def __init__(self, models: NestedModels, target: Target, fit: FitState, rows: Int[np.ndarray, " r"] | None = None):
        self._models, self._target, self._fit = models, target, fit
        self._rows = np.arange(len(target.values)) if rows is None else rows
        self._x = models.neutral.copy()
        self._x[fit.free] = fit.x[fit.free]
        moved = [self._moved(self._x, int(k)) for k in fit.free]
        outputs, ok = models.predict([(self._x, fit.submodel), *((x, fit.submodel) for x, _ in moved)], self._rows)
        self._outputs = outputs[0]
        self._residual = self._standardised(target.values[self._rows] - outputs[0]).ravel()
        slopes = self._standardised((outputs[1:] - outputs[0]) * ok[1:, :, None]).reshape(len(moved), -1)
        self._basis, _ = np.linalg.qr((slopes / np.asarray([step for _, step in moved])[:, None]).T)

    def score_tests[T](self, amplitudes: Mapping[T, tuple[int, Mapping[int, float]]]) -> dict[T, float]:
        r"""Rao's score statistic of amplitudes at their neutral values, distributed as $\chi^2_1$ if an effect is absent.

        Arguments:
            amplitudes: the index of each amplitude, and the values of other parameters that are held beside it.
        """
        places = [self._moved(self._x, k) for k, _ in amplitudes.values()]
        submodels = [self._fit.submodel.beside(np.asarray([k]), held) for k, held in amplitudes.values()]
        differences, own = self.across([(x, m) for (x, _), m in zip(places, submodels, strict=True)])
        found: dict[T, float] = {}
        for effect, slope, free in zip(amplitudes, differences, own, strict=True):
            power = float(free @ free)
            is_told = power > 1e-12 * float(slope @ slope) and power > 0
            found[effect] = float(free @ self._residual) ** 2 / power if is_told else 0.0
        return found

    def predicted_gains(self, trials: Sequence[Trial]) -> list[PredictedGain]:
        """The predicted gain of each trial."""
        _, own = self.across([(trial.x, trial.submodel) for trial in trials])
        found: list[PredictedGain] = []
        for trial, free in zip(trials, own, strict=True):
            along, power = float(free @ self._residual), float(free @ free)
            size = float(np.clip(along / power, *trial.factors)) if power > 0 else 0.0
            k, first = trial.amplitude, size if abs(size) > _LEAST else _LEAST
            start = trial.x.copy()
            start[k] = self._models.neutral[k] + first * (trial.x[k] - self._models.neutral[k])
            found.append(PredictedGain(size * along - 0.5 * size**2 * power, start))
        return found

    def of_places(self, effects: Mapping[str, Forms], are_small: bool) -> dict[str, dict[str, list[PredictedGain]]]:
        """Predicted gains by effect and form, for the forms with the fewest parameters, at several sizes, the largest first.

        Arguments:
            effects: the candidates.
            are_small: whether the effects may be small, so that a vanishing size is tried as well.
        """
        trials: list[tuple[str, str, Trial]] = []
        for effect, forms in effects.items():
            for label in of_fewest_parameters(forms):
                form = forms[label]
                submodel, size = self._fit.submodel.beside(form.columns, form.held), int(form.columns[0])
                for x in self._models.box.quantiles(form.columns, spread(len(form.columns), _TRIALS)):
                    start = self._fit.x.copy()
                    start[form.columns] = x
                    trials.append((effect, label, Trial(submodel, start, size)))
                trials += [(effect, label, self._small(submodel, form.columns))] if are_small else []
        found: dict[str, dict[str, list[PredictedGain]]] = {}
        for (effect, label, _), gain in zip(trials, self.predicted_gains([t for *_, t in trials]), strict=True):
            found.setdefault(effect, {}).setdefault(label, []).append(gain)
        return {e: {f: sorted(ps, key=lambda p: -p.gain) for f, ps in forms.items()} for e, forms in found.items()}

    def _small(self, submodel: Submodel, columns: Int[np.ndarray, " q"]) -> Trial:
        """A form at a vanishing size, with its other parameters at their medians; its size extends over most of its prior."""
        start, size = self._fit.x.copy(), int(columns[0])
        start[columns] = self._models.box.quantiles(columns, np.full((1, len(columns)), 0.5))[0]
        start[size] = neutral = self._models.neutral[size]
        start, step = self._moved(start, size)
        ends = (self._models.box.quantiles(columns[:1], np.asarray([[0.1], [0.9]])).ravel() - neutral) / step
        return Trial(submodel, start, size, (min(*ends, 0.0), max(*ends, 0.0)))

    def across(self, points: Sequence[tuple[np.ndarray, Submodel]]) -> tuple[np.ndarray, np.ndarray]:
        """Standardised differences of models at points from the fit (zero if a simulation diverges), and the part of them that
        the parameters of the fit cannot explain, (B, N) each."""
        if not points:
            return np.zeros((0, self._residual.size)), np.zeros((0, self._residual.size))
        outputs, ok = self._models.predict(points, self._rows)
        is_whole = ok.all(axis=1)[:, None, None]
        differences = self._standardised(np.where(is_whole, outputs - self._outputs, 0.0)).reshape(len(points), -1)
        return differences, self.own(differences)

    def own(self, differences: Float[np.ndarray, "B N"]) -> Float[np.ndarray, "B N"]:
        """The part of standardised differences that the parameters of the fit cannot explain."""
        return differences - (differences @ self._basis) @ self._basis.T

    @property
    def residual(self) -> Float[np.ndarray, " N"]:
        """The residual of the fit, standardised."""
        return self._residual

    @property
    def origin(self) -> Float[np.ndarray, " P"]:
        """The point of the fit, with all other parameters neutral."""
        return self._x.copy()

    def _moved(self, x: np.ndarray, k: int) -> tuple[np.ndarray, float]:
        """A point one step further in one coordinate, and the step, which is negative if it would cross the upper bound."""
        step = -_STEP if x[k] + _STEP > self._models.box.high[k] else _STEP
        moved = x.copy()
        moved[k] += step
        return moved, step

    def _standardised(self, difference: np.ndarray) -> np.ndarray:
        return self._target.standardised(self._fit.use, self._rows, difference)


def telling(target: Target, fit: FitState) -> Int[np.ndarray, " r"]:
    """The experiments with the largest residuals of a fit: the smallest number with half of the squared residual and enough
    values to tell many candidates apart."""
    rows = target.rows(fit.use)
    left = np.sum(target.standardised(fit.use, rows, (fit.predicted - target.values)[rows]) ** 2, axis=-1)
    order = np.argsort(-left)
    values = np.count_nonzero(target.weights[fit.use][rows[order]], axis=-1)
    enough = max(
        np.searchsorted(np.cumsum(left[order]), _HALF * left.sum()), np.searchsorted(np.cumsum(values), _VALUES)
    )
    return np.sort(rows[order[: int(enough) + 1]])


def score_p_value(statistic: float, candidates: int = 1) -> float:
    """Probability of a score statistic at least this large, as the largest of several candidates, if all effects are absent."""
    one = float(chdtrc(1, statistic))
    return 1.0 if one >= 1 else float(-np.expm1(candidates * np.log1p(-one)))
