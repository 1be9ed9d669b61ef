r"""Whether an effect belongs to the population or to some specimens only, or is scatter.

For every member of a level, the likelihood of its measurements is computed at several sizes of the effect, with its own
parameters adjusted.  Three explanations are compared by these likelihoods:

* **population**: all members have it, with sizes $\mu\,e^{cz}$, z standard normal;
* **specimens**: some members have it, with such sizes, and the others do not; every number of members is equally probable;
* **scatter**: no member has it, or the sizes scatter about zero.

Each explanation has the prior probability of a third.  μ has the prior of the catalogue, and c a half-normal one.  The prior
probability of a number of members is divided among all choices of so many members, which accounts for multiple comparisons.
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import gammaln, logsumexp

from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.findings import Judgement
from hsed_jax.diagnosis.fit_state import FitState, Target, Task
from hsed_jax.diagnosis.problem import Problem

# Sizes at which every member is fitted, relative to the largest fitted size; negative ones if the amplitude may be negative.
_SIZES, _NEGATIVE = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.6), (-1.0, -0.5, -0.25)
# Grids of the integrals: numbers of sizes and centres; scale of the half-normal prior of the coefficient of variation, its grid.
_POINTS, _CENTRES = 1600, 48
_VARIATION, _VARIATIONS = 0.3, np.asarray([0.03, 0.1, 0.2, 0.3, 0.45, 0.6, 0.9])
# A member has an effect if its probability is larger than this.
_HAS = 0.5


class Membership(NamedTuple):
    """The members of a level, and their training experiments.

    Attributes:
        level: its name.
        members: their names.
        of: index of the member of each experiment, (n,).
        varying: names of the parameters that vary with the level.
    """

    level: str
    members: tuple[str, ...]
    of: Int[np.ndarray, " n"]
    varying: tuple[str, ...]

    @property
    def rows(self) -> Bool[np.ndarray, "M n"]:
        """Whether an experiment belongs to a member."""
        return np.arange(len(self.members))[:, None] == self.of


def judge_specimens(
    problem: Problem,
    effects: Sequence[str],
    forms: Mapping[str, str],
    optimum: Mapping[str, float],
    memberships: Sequence[Membership],
) -> list[Judgement]:
    """Judge the named effects over the members of each level.

    Arguments:
        problem: the measurements and the large model.
        effects: the effects of one model.
        forms: labels of their forms, unless these are the default forms.
        optimum: parameters of that model at its best fit, by name, SI.
        memberships: the members of each level.
    """
    chosen = {
        effect: problem.effects[effect][forms.get(effect) or next(iter(problem.effects[effect]))] for effect in effects
    }
    theta = problem.models.submodel(np.zeros(0, dtype=int)).held
    for form in chosen.values():
        for column, value in form.held.items():
            theta[column] = value
    for name, value in optimum.items():
        theta[problem.names.index(name)] = value
    return [
        _judged(problem, effect, int(form.columns[0]), theta, problem.models.point(optimum), membership)
        for membership in memberships
        for effect, form in chosen.items()
    ]


def _judged(
    problem: Problem, effect: str, column: int, theta: np.ndarray, x: np.ndarray, membership: Membership
) -> Judgement:
    models, uses = problem.models, range(len(membership.members))
    own = np.asarray([k for k in problem.law if problem.names[k] in membership.varying], dtype=int)
    used = problem.train.used & membership.rows[:, :, None]
    rows = np.arange(len(problem.train.values))
    outputs, _ = models.batch(np.repeat(theta[None], len(rows), axis=0), rows)
    target = problem.train.standard(outputs, used).target
    # Each member has its own size here: the residual of these fits is the error for the comparison of sizes.
    free = np.append(own, column)
    fits = models.fit(target, [Task(models.submodel(free, _held(theta, free)), x, use) for use in uses])
    target = problem.train.standard(np.sum([f.predicted for f in fits], axis=0), used).target
    neutral = float(models.submodel(own).held[column])
    found = [models.box.theta(f.x)[column] - neutral for f in fits if np.isfinite(f.cost)]
    unit = float(max([theta[column] - neutral, *found], key=abs)) or 1.0
    low, high = (models.box.theta(side)[column] for side in (models.box.low, models.box.high))
    # The bounds of the amplitude limit the sizes.
    shares = np.asarray([*_SIZES, *_NEGATIVE])
    shares = np.unique(np.clip(unit * shares, low - neutral, high - neutral) / unit)
    at, table = _tabulated(
        shares, _log_likelihoods(problem, target, x, theta, own, column, neutral + unit * shares, uses)
    )
    prior = models.box.priors[problem.names[column]]
    inside = np.clip(neutral + unit * at, low + 1e-9 * abs(unit), high - 1e-9 * abs(unit))
    weighed = weigh_explanations(at, table, np.asarray(prior.log_density(jnp.asarray(inside)), dtype=float))
    of = {
        member: _statistics(neutral + unit * at, table[m]) | {"probability": float(weighed.has[m])}
        for m, member in enumerate(membership.members)
    }
    having = weighed.named(membership.members)
    return Judgement(effect, membership.level, weighed.verdict, weighed.probability, having, of)


def _log_likelihoods(
    problem: Problem, target: Target, x: np.ndarray, theta: np.ndarray, own: np.ndarray, column: int, sizes: np.ndarray,
    uses: Sequence[int],
) -> Float[np.ndarray, "M S"]:  # fmt: skip
    """Log likelihood of each member's measurements at each size, integrated over its own parameters."""
    tasks: list[Task] = []
    for use in uses:
        for size in sizes:
            held = theta.copy()
            held[column] = size
            tasks.append(Task(problem.models.submodel(own, _held(held, own)), x, use))
    fits = problem.models.fit(target, tasks)
    log_likelihoods = np.asarray([_log_likelihood(problem, f) for f in fits]).reshape(len(uses), len(sizes))
    return np.where(np.isfinite(log_likelihoods), log_likelihoods, -1e6)


