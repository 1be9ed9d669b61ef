"""Standardised coordinates in a box, for a search over many nested models.

Each parameter becomes a number of order one with a lower and an upper bound.  The coordinate is linear in θ, or in log θ if the
prior has a logarithmic scale.  Bounds are preserved: an amplitude that cannot be negative has its neutral value *on* its bound,
and an unconstrained coordinate cannot represent this value.
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import expit

from hsed_jax.inference.priors import Prior

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

# Largest log odds of a tabulated quantile, number of quantiles, and least distance between two knots of a tabulated density.
_TAIL, _KNOTS, _APART = 14.0, 257, 1e-4


class Terms(NamedTuple):
    """Log density of some coordinates, its slope and its curvature (minus the second derivative, at least zero), (q,)."""

    value: Float[np.ndarray, " q"]
    slope: Float[np.ndarray, " q"]
    curvature: Float[np.ndarray, " q"]


class Coordinate(NamedTuple):
    """The coordinate x of one parameter θ.

    Attributes:
        is_log: whether x is linear in log θ.
        middle, spread: θ or log θ at x = 0, and its change per unit of x.
        low, high: bounds of x; infinite without one.
        density: log density of x, a spline over the prior; it is exact for a normal or uniform prior.
    """

    is_log: bool
    middle: float
    spread: float
    low: float
    high: float
    density: "CubicSpline"


@lru_cache(1024)
def _coordinate(prior: Prior) -> Coordinate:
    """The coordinate of a parameter with this prior."""
    from scipy.interpolate import CubicSpline

    def scaled(theta: Any) -> Any:
        with np.errstate(divide="ignore"):
            return np.log(theta) if is_log else np.asarray(theta, dtype=float)

    shares = np.concatenate([expit(np.linspace(-_TAIL, _TAIL, _KNOTS)), [0.16, 0.5, 0.84]])
    quantiles = np.asarray(prior.quantile(shares), dtype=float)
    is_log = _is_logarithmic(prior, quantiles[-2])
    lower, middle, upper = scaled(quantiles[-3:])
    spread = 0.5 * (upper - lower)
    low, high = ((scaled(side) - middle) / spread for side in _bounds(prior))
    # All quantiles are evaluated before some are removed: with arrays of equal shape, all priors share the compiled programs.
    values = np.asarray(prior.log_density(jnp.asarray(quantiles[:_KNOTS])), dtype=float) + np.log(spread)
    x = (scaled(quantiles[:_KNOTS]) - middle) / spread
    values += scaled(quantiles[:_KNOTS]) if is_log else 0.0
    # If quantiles are close together, the slopes between them are rounding errors.
    is_apart = np.concatenate([[True], np.diff(np.maximum.accumulate(x)) > _APART])
    return Coordinate(
        is_log, float(middle), float(spread), float(low), float(high), CubicSpline(x[is_apart], values[is_apart])
    )


class Box:
    """Coordinates x of several parameters θ.

    Arguments:
        priors: of the parameters, by name.
        flat: names of the parameters with a constant density; their priors give only the bounds and the scale.
        limits: least and largest possible value of θ, by name; they limit the box if a prior exceeds them.

    Attributes:
        priors, limits: of the parameters, by name.
        names: of the P parameters.
        low, high: bounds of x, (P,); infinite without one.
    """

    def __init__(
        self,
        priors: Mapping[str, Prior],
        flat: Collection[str] = (),
        limits: Mapping[str, tuple[float, float]] | None = None,
    ):
        self.names, self.priors, self.limits = tuple(priors), dict(priors), dict(limits or {})
        self._priors = tuple(priors.values())
        coordinates = [_coordinate(prior) for prior in self._priors]
        self._is_log = np.asarray([c.is_log for c in coordinates], dtype=bool)
        self._middle, self._spread, self.low, self.high = (
            np.asarray([(c.middle, c.spread, c.low, c.high) for c in coordinates]).reshape(-1, 4).T
        )
        possible = np.asarray([self.limits.get(name, (-np.inf, np.inf)) for name in self.names]).reshape(-1, 2).T
        # Only positive numbers have a logarithm.
        with np.errstate(divide="ignore"):
            lower, upper = self.x(np.where(self._is_log, np.maximum(possible, 0.0), possible))
        self.low, self.high = np.maximum(self.low, lower), np.minimum(self.high, upper)
        densities = [_level() if n in flat else c.density for n, c in zip(priors, coordinates, strict=True)]
        # One table for all densities: separate evaluations would take longer than all other work between simulations.
        most = max((d.c.shape[1] for d in densities), default=0)
        self._inner, self._from = [d.x[1:-1] for d in densities], np.zeros((len(densities), most))
        self._cubics = np.zeros((len(densities), most, 4))
        for start, cubics, density in zip(self._from, self._cubics, densities, strict=True):
            start[: density.c.shape[1]], cubics[: density.c.shape[1]] = density.x[:-1], density.c.T
        self._quantiles: dict[tuple[int, tuple[float, ...]], np.ndarray] = {}

    def theta(self, x: np.ndarray) -> np.ndarray:
        """θ(x), SI, last axis P."""
        plain = self._middle + self._spread * x
        return np.where(self._is_log, np.exp(np.where(self._is_log, plain, 0.0)), plain)

    def x(self, theta: np.ndarray) -> np.ndarray:
        """x(θ), last axis P."""
        plain = np.where(self._is_log, np.log(np.where(self._is_log, theta, 1.0)), theta)
        return (plain - self._middle) / self._spread

    def quantiles(self, columns: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """x of the given columns (indices) at these quantile levels of their priors, (B, len(columns))."""
        found = [self._quantile(int(k), tuple(s)) for k, s in zip(columns, shares.T, strict=True)]
        theta = np.tile(self._middle, (len(shares), 1))
        theta[:, columns] = np.stack(found, axis=1)
        return self.x(np.where(self._is_log & (theta <= 0), 1.0, theta))[:, columns]

    def log_density(self, x: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Log prior density in x of the given columns (indices); x has the shape (B, P), the result (B, len(columns))."""
        (a, b, c, d), along = self._pieces(x[:, columns], columns)
        return ((a * along + b) * along + c) * along + d

    def terms(self, x: np.ndarray, columns: np.ndarray) -> Terms:
        """Log prior density in x, its slope and its curvature for the given columns; x: (P,), results: (len(columns),)."""
        (a, b, c, d), along = self._pieces(x[columns], columns)
        value, slope = ((a * along + b) * along + c) * along + d, (3 * a * along + 2 * b) * along + c
        return Terms(value, slope, np.maximum(-(6 * a * along + 2 * b), 0.0))

    def _pieces(self, x: Float[np.ndarray, "*B q"], columns: Int[np.ndarray, " q"]) -> tuple[Any, np.ndarray]:
        """The cubics of the splines at x, highest power first, (4, *B, q), and the distance of x from its knot, (*B, q)."""
        piece = np.zeros(x.shape, dtype=int)
        for place, column in enumerate(columns):
            piece[..., place] = self._inner[column].searchsorted(x[..., place], side="right")
        return np.moveaxis(self._cubics[columns, piece], -1, 0), x - self._from[columns, piece]

    def _quantile(self, k: int, shares: tuple[float, ...]) -> np.ndarray:
        if (k, shares) not in self._quantiles:
            self._quantiles[k, shares] = np.asarray(self._priors[k].quantile(np.asarray(shares)), dtype=float)
        return self._quantiles[k, shares]


