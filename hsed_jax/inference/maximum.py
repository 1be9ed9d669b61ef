"""The maximum a posteriori estimate, by Levenberg–Marquardt from several starts, and the evidence by Laplace.

Starts may end in different modes.  What Laplace's method gives each of them is its share of the posterior, and those that matter
are kept beside the best.

Each search is a program of its own and not one large one: what they share is compiled once.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from hsed_jax.inference.likelihood import LOG_2PI, Data
from hsed_jax.inference.posterior import Expansion, Posterior
from hsed_jax.programs import program

# All starts descend this far side by side, and the best of them goes on alone: by then it is in its basin, and the kinks of the
# simulated response make the last digits slow.
_RACE = 10
_MOST_STEPS = 60
# Newton's method towards the mode of the density in u ends where it expects to gain less than this many nats.
_LEAST_GAIN = 1e-4
_MOST_NEWTON_STEPS, _MOST_HALVINGS = 20, 6
# No coordinate, of order one, goes further at once.
_LONGEST = 8.0
# What ended at a bound starts again at this share of the way to it, at most so often.
_RETURN, _MOST_RETURNS = 0.5, 3
# An end of the race this many standard deviations from the mode should be half the square of it lower [nats]; one that is higher
# is in another mode, if the density between them falls so far below both.
_APART, _LEAST_DIP = 5.0, 2.0
# Places between two modes where the density is looked at.
_BETWEEN = np.linspace(0.1, 0.9, 9)
# A mode of less evidence, relative to the best, does not matter.
_LEAST_SHARE = 0.01


class Maximum(NamedTuple):
    """The best of several starts: a mode of the posterior, and the others.

    Attributes:
        u, theta: unconstrained and physical (SI) coordinates of the MAP (Eq. 6), shape (p,).  Of a population they are those of
            `start`: the joint density of spreads and offsets has its mode at spreads that no measurement supports.
        log_posterior: log π(θ)L(θ) there.
        covariance: Gauss–Newton covariance of θ there, prior included, shape (p, p).
        log_evidence: log Z by Laplace's method (Tierney & Kadane 1986), of this mode alone.
        start: unconstrained coordinates of the mode of the density in u, where a sampler of u starts, shape (p,).
        whitening: L with u = start + L w, w nearly standard normal, shape (p, p).
        converged: whether the winning start met its tolerances.
        others: modes besides this one that hold a share of the posterior that matters; without others of their own.
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
        """One sentence that says which modes there are, or None if there is one."""
        if not self.others:
            return None
        places = [
            ", ".join(f"{name} = {value:.4g}" for name, value in zip(names, np.asarray(mode.theta), strict=True))
            for mode in self.modes
        ]
        told = "; ".join(f"{place} ({share:.0%})" for place, share in zip(places, self.shares, strict=True))
        return f"the posterior has {len(places)} modes: {told}"


def maximise(posterior: Posterior, data: Data, starts: Float[Array, "s p"]) -> Maximum:
    """Find the MAP, and what other modes the starts end in.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        starts: unconstrained starting points.
    """
    ends = _race(posterior, data, starts)
    heights = np.asarray([float(_expand(posterior, data, end).log_posterior) for end in ends])
    heights = np.where(np.isfinite(heights), heights, -np.inf)
    order = np.argsort(-heights)
    best = _mode(posterior, data, ends[order[0]])
    modes = [best]
    for end, height in zip(ends[order[1:]], heights[order[1:]], strict=True):
        # Each has its own frame; a wide mode beside a narrow one is far from it and not the other way round.
        if heights[order[0]] - height < 0.5 * _APART**2 and _is_apart(end, modes):
            found = _mode(posterior, data, end)
            if _is_apart(found.start, modes) and all(_dips(posterior, data, found, mode) for mode in modes):
                modes.append(found)
    least = max(float(mode.log_evidence) for mode in modes) + np.log(_LEAST_SHARE)
    return best._replace(others=tuple(mode for mode in modes[1:] if float(mode.log_evidence) > least))


def _is_apart(u: Float[Array, " p"], modes: list[Maximum]) -> bool:
    # A bound lies at infinity of u, where distances mean nothing.
    at = np.asarray(_held(u))
    return all(
        np.linalg.norm(np.linalg.solve(np.asarray(mode.whitening), at - np.asarray(mode.start))) > _APART
        for mode in modes
    )


def _dips(posterior: Posterior, data: Data, one: Maximum, other: Maximum) -> bool:
    """Whether the density falls between two modes; a long ridge has many ends and no dip."""
    ends = [float(_expand(posterior, data, mode.start).log_density) for mode in (one, other)]
    between = [float(_expand(posterior, data, one.start + t * (other.start - one.start)).log_density) for t in _BETWEEN]
    return min(between) < min(ends) - _LEAST_DIP


