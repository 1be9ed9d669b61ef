"""A diagnosis over a population: the meaning of its effects for the specimens, and the effects of single specimens."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hsed_jax.diagnosis.diagnose import diagnose, noise_explains
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.diagnosis.fit_state import Task
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.diagnosis.specimens import Membership, judge_specimens
from hsed_jax.measurements import Campaign
from hsed_jax.study.build import Built
from hsed_jax.study.levels import members_of

# Up to so many members that the noise does not explain are searched alone.
_SEARCHED = 3


def over_specimens(
    found: Diagnosis,
    problem: Problem,
    problem_of_some: Callable[[Campaign], Problem],
    built: Built,
    campaign: Campaign,
    report: Callable[[str], None],
) -> Diagnosis:
    """The diagnosis with the meaning of its effects for the specimens of each level; unchanged without levels.

    If no effect helps all specimens, the few specimens whose measurements the noise does not explain are searched alone.

    Arguments:
        found: the diagnosis.
        problem: of it.
        problem_of_some: the same of some of the experiments.
        built: the study.
        campaign: the experiments.
        report: called with the current activity.
    """
    if not built.inference.levels:
        return found
    memberships = memberships_of(built, campaign)
    if found.effects:
        report("which specimens have it")
        judged = judge_specimens(problem, found.effects, found.forms, found.optimum, memberships)
        return replace(found, specimens=judged)
    if found.verdict != "unexplained":
        return found
    inner, judged = memberships[-1], []
    for member in _odd(problem, inner):
        report(f"{inner.level} {member} by itself")
        ids = [e.id for e, m in zip(campaign.train, inner.of, strict=True) if inner.members[m] == member]
        experiments = tuple(e for e in campaign if e.id in ids)
        own = diagnose(problem_of_some(replace(campaign, experiments=experiments)), report)
        if own.effects:
            judged += judge_specimens(problem, own.effects, own.forms, own.optimum, [inner])
    unique = {(one.effect, one.level): one for one in judged if one.verdict != "scatter"}
    return replace(found, specimens=list(unique.values()))


def memberships_of(built: Built, campaign: Campaign) -> list[Membership]:
    """The levels of the training experiments."""
    levels, experiments = built.inference.levels, campaign.train.experiments
    table = members_of(levels, campaign, experiments, len(experiments))
    names = [tuple(v.name for v in level.varying) for level in levels]
    return [Membership(lv.name, lv.members, table[:, i], names[i]) for i, lv in enumerate(levels)]


def _odd(problem: Problem, membership: Membership) -> list[str]:
    """The members that the noise does not explain, each at its own best fit, if they are few."""
    assert problem.start is not None
    train, models = problem.train, problem.models
    # The common parameters, too: one odd member has moved them for all.
    own = problem.law
    theta = models.submodel(np.zeros(0, dtype=int)).held
    theta[problem.law] = models.box.theta(problem.start)[problem.law]
    used = train.used & membership.rows[:, :, None]
    rows = np.arange(len(train.values))
    outputs, _ = models.batch(np.repeat(theta[None], len(rows), axis=0), rows)
    member = models.submodel(own, {k: float(v) for k, v in enumerate(theta) if k not in own})
    uses = range(len(membership.members))
    fits = models.fit(train.standard(outputs, used).target, [Task(member, problem.start, use) for use in uses])
    odd = []
    for name, mine, fit in zip(membership.members, used, fits, strict=True):
        # The noise of all, and the measurements of one.
        one = problem._replace(train=train._replace(used=mine))
        if not noise_explains(one, fit):
            odd.append(name)
    return odd if len(odd) <= min(_SEARCHED, len(membership.members) // 2) else []
