"""The maximum a posteriori estimate, by Levenberg–Marquardt from several starts, and the evidence by Laplace's method.

Starts may end in different modes.  Laplace's method gives the share of each mode in the posterior, and modes with a relevant
share are kept beside the best.

All searches use one program, `hsed_jax.inference.expansion`: each point is simulated once.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hsed_jax.errors import UserError
from hsed_jax.inference.expansion import Expansion, expand
from hsed_jax.inference.likelihood import LOG_2PI, Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.programs import program

# All starts descend side by side for so many steps, except those that met a better one.  Then the best one continues alone: it is
# in its basin by then, and the kinks of the simulated response make the last digits slow.
_RACE = 10
_MOST_STEPS = 60
# A descent ends if it expects to gain less than the first number of nats.  It also ends at a kink: if it expects less than the
# second number, and gains less than a quarter of its expectation.
_SETTLED, _AT_A_KINK = 1e-9, 3e-2
# Descents closer than this, in standard deviations and in u, are merged.
_MET = 0.5
# Newton's method towards the mode of the density in u ends if it expects to gain less than this many nats.
_LEAST_GAIN = 1e-2
_MOST_NEWTON_STEPS, _MOST_HALVINGS = 10, 4
# Largest step of a coordinate, which has order one.
_LONGEST = 8.0
# A descent that ended at a bound starts again at this share of the way to it, at most so often.
_RETURN, _MOST_RETURNS = 0.5, 3
# Coordinates at bounds, that is at infinity of u, are moved to one of these distances.
_FROM_BOUNDS = (4.0, 6.0, 9.0, 14.0)
# The end of a descent that lies k standard deviations from the mode should be k²/2 nats lower.  A higher end belongs to another
# mode, if the density between the two falls so far below both.
_APART, _LEAST_DIP = 5.0, 2.0
# Points between two modes at which the density is computed.
_BETWEEN = np.linspace(0.1, 0.9, 9)
# A mode with less evidence than this, relative to the best, is left out.
_LEAST_SHARE = 0.01


class Maximum(NamedTuple):
    """The best of several starts: a mode of the posterior, and the others.

    Attributes:
        u, theta: unconstrained and physical (SI) coordinates of the MAP (Eq. 6), shape (p,).  For a population they are those
            of `start`: the joint density of spreads and offsets has its mode at spreads that the measurements do not support.
        log_posterior: log π(θ)L(θ) there.
        covariance: Gauss–Newton covariance of θ there, prior included, shape (p, p).
        log_evidence: log Z by Laplace's method (Tierney & Kadane 1986), of this mode alone.
        start: unconstrained coordinates of the mode of the density in u, where a sampler of u starts, shape (p,).
        whitening: L with u = start + L w, w nearly standard normal, shape (p, p).
        converged: whether the descent ended where no step has a predicted gain.
        others: further modes with a relevant share of the posterior; their own `others` are empty.
    """

    u: Float[Array, " p"]
    theta: Float[Array, " p"]
    log_posterior: Float[Array, ""]
    covariance: Float[Array, "p p"]
    log_evidence: Float[Array, ""]
    start: Float[Array, " p"]
    whitening: Float[Array, "p p"]
    converged: Bool[Array, ""]
    others: tuple["Maximum", ...] = ()

    @property
    def modes(self) -> tuple["Maximum", ...]:
        """All modes, the MAP first, each without the others."""
        return (self._replace(others=()), *self.others)

    @property
    def shares(self) -> Float[np.ndarray, " modes"]:
        """Share of the posterior that each of `modes` holds, by its evidence."""
        return np.asarray(jax.nn.softmax(jnp.asarray([mode.log_evidence for mode in self.modes])))

    def warning(self, names: tuple[str, ...]) -> str | None:
        """One sentence that lists the modes, or None if there is only one."""
        if not self.others:
            return None
        places = [
            ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, np.asarray(mode.theta), strict=True))
            for mode in self.modes
        ]
        told = "; ".join(f"{place} ({share:.0%})" for place, share in zip(places, self.shares, strict=True))
        return f"the posterior has {len(places)} modes: {told}"


def maximise(posterior: Posterior, data: Data, starts: Float[Array | np.ndarray, "s p"]) -> Maximum:
    """Find the MAP, and the other modes in which the starts end.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        starts: unconstrained starting points.

    Raises:
        UserError: the posterior has no curvature at its maximum.
    """
    race = _begun(posterior, data, np.asarray(starts))
    _descend(posterior, data, race, _RACE)
    log_densities = np.asarray([float(search.here.log_posterior) for search in race])
    log_densities = np.where(np.isfinite(log_densities), log_densities, -np.inf)
    order = np.argsort(-log_densities)
    best = _mode(posterior, data, race[order[0]])
    modes = [best]
    for end in order[1:]:
        # Each mode has its own frame, so the distance from a narrow mode to a wide one differs from that back.
        if log_densities[order[0]] - log_densities[end] < 0.5 * _APART**2 and _is_apart(race[end].u, modes):
            found = _mode(posterior, data, race[end])
            if _is_apart(np.asarray(found.start), modes) and all(_dips(posterior, data, found, mode) for mode in modes):
                modes.append(found)
    least = max(float(mode.log_evidence) for mode in modes) + np.log(_LEAST_SHARE)
    return best._replace(others=tuple(mode for mode in modes[1:] if float(mode.log_evidence) > least))


class _Search:
    """The state of one descent.

    Attributes:
        u: where it is, (p,).
        here: the posterior there.
        is_settled: whether no step has a predicted gain.
        is_over: whether it met a better one, or has no further step.
    """

    def __init__(self, u: Float[np.ndarray, " p"], here: Expansion):
        self.u, self.here, self.is_settled, self.is_over = u, here, False, False
        self._damping, self._growth = 1.0, 2.0

    def step(self) -> Float[np.ndarray, " p"]:
        """The next step, that of the damped quadratic (Levenberg 1944; Marquardt 1963)."""
        damped = np.asarray(self.here.hessian) + self._damping * np.eye(self.u.size)
        if not (np.isfinite(damped).all() and np.isfinite(self.here.slope).all()):
            return np.full(self.u.size, np.nan)
        try:
            return np.linalg.solve(damped, np.asarray(self.here.slope))
        except np.linalg.LinAlgError:  # numbers beyond the digits of a double
            return np.full(self.u.size, np.nan)

    def predicted_gain(self, step: Float[np.ndarray, " p"]) -> float:
        """The gain that the quadratic expects of a step [nats]."""
        return float(step @ self.here.slope - 0.5 * step @ self.here.hessian @ step)

    def judge(self, step: Float[np.ndarray, " p"], there: Expansion) -> None:
        """Accept a step or not, and adapt the damping (Nielsen 1999); a descent that stops at a kink soon ends."""
        predicted_gain = self.predicted_gain(step)
        share = float(there.log_posterior - self.here.log_posterior) / predicted_gain
        self.is_settled = share < 0.25 and predicted_gain < _AT_A_KINK
        if share > 0:
            self.u, self.here = self.u + step, there
            self._damping *= max(1 / 3, 1 - (2 * min(share, 1.0) - 1) ** 3)
            self._growth = 2.0
        else:
            self._damping *= self._growth
            self._growth *= 2


def _begun(posterior: Posterior, data: Data, starts: Float[np.ndarray, "s p"]) -> list[_Search]:
    return [_Search(start, here) for start, here in zip(starts, expand(posterior, data, starts), strict=True)]


def _descend(posterior: Posterior, data: Data, searches: Sequence[_Search], most_steps: int) -> None:
    """Let descents continue side by side, for a limited number of steps; a descent that meets a better one is over."""
    for _ in range(most_steps):
        going, steps = [], []
        for search in searches:
            if search.is_over or search.is_settled:
                continue
            step = search.step()
            predicted_gain = search.predicted_gain(step)
            search.is_settled, search.is_over = predicted_gain < _SETTLED, not np.isfinite(predicted_gain)
            if np.isfinite(predicted_gain) and not search.is_settled:
                going.append(search)
                steps.append(step)
        if not going:
            return
        there = expand(posterior, data, [search.u + step for search, step in zip(going, steps, strict=True)])
        for search, step, trial in zip(going, steps, there, strict=True):
            search.judge(step, trial)
        for search in going:
            search.is_over = any(_has_met(search, other) for other in searches if other is not search)


def _has_met(one: _Search, other: _Search) -> bool:
    """Whether a descent has reached a better one."""
    # A bound lies at infinity of u, where distances have no meaning.
    apart = _held(other.u) - _held(one.u)
    behind = float(other.here.log_posterior - one.here.log_posterior)
    return bool(
        0 < behind < _LEAST_DIP and np.abs(apart).max() < _MET and apart @ other.here.curvature @ apart < _MET**2
    )


def _is_apart(u: Float[np.ndarray, " p"], modes: list[Maximum]) -> bool:
    at = _held(u)
    return all(
        np.linalg.norm(np.linalg.solve(np.asarray(mode.whitening), at - np.asarray(mode.start))) > _APART
        for mode in modes
    )


def _dips(posterior: Posterior, data: Data, one: Maximum, other: Maximum) -> bool:
    """Whether the density falls between two modes; a long ridge has many ends and no dip."""
    begin, end = np.asarray(one.start), np.asarray(other.start)
    points = [begin, end, *(begin + t * (end - begin) for t in _BETWEEN)]
    at_one, at_other, *between = (float(found.log_density) for found in expand(posterior, data, points))
    return min(between) < min(at_one, at_other) - _LEAST_DIP


def _mode(posterior: Posterior, data: Data, search: _Search) -> Maximum:
    search.is_over = False
    _descend(posterior, data, [search], _MOST_STEPS)
    search = _off_the_bounds(posterior, data, search)
    u, found = search.u, search.here
    if posterior.population.levels:
        u = np.asarray(_settled(posterior, jnp.asarray(u)))
        (found,) = expand(posterior, data, [u])
    center, at_center = _sampling_frame(posterior, data, u, found)
    if posterior.population.levels:
        u, found = center, at_center
    theta, to_theta = map(np.asarray, _physical(posterior, jax.device_put(u)))
    try:
        covariance = to_theta @ np.linalg.inv(found.curvature) @ to_theta.T
        whitening = np.linalg.inv(np.linalg.cholesky(at_center.curvature)).T
    except np.linalg.LinAlgError:
        raise UserError(
            f"the posterior of {', '.join(posterior.names)} has no curvature at its maximum: there are fewer measurements than "
            "parameters, or they are fitted to the last digit; measure more, or give the error of the measurements (error)"
        ) from None
    log_evidence = at_center.log_density + 0.5 * u.size * LOG_2PI + np.linalg.slogdet(whitening)[1]
    known = (u, theta, found.log_posterior, covariance, log_evidence, center, whitening, search.is_settled)
    return Maximum._make([*jax.device_put(known), ()])


def _off_the_bounds(posterior: Posterior, data: Data, search: _Search) -> _Search:
    """The end of a descent, or a better one.

    A first step that is too long puts a coordinate at its bound, which lies at infinity of u, where the slope is zero.  A
    descent that ends there starts again where there is a slope.
    """
    for _ in range(_MOST_RETURNS):
        held = _held(search.u)
        if np.array_equal(held, search.u):
            break
        (again,) = _begun(posterior, data, np.where(held == search.u, search.u, _RETURN * held)[None])
        search.is_over = True
        _descend(posterior, data, [again, search], _MOST_STEPS)
        if not again.here.log_posterior > search.here.log_posterior + _LEAST_GAIN:
            break
        search = again
    return search


def _held(u: Float[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
    return np.clip(u, -_FROM_BOUNDS[0], _FROM_BOUNDS[0])


@program
def _settled(posterior: Posterior, u: Float[Array, " p"]) -> Float[Array, " p"]:
    return posterior.unconstrain(posterior.population.settled(posterior.constrain(u)))


@program
def _physical(posterior: Posterior, u: Float[Array, " p"]) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
    return posterior.constrain(u), jax.jacfwd(posterior.constrain)(u)


def _sampling_frame(
    posterior: Posterior, data: Data, u: Float[np.ndarray, " p"], around: Expansion
) -> tuple[Float[np.ndarray, " p"], Expansion]:
    """The mode of the density in u, and the posterior there.

    A MAP at a bound lies at infinity of u, but the mode does not.  Newton's method with halved steps finds it, from the best of
    several distances to the bounds: near a bound, a small change may change the response much.  If a kink of the response stops
    it early, the point that it reached is good enough.
    """
    center, here = u, around
    if np.abs(u).max() > _FROM_BOUNDS[0]:
        centers = [np.clip(u, -far, far) for far in _FROM_BOUNDS]
        found = expand(posterior, data, centers)
        best = int(np.argmax(np.nan_to_num([float(one.log_density) for one in found], nan=-np.inf)))
        center, here = centers[best], found[best]
    for _ in range(_MOST_NEWTON_STEPS):
        step = np.linalg.solve(here.curvature, here.gradient)
        step = step * min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-300))
        if not np.isfinite(step).all() or float(step @ here.gradient) < _LEAST_GAIN:
            break
        for _ in range(_MOST_HALVINGS):
            (trial,) = expand(posterior, data, [center + step])
            gain = float(trial.log_density - here.log_density)
            if gain > 0:
                center, here = center + step, trial
                break
            step = 0.5 * step
        if not gain >= _LEAST_GAIN:
            break
    return center, here