def _log_likelihood(problem: Problem, fit: FitState) -> float:
    return laplace(fit, problem.models) if len(fit.free) else -fit.cost


def _held(theta: np.ndarray, free: np.ndarray) -> dict[int, float]:
    return {k: float(value) for k, value in enumerate(theta) if k not in free}


def _tabulated(
    sizes: np.ndarray, log_likelihoods: Float[np.ndarray, "M S"]
) -> tuple[np.ndarray, Float[np.ndarray, "M P"]]:
    """Log likelihoods on a fine grid of sizes, minus the largest value of each member."""
    from scipy.interpolate import PchipInterpolator

    at = np.linspace(sizes[0], sizes[-1], _POINTS)
    table = np.stack([PchipInterpolator(sizes, row)(at) for row in log_likelihoods])
    return at, table - table.max(axis=1, keepdims=True)


def _statistics(sizes: np.ndarray, log_likelihoods: np.ndarray) -> dict[str, float]:
    if sizes[0] > sizes[-1]:
        sizes, log_likelihoods = sizes[::-1], log_likelihoods[::-1]
    share = np.exp(log_likelihoods - logsumexp(log_likelihoods))
    mean, below = float(share @ sizes), np.cumsum(share) - 0.5 * share
    q05, q95 = np.interp([0.05, 0.95], below, sizes)
    return {"mean": mean, "sd": float(np.sqrt(share @ (sizes - mean) ** 2)), "q05": float(q05), "q95": float(q95)}


class Weighed(NamedTuple):
    """The comparison of the explanations of an effect.

    Attributes:
        verdict: `population`, `specimens` or `scatter`.
        probability: of the verdict.
        has: probability that each member has the effect, (M,).
    """

    verdict: str
    probability: float
    has: Float[np.ndarray, " M"]

    def named(self, members: Sequence[str]) -> list[str]:
        """The members, of those given, that have the effect."""
        if self.verdict == "scatter":
            return []
        return [m for m, p in zip(members, self.has, strict=True) if self.verdict == "population" or p > _HAS]


