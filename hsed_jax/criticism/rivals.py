"""Explanations that are as good: which effects stand for one another, and which experiment would tell them apart."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hsed_jax.criticism.problem import Problem
from hsed_jax.criticism.search import Model, Search, Set

# Rivals whose posterior odds against the best are at least this are as good.
_AS_GOOD = 1 / 3
# A rival mends the model, too, if it gains at least this share of what the best one gains.
_MENDS = 0.5
# Expected log Bayes factor that makes an experiment worth proposing.
_WORTHWHILE = 1.0


def separation(problem: Problem, search: Search, rivals: Sequence[Model]) -> Float[np.ndarray, " c"]:
    r"""Expected log Bayes factor between rivals of each candidate experiment [nats]; zero where a simulation diverges.

    Between two models with Gaussian errors it is $\frac12\sum_j w_j(\Delta f_j/\sigma_j)^2$ (Kullback & Leibler 1951; Box &
    Hill 1967), averaged over the pairs of rivals by their probabilities.
    """
    rows = problem.rows + np.arange(len(problem.candidates))
    information = np.zeros(len(rows))
    if len(rivals) < 2 or not rows.size:
        return information
    outputs, ok = problem.models.predict([(m.fit.x, m.fit.free) for m in rivals], rows)
    sigma = problem.sigma(search.errors, outputs[0])
    worth = search.worth[problem.train.groups]
    shares = search.probabilities(rivals)
    for i in range(len(rivals)):
        for j in range(i):
            apart = 0.5 * np.sum(worth * ((outputs[i] - outputs[j]) / sigma) ** 2, axis=1)
            information += shares[i] * shares[j] * np.where((ok[i] > 0) & (ok[j] > 0), apart, 0.0)
    return information / max(float(1 - shares @ shares) / 2, 1e-12)


def next_experiment(
    problem: Problem, information: Float[np.ndarray, " c"]
) -> tuple[dict[str, float] | None, float | None]:
    """The candidate that separates rivals best and what it is expected to tell [nats]; None where none would tell."""
    if not information.size or information.max() < _WORTHWHILE:
        return None, None
    best = int(np.argmax(information))
    return dict(problem.candidates[best]), float(information[best])


def rivals_of(models: Sequence[Model], best: Model) -> list[Model]:
    """Models as probable as the best that name something else (and not only something more)."""
    return [
        m
        for m in models
        if m.effects != best.effects
        and not m.effects > best.effects
        and m.log_posterior - best.log_posterior >= math.log(_AS_GOOD)
    ]


def look_alikes_of(problem: Problem, search: Search, best: Model) -> list[list[str]]:
    """For each named effect, those that could stand in its place with predictions that differ by less than the noise."""
    rows = np.arange(problem.rows + len(problem.candidates))
    exchanged = [m for m in search.all() if len(m.effects) == len(best.effects) and m.effects != best.effects]
    groups = []
    for effect in sorted(best.effects):
        without = search.model(best.effects - {effect})
        gain = best.log_evidence - without.log_evidence
        others = [
            m
            for m in exchanged
            if m.effects > without.effects and m.log_evidence - without.log_evidence >= _MENDS * gain
        ]
        if not others:
            continue
        outputs, ok = problem.models.predict([(m.fit.x, m.fit.free) for m in (best, *others)], rows)
        sigma = problem.sigma(search.errors, outputs[0])
        alike = []
        for m, predicted, converged in zip(others, outputs[1:], ok[1:], strict=True):
            apart = ((predicted - outputs[0]) / sigma) ** 2
            by_output = np.stack(
                [apart[:, problem.train.groups == g].mean(axis=1) for g in np.unique(problem.train.groups)]
            )
            both = (converged > 0) & (ok[0] > 0)
            if both.any() and np.all(by_output[:, both] < 1):
                alike.append(next(iter(m.effects - without.effects)))
        if alike:
            groups.append([effect, *alike])
    return groups


def difference(best: Set, rival: Set) -> list[str]:
    """What two sets do not share: the effects that stand for one another."""
    return [*sorted(best - rival), *sorted(rival - best)] or sorted(best)


def joined(groups: Sequence[Sequence[str]]) -> list[list[str]]:
    """Groups that share a member, as one."""
    joined: list[list[str]] = []
    for group in groups:
        touching = [known for known in joined if set(known) & set(group)]
        joined = [known for known in joined if known not in touching]
        joined.append(list(dict.fromkeys([e for known in touching for e in known] + list(group))))
    return joined
