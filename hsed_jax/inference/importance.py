r"""Importance sampling: draws of a Student t, weighted to be exact for a density that is known up to a constant.

A posterior is nearly Gaussian around its mode.  So with a proposal of heavier tails nearly every simulation is an independent
draw, where a chain needs dozens of simulations for one.  The mean of the weights is the evidence $Z = \int p(x)\,dx$.  The
draws come in rounds, and the proposal $t_r$ of each round learns its centre and its spread from all earlier draws.  All draws
are used, weighted by the mixture of the proposals,

$$w_s = \frac{p(x_s)}{\sum_r n_r\,t_r(x_s) / \sum_r n_r},$$

so a proposal may miss a part that another one covers.  Three checks show whether the draws are sufficient: the Pareto shape
of the weights (below 0.7), the effective number of draws, and a search outside the sampled region, about which weights have
no information.  The search makes Metropolis steps from the draws, some of them long, and counts accepted steps that end where
the proposals have hardly any density.

Source: Geweke 1989; Cornuet, Marin, Mira & Robert 2012 (adaptive multiple importance sampling); Vehtari, Simpson, Gelman, Yao &
Gabry 2024 (Pareto smoothed importance sampling).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, logsumexp

from hsed_jax.physics.batch import TILE

_DEGREES = 5.0
# Draws of a round: small rounds adapt fast, and a block has the same number of simulations.  The other number is the
# largest total, relative to the requested draws.
_EACH, _MOST = 4 * TILE, 2
# The learning ends when the effective number of draws is this share of their number.
_GOOD = 0.5
# Beyond this Pareto shape the mean of the weights is not reliable; below this effective share, a chain is better.
_SHAPE, _WORTHY = 0.7, 0.1
# Above this effective share the weights are so similar that they have no tail.
_ALIKE = 0.95
# The tail of fewer weights than this has no shape.
TELLING = 25
# Number of steps of the search; their length is a Student t of few degrees of freedom, in standard deviations.
_LOOKS, _LENGTH, _OF_LENGTH = 400, 2.0, 3.0
# A part is missed if the draws have less than so much of the density there [nats]; this share of the steps may end there.
_LESS, _MAY_MISS = 2.0, 0.01

Points = Float[np.ndarray, "S p"]
Values = Float[np.ndarray, " S"]


class Proposal(NamedTuple):
    """A Student t of five degrees of freedom.

    Attributes:
        center: its mode, (p,).
        frame: L with x = center + L w, w standard, (p, p).
    """

    center: Float[np.ndarray, " p"]
    frame: Float[np.ndarray, "p p"]

    def draw(self, random: np.random.Generator, draws: int) -> Points:
        """Points of it."""
        size = self.center.size
        w = random.standard_normal((draws, size)) * np.sqrt(_DEGREES / random.chisquare(_DEGREES, (draws, 1)))
        return self.center + w @ self.frame.T

    def log_density(self, points: Points) -> Values:
        """Its log density at points."""
        size, w = self.center.size, np.linalg.solve(self.frame, (points - self.center).T)
        normalisation = (
            gammaln(0.5 * (_DEGREES + size)) - gammaln(0.5 * _DEGREES) - 0.5 * size * np.log(_DEGREES * np.pi)
        )
        normalisation -= np.linalg.slogdet(self.frame)[1]
        return normalisation - 0.5 * (_DEGREES + size) * np.log1p(np.sum(w**2, axis=0) / _DEGREES)

    def learnt(self, points: Points, log_weight: Values) -> "Proposal":
        """The proposal that fits the draws, their weights flattened until enough of them count."""
        size = self.center.size
        share = flattened(log_weight, size)
        middle = share @ points
        apart = np.linalg.solve(self.frame, (np.sqrt(share)[:, None] * (points - middle)).T)
        factor = np.linalg.cholesky(apart @ apart.T + 1e-6 * np.eye(size))
        return Proposal(middle, self.frame @ factor)


class Weighted(NamedTuple):
    """Weighted draws of a density.

    Attributes:
        points: where, (S, p).
        log_density: there; -inf without one, (S,).
        weights: summing to one, (S,).
        log_evidence: log Z; -inf where no draw has a density.
        shape: Pareto shape of the largest weights.
        missed: share of search steps that ended where the proposals have hardly any density, if the search was made.
    """

    points: Points
    log_density: Values
    weights: Values
    log_evidence: float
    shape: float
    missed: float = 0.0

    @property
    def worth(self) -> float:
        """Effective number of draws (Kish)."""
        return _worth(self.weights) if np.isfinite(self.log_evidence) else 0.0

    def flattened(self) -> "Weighted":
        """The same draws, their weights flattened until enough of them count."""
        with np.errstate(divide="ignore"):
            return self._replace(weights=flattened(np.log(self.weights), self.points.shape[1]))

    @property
    def doubt(self) -> str | None:
        """The reason for doubts about moments of these draws, in a sentence; None if they are reliable."""
        if self.reliable:
            return None
        what = f"Pareto shape {self.shape:.2f}, effective number {self.worth:.0f} of {len(self.points)} draws"
        if self.flattened().worth > self.worth + 1:
            what += ", so that the weights are flattened and the intervals are approximate"
        if self.missed > _MAY_MISS:
            what = f"{self.missed:.1%} of the steps from its draws end where it has hardly any draws, so a tail is too short"
        return f"importance sampling is unreliable here: {what} (calibration.sampler: nuts does not use it)"

    @property
    def reliable(self) -> bool:
        """Whether moments of these draws are reliable."""
        if self.missed > _MAY_MISS:
            return False
        if len(self.points) >= TELLING and self.worth > _ALIKE * len(self.points):
            return True
        if self.shape == np.inf:
            return False
        # The tail of a few draws is uncertain (Vehtari et al. 2024, section 3.2.4).
        least = _WORTHY * len(self.points)
        return bool(self.shape < min(_SHAPE, 1 - 1 / np.log10(len(self.points))) and self.worth >= least)


def weigh(
    log_densities: Callable[[Points], Values], proposal: Proposal, draws: int, random: np.random.Generator
) -> Weighted:
    """Draw around a mode, and weight the draws.

    Arguments:
        log_densities: of many points; -inf or nan without one.
        proposal: to begin with.
        draws: least number, and up to twice as many while they are unreliable.
        random: the source of the draws.
    """
    points, log_density, rounds, size = np.zeros((0, proposal.center.size)), np.zeros(0), [], min(draws, _EACH)
    mixed = np.full(0, -np.inf)
    while True:
        rounds.append((math.log(size), proposal))
        new = proposal.draw(random, size)
        there = np.asarray(log_densities(new))
        # log Σ n_r t_r: add this proposal at the earlier draws, and sum all proposals at its own draws.
        mixed = np.logaddexp(mixed, rounds[-1][0] + proposal.log_density(points))
        of_new = np.logaddexp.reduce([count + one.log_density(new) for count, one in rounds])
        points, mixed = np.concatenate([points, new]), np.concatenate([mixed, of_new])
        log_density = np.concatenate([log_density, np.where(np.isnan(there), -np.inf, there)])
        log_weight = log_density - mixed + math.log(len(points))
        found, taught = weighted(points, log_density, log_weight), (points, log_weight)
        if len(points) >= draws and found.reliable:
            shift = found.log_evidence - math.log(len(points))
            seen = look(
                log_densities,
                lambda at, shift=shift: shift + np.logaddexp.reduce([c + one.log_density(at) for c, one in rounds]),
                *resampled(found, len(points), random),
                random,
            )
            found = found._replace(missed=seen.missed)
            # These points inform the next proposal, and have no weight.
            taught = (
                np.concatenate([points, seen.points]),
                np.concatenate([log_weight, seen.excess + found.log_evidence]),
            )
        if len(points) >= draws and (found.reliable or len(points) >= _MOST * draws):
            return found
        if np.isfinite(log_weight).any():
            proposal = proposal.learnt(*taught)
        size = min(draws, _EACH)
        if found.worth > _GOOD * len(points):
            size = max(draws - len(points), size)


def weighted(points: Points, log_density: Values, log_weight: Values) -> Weighted:
    """Draws with the logarithms of their weights, in any scale; the evidence is that of the density relative to this scale."""
    total = float(np.asarray(logsumexp(log_weight)))
    if not np.isfinite(total):
        return Weighted(points, log_density, np.full(len(points), 1 / len(points)), -np.inf, np.inf)
    weights, evidence = np.exp(log_weight - total), total - float(np.log(len(points)))
    return Weighted(points, log_density, weights / weights.sum(), evidence, _pareto_shape(log_weight))


def _shares(log_weight: Values) -> Values:
    finite = np.where(np.isfinite(log_weight), log_weight, -np.inf)
    share = np.exp(finite - finite.max())
    return share / share.sum()


def _worth(share: Values) -> float:
    return float(1 / np.sum(share**2))


def _pareto_shape(log_weight: Values) -> float:
    from arviz_stats.base.array import array_stats

    finite = np.sort(log_weight[np.isfinite(log_weight)])
    if len(finite) < TELLING:
        return np.inf
    # The tail of Vehtari et al. 2024, section 2; if a whole tail has one weight, as in a chain that stands still, it is bounded.
    if finite[-1] == finite[-int(min(0.2 * len(finite), 3 * np.sqrt(len(finite))))]:
        return -np.inf
    # ArviZ takes the negative logarithm of the weights.  A tail that is far too long overflows.
    with np.errstate(over="ignore"):
        return float(array_stats.psislw(finite.max() - finite)[1])


class Looked(NamedTuple):
    """The ends of Metropolis steps from draws.

    Attributes:
        points: there, (S, p).
        excess: log density less that which the draws were made by, (S,).
        missed: share of the steps that are accepted where hardly any draw is.
    """

    points: Points
    excess: Values
    missed: float


def look(
    log_densities: Callable[[Points], Values],
    log_drawn: Callable[[Points], Values],
    points: Points,
    log_density: Values,
    random: np.random.Generator,
) -> Looked:
    """Search by Metropolis steps for parts that the draws miss.

    Arguments:
        log_densities: of many points.
        log_drawn: log density that the draws were made by, in the scale of the other.
        points, log_density: draws, and their log density.
        random: the source of the steps.
    """
    count, size = min(_LOOKS, len(points)), points.shape[1]
    values, axes = np.linalg.eigh(np.atleast_2d(np.cov(points.T)))
    which = random.integers(size, size=count)
    length = _LENGTH * random.standard_t(_OF_LENGTH, count) * np.sqrt(np.maximum(values[which], 0.0))
    rows = random.permutation(len(points))[:count]
    looked = points[rows] + length[:, None] * axes[:, which].T
    there = np.asarray(log_densities(looked))
    there = np.where(np.isnan(there), -np.inf, there)
    excess = there - log_drawn(looked)
    accepted = np.exp(np.minimum(there - log_density[rows], 0.0))
    return Looked(looked, excess, float(np.mean(accepted * ~(excess < _LESS))))


def resampled(weighted: Weighted, count: int, random: np.random.Generator) -> tuple[Points, Values]:
    """Equally weighted draws (count, p) and their log density, by systematic resampling, in random order."""
    chosen = random.permutation(systematic(weighted.weights, count, random))
    return weighted.points[chosen], weighted.log_density[chosen]


def flattened(log_weight: Values, size: int) -> Values:
    """Weights raised to a power below one, the largest with which enough draws count for `size` dimensions."""
    enough = min(4 * size + 20, 0.5 * len(log_weight))
    power, share = 1.0, _shares(log_weight)
    while _worth(share) < enough and power > 1e-6:
        power *= 0.7
        share = _shares(power * log_weight)
    return share


def systematic(weights: Values, count: int, random: np.random.Generator) -> np.ndarray:
    """Indices of `count` draws of equal weight, in their order; a draw may occur several times."""
    places = (np.arange(count) + random.uniform()) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)
