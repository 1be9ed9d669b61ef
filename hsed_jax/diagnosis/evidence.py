r"""The evidence of a fit, $Z = \int e^{-\varphi(x)}\,dx$ over the box: by Laplace's method, and by importance sampling.

Laplace's method expands φ to second order at the end of the fit and integrates the Gaussian over the box.  The limits of the box
matter if an amplitude is on its bound: half of the Gaussian or more is then outside.  Importance sampling
(`hsed_jax.inference.importance`) does not need this approximation and also gives the moments of the posterior.

Source: Tierney & Kadane 1986.
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from hsed_jax.diagnosis.box import Box, quadratic_minimum
from hsed_jax.diagnosis.fit_state import FitState, Target
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.inference.importance import Proposal, weigh

_FLOOR = 1e-6
# With fewer effective draws than this, even after the weights are flattened, a sample gives no interval.
_TELLING = 8


class Sampled(NamedTuple):
    """A weighted sample of one posterior.

    Attributes:
        log_evidence: log Z.
        effective: effective number of draws.
        thetas: draws, SI, (S, P).
        weights: of the draws, summing to one, (S,).  If only a few draws have weight, the weights are flattened: an interval is
            then too wide rather than too narrow.  If even fewer have weight, draws of a Student t around the fit, clipped to
            the bounds, replace them, with equal weights.
    """

    log_evidence: float
    effective: float
    thetas: np.ndarray
    weights: np.ndarray

    def moments(self, column: int) -> dict[str, float]:
        """Mean, sd, 5 % and 95 % quantile of one parameter."""
        values = self.thetas[:, column]
        mean = float(self.weights @ values)
        order = np.argsort(values)
        below = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        q05, q95 = np.interp([0.05, 0.95], below, values[order])
        return {
            "mean": mean,
            "sd": float(np.sqrt(self.weights @ (values - mean) ** 2)),
            "q05": float(q05),
            "q95": float(q95),
        }


class _Minimum(NamedTuple):
    """The minimum of φ within the box, expanded to second order at the end of a fit.

    Attributes:
        x: the free coordinates, (p,).
        cost, gradient, hessian: of φ there.
        is_held: whether the gradient holds a coordinate at its bound, (p,).
    """

    x: np.ndarray
    cost: float
    gradient: np.ndarray
    hessian: np.ndarray
    is_held: np.ndarray


def laplace(fit: FitState, models: NestedModels) -> float:
    """log Z of a fit; −∞ if its simulation diverged.

    A coordinate that the gradient of φ holds at its bound contributes the integral of its tail; the others form a Gaussian.  A
    fit that is only evaluated with other errors counts with the minimum of the expansion.  A fit that tried steps does not: what
    the expansion promises beyond its end, it did not reach.
    """
    if not np.isfinite(fit.cost):
        return -np.inf
    low, high = models.box.low[fit.free], models.box.high[fit.free]
    x, cost, gradient, hessian, is_held = _minimum(fit, models.box)
    loose, held = np.flatnonzero(~is_held), np.flatnonzero(is_held)
    log_z = -(fit.cost if fit.steps + fit.trials else cost)
    stiffness, slopes = np.diag(hessian)[held], np.abs(gradient[held])
    if loose.size:
        covariance = np.linalg.inv(hessian[np.ix_(loose, loose)])
        deviation = np.sqrt(np.diag(covariance))
        log_z += float(_log_interval((low - x)[loose] / deviation, (high - x)[loose] / deviation).sum())
        log_z += 0.5 * float(np.linalg.slogdet(2 * np.pi * covariance)[1])
        across = hessian[np.ix_(held, loose)]
        stiffness = stiffness - np.diag(across @ covariance @ across.T)
    # ∫ exp(−g d − h d²/2) over d > 0, up to the other bound.
    stiffness = np.maximum(stiffness, _FLOOR)
    deviation, width = 1 / np.sqrt(stiffness), (high - low)[held]
    tail = _log_interval(slopes * deviation, slopes * deviation + width / deviation)
    log_z += float(np.sum(0.5 * (slopes * deviation) ** 2 + 0.5 * np.log(2 * np.pi * deviation**2) + tail))
    return log_z


def sample_posterior(fit: FitState, models: NestedModels, target: Target, draws: int, seed: int) -> Sampled:
    """log Z and a weighted sample of the posterior of a fit.

    Arguments:
        fit: the fit state.
        models: of the fit.
        target: the data of the fit.
        draws: least number of draws, to which 40 are added per free parameter.
        seed: of the random numbers.
    """
    low, high = models.box.low[fit.free], models.box.high[fit.free]
    center, covariance = gaussian(fit, models.box)
    # The proposal of a coordinate without information has at most half the width of the box as its standard deviation.
    width = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (high - low), 10.0)
    shrink = np.minimum(1.0, width / np.sqrt(np.diag(covariance)))
    proposal = Proposal(np.clip(center, low, high), shrink[:, None] * np.linalg.cholesky(covariance))

    def log_density(points: np.ndarray) -> np.ndarray:
        inside = np.all((points >= low) & (points <= high), axis=1)
        log_densities = np.full(len(points), -np.inf)
        if inside.any():
            log_densities[inside] = -_costs(fit, models, target, points[inside])
        return log_densities

    found = weigh(log_density, proposal, draws + 40 * len(fit.free), np.random.default_rng(seed))
    weights, points = found.flattened().weights, found.points
    if not 1 / np.sum(weights**2) > _TELLING or not np.isfinite(found.log_evidence):
        # With many active bounds hardly any draw is within all of them.  Clipped draws of the first proposal replace the draws.
        points = np.clip(proposal.draw(np.random.default_rng(seed), draws), low, high)
        weights = np.full(draws, 1 / draws)
    thetas = np.stack([models.theta(_at(fit, point), fit.submodel) for point in points])
    return Sampled(found.log_evidence, found.worth, thetas, weights)


def gaussian(fit: FitState, box: Box) -> tuple[np.ndarray, np.ndarray]:
    """Centre and covariance of exp(−φ) within the box, expanded to second order.

    A coordinate that the gradient g of φ holds at its bound has an exponential tail, whose mean square about the bound is 2/g².
    """
    found = _minimum(fit, box)
    covariance = np.linalg.inv(found.hessian + np.diag(np.where(found.is_held, 0.5 * found.gradient**2, 0.0)))
    return found.x, 0.5 * (covariance + covariance.T)


def _minimum(fit: FitState, box: Box) -> _Minimum:
    low, high, start = box.low[fit.free], box.high[fit.free], fit.x[fit.free]
    hessian = fit.hessian + _FLOOR * np.eye(len(start))
    step, is_held = quadratic_minimum(fit.gradient, hessian, low - start, high - start)
    x = np.clip(start + step, low, high)
    cost = fit.cost + float(fit.gradient @ step + 0.5 * step @ hessian @ step)
    return _Minimum(x, cost, fit.gradient + hessian @ step, hessian, is_held)


def _costs(fit: FitState, models: NestedModels, target: Target, points: np.ndarray) -> np.ndarray:
    """φ at several points of the free coordinates."""
    full = [_at(fit, point) for point in points]
    prior = models.box.log_density(np.stack(full), fit.free).sum(axis=1)
    outputs, ok = models.predict([(x, fit.submodel) for x in full], target.rows(fit.use))
    costs = target.misfit(fit.use, outputs) - prior
    return np.where(ok.all(axis=1) & np.isfinite(costs), costs, np.inf)


def _at(fit: FitState, point: np.ndarray) -> np.ndarray:
    x = fit.x.copy()
    x[fit.free] = point
    return x


def _log_interval(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """log(Φ(high) − Φ(low)), accurate also far in a tail."""
    # By symmetry, the interval is moved to the lower tail, where the logarithm of Φ is accurate.
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    upper, lower = log_ndtr(b), log_ndtr(a)
    return upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-16)))
