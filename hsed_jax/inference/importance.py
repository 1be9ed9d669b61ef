r"""Importance sampling: draws of a Student t, weighted to be exact for a density that is known up to a constant.

A posterior is nearly Gaussian around its mode, so that a proposal of heavier tails, $w_s = p(x_s)/t(x_s)$, makes nearly every
simulation an independent draw, where a chain needs dozens of them for one; and the mean of the weights is the evidence
$Z = \int p(x)\,dx$.  The proposal learns its centre and its spread from its own draws.  Whether that was enough is told by the
Pareto shape of the weights (below 0.7) and by how many draws they are worth.

Source: Geweke 1989; Cappé, Guillin, Marin & Robert 2004 (population Monte Carlo); Vehtari, Simpson, Gelman, Yao & Gabry 2024
(Pareto smoothed importance sampling).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import gammaln, logsumexp

from hsed_jax.physics.batch import TILE

_DEGREES = 5.0
_MOST_ROUNDS = 5
# A round ends the learning when its draws are worth this share of their number.
_GOOD = 0.5
# Beyond this Pareto shape the weights have no mean that can be relied on; of less worth than this share, a chain is better.
_SHAPE, _WORTHY = 0.7, 0.1
# Draws worth nearly their number have weights so alike that they have no tail to speak of.
_ALIKE = 0.95
# Fewer weights than this have no tail to take a shape from.
TELLING = 25

Points = Float[np.ndarray, "S p"]
Heights = Float[np.ndarray, " S"]


class Proposal(NamedTuple):
    """A Student t of five degrees of freedom.

    Attributes:
        center: its mode, (p,).
        frame: L with x = center + L w, w standard, (p, p).
    """

    center: Float[np.ndarray, " p"]
    frame: Float[np.ndarray, "p p"]

    def draw(self, random: np.random.Generator, draws: int) -> tuple[Points, Heights]:
        """Points and their log density."""
        size = self.center.size
        w = random.standard_normal((draws, size)) * np.sqrt(_DEGREES / random.chisquare(_DEGREES, (draws, 1)))
        normalisation = (
            gammaln(0.5 * (_DEGREES + size)) - gammaln(0.5 * _DEGREES) - 0.5 * size * np.log(_DEGREES * np.pi)
        )
        normalisation -= np.linalg.slogdet(self.frame)[1]
        height = normalisation - 0.5 * (_DEGREES + size) * np.log1p(np.sum(w**2, axis=1) / _DEGREES)
        return self.center + w @ self.frame.T, height

    def learnt(self, points: Points, log_weight: Heights) -> "Proposal":
        """The proposal that a round's draws call for, their weights flattened as far as it takes for enough of them to count."""
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
        log_density: there; -inf where there is none, (S,).
        weights: summing to one, (S,).
        log_evidence: log Z; -inf where no draw has a density.
        shape: Pareto shape of the largest weights.
    """

    points: Points
    log_density: Heights
    weights: Heights
    log_evidence: float
    shape: float

    @property
    def worth(self) -> float:
        """Number of draws that the weighted ones are worth (Kish)."""
        return _worth(self.weights) if np.isfinite(self.log_evidence) else 0.0

    @property
    def doubt(self) -> str | None:
        """Why moments of these draws may not be believed, in a sentence; None where they may."""
        if self.reliable:
            return None
        return (
            f"importance sampling cannot be relied on here: Pareto shape {self.shape:.2f}, {len(self.points)} draws worth "
            f"{self.worth:.0f} (calibration.sampler: auto leaves it to NUTS)"
        )

    @property
    def reliable(self) -> bool:
        """Whether moments of these draws may be believed."""
        if len(self.points) >= TELLING and self.worth > _ALIKE * len(self.points):
            return True
        if self.shape == np.inf:
            return False
        # What a few draws say of their tail is uncertain (Vehtari et al. 2024, section 3.2.4).
        least = _WORTHY * len(self.points)
        return bool(self.shape < min(_SHAPE, 1 - 1 / np.log10(len(self.points))) and self.worth >= least)


def weigh(
    log_density: Callable[[Points], Heights], proposal: Proposal, draws: int, random: np.random.Generator
) -> Weighted:
    """Draw from around a mode and weigh.

    Arguments:
        log_density: of many points; -inf or nan where there is none.
        proposal: to begin with.
        draws: S; the rounds before the last, in which the proposal learns, have fewer.
        random: the source of the draws.
    """
    learning = min(draws, TILE * (1 + proposal.center.size // 4))
    for _ in range(_MOST_ROUNDS):
        points, _, log_weight = _round(log_density, proposal, learning, random)
        if not np.isfinite(log_weight).any() or _worth(_shares(log_weight)) > _GOOD * learning:
            break
        proposal = proposal.learnt(points, log_weight)
    return weighted(*_round(log_density, proposal, draws, random))


def weighted(points: Points, log_density: Heights, log_weight: Heights) -> Weighted:
    """Draws with the logarithms of their weights, in any scale; the evidence is that of the density over the scale's."""
    total = float(np.asarray(logsumexp(log_weight)))
    if not np.isfinite(total):
        return Weighted(points, log_density, np.full(len(points), 1 / len(points)), -np.inf, np.inf)
    weights, evidence = np.exp(log_weight - total), total - float(np.log(len(points)))
    return Weighted(points, log_density, weights / weights.sum(), evidence, _pareto_shape(log_weight))


def _round(
    log_density: Callable[[Points], Heights], proposal: Proposal, draws: int, random: np.random.Generator
) -> tuple[Points, Heights, Heights]:
    points, of_proposal = proposal.draw(random, draws)
    height = np.asarray(log_density(points))
    height = np.where(np.isnan(height), -np.inf, height)
    return points, height, height - of_proposal


def _shares(log_weight: Heights) -> Heights:
    finite = np.where(np.isfinite(log_weight), log_weight, -np.inf)
    share = np.exp(finite - finite.max())
    return share / share.sum()


def _worth(share: Heights) -> float:
    return float(1 / np.sum(share**2))


def _pareto_shape(log_weight: Heights) -> float:
    from arviz_stats.base.array import array_stats

    finite = np.sort(log_weight[np.isfinite(log_weight)])
    if len(finite) < TELLING:
        return np.inf
    # The tail of Vehtari et al. 2024, section 2; weights that a whole tail shares, as those of a chain that stands, are bounded.
    if finite[-1] == finite[-int(min(0.2 * len(finite), 3 * np.sqrt(len(finite))))]:
        return -np.inf
    # ArviZ takes what is to be weighed down: the negative logarithm of the weights.
    return float(array_stats.psislw(finite.max() - finite)[1])


def resampled(weighted: Weighted, count: int, random: np.random.Generator) -> tuple[Points, Heights]:
    """Equally weighted draws (count, p) and their log density, by systematic resampling, in random order."""
    chosen = random.permutation(systematic(weighted.weights, count, random))
    return weighted.points[chosen], weighted.log_density[chosen]


def flattened(log_weight: Heights, size: int) -> Heights:
    """Weights raised to a power as far below one as it takes for enough draws of `size` dimensions to count."""
    enough = min(4 * size + 20, 0.5 * len(log_weight))
    power, share = 1.0, _shares(log_weight)
    while _worth(share) < enough and power > 1e-6:
        power *= 0.7
        share = _shares(power * log_weight)
    return share


def systematic(weights: Heights, count: int, random: np.random.Generator) -> np.ndarray:
    """Which draws are taken, and how often, for `count` of equal weight; in their order."""
    places = (np.arange(count) + random.uniform()) / count
    return np.minimum(np.searchsorted(np.cumsum(weights), places), len(weights) - 1)
