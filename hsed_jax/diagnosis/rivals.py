"""Equally good explanations: the effects that can replace one another, and the experiment that separates them best."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.diagnosis.evidence import gaussian
from hsed_jax.diagnosis.fit_state import FitState
from hsed_jax.diagnosis.fits import Model, Set
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.diagnosis.search import Search

# Rivals with at least these odds against the best model count as equally good.
_AS_GOOD = 1 / 10
# A model with lower odds than these against the best model is excluded.
_EXCLUDED = 0.01
# Largest sd of a parameter without information from data or bounds, in coordinates of order one.
_WIDEST = 10.0
WORTHWHILE = 1.0
"""Least expected log Bayes factor of an experiment that is proposed [nats]."""


def separation(problem: Problem, search: Search, rivals: Sequence[Model]) -> Float[np.ndarray, " c"]:
    r"""Expected log Bayes factor between rivals for each candidate experiment [nats]; zero if a simulation diverges.

    With pending experiments, it is what a candidate adds to these, because all their results will be known together.

    Each rival predicts an experiment as a Gaussian, $N(f, J C J^\top + \Sigma)$.  The covariance C of its parameters is included,
    so that a difference which a new fit would absorb does not count.  For two Gaussians, the expectation is the Kullback–Leibler
    divergence (1951) from the true one (Box & Hill 1967).  It is averaged over the pairs of rivals and over which rival of a
    pair is true, weighted by their probabilities.
    """
    rows = problem.rows + np.arange(len(problem.candidates))
    count = len(rows) - problem.pending
    if len(rivals) < 2 or not rows.size:
        return np.zeros(count)
    predictions = [predictive(problem.models, m.fit, rows) for m in rivals]
    root = np.sqrt(search.standard.worth[problem.train.groups]) / problem.sigma(
        search.standard.errors, predictions[0].mean
    )
    return expected_log_bayes_factor(predictions, root, shares_of(rivals), problem.pending)


class Predictive(NamedTuple):
    """Predictions of a rival for experiments: Gaussians N(f, L Lᵀ + noise).

    Attributes:
        mean: f, outputs in SI, (c, J).
        spread: L, from the uncertainty of the parameters, (c, J, p).
        ok: whether the simulation converged, (c,).
    """

    mean: Float[np.ndarray, "c J"]
    spread: Float[np.ndarray, "c J p"]
    ok: Float[np.ndarray, " c"]


def expected_log_bayes_factor(
    predictions: Sequence[Predictive], root: Float[np.ndarray, "c J"], shares: Float[np.ndarray, " m"], pending: int = 0
) -> Float[np.ndarray, " n"]:
    """Expected log Bayes factor between rivals for each experiment that is not pending [nats], (n,).

    Arguments:
        predictions: of the rivals.
        root: one over the standard deviation of the noise.
        shares: probabilities of the rivals.
        pending: number of experiments, the last ones, whose results are known before those of any other experiment.
    """
    count = len(root) - pending
    information = np.zeros(count)
    for i, one in enumerate(predictions):
        for j, other in enumerate(predictions[:i]):
            apart = root * (one.mean - other.mean)
            own, others = (root[..., None] * prediction.spread for prediction in (one, other))
            both = (one.ok > 0) & (other.ok > 0)
            told = shares[i] * _told(apart, own, others, both, count) + shares[j] * _told(
                apart, others, own, both, count
            )
            told *= shares[i] * shares[j] / (shares[i] + shares[j])
            information += np.where(both[:count], told, 0.0)
    return information / max(float(1 - shares @ shares) / 2, 1e-12)


class Around(NamedTuple):
    """Points around a fit, for derivatives in its free coordinates.

    Attributes:
        points: the fit, then one step along each coordinate, (P,) each.
        steps: lengths of the steps, (p,).
        factor: factor L of the covariance L Lᵀ of the free coordinates, (p, p).
    """

    points: list[Float[np.ndarray, " P"]]
    steps: Float[np.ndarray, " p"]
    factor: Float[np.ndarray, "p p"]


def around(models: NestedModels, fit: FitState) -> Around:
    """Points around a fit, within the spread of its posterior."""
    box = models.box
    _, covariance = gaussian(fit, box)
    low, high = box.low[fit.free], box.high[fit.free]
    deviation = np.sqrt(np.diag(covariance))
    # The sd of a parameter without information is limited to half the width of the box.
    shrink = np.minimum(1.0, np.where(np.isfinite(high - low), 0.5 * (high - low), _WIDEST) / deviation)
    factor = shrink[:, None] * np.linalg.cholesky(covariance + 1e-12 * np.diag(deviation**2))
    steps = 0.1 * np.minimum(shrink * deviation, 1.0)
    steps = np.where(fit.x[fit.free] + steps > high, -steps, steps)
    points = [fit.x]
    for k, step in zip(fit.free, steps, strict=True):
        x = fit.x.copy()
        x[k] += step
        points.append(x)
    return Around(points, steps, factor)


def spread_of(
    near: Around, outputs: Float[np.ndarray, "p1 c J"], ok: Float[np.ndarray, "p1 c"]
) -> Float[np.ndarray, "c J p"]:
    """L of `Predictive`, from the outputs at the points; the derivative is zero if the simulation of a coordinate diverges."""
    slopes = (outputs[1:] - outputs[0]) * ok[1:, :, None] / near.steps[:, None, None]
    return np.einsum("pcj,pq->cjq", slopes, near.factor)


def predictive(models: NestedModels, fit: FitState, rows: np.ndarray) -> Predictive:
    """The predictions of a fitted model for the experiments in `rows`."""
    near = around(models, fit)
    outputs, ok = models.predict([(x, fit.submodel) for x in near.points], rows)
    return Predictive(outputs[0], spread_of(near, outputs, ok), ok[0])


def _told(apart: np.ndarray, true: np.ndarray, other: np.ndarray, ok: np.ndarray, count: int) -> np.ndarray:
    """Information from each of the first `count` experiments, in addition to all other ones, which are pending [nats], (count,).

    The true prediction is N(δ, I + T Tᵀ), the other one N(0, I + O Oᵀ): δ (c, J), T and O (c, J, p).
    """
    directions = np.concatenate([true, other, apart[..., None]], axis=2)
    sizes = [true.shape[2], true.shape[2] + other.shape[2]]
    known = np.where(ok[count:, None, None], directions[count:], 0.0).reshape(-1, directions.shape[2])
    if not len(known):
        return _divergence(directions, sizes)
    # Only products of the columns matter, and a triangular factor has the same products as all pending samples.
    triangle = np.linalg.qr(known, mode="r")
    beside = np.broadcast_to(triangle, (count, *triangle.shape))
    return _divergence(np.concatenate([directions[:count], beside], axis=1), sizes) - _divergence(triangle[None], sizes)


def _divergence(columns: np.ndarray, sizes: Sequence[int]) -> np.ndarray:
    """Divergence from N(δ, I + T Tᵀ) to N(0, I + O Oᵀ) [nats], (c,), in the few directions of the columns T, O, δ (c, J, ·)."""
    directions = np.linalg.qr(columns, mode="r")
    t, o, delta = np.split(directions, sizes, axis=2)
    size = directions.shape[1]
    of_true, of_other = (np.eye(size) + part @ np.swapaxes(part, 1, 2) for part in (t, o))
    solved = np.linalg.solve(of_other, np.concatenate([of_true, delta], axis=2))
    traces = np.trace(solved[..., :-1], axis1=1, axis2=2) - size
    squares = np.einsum("cr,cr->c", delta[..., 0], solved[..., -1])
    return 0.5 * (traces + squares + np.linalg.slogdet(of_other)[1] - np.linalg.slogdet(of_true)[1])


def next_experiment(
    problem: Problem, information: Float[np.ndarray, " c"]
) -> tuple[dict[str, float] | None, float | None]:
    """The candidate that separates rivals best, and its expected log Bayes factor [nats]; None if none is worthwhile."""
    if not information.size or information.max() < WORTHWHILE:
        return None, None
    best = int(np.argmax(information))
    return dict(problem.candidates[best]), float(information[best])


def shares_of(models: Sequence[Model]) -> Float[np.ndarray, " m"]:
    """Probabilities of models, normalised to a sum of one; equal if none was scored."""
    found = np.asarray([m.probability for m in models])
    return found / found.sum() if found.any() else np.full(len(found), 1 / len(found))


def rivals_of(models: Sequence[Model], best: Model) -> list[Model]:
    """Models that are as good as the best one, with no more effects, of which at least one is not in the best model."""
    as_good = _instead(models, best, _AS_GOOD)
    return [m for m in as_good if len(m.effects) <= len(best.effects) and not m.effects < best.effects]


def look_alikes_of(problem: Problem, search: Search, best: Model, models: Sequence[Model]) -> list[list[str]]:
    """For each named effect, the effects that can replace it.  Their predictions differ by less than the noise of a sample, but
    many samples together may still exclude an effect; such an effect is omitted."""
    rows = np.arange(problem.rows + len(problem.candidates))
    groups: list[list[str]] = []
    for effect in sorted(best.effects):
        rest = best.effects - {effect}
        others = [m for m in _instead(models, best, _EXCLUDED) if m.effects > rest and len(m.effects - rest) == 1]
        if not others:
            continue
        outputs, ok = problem.models.predict([(m.fit.x, m.fit.submodel) for m in (best, *others)], rows)
        sigma = problem.sigma(search.standard.errors, outputs[0])
        alike: list[str] = []
        for m, predicted, converged in zip(others, outputs[1:], ok[1:], strict=True):
            apart = ((predicted - outputs[0]) / sigma) ** 2
            by_output = np.stack(
                [apart[:, problem.train.groups == g].mean(axis=1) for g in np.unique(problem.train.groups)]
            )
            both = (converged > 0) & (ok[0] > 0)
            if both.any() and np.all(by_output[:, both] < 1):
                alike.append(next(iter(m.effects - rest)))
        if alike:
            groups.append([effect, *alike])
    return groups


def _instead(models: Sequence[Model], best: Model, least: float) -> list[Model]:
    """Other models with at least these odds against the best one."""
    return [m for m in models if m.effects != best.effects and m.probability >= least * best.probability > 0]


def difference(best: Set, rival: Set) -> list[str]:
    """The effects that only one of two sets has, so that they replace one another."""
    return [*sorted(best - rival), *sorted(rival - best)] or sorted(best)


def joined(groups: Sequence[Sequence[str]]) -> list[list[str]]:
    """The groups, after those with a common member are merged."""
    joined: list[list[str]] = []
    for group in groups:
        touching = [known for known in joined if set(known) & set(group)]
        joined = [known for known in joined if known not in touching]
        joined.append(list(dict.fromkeys([e for known in touching for e in known] + list(group))))
    return joined
