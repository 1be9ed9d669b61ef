"""The missing physical effect, its size, its probability, and the experiment that separates it from its look-alikes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hsed_jax.behaviour.findings import Behaviours
from hsed_jax.behaviour.names import LATER_FAR, RIGHT, RIGHT_FAR, is_far
from hsed_jax.criticism.compare import discrepancy_p_value, is_noise
from hsed_jax.criticism.prediction import Prediction
from hsed_jax.diagnosis.averaging import averaged
from hsed_jax.diagnosis.evidence import Sampled, gaussian, sample_posterior
from hsed_jax.diagnosis.findings import Candidate, Diagnosis, Explained
from hsed_jax.diagnosis.fit_state import FitState
from hsed_jax.diagnosis.fits import Model, Set
from hsed_jax.diagnosis.loadings import next_loading
from hsed_jax.diagnosis.prior_widths import prior_widths
from hsed_jax.diagnosis.probing import Probe
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.diagnosis.rivals import difference, joined, look_alikes_of, next_experiment, rivals_of, separation
from hsed_jax.diagnosis.score import explained_share
from hsed_jax.diagnosis.scores import score_p_value
from hsed_jax.diagnosis.search import Search
from hsed_jax.tables import odds

# Number of posterior draws of a reported model.
_DRAWS = 240
# Least effective number of draws of a usable sample.
_ENOUGH = 30
# Largest number of training experiments in a search; all training experiments judge its result.
_MOST_EXPERIMENTS = 6
# Number of effects that are shown during a search.
_SHOWN = 5
# An effect with this probability is likely: if it is not named, the report gives the reason.
_LIKELY = 0.2
# Least weight of a reported explanation.
_COUNTS = 0.01
# Least difference between two optima of the first model (without candidates) that is reported [nats].
_APART = 2.0
_MISSED = (
    "the calibration did not end at the best fit of the model as it is, which is taken here; calibration.starts says from how "
    "many points it looks for it"
)


def diagnose(
    problem: Problem,
    report: Callable[[str], None] = lambda line: None,
    lead: Callable[[dict[str, Any]], None] = lambda content: None,
) -> Diagnosis:
    """Look for missing effects.

    Arguments:
        problem: the measurements and the large model.
        report: receives the current activity, for a progress bar.
        lead: receives the best result after each round, in the format of `summary.json`.
    """

    is_explained = partial(noise_explains, problem)
    search = _started(problem, report)
    p_value = _p_value(problem, search.model(()).fit)
    few = problem.of_few(_MOST_EXPERIMENTS)
    if few is None:
        search.on_round = lambda: lead(_leading(problem, search))
        search.run()
    else:
        # A search on a few experiments selects the models, and all experiments judge them.
        coarse = _started(few, report)
        coarse.on_round = lambda: lead(_leading(few, coarse))
        coarse.run()
        report("what was found, on all experiments")
        search.adopt(coarse)
    report("what the model with them does")
    probe = None
    if problem.simulator is not None and problem.visited is not None:
        probe = Probe(problem, problem.simulator, problem.visited)
        _rename(probe, search)
    report("probabilities and sizes")
    models, best, none = search.all(), search.model(search.best), search.model(())
    sampled = {best.effects: sample_posterior(best.fit, problem.models, search.standard.target, _DRAWS, problem.seed)}
    rivals = rivals_of(models, best)
    behaves = {} if probe is None else {m.effects: probe.called(m) for m in (best, *rivals) if m.effects}
    behaviour = behaves.get(best.effects, best.effects)
    rivals = [m for m in rivals if behaves.get(m.effects) != behaviour]
    # The best set has its own names where the effects named after its behaviour predict worse (`_rename`).
    called = {effects: best.effects if name == behaviour else name for effects, name in behaves.items()}
    stated = stated_probabilities(problem, search, models, called)
    ranking = _ranking(problem, search, models, sampled, stated)
    is_adequate = is_explained(none.fit) and not problem.excludes
    plain = "undecided" if p_value is None else "adequate" if is_adequate else "unexplained"
    before = plain if not best.effects else "ambiguous" if rivals else "missing_effects"
    widths = prior_widths(search, models, best, before, plain, partial(_does_the_same, probe, behaves, best))
    # With other priors of the effects, another explanation leads: the data alone do not decide between the two.
    leaders = [
        search.model(one.leader)._replace(probability=best.probability) for one in widths if one.leader is not None
    ]
    rivals = rivals or leaders[:1]
    # Without a rival, the experiment separates the best model from the most probable other model.
    information = separation(problem, search, [best, *(rivals or [m for m in models if m is not best][:1])])
    look_alikes = look_alikes_of(problem, search, best, models) if best.effects else []
    chosen, worth, average, loading = None, None, None, None
    if not best.effects:
        verdict = plain
    elif rivals:
        verdict = "ambiguous"
        look_alikes = joined([*look_alikes, *(difference(best.effects, rival.effects) for rival in rivals)])
        chosen, worth = next_experiment(problem, information)
        average = averaged(problem, search, [best, *rivals])
        if probe is not None and probe.is_component_test:
            loading = next_loading(probe, search, [best, *rivals])
    else:
        verdict = "missing_effects"
    named = [c.effect for c in ranking if c.effect in best.effects]
    tests = search.unseen([none.effects, best.effects])
    theta = problem.models.theta(best.fit.x, best.fit.submodel)
    return Diagnosis(
        verdict=verdict,
        effects=named,
        forms={e: label for e, label in best.forms.items() if not problem.effects[e][label].form.is_default},
        ranking=ranking,
        look_alikes=look_alikes,
        next_experiment=chosen,
        expected_log_bayes_factor=worth,
        next_loading=loading,
        separation=information,
        p_value=p_value,
        p_value_after=_p_value(problem, best.fit) if best.effects else p_value,
        error=(problem.train.error(none.fit.predicted), tests[0]),
        error_after=(problem.train.error(best.fit.predicted), tests[1]),
        noise_floor=problem.train.noise,
        parameters={
            "before": _law(problem, none.fit, sampled.get(none.effects)),
            "after": _law(problem, best.fit, sampled[best.effects]),
        },
        optimum={problem.names[k]: float(theta[k]) for k in best.fit.free},
        prediction=_prediction(problem, best.fit, search.standard.target.sigma),
        scales=problem.scales,
        opened=_opened(problem, none.fit),
        notes=[*problem.notes, *([_MISSED] if search.missed > _APART else [])],
        averaged=average,
        explanations=_explanations(search, models, best, called, stated),
        behaviour=Behaviours()
        if probe is None
        else probe.behaviours(
            none, best, sampled[best.effects], problem.train.model_error(best.fit.predicted, search.standard)
        ),
        prior_widths=widths,
    )


def _does_the_same(probe: Probe | None, called: dict[Set, Set], best: Model, model: Model) -> bool:
    """Whether two models differ only in their formulas; `called` stores the names of the models by their behaviour."""
    if probe is None:
        return False
    for one in (best, model):
        if one.effects not in called:
            called[one.effects] = probe.called(one)
    return called[best.effects] == called[model.effects]


def _rename(probe: Probe, search: Search) -> None:
    """Name the effects of the best set after their behaviour, if the effects of these names explain nearly as much.

    The behaviour of the new effect must have the same name: otherwise, either would stand for the other.
    """
    best = search.model(search.best)
    traits = probe.traits(best)
    for effect in sorted(best.effects):
        name = probe.name(effect, traits)
        if name not in search.best:
            search.exchange(effect, name, traits[effect].driver, lambda model, name=name: name in probe.called(model))


def _explanations(
    search: Search, models: list[Model], best: Model, called: Mapping[Set, Set], stated: Mapping[Set, float]
) -> list[Explained]:
    """The models with a relevant probability, the most probable first; models with the same behaviour are one explanation."""
    groups: dict[Set, list[Model]] = {}
    for model in models:
        groups.setdefault(called.get(model.effects, model.effects), []).append(model)
    own = called.get(best.effects, best.effects)
    kept = [name for name in groups if stated.get(name, 0.0) >= _COUNTS or name == own]
    first = {name: best if name == own else groups[name][0] for name in kept}
    tests = search.unseen([model.effects for model in first.values()])
    gains = _gains(search, list(first.values()))
    found = [
        Explained(sorted(name), dict(model.forms), stated.get(name, 0.0), test, gains.get(model.effects))
        for (name, model), test in zip(first.items(), tests, strict=True)
    ]
    return sorted(found, key=lambda one: -one.weight)


def _started(problem: Problem, report: Callable[[str], None]) -> Search:
    is_explained = partial(noise_explains, problem)
    search = Search(
        problem.models, problem.train, problem.law, problem.effects, is_explained, report, problem.test, problem.start
    )
    search.start()
    return search


def _leading(problem: Problem, search: Search) -> dict[str, Any]:
    """The current result of a running search: the best set, and the probabilities of the effects."""
    best, before = search.model(search.best), search.model(())
    stated = stated_probabilities(problem, search, search.all(), {})
    ranking: list[dict[str, Any]] = [
        {"effect": effect, "family": problem.catalogue[effect].family, "probability": _probability(effect, stated)}
        for effect in problem.effects
    ]
    return {
        "is_finished": False,
        "effects": sorted(best.effects),
        "forms": {e: label for e, label in best.forms.items() if label},
        "error": {
            "before": problem.train.error(before.fit.predicted),
            "after": problem.train.error(best.fit.predicted),
            "noise_floor": problem.train.noise,
        },
        "ranking": sorted(ranking, key=lambda entry: -entry["probability"])[:_SHOWN],
    }


# Probabilities and sizes.


def stated_probabilities(
    problem: Problem, search: Search, models: Sequence[Model], called: Mapping[Set, Set]
) -> dict[Set, float]:
    r"""The probability of each explanation, by the names of its behaviour: models with the same behaviour are one explanation.

    The weight $p_M$ of a model compares the formulas of the catalogue only.  The part of the misfit that a model does not explain
    may be due to anything, and a specimen whose formula is not in the catalogue may be described by a wrong one:

    $$P = \sum_M r_M\,p_M\,\Big(1 - \frac{E_M^2 - s^2}{E_0^2 - s^2}\Big)$$

    with the errors E of held-out data, of the first model $E_0$, the noise floor s, and the share $r_M$ of right names of models
    with such an error (`RIGHT`, `RIGHT_FAR`).  A model whose residual the noise explains leaves nothing.
    """
    counted = [m for m in models if m.probability > 0]
    before, *errors = search.unseen([frozenset(), *(m.effects for m in counted)])
    may_be_noise = search.by_evidence  # if not what the best fit leaves, then not what a worse one leaves
    stated: dict[Set, float] = {}
    for model, error in zip(counted, errors, strict=True):
        name, share, noise = called.get(model.effects, model.effects), RIGHT, problem.train.noise
        if not (may_be_noise and noise_explains(problem, model.fit)):
            share = (RIGHT_FAR if is_far(noise, error) else RIGHT) * explained_share(noise, before, error)
        stated[name] = stated.get(name, 0.0) + share * model.probability
    return stated


def _probability(effect: str, stated: Mapping[Set, float]) -> float:
    """Probability of an effect: of all explanations with it."""
    return min(sum(probability for name, probability in stated.items() if effect in name), RIGHT)


def _ranking(
    problem: Problem, search: Search, models: list[Model], sampled: dict[Set, Sampled], stated: Mapping[Set, float]
) -> list[Candidate]:
    by_set = {m.effects: m for m in models}
    best = search.best
    shown: dict[str, tuple[Model, Model]] = {}
    for effect in problem.effects:
        if effect in best:
            shown[effect] = by_set[best], by_set.get(best - {effect}) or search.model(best - {effect})
            continue
        # The most probable model with the effect: with no more effects than the best model, or the best model with this effect.
        options = [m for m in models if effect in m.effects and m.effects - {effect} in by_set]
        if not options:
            continue  # it was not fitted, because its predicted gain is smaller than that of others, or its simulations fail
        instead = [m for m in options if len(m.effects) <= max(len(best), 1)] or options
        beside = by_set.get(best | {effect})
        if beside is None or beside.probability <= instead[0].probability:
            beside = instead[0]
        shown[effect] = beside, by_set[beside.effects - {effect}]
    tests = search.unseen([model.effects for model, _ in shown.values()])
    gains = _gains(search, [model for model, _ in shown.values()])
    found: list[Candidate] = []
    for (effect, (model, without)), test in zip(shown.items(), tests, strict=True):
        sample = sampled.get(model.effects)
        score = search.scores[effect]
        probability = _probability(effect, stated)
        found.append(
            Candidate(
                effect=effect,
                family=problem.catalogue[effect].family,
                probability=probability,
                log_evidence_gain=model.log_evidence - without.log_evidence,
                rao_statistic=score,
                rao_p_value=score_p_value(score),
                score=gains.get(model.effects),
                estimate=_estimate(problem, effect, model, sample),
                form=model.forms[effect] or None,
                forms=dict(sorted(model.shares[effect].items(), key=lambda item: -item[1]))
                if model.forms[effect]
                else {},
                error_train=problem.train.error(model.fit.predicted),
                error_test=test,
                reason=_reason(search, model, by_set[best]) if probability >= _LIKELY and effect not in best else None,
            )
        )
    # Named effects come first, sorted by the evidence that the model loses without them.
    found.sort(key=lambda c: (c.effect not in best, -c.log_evidence_gain if c.effect in best else -c.probability,
                              -c.log_evidence_gain))  # fmt: skip
    if (
        len(best) > 1
        and is_far(problem.train.noise, found[0].error_test)
        and not noise_explains(problem, by_set[best].fit)
    ):
        further = found[1 : len(best)]
        found[1 : len(best)] = [replace(c, probability=LATER_FAR / RIGHT_FAR * c.probability) for c in further]
    return found


def _gains(search: Search, models: Sequence[Model]) -> dict[Set, dict[str, float]]:
    """Gain of the scored sets in the log density of held-out data over the first model, by set [nats]."""
    scored = [m.effects for m in models if m.probability > 0]
    gains = zip(scored, search.gains(scored, frozenset()), strict=True)
    return {s: {"gain": g.total, "standard_error": g.standard_error} for s, g in gains if math.isfinite(g.total)}


def _reason(search: Search, model: Model, best: Model) -> str | None:
    """The reason why a model with a likely effect is not named."""
    if not model.effects > best.effects:
        instead = " + ".join(sorted(best.effects - model.effects))
        if best.probability < model.probability:  # the test experiments have chosen the best set
            return f"the model predicts the experiments that were not fitted better with {instead} in its place"
        nats = math.log(best.probability / max(model.probability, 1e-300))
        return f"the odds of {instead} in its place are {odds(nats)}"
    return search.obstacle(model.effects, best.effects) or "the search ended before it"


def _estimate(problem: Problem, effect: str, model: Model, sample: Sampled | None) -> dict[str, dict[str, Any]]:
    """Mean, sd and quantiles of the parameters of an effect in its form, from draws or else from the Hessian at the fit."""
    found: dict[str, dict[str, Any]] = {}
    form, kind = problem.effects[effect][model.forms[effect]].form, problem.catalogue[effect]
    in_units = form.physical(kind)
    for known in form.parameters(kind).values():
        column = problem.names.index(f"{effect}.{known.name}")
        numbers = _moments(problem, model.fit, sample, column)
        found[known.name] = numbers | {"unit": problem.pair.unit(known.unit)}
        if known.physical is not None and known.physical.name in in_units:
            factor = known.physical.factor(problem.scales)
            unit = problem.pair.unit(known.physical.unit)
            found[known.physical.name] = {k: v * factor for k, v in numbers.items()} | {"unit": unit}
    return found


def _moments(problem: Problem, fit: FitState, sample: Sampled | None, column: int) -> dict[str, float]:
    """Mean, sd, 5 % and 95 % quantile of a parameter."""
    if sample is not None and sample.effective >= _ENOUGH:
        return sample.moments(column)
    mean, sd = float(problem.models.theta(fit.x, fit.submodel)[column]), _deviation(problem, fit, column)
    box = problem.models.box
    low, high = (float(box.theta(side)[column]) for side in (box.low, box.high))
    q05, q95 = np.clip([mean - 1.645 * sd, mean + 1.645 * sd], low, high)
    return {"mean": mean, "sd": sd, "q05": float(q05), "q95": float(q95)}


def _deviation(problem: Problem, fit: FitState, column: int) -> float:
    """Change of a parameter over one posterior sd of its coordinate (from the Hessian), at most over one sd of its prior."""
    _, covariance = gaussian(fit, problem.models.box)
    place = int(np.flatnonzero(fit.free == column)[0])
    step = min(math.sqrt(covariance[place, place]), 1.0)
    moved = fit.x.copy()
    moved[column] += step
    box = problem.models.box
    return float(abs(box.theta(moved)[column] - box.theta(fit.x)[column]))


def _opened(problem: Problem, fit: FitState) -> dict[str, float]:
    """Estimates of the first model for the parameters whose prior bounds are removed, SI."""
    theta = problem.models.theta(fit.x, fit.submodel)
    return {name: float(theta[problem.names.index(name)]) for name in problem.opened}


def _law(problem: Problem, fit: FitState, sample: Sampled | None) -> dict[str, dict[str, float]]:
    return {problem.names[k]: _moments(problem, fit, sample, int(k)) for k in problem.law}


def _prediction(problem: Problem, fit: FitState, sigma: np.ndarray) -> Prediction:
    train = problem.train
    known = problem.outputs, train.groups, problem.experiments, train.values, train.used
    return Prediction(*known, fit.predicted, fit.predicted, sigma, sigma, np.ones(len(train.values), dtype=bool))


def noise_explains(problem: Problem, fit: FitState) -> bool:
    """Whether the noise explains the residual of a fit; False if the noise is unknown."""
    return is_noise(_p_value(problem, fit), problem.train.error(fit.predicted), problem.train.noise)


def _p_value(problem: Problem, fit: FitState) -> float | None:
    """Probability that the noise alone causes the residual of a fit (`discrepancy_p_value`); None if the noise is unknown."""
    train = problem.train
    is_declared = ~np.isnan(train.declared)
    sigma = train.sigma(np.where(is_declared, train.declared, 1.0), fit.predicted)
    return discrepancy_p_value(_prediction(problem, fit, sigma), is_declared, len(fit.free))