def weigh_explanations(
    at: Float[np.ndarray, " P"], table: Float[np.ndarray, "M P"], log_prior: Float[np.ndarray, " P"]
) -> Weighed:
    """Compare the three explanations.

    Arguments:
        at: sizes on a grid that contains zero, relative to the largest fitted size.
        table: log likelihoods of each member at these sizes.
        log_prior: log density of the prior at these sizes, up to a constant.
    """
    many, step = len(table), float(at[1] - at[0])
    none = np.asarray([np.interp(0.0, at, row) for row in table])
    likelihoods = np.exp(table - table.max(axis=1, keepdims=True))
    log_likelihoods = table.max(axis=1) - none

    def ratios(density: Float[np.ndarray, "C P"]) -> Float[np.ndarray, "M C"]:
        """Log odds of each member: sizes with these densities against size zero."""
        with np.errstate(divide="ignore"):
            return log_likelihoods[:, None] + np.log(likelihoods @ (density.T * step))

    centres = np.linspace(at[0], at[-1], _CENTRES)
    centres = centres[np.abs(centres) > 0.5 * (centres[1] - centres[0])]
    log_centre = np.interp(centres, at, log_prior)
    log_variation = -0.5 * (_VARIATIONS / _VARIATION) ** 2
    pairs = np.asarray([(centre, variation) for centre in centres for variation in _VARIATIONS])
    log_weight = (log_centre[:, None] + log_variation).ravel()
    log_weight -= logsumexp(log_weight)
    by_number, has = _numbers(ratios(_lognormal(at, *pairs.T)), log_weight)
    scales = np.geomspace(0.02, 2.0, 24)
    # The prior density of a scale is the prior density of a size of the same magnitude.
    log_scale = np.interp(scales * np.sign(at[-1] + at[0]), at, log_prior) + np.log(scales)
    scattered = _half_normal(at, scales)
    log_scattered = ratios(scattered).sum(axis=0) + log_scale - logsumexp(log_scale)
    scatter = np.logaddexp(-math.log(2), float(logsumexp(log_scattered)) - math.log(2))
    some = float(logsumexp(by_number[1:many])) - math.log(many - 1)
    explanations = {"population": float(by_number[many]), "specimens": some, "scatter": float(scatter)}
    total = float(logsumexp(list(explanations.values())))
    verdict = max(explanations, key=lambda name: explanations[name])
    return Weighed(verdict, math.exp(explanations[verdict] - total), has)


def _lognormal(at: np.ndarray, centre: np.ndarray, variation: np.ndarray) -> Float[np.ndarray, "C P"]:
    """Lognormal densities of sizes, all of the same sign."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(at[None] / centre[:, None]) / variation[:, None]
        density = np.exp(-0.5 * ratio**2) / (math.sqrt(2 * math.pi) * variation[:, None] * np.abs(at[None]))
    return np.where(np.isfinite(density) & (at[None] * centre[:, None] > 0), density, 0.0)


def _half_normal(at: np.ndarray, scale: np.ndarray) -> Float[np.ndarray, "C P"]:
    """Normal densities of sizes about zero, cut off at the ends of the grid."""
    density = np.exp(-0.5 * (at[None] / scale[:, None]) ** 2)
    return density / (density.sum(axis=1, keepdims=True) * (at[1] - at[0]))


def _numbers(
    ratios: Float[np.ndarray, "M C"], log_weight: Float[np.ndarray, " C"]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " M"]]:
    """Log evidence that 0 to M members have the effect, with equally probable choices of the members; and the probability that
    each member has it, if every number of members from one to M is equally probable."""
    many = len(ratios)
    choices = np.asarray([gammaln(many + 1) - gammaln(k + 1) - gammaln(many - k + 1) for k in range(many + 1)])

    def sums(rows: Float[np.ndarray, "R C"]) -> Float[np.ndarray, "R1 C"]:
        """Logarithms of the elementary symmetric polynomials of the odds."""
        found = np.full((len(rows) + 1, ratios.shape[1]), -np.inf)
        found[0] = 0.0
        for row in rows:
            found[1:] = np.logaddexp(found[1:], found[:-1] + row)
        return found

    by_number = np.asarray(logsumexp(sums(ratios) + log_weight, axis=1)) - choices
    total = logsumexp(by_number[1:])
    has: list[float] = []
    for m in range(many):
        others = sums(np.delete(ratios, m, axis=0))
        with_it = logsumexp(others + ratios[m] + log_weight, axis=1) - choices[1:]
        has.append(math.exp(min(float(logsumexp(with_it) - total), 0.0)))
    return by_number, np.asarray(has)