def _level() -> "CubicSpline":
    """The log density of a coordinate with a constant density."""
    from scipy.interpolate import CubicSpline

    return CubicSpline([-1.0, 1.0], [0.0, 0.0])


def _bounds(prior: Prior) -> tuple[float, float]:
    low, high = prior.bounds
    return (-np.inf if low is None else low), (np.inf if high is None else high)


def _is_logarithmic(prior: Prior, median: float) -> bool:
    """Whether a prior has a logarithmic scale: log-uniform, or positive, without an upper bound and without density at zero."""
    if prior.name.lower().replace("_", "") == "loguniform":
        return True
    low, high = prior.bounds
    if low != 0.0 or high is not None:
        return False
    near_zero, there = (float(prior.log_density(jnp.asarray(value))) for value in (1e-9 * median, median))
    return near_zero < there - 20.0


def quadratic_minimum(
    gradient: Float[np.ndarray, " p"],
    hessian: Float[np.ndarray, "p p"],
    low: Float[np.ndarray, " p"],
    high: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
    r"""A step d from a point to the minimum of $g^\top d + d^\top H d/2$ within bounds, and the coordinates on a bound.

    It goes towards the minimum without bounds until a coordinate reaches its bound and stays there, then on in the others: no
    part of the way increases the value.
    """
    step, slope = np.zeros(len(gradient)), gradient
    is_held = ((low >= 0) & (gradient > 0)) | ((high <= 0) & (gradient < 0))
    while not is_held.all():
        loose = np.flatnonzero(~is_held)
        way = -np.linalg.solve(hessian[np.ix_(loose, loose)], slope[loose])
        left = np.where(way < 0, low[loose], high[loose]) - step[loose]
        # The share of its way that each coordinate can go.
        shares = np.divide(left, way, out=np.full(len(way), np.inf), where=way != 0)
        share = min(shares.min(), 1.0)
        is_reached = shares <= share
        step[loose] += np.where(is_reached, left, share * way)
        slope = gradient + hessian @ step
        if not is_reached.any():
            break
        is_held[loose[is_reached]] = True
    return step, is_held
