r"""The evidence of a fit, $Z = \int e^{-\varphi(x)}\,dx$ over the box: by Laplace's method, and by importance sampling.

Laplace's method expands φ to second order at the end of the fit and integrates the Gaussian over the box, which matters where an
amplitude rests on its bound: half of the Gaussian, or its tail, lies beyond.  Importance sampling (Student's t around the
Gaussian, improved once by its own draws) has no such assumption and gives the posterior's moments as well.

Source: Tierney & Kadane 1986; Geweke 1989; Cappé, Guillin, Marin & Robert 2004 (population Monte Carlo).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.special import log_ndtr, logsumexp
from scipy.stats import multivariate_t

from hsed_jax.inference.nested import Descent, NestedModels, Target

_FLOOR = 1e-6
_DEGREES = 5


class Sampled(NamedTuple):
    """A weighted sample of one posterior.

    Attributes:
        log_evidence: log Z.
        effective: effective number of draws.
        thetas: draws, SI, (S, P).
        weights: of the draws, summing to one, (S,).
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


def laplace(fit: Descent, models: NestedModels) -> float:
    """log Z of a fit; −∞ where its simulation diverged."""
    if not np.isfinite(fit.cost):
        return -np.inf
    center, covariance = _gaussian(fit)
    low, high = models.box.low[fit.free], models.box.high[fit.free]
    deviation = np.sqrt(np.diag(covariance))
    inside = _log_interval((low - center) / deviation, (high - center) / deviation)
    gain = 0.5 * float(fit.gradient @ covariance @ fit.gradient)
    log_volume = 0.5 * float(np.linalg.slogdet(2 * np.pi * covariance)[1])
    return -fit.cost + gain + log_volume + float(inside.sum())


def importance(fit: Descent, models: NestedModels, target: Target, draws: int, seed: int) -> Sampled:
    """log Z and a weighted sample of a fit's posterior.

    Arguments:
        fit: where it is.
        models: of the fit.
        target: what was fitted.
        draws: number of draws in each of the two rounds.
        seed: of the random numbers.
    """
    random = np.random.default_rng(seed)
    center, covariance = _gaussian(fit)
    low, high = models.box.low[fit.free], models.box.high[fit.free]
    # A coordinate nobody holds is spread over its box, and no further.
    finite = np.isfinite(low) & np.isfinite(high)
    width = np.where(finite, 0.5 * (np.where(finite, high, 1.0) - np.where(finite, low, 0.0)), 10.0)
    shrink = np.minimum(1.0, width / np.sqrt(np.diag(covariance)))
    covariance = covariance * np.outer(shrink, shrink)
    center = np.clip(center, low, high)
    points, log_weight = np.zeros((0, len(fit.free))), np.zeros(0)
    for round_number in range(2):
        proposal = multivariate_t(center, covariance, df=_DEGREES, allow_singular=True)
        drawn: Any = proposal.rvs(draws * (1 + round_number), random_state=random)
        points = np.reshape(drawn, (-1, len(fit.free)))
        inside = np.all((points >= low) & (points <= high), axis=1)
        log_weight = np.full(len(points), -np.inf)
        if inside.any():
            log_weight[inside] = -_costs(fit, models, target, points[inside]) - np.atleast_1d(
                proposal.logpdf(points[inside])
            )
        share = np.exp(log_weight - logsumexp(log_weight)) if np.isfinite(log_weight).any() else None
        if share is None:
            break
        if round_number == 0 and 1 / np.sum(share**2) > 3 * len(fit.free):
            center = share @ points
            spread = np.sqrt(share)[:, None] * (points - center)
            covariance = 1.2 * (spread.T @ spread) + 1e-12 * np.eye(len(center))
    total = float(np.asarray(logsumexp(log_weight)))
    if not np.isfinite(total):
        return Sampled(-np.inf, 0.0, models.theta(fit.x, fit.free)[None], np.ones(1))
    weights = np.exp(log_weight - total)
    thetas = np.stack([models.theta(_at(fit, point), fit.free) for point in points])
    return Sampled(total - float(np.log(len(points))), float(1 / np.sum(weights**2)), thetas, weights)


def _gaussian(fit: Descent) -> tuple[np.ndarray, np.ndarray]:
    """Centre and covariance of exp(−φ) to second order."""
    covariance = np.linalg.inv(fit.hessian + _FLOOR * np.eye(len(fit.free)))
    covariance = 0.5 * (covariance + covariance.T)
    return fit.x[fit.free] - covariance @ fit.gradient, covariance


def _costs(fit: Descent, models: NestedModels, target: Target, points: np.ndarray) -> np.ndarray:
    """φ at several points of the free coordinates."""
    rows = np.flatnonzero(target.weights[fit.use].any(axis=1))
    full = [_at(fit, point) for point in points]
    weights = target.weights[fit.use][rows]
    prior = models.box.log_density(np.stack(full), fit.free).sum(axis=1)
    outputs, ok = models.predict([(x, fit.free) for x in full], rows)
    misfit = 0.5 * np.sum(weights * ((outputs - target.values[rows]) / target.sigma[rows]) ** 2, axis=(1, 2))
    costs = misfit - prior
    return np.where(ok.all(axis=1) & np.isfinite(costs), costs, np.inf)


def _at(fit: Descent, point: np.ndarray) -> np.ndarray:
    x = fit.x.copy()
    x[fit.free] = point
    return x


def _log_interval(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """log(Φ(high) − Φ(low)), also far in a tail."""
    # By symmetry the interval is put into the lower tail, where the logarithm of Φ is accurate.
    flip = low > 0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    upper, lower = log_ndtr(b), log_ndtr(a)
    return upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-16)))
