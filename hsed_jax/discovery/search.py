"""The search for a place: every place is screened, the best ones are fitted in the simulation, and the winner is tested.

The parameters of the law have flat priors here, those of the function do not: of all functions with equal fits the smallest
is taken, so that the parameters of the law explain as much as possible.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.fit_state import FitState, Target, Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.diagnosis.score import Gain, folds_of, left_out_predictions
from hsed_jax.diagnosis.scores import Linearisation
from hsed_jax.discovery.places import Place, Reaches
from hsed_jax.discovery.screen import ByPolynomials, PlaceGain, evidence, learned, located, screened
from hsed_jax.inference.priors import Prior

# Number of fitted places of one and of two coordinates, and of fits of each, with the size and length from the fit before.
_FITTED, _ROUNDS = {1: 5, 2: 4}, 3
# Nats that a second coordinate must gain: two coordinates fit at least as well as one, and Laplace's evidence is good to a few.
_SECOND = 10.0
# No coefficient is held tighter than this.
_LEAST = 1e-6
# Half the distance between the 16 % and 84 % quantiles of a normal distribution, which is the unit of a coordinate.
_SPREAD = float(ndtri(0.84))
# Prior of the time constant of fading, over u_c/v_c.
_FADING = Prior("lognormal", [0.9, 1.0])


@dataclass(frozen=True)
class Fitted:
    """A place, its function fitted inside the simulation.

    Attributes:
        predicted_gain: its predicted gain, from the screening.
        place: where it is, with the time of fading that was fitted.
        reaches: of its coordinates, as the fit had them.
        models, fit: the fit, and the models it is one of; its last free coordinates are the coefficients.
        columns: of the coefficients of the function.
        deviations: of their priors, (m,).
        log_evidence: over all lengths and sizes.
    """

    predicted_gain: PlaceGain
    place: Place
    reaches: tuple[tuple[float, float], ...]
    models: NestedModels
    fit: FitState
    columns: np.ndarray
    deviations: np.ndarray
    log_evidence: float = -np.inf

    @property
    def log_posterior(self) -> float:
        """The evidence and the prior of the place, up to a constant."""
        return self.log_evidence - _SECOND * (len(self.place.of) - 1)

    @property
    def coefficients(self) -> np.ndarray:
        """Those of the function, (m,)."""
        return self.models.theta(self.fit.x, self.fit.submodel)[self.columns]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the coefficients, including the uncertainty of the law, (m, m)."""
        law, own = self._blocks
        covariance = np.linalg.inv(self.fit.hessian + 1e-9 * np.eye(len(law) + len(own)))[np.ix_(own, own)]
        return covariance * np.outer(self._scale, self._scale)

    @property
    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """G and b of the coefficients (`hsed_jax.discovery.screen`), the law adjusted to first order."""
        law, own = self._blocks
        hessian = self.fit.hessian.copy()
        hessian[own, own] -= _SPREAD**2
        across, inner = hessian[np.ix_(own, law)], hessian[np.ix_(law, law)] + 1e-9 * np.eye(len(law))
        strength = hessian[np.ix_(own, own)] - across @ np.linalg.solve(inner, across.T)
        strength = _without_negative(0.5 * (strength + strength.T) / np.outer(self._scale, self._scale))
        # At the optimum, the gradients of data and prior are in balance.
        return strength, strength @ self.coefficients + self.coefficients / self.deviations**2

    @property
    def _blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Where parameters of the law and coefficients stand among the free coordinates."""
        count = len(self.fit.free)
        return np.arange(count - len(self.columns)), np.arange(count - len(self.columns), count)

    @property
    def _scale(self) -> np.ndarray:
        return _SPREAD * self.deviations


class HeldOutError(NamedTuple):
    """The predictions of a model for data to which it was not fitted.

    Attributes:
        error: normalised error on the test experiments, or on those left out in turn.
        gain: reduction of the squared errors in these experiments; for a single experiment, in those left out in turn.
    """

    error: float
    gain: Gain


class PlaceSearch:
    """The search.

    Arguments:
        problem: the model with the free function as its one candidate.
        reaches: of its coordinates.
        report: called with the current activity.

    Attributes:
        models, base: the first model, and its fit.
        target: the last data and errors of the fits.
        predicted_gains: of all places, the largest first.
        fitted: the places that were fitted, the most probable first.
    """

    def __init__(self, problem: Problem, reaches: Reaches, report: Callable[[str], None] = lambda line: None):
        self._problem, self._reaches, self._report = problem, reaches, report
        self._batch = ByPolynomials(problem.models.batch, problem.names)
        self._folds = folds_of(problem.train.used, problem.train.groups)
        self.models = self._with({})
        free = self.models.submodel(problem.law)
        x = self.models.neutral if problem.start is None else problem.start
        self.target = self._judged_by(np.zeros_like(problem.train.values))
        for _ in range(2):
            self.base = self.models.fit(self.target, [Task(free, x)])[0]
            x, self.target = self.base.x, self._judged_by(self.base.predicted)
        self.base = self.models.fit(self.target, [Task(free, x)])[0]
        self.predicted_gains: list[PlaceGain] = []
        self.fitted: list[Fitted] = []

    def run(self, chosen: Sequence[Place]) -> None:
        """Screen places and fit those with the largest predicted gains."""
        self._report(f"{len(chosen)} places")
        linearisation = Linearisation(self.models, self.target, self.base)
        count = len(self._problem.train.values)
        self.predicted_gains = screened(
            linearisation, self.base.submodel, self._problem.names, chosen, self._reaches, count
        )
        best: dict[tuple, PlaceGain] = {}
        for predicted_gain in self.predicted_gains:
            best.setdefault(predicted_gain.place[:2], predicted_gain)
        # A function of two coordinates fits at least as well as one of a single coordinate, so both are compared.
        tried = [
            p for count in (1, 2) for p in [q for q in best.values() if len(q.place.of) == count][: _FITTED[count]]
        ]
        self.fitted = [self._fit(predicted_gain) for predicted_gain in tried]
        for _ in range(2):
            lead = min(self.fitted, key=lambda f: f.fit.cost)
            self._report(f"all beside {lead.place.words}")
            self.target = self._judged_by(lead.fit.predicted)
            self.fitted = [
                self._fits(f.predicted_gain, f.place, f.deviations, [f.coefficients], f.fit.x) for f in self.fitted
            ]
        self.base = self.models.fit(self.target, [Task(self.base.submodel, self.base.x)])[0]
        self.fitted.sort(key=lambda f: -f.log_posterior)

    @property
    def log_evidence(self) -> float:
        """The fit of the first model."""
        return laplace(self.base, self.models)

    def held_out_error(self, one: Fitted | None) -> HeldOutError:
        """The predictions of held-out data with a fitted place, or by the first model."""
        models, fit = (self.models, self.base) if one is None else (one.models, one.fit)
        return held_out_error(self._problem, self.target, (models, fit), (self.models, self.base))

    def _fit(self, predicted_gain: PlaceGain) -> Fitted:
        """Fit a place, starting from the coefficients of the screening and from a fifth of them."""
        self._report(predicted_gain.place.words)
        starts = [predicted_gain.coefficients, 0.2 * predicted_gain.coefficients]
        return self._fits(predicted_gain, predicted_gain.place, predicted_gain.deviations, starts, self.base.x)

    def _fits(
        self,
        predicted_gain: PlaceGain,
        place: Place,
        deviations: np.ndarray,
        starts: Sequence[np.ndarray],
        x: np.ndarray,
    ) -> Fitted:
        """Fit a place repeatedly; each fit gives the length, the size and the range of fading coordinates of the next fit."""
        found: Fitted | None = None
        fade = self._problem.names.index("learned.fade")
        for _ in range(_ROUNDS):
            columns, held = located(place, self._problem.names, self._reaches)
            # The time of fading is free like the law, before the coefficients.
            own = np.asarray([fade, *columns] if place.fades else columns)
            submodel = self.base.submodel.beside(own, held)
            deviations = np.maximum(deviations, _LEAST)
            names = [self._problem.names[k] for k in columns]
            priors = {n: Prior("normal", [0.0, float(d)]) for n, d in zip(names, deviations, strict=True)}
            models = self._with({"learned.fade": _FADING, **priors})
            tasks = []
            for start in starts:
                point = x.copy()
                point[columns] = start / (_SPREAD * deviations)
                point[fade] = models.point({"learned.fade": place.fade})[fade]
                tasks.append(Task(submodel, point))
            fit = min(models.fit(self.target, tasks), key=lambda f: f.cost)
            reaches = self._reaches.of(place)
            if place.fades:
                place = place._replace(fade=float(models.theta(fit.x, fit.submodel)[fade]))
            found = Fitted(predicted_gain, place, reaches, models, fit, columns, deviations)
            if not np.isfinite(fit.cost):
                break
            asked = learned(*found.normal_equations, place)
            over_others = asked.gain - evidence(*found.normal_equations, deviations)[0]
            found = replace(found, log_evidence=laplace(fit, models) + over_others)
            if np.allclose(asked.deviations, deviations) and not place.fades:
                break
            deviations, starts, x = asked.deviations, [found.coefficients], fit.x
        assert found is not None
        return found

    def _with(self, priors: Mapping[str, Prior]) -> NestedModels:
        """The models with these priors of coefficients, and flat ones of the law."""
        return self._problem.models.within(flat(self._problem, priors), self._batch)

    def _judged_by(self, predicted: np.ndarray) -> Target:
        return self._problem.train.standard(predicted, self._folds.fitted).target


def _without_negative(strength: np.ndarray) -> np.ndarray:
    """A matrix of information: at an unfinished fit, differences give directions of negative information, which are set
    to zero.
    """
    values, vectors = np.linalg.eigh(strength)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def flat(problem: Problem, priors: Mapping[str, Prior]) -> Box:
    """The coordinates of a problem with these priors of some parameters, and flat ones of the law."""
    law = [problem.names[k] for k in problem.law]
    box = problem.models.box
    return Box({**box.priors, **priors}, flat=law, limits=box.limits)


def held_out_error(
    problem: Problem, target: Target, now: tuple[NestedModels, FitState], before: tuple[NestedModels, FitState]
) -> HeldOutError:
    """The predictions of a model for unused data, beside those of the first model.

    These are the held-out data; without them, the data that are left out in turn, some of them outside the range of the
    function. A single held-out experiment has no standard error, and the gain is that of the data that are left out in turn.
    """
    folds = folds_of(problem.train.used, problem.train.groups)

    def left_out(models: NestedModels, fit: FitState) -> tuple[np.ndarray, float]:
        parts = folds.left_out[1:]
        (predicted,) = left_out_predictions(models, target, folds, [fit])
        if predicted is None:
            return np.full(len(parts), np.inf), np.inf
        return problem.train.squares(predicted, parts), problem.train.error(predicted, folds.left_out.any(axis=0))

    def held_out(models: NestedModels, fit: FitState) -> tuple[np.ndarray, float]:
        assert problem.test is not None
        rows = np.arange(len(problem.train.values), problem.rows)
        outputs, ok = models.predict([(fit.x, fit.submodel)], rows)
        if not ok.all():
            return np.full(len(rows), np.inf), np.inf
        each = np.eye(len(rows), dtype=bool)[..., None] & np.ones(problem.test.values.shape, dtype=bool)
        return problem.test.squares(outputs[0], each), problem.test.error(outputs[0])

    tested = 0 if problem.test is None else len(problem.test.values)
    squares, error = (left_out if tested == 0 else held_out)(*now)
    if tested == 1:
        squares, _ = left_out(*now)
    squares_before, _ = (held_out if tested > 1 else left_out)(*before)
    return HeldOutError(float(error), Gain((squares_before - squares) / len(squares)))
