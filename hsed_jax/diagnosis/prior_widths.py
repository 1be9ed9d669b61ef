r"""The influence of the priors on a verdict: the same models with priors of the effects 3 times narrower and 10 times wider.

The prior of an amplitude is stretched about its neutral value, and that of another parameter about its median, on the linear or
logarithmic scale of the coordinate (`hsed_jax.diagnosis.box`).  No simulation is needed: each misfit is expanded to second order,

$$\varphi_s(x) = c + g^\top(x-\hat x) + \tfrac12 (x-\hat x)^\top H (x-\hat x) - \sum_k \log p_s(x_k),$$

and the stretched densities $p_s$ are exact.  The minimum of φ_s gives the evidence by Laplace's method.  The same expansion for
the data of each fold gives the change of the fit to this fold, and the derivatives give the change of its predictions.

Another explanation leads at a width if it meets the conditions of a verdict: its odds against the named explanation (by the
score, or by the evidence where that is the measure) are at least those that an effect needs, and its evidence with its prior is
not less.  Then the verdict is ambiguous.  A verdict that changes without such a leader is a caution: an effect may lose its
support although no other explanation is better.

A uniform prior gives limits and no scale, so it keeps its width.  A wider prior does not extend the bounds, because no
simulation is beyond them.  If a fit is on a bound, the evidence with a wider prior is therefore a lower limit.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.diagnosis.box import Box, Terms, quadratic_minimum
from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.findings import PriorWidth
from hsed_jax.diagnosis.fit_state import FitState
from hsed_jax.diagnosis.fits import Model
from hsed_jax.diagnosis.rivals import rivals_of
from hsed_jax.diagnosis.score import ODDS, weights_of
from hsed_jax.diagnosis.search import Search

WIDTHS = (1 / 3, 10.0)
"""Factors on the width of the priors."""

# Newton steps to the minimum of φ_s: largest number, largest step in coordinates of order one, and step at which they end.
_STEPS, _LONGEST, _SETTLED = 30, 3.0, 1e-7
# Curvature of a coordinate without information from data or prior.
_FLAT = 1e-6
# Without a named effect: number of reported candidates, the ones with the largest evidence.
_TOLD = 1


class Stretched(Box):
    """The box of a search, with stretched priors of some coordinates.

    Arguments:
        box: of the search.
        columns: indices of the stretched coordinates.
        about: the fixed point of the stretching, for all coordinates, (P,).
        width: factor on the width of the priors.
    """

    def __init__(self, box: Box, columns: Int[np.ndarray, " q"], about: Float[np.ndarray, " P"], width: float):
        super().__init__(box.priors, limits=box.limits)
        self._about = about
        self._width = np.ones(len(self.names))
        self._width[columns] = width
        bounds = [prior.bounds for prior in self.priors.values()]
        least, most = ([side[i] for side in bounds] for i in (0, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            low = self.x(np.asarray([-np.inf if v is None else v for v in least]))
            high = self.x(np.asarray([np.inf if v is None else v for v in most]))
        narrowed = self._width < 1
        self.low = np.where(narrowed, np.fmax(self.low, about + (low - about) * self._width), self.low)
        self.high = np.where(narrowed, np.fmin(self.high, about + (high - about) * self._width), self.high)

    def log_density(self, x: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """As in `Box`, for the stretched priors."""
        return super().log_density(self._before(x), columns) - np.log(self._width[columns])

    def terms(self, x: np.ndarray, columns: np.ndarray) -> Terms:
        """As in `Box`, for the stretched priors."""
        value, slope, curvature = super().terms(self._before(x), columns)
        width = self._width[columns]
        return Terms(value - np.log(width), slope / width, curvature / width**2)

    def _before(self, x: np.ndarray) -> np.ndarray:
        return self._about + (x - self._about) / self._width


class _Misfit(NamedTuple):
    """Second-order expansion of a misfit about a fit, in its free coordinates."""

    cost: float
    gradient: Float[np.ndarray, " p"]
    hessian: Float[np.ndarray, "p p"]


def prior_widths(
    search: Search,
    models: Sequence[Model],
    best: Model,
    verdict: str,
    otherwise: str,
    does_the_same: Callable[[Model], bool] = lambda model: False,
) -> list[PriorWidth]:
    """The verdict with narrower and wider priors of the named effects; without a named effect, of all candidates.

    Arguments:
        search: the search, which has ended.
        models: its fitted models, the most probable first.
        best: the named model.
        verdict: of the diagnosis.
        otherwise: the verdict if no effect is supported.
        does_the_same: whether a model differs from the best one only in its formulas; such a model is no rival.
    """
    stretching = _Stretching(search, models, best)
    before = stretching.at(1.0)
    return [_told(search, best, verdict, otherwise, before, stretching.at(w), does_the_same) for w in WIDTHS]


class _State(NamedTuple):
    """The probabilities of the models at one width.

    Attributes:
        width: factor on the width of the priors.
        models: the models with their probabilities and log posteriors at this width.
        gains: log evidence gain of each reported effect.
        odds: of the model with each of these effects against the model without it, by the score.
        log_priors: log prior odds of the same two models.
    """

    width: float
    models: list[Model]
    gains: Mapping[str, float]
    odds: Mapping[str, float]
    log_priors: Mapping[str, float]


class _Stretching:
    """The models with a relevant weight, with priors of another width."""

    def __init__(self, search: Search, models: Sequence[Model], best: Model):
        self._search, self._best = search, best
        fitted = {m.effects: m for m in models} | {best.effects: best}
        # By reported effect: the model with it and the model without it.
        self._pairs: dict[str, tuple[Model, Model]] = {}
        if best.effects:
            for effect in sorted(best.effects):
                less = best.effects - {effect}
                self._pairs[effect] = best, fitted.get(less) or search.model(less)
        else:
            singles = [m for m in models if len(m.effects) == 1]
            for model in sorted(singles, key=lambda m: -m.log_posterior)[:_TOLD]:
                self._pairs[next(iter(model.effects))] = model, best
        scored = [m for m in models if m.probability > 0]
        own = [m for pair in self._pairs.values() for m in pair]
        self._models = list({m.effects: m for m in (best, *own, *scored)}.values())
        self._count = len(scored)
        named = best.effects or frozenset(search.effects)
        forms = [form for effect in named for form in search.effects[effect].values()]
        priors, columns = list(search.models.box.priors.values()), np.concatenate([form.columns for form in forms])
        self._columns = np.asarray([k for k in np.unique(columns) if priors[int(k)].name != "uniform"], dtype=int)
        neutral, self._about = search.models.neutral, np.zeros(len(search.models.neutral))
        amplitudes = np.unique([int(form.columns[0]) for form in forms])
        self._about[amplitudes] = np.where(np.isfinite(neutral[amplitudes]), neutral[amplitudes], 0.0)
        self._priors = np.asarray([m.log_posterior - m.log_evidence for m in self._models])
        self._plain = self._evidence(self._box(1.0))
        self._plain_weights = self._weights(self._densities(1.0, np.zeros(len(self._models))))

    def at(self, width: float) -> _State:
        """The probabilities of the models with priors of this width."""
        evidence = self._evidence(self._box(width)) - self._plain
        densities = self._densities(width, evidence)
        weights = self._weights(densities)
        # Only the change by the width is computed here; it is applied to the probabilities over all forms.
        shares = np.asarray([m.probability for m in self._models])
        shares = shares * weights / np.maximum(self._plain_weights, 1e-300)
        shares = shares / shares.sum() if shares.sum() > 0 else shares
        models = [
            m._replace(probability=float(p), log_posterior=float(m.log_posterior + change))
            for m, p, change in zip(self._models, shares, evidence, strict=True)
        ]
        place = {m.effects: k for k, m in enumerate(self._models)}
        gains, odds, log_priors = {}, {}, {}
        for effect, (larger, smaller) in self._pairs.items():
            one, other = place[larger.effects], place[smaller.effects]
            change = float(evidence[one] - evidence[other])
            gains[effect] = larger.log_evidence - smaller.log_evidence + change
            both = weights_of(densities[[one, other]], self._priors[[one, other]])
            odds[effect] = float(both[0] / max(both[1], 1e-300))
            log_priors[effect] = float(self._priors[one] - self._priors[other])
        return _State(width, models, gains, odds, log_priors)

    def _box(self, width: float) -> Stretched:
        return Stretched(self._search.models.box, self._columns, self._about, width)

    def _evidence(self, box: Stretched) -> Float[np.ndarray, " M"]:
        """log Z of the models, each with its selected forms."""
        models = self._search.models.within(box)
        found: list[float] = []
        for fit in (m.fit for m in self._models):
            if not np.isfinite(fit.cost):
                found.append(0.0)  # the width changes nothing for a model that cannot be simulated
                continue
            misfit = _of_all(fit, self._search.models.box)
            x = _least(misfit, fit, box)
            terms, step = box.terms(x, fit.free), (x - fit.x)[fit.free]
            cost = misfit.cost + float(misfit.gradient @ step + 0.5 * step @ misfit.hessian @ step)
            gradient = misfit.gradient + misfit.hessian @ step - terms.slope
            hessian = misfit.hessian + np.diag(terms.curvature)
            moved = replace(fit, x=x, cost=cost - float(terms.value.sum()), gradient=gradient, hessian=hessian)
            found.append(laplace(moved, models))
        return np.asarray(found)

    def _weights(self, densities: Float[np.ndarray, "M P"]) -> Float[np.ndarray, " M"]:
        return weights_of(densities, self._priors)

    def _densities(self, width: float, change: Float[np.ndarray, " M"]) -> Float[np.ndarray, "M P"]:
        """Log densities of the held-out data, by model and piece; log evidence, changed by the width, if that is the measure."""
        search = self._search
        if search.by_evidence:
            return (np.asarray([m.log_evidence for m in self._models]) + change)[:, None]
        fits, box, plain = [m.fit for m in self._models], self._box(width), self._box(1.0)
        moved = None if width == 1.0 else [moved_by(search, fit, plain, box) for fit in fits]
        return search.held_out.densities(search.standard.target, fits, moved)


def _told(
    search: Search,
    best: Model,
    verdict: str,
    otherwise: str,
    before: _State,
    after: _State,
    does_the_same: Callable[[Model], bool],
) -> PriorWidth:
    """The verdict with priors of another width: it changes only if the width changes whether a condition is met."""

    def supports(state: _State, effect: str) -> tuple[bool, bool]:
        return state.odds[effect] >= ODDS, state.gains[effect] + state.log_priors[effect] >= 0

    found, effects = verdict, sorted(best.effects)
    if best.effects:
        lost = {
            e for e in effects if any(a and not b for a, b in zip(supports(before, e), supports(after, e), strict=True))
        }
        if lost:
            effects = [e for e in effects if e not in lost]
            found = verdict if effects else otherwise
        elif verdict == "missing_effects":
            known = {m.effects for m in rivals_of(before.models, best)}
            own = next(m for m in after.models if m.effects == best.effects)
            new = [m for m in rivals_of(after.models, own) if m.effects not in known and not does_the_same(m)]
            found = "ambiguous" if new else verdict
    elif verdict in ("unexplained", "undecided"):
        effects = [e for e in after.odds if all(supports(after, e)) and not all(supports(before, e))]
        found = "missing_effects" if effects else verdict
    is_same = found == verdict and effects == sorted(best.effects)
    leader = None if is_same or verdict != "missing_effects" else _leader(best, before, after, does_the_same)
    return PriorWidth(after.width, found, tuple(effects), dict(after.gains), dict(before.gains), is_same, leader)


def _leader(
    best: Model, before: _State, after: _State, does_the_same: Callable[[Model], bool]
) -> tuple[str, ...] | None:
    """Effects of the explanation that leads with the other priors and not with the original ones; None without one."""

    def leading(state: _State) -> dict[frozenset[str], float]:
        own = next(m for m in state.models if m.effects == best.effects)
        return {
            m.effects: m.probability / max(own.probability, 1e-300)
            for m in state.models
            if len(m.effects) <= len(best.effects)
            # A submodel of the named model is no other explanation: such a change is only a caution.
            and not m.effects <= best.effects
            and m.probability > 0
            and m.probability >= ODDS * own.probability
            and m.log_posterior >= own.log_posterior
            and not does_the_same(m)
        }

    known = leading(before)
    new = {effects: odds for effects, odds in leading(after).items() if effects not in known}
    return tuple(sorted(max(new, key=lambda effects: new[effects]))) if new else None


def _of_all(fit: FitState, box: Box) -> _Misfit:
    """The misfit of all data, expanded about the fit."""
    terms = box.terms(fit.x, fit.free)
    hessian = fit.hessian - np.diag(terms.curvature)
    return _Misfit(fit.cost + float(terms.value.sum()), fit.gradient + terms.slope, hessian)


def _of_fold(search: Search, fit: FitState, use: int) -> _Misfit:
    """The misfit of the data of a fold, expanded about the fit to all data."""
    target = search.standard.target
    rows = target.rows(use)
    jacobian = target.standardised(use, rows, fit.slopes[:, rows]).reshape(len(fit.free), -1)
    residual = target.standardised(use, rows, (fit.predicted - target.values)[rows]).ravel()
    return _Misfit(0.5 * float(residual @ residual), jacobian @ residual, jacobian @ jacobian.T)


def _least(misfit: _Misfit, fit: FitState, box: Box) -> Float[np.ndarray, " P"]:
    """The minimum of φ_s within the bounds."""
    free = fit.free
    low, high, x = box.low[free], box.high[free], fit.x.copy()
    x[free] = np.clip(x[free], low, high)
    for _ in range(_STEPS if len(free) else 0):
        terms = box.terms(x, free)
        gradient = misfit.gradient + misfit.hessian @ (x - fit.x)[free] - terms.slope
        hessian = misfit.hessian + np.diag(terms.curvature + _FLAT)
        bounds = np.clip(low - x[free], -_LONGEST, 0.0), np.clip(high - x[free], 0.0, _LONGEST)
        step, _ = quadratic_minimum(gradient, hessian, *bounds)
        x[free] = np.clip(x[free] + step, low, high)
        if np.max(np.abs(step)) < _SETTLED:
            break
    return x


def moved_by(search: Search, fit: FitState, plain: Box, box: Box) -> np.ndarray | None:
    """The change of the held-out predictions of all folds due to the width of the priors, (n, J).

    None if the derivatives are too many to be stored: with so many samples, the priors have hardly any influence.
    """
    if not fit.slopes.size or not np.isfinite(fit.cost):
        return None
    folds, change = search.held_out.folds, np.zeros(search.standard.target.values.shape)
    for use in range(1, len(folds.fitted)):
        misfit = _of_fold(search, fit, use)
        step = (_least(misfit, fit, box) - _least(misfit, fit, plain))[fit.free]
        change = np.where(folds.left_out[use], np.tensordot(step, fit.slopes, 1), change)
    return change