def _mode(posterior: Posterior, data: Data, start: Float[Array, " p"]) -> Maximum:
    u, converged = _off_the_bounds(posterior, data, *_descend(posterior, data, start))
    if posterior.population.levels:
        u = _settled(posterior, u)
    center, log_density, whitening = _sampling_frame(posterior, data, u)
    if posterior.population.levels:
        u = center
    theta, to_theta = _physical(posterior, u)
    found = _expand(posterior, data, u)
    covariance = to_theta @ np.linalg.inv(found.curvature) @ np.asarray(to_theta).T
    log_evidence = log_density + 0.5 * u.size * LOG_2PI + jnp.linalg.slogdet(whitening)[1]
    return Maximum(u, theta, found.log_posterior, covariance, log_evidence, center, whitening, converged)


def _off_the_bounds(
    posterior: Posterior, data: Data, u: Float[Array, " p"], converged: Bool[Array, ""]
) -> tuple[Float[Array, " p"], Bool[Array, ""]]:
    """The end of a descent, or a better one.

    A first step too long throws a coordinate against its bound, which lies at infinity of u and where no slope leads back:
    whoever ends there goes down once more from where there is one.
    """
    for _ in range(_MOST_RETURNS):
        if np.array_equal(_held(u), u):
            break
        back = jnp.where(_held(u) == u, u, _RETURN * _held(u))
        again, is_end = _descend(posterior, data, back)
        before, after = (float(_expand(posterior, data, at).log_posterior) for at in (u, again))
        if not after > before + _LEAST_GAIN:
            break
        u, converged = again, is_end
    return u, converged


def _held(u: Float[Array, " p"]) -> Float[Array, " p"]:
    return jnp.clip(u, -4.0, 4.0)


@program
def _race(posterior: Posterior, data: Data, starts: Float[Array, "s p"]) -> Float[Array, "s p"]:
    return jax.vmap(lambda start: least_squares(posterior, data, start, _RACE)[0])(starts)


@program
def _descend(posterior: Posterior, data: Data, start: Float[Array, " p"]) -> tuple[Float[Array, " p"], Bool[Array, ""]]:
    return least_squares(posterior, data, start, _MOST_STEPS)


@program
def _expand(posterior: Posterior, data: Data, u: Float[Array, " p"]) -> Expansion:
    return posterior.expand(u, data)


@program
def _settled(posterior: Posterior, u: Float[Array, " p"]) -> Float[Array, " p"]:
    return posterior.unconstrain(posterior.population.settled(posterior.constrain(u)))


@program
def _physical(posterior: Posterior, u: Float[Array, " p"]) -> tuple[Float[Array, " p"], Float[Array, "p p"]]:
    return posterior.constrain(u), jax.jacfwd(posterior.constrain)(u)


def least_squares(
    posterior: Posterior, data: Data, start: Float[Array, " p"], most_steps: int, tolerance: float = 1e-6
) -> tuple[Float[Array, " p"], Bool[Array, ""]]:
    """Descend by Levenberg and Marquardt, without evidence or covariance.

    Arguments:
        posterior: to climb.
        data: the measurements.
        start: unconstrained parameters, (p,).
        most_steps: the descent ends after so many.
        tolerance: relative; a tenth of it absolute.

    Returns:
        Where it ended, and whether that is a minimum of the squares to the tolerance.
    """
    solution = optx.least_squares(
        lambda u, _: posterior.residuals(u, data),
        optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance / 10),
        start,
        max_steps=most_steps,
        throw=False,
    )
    return solution.value, solution.result == optx.RESULTS.successful


def _sampling_frame(
    posterior: Posterior, data: Data, u: Float[Array, " p"]
) -> tuple[Float[Array, " p"], Float[Array, ""], Float[Array, "p p"]]:
    """The mode of the density in u, the log density and a whitening there.

    A MAP at a bound lies at infinity of u, the mode does not.  It is found by Newton's method with halved steps; where a kink of
    the response stops it early, what was reached serves as well.
    """
    center = _held(u)
    here = _expand(posterior, data, center)
    for _ in range(_MOST_NEWTON_STEPS):
        step = np.linalg.solve(here.curvature, here.gradient)
        step = step * min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-300))
        if not np.isfinite(step).all() or float(step @ np.asarray(here.gradient)) < _LEAST_GAIN:
            break
        for _ in range(_MOST_HALVINGS):
            trial = _expand(posterior, data, center + step)
            if trial.log_density > here.log_density:
                center, here = center + step, trial
                break
            step = 0.5 * step
        else:
            break
    return center, here.log_density, jnp.asarray(np.linalg.inv(np.linalg.cholesky(here.curvature)).T)
