"""Two explanations of one specimen: made, measured, and told apart, for many designs side by side.

A pair is two nested models, the plain law with the one effect and with the other; the specimen has the first, its parameters
drawn from the priors of that model.  So a probability above 0.95 is right 19 times of 20, whatever a design asks for, if evidence
is what it should be.  Sizes have priors of their own, log-normal about the one that changes the response by 15 %: those of the
catalogue allow for effects that any two experiments tell, and for some effects far more of these than for others.

After every experiment both models are fitted and weighed as a diagnosis does it: bounded descents from several starts, Laplace's
method, even prior odds, an error that is relative to what the better one predicts.  All designs of a seed choose from the same
candidates, of which each has one noise, whoever asks for it, and advance in lockstep: their simulations are lanes of one batch
(`hsed_jax.diagnosis.batch`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from case import PAPER
from scipy.special import expit

import hsed_jax as hx
from hsed_jax.design.acquisition import sobol_candidates
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.design.discrepancy import discrepancy, variance_over
from hsed_jax.design.kriging import fit_kriging
from hsed_jax.diagnosis.batch import Predictions
from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.fit_state import FitState, Submodel, Target, Task
from hsed_jax.diagnosis.fits import spread
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.rivals import Predictive, expected_log_bayes_factor, predictive
from hsed_jax.inference.priors import Prior
from hsed_jax.study.build import Built

INITIAL, MOST, CERTAIN, CANDIDATES = 2, 12, 0.95, 64
# Sizes: relative change of the response at their median, and the sd of their logarithm; experiments and sizes that tell.
_CHANGE, _SPREAD, _COMPARED, _SIZES = 0.15, 0.5, 16, 12
# Starts of a fit spread over its priors, others each time, besides the last end.
_AFRESH = 1


@dataclass(frozen=True)
class Test:
    """A kind of test: a study, the relative noise of what it measures, and the pairs of effects that are asked for in it."""

    path: str
    noise: float
    settings: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]


_COMMON = ("steps=[design]",)
_CYCLES = (
    "excitation.imposed={amplitudes: [a1, a2, a3], cycles: 1, rate: v}",
    "inputs={a1: {uniform: [5, 60], unit: mm}, a2: {uniform: [5, 60], unit: mm}, a3: {uniform: [5, 60], unit: mm}, "
    "v: {loguniform: [5, 200], unit: mm/s}}",
    "model={spring: bouc_wen, parameters: {A: {uniform: [2.0e6, 9.0e6]}, beta: {uniform: [60, 250]}, gamma: 0.0, n: 1.0}}",
    "experiments={virtual: {parameters: {A: 5.0e6, beta: 125.0, gamma: 0.0, n: 1.0}}}",
    "observe=quantities",
    "quantities=[peak_force, dissipated_energy]",
)  # fmt: skip
TESTS = {
    "shaken": Test(str(PAPER), 0.15, _COMMON, (
        ("stiffness_degradation", "strength_degradation"),
        ("viscous_damping", "quadratic_damping"),
        ("viscous_damping", "coulomb_friction"),
        ("hardening", "cubic_stiffness"),
        ("asymmetry", "quadratic_stiffness"),
        ("slip", "peak_softening"),
    )),
    "loading history": Test(str(PAPER.with_name("cyclic.yaml")), 0.05, (*_COMMON, *_CYCLES), (
        ("stiffness_degradation", "peak_softening"),
        ("rate_dependence", "viscous_damping"),
        ("hardening", "isotropic_hardening"),
        ("yield_sharpness", "loop_shape"),
    )),
}  # fmt: skip


class Large(NamedTuple):
    """The model with all effects of a kind of test in it, and the candidates of one seed.

    Attributes:
        lanes: predictions, of a candidate by its number.
        models: the nested models on them.
        law: its parameters' columns.
        columns: of each effect in its default form.
        held: what that form holds other parameters at.
        cube: the candidates in the unit cube, (c, d).
        noise: relative to what is measured.
    """

    lanes: Predictions
    models: NestedModels
    law: np.ndarray
    columns: Mapping[str, np.ndarray]
    held: Mapping[str, Mapping[int, float]]
    cube: np.ndarray
    noise: float

    def submodel(self, *effects: str) -> Submodel:
        """The law with these effects."""
        held = {column: value for effect in effects for column, value in self.held[effect].items()}
        return self.models.submodel(np.concatenate([self.law, *(self.columns[e] for e in effects)]), held)


_MEDIANS: dict[str, dict[str, float]] = {}


# Absent is a size whose logarithm is none.
@np.errstate(divide="ignore", invalid="ignore")
@lru_cache(2)
def large(test: str, seed: int) -> Large:
    """The large model of a kind of test."""
    kind = TESTS[test]
    built = Built(hx.load_study(kind.path, [*kind.settings, f"error={{relative: {kind.noise}}}"]))
    cube = np.asarray(sobol_candidates(CANDIDATES, len(built.experiments.space.names), seed))
    compared = built.experiments.space.initial_design(_COMPARED)
    # What a problem is made of wants an experiment; nothing is fitted to this one.
    first = {name: float(value) for name, value in built.experiments.space.point(cube[0]).si.items()}
    one = hx.Experiment("E01", first, quantities=dict.fromkeys(built.observed.outputs, 1.0))
    effects = list(dict.fromkeys(effect for pair in kind.pairs for effect in pair))
    problem = problem_of(
        built, built.site.empty_campaign().add(one), effects=effects, cube=np.concatenate([cube, compared])
    )
    forms = {effect: next(iter(problem.effects[effect].values())) for effect in effects}

    def lanes(thetas, candidates, samples=None):
        return problem.models.batch(thetas, candidates + problem.rows, samples)

    columns, held = ({e: getattr(form, what) for e, form in forms.items()} for what in ("columns", "held"))
    found = Large(lanes, problem.models.within(problem.models.box, lanes), problem.law, columns, held, cube, kind.noise)
    if test not in _MEDIANS:
        _MEDIANS[test] = {effect: _median(found, effect) for effect in effects}
    box = problem.models.box
    amplitudes = {box.names[columns[e][0]]: Prior("lognormal", [np.log(m), _SPREAD]) for e, m in _MEDIANS[test].items()}
    return found._replace(models=found.models.within(Box(box.priors | amplitudes, limits=box.limits), lanes))


def _median(case: Large, effect: str) -> float:
    """The size at which an effect changes the response by 15 %; at most the largest that is probable at all."""
    submodel, plain, column = case.submodel(effect), case.submodel(), case.columns[effect][0]
    largest = float(case.models.box.priors[case.models.box.names[column]].quantile(0.98))
    sizes = largest * np.geomspace(1e-3, 1.0, _SIZES)
    starts = np.tile(case.models.neutral, (1 + _SIZES, 1))
    others = np.setdiff1d(submodel.free, column)
    starts[:, others] = case.models.box.quantiles(others, np.full((1, len(others)), 0.5))
    starts[1:, column] = [case.models.box.x(np.full(starts.shape[1], size))[column] for size in sizes]
    points = [(x, submodel if number else plain) for number, x in enumerate(starts)]
    outputs, ok = case.models.predict(points, CANDIDATES + np.arange(_COMPARED))
    change = np.sqrt(np.mean((outputs[1:] / outputs[0] - 1) ** 2, axis=(1, 2)))
    enough = (change > _CHANGE) & (ok[1:] > 0).all(axis=1)
    return float(sizes[np.argmax(enough)] if enough.any() else largest)


@dataclass
class Trial:
    """A design on its way: what it has asked so far, and how its models fit.

    Attributes:
        by: what it chooses by.
        asked: numbers of the candidates, in order.
        fits: of both models.
        probability: of the right explanation.
    """

    by: str
    asked: list[int]
    fits: list[FitState] = field(default_factory=list)
    probability: float = 0.5

    @property
    def is_over(self) -> bool:
        """Whether it is certain, or has asked for all it may."""
        return max(self.probability, 1 - self.probability) > CERTAIN or len(self.asked) == MOST


class State(NamedTuple):
    """What a criterion chooses by: what was asked and found, and what both models predict of all candidates.

    Attributes:
        asked: numbers of the candidates that were measured, in order.
        shares: probabilities of the two models.
        models, fits: of both models.
        plain: the fit of the plain law, for a criterion that asks for it.
        measured: outputs at those asked, (n, J).
        cube: the candidates, (c, d).
        noise: relative to what is measured.
        seed: of what is drawn.
    """

    asked: Sequence[int]
    shares: np.ndarray
    models: NestedModels
    fits: Sequence[FitState]
    plain: FitState | None
    measured: np.ndarray
    cube: np.ndarray
    noise: float
    seed: int

    def predicted(self) -> tuple[list[Predictive], np.ndarray]:
        """What both models predict of the candidates, and the noise there, (c, J)."""
        rows = np.arange(len(self.cube))
        found = [predictive(self.models, fit, rows) for fit in self.fits]
        best = found[int(np.argmax(self.shares))]
        return found, np.maximum(self.noise * np.abs(best.mean), 1e-12)


@np.errstate(divide="ignore", invalid="ignore")
def trials_of(test: str, right: str, rival: str, seed: int, criteria: Sequence[str]) -> list[Trial]:
    """Designs of one seed, each to its end.

    Arguments:
        test: kind of test.
        right, rival: the effect of the specimen, and the other explanation.
        seed: of the specimen, the candidates, and the noise.
        criteria: names of what the designs choose by.
    """
    case = large(test, seed)
    made = _measured(case, right, seed)
    pair = [case.submodel(right), case.submodel(rival)]
    first = Trial("", list(range(INITIAL)))
    _fit(case, made, [first], pair, seed)
    trials = [replace(first, by=by, asked=list(first.asked)) for by in criteria]
    while active := [trial for trial in trials if not trial.is_over]:
        for trial, plain in zip(active, _plain(case, made, active, seed), strict=True):
            trial.asked.append(_next(case, made, trial, plain, seed))
        _fit(case, made, active, pair, seed)
    return trials


def _measured(case: Large, right: str, seed: int) -> np.ndarray:
    """What every candidate measures of a specimen drawn from the priors of the right model, (c, J)."""
    random = np.random.default_rng([seed, *right.encode()])
    submodel, rows = case.submodel(right), np.arange(len(case.cube))
    while True:
        x = np.array(case.models.neutral)
        shares = random.uniform(0.001, 0.999, size=(1, len(submodel.free)))
        x[submodel.free] = case.models.box.quantiles(submodel.free, shares)[0]
        x = np.clip(x, case.models.box.low, case.models.box.high)
        outputs, ok = case.models.predict([(x, submodel)], rows)
        # A specimen that cannot be simulated is none.
        if (ok > 0).all():
            return outputs[0] * (1 + case.noise * random.standard_normal(outputs[0].shape))


def _fit(case: Large, made: np.ndarray, trials: Sequence[Trial], pair: Sequence[Submodel], seed: int) -> None:
    """Fit both models to what trials have asked, and weigh them."""
    scale = np.abs(made[_slots(trials)])
    for again in (False, True):
        known = [trial.fits for trial in trials]
        ends, models = _descents(case, made, trials, pair, known, scale, seed, again)
        for k, (trial, fits) in enumerate(zip(trials, ends, strict=True)):
            evidence = [laplace(fit, models) for fit in fits]
            trial.fits, trial.probability = fits, float(expit(evidence[0] - evidence[1]))
            # The error is relative to what the better one predicts.
            better = fits[int(np.argmax(evidence))].predicted.reshape(*scale.shape)[k]
            scale[k, : len(trial.asked)] = np.abs(better[: len(trial.asked)])


def _plain(case: Large, made: np.ndarray, trials: Sequence[Trial], seed: int) -> list[FitState | None]:
    """The fits of the plain law for trials that choose by its discrepancy."""
    asking = [trial for trial in trials if trial.by in ("expected_improvement", "max_variance")]
    if not asking:
        return [None] * len(trials)
    scale, known = np.abs(made[_slots(asking)]), [[] for _ in asking]
    ends, _ = _descents(case, made, asking, [case.submodel()], known, scale, seed, again=False)
    found = iter(ends)
    return [next(found)[0] if trial in asking else None for trial in trials]


def _descents(
    case: Large,
    made: np.ndarray,
    trials: Sequence[Trial],
    submodels: Sequence[Submodel],
    known: Sequence[Sequence[FitState]],
    scale: np.ndarray,
    seed: int,
    again: bool,
) -> tuple[list[list[FitState]], NestedModels]:
    """Of each trial the best fits of these submodels, all made side by side."""
    slots = _slots(trials)

    def lanes(thetas: np.ndarray, rows: np.ndarray, samples: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        return case.lanes(thetas, slots.ravel()[rows], samples)

    models = case.models.within(case.models.box, lanes)
    used = np.asarray([np.arange(MOST) < len(trial.asked) for trial in trials]).reshape(-1, MOST)
    weights = np.zeros((len(trials), *slots.shape, made.shape[1]))
    weights[range(len(trials)), range(len(trials))] = used[..., None]
    values = made[slots.ravel()]
    sigma = np.maximum(case.noise * scale.reshape(values.shape), 1e-12)
    target = Target(values, sigma, weights.reshape(len(trials), *values.shape), np.zeros(values.shape))
    tasks = []
    for k, trial in enumerate(trials):
        for number, submodel in enumerate(submodels):
            last = known[k][number].x if known[k] else None
            starts = [last] if again else _starts(models, submodel, last, len(trial.asked) + seed)
            tasks += [Task(submodel, start, k, rivals=len(submodels) * k + number) for start in starts]
    ends: dict[int, FitState] = {}
    for task, end in zip(tasks, models.fit(target, tasks), strict=True):
        if task.rivals not in ends or end.cost < ends[task.rivals].cost:
            ends[task.rivals] = end
    return [[ends[len(submodels) * k + n] for n in range(len(submodels))] for k in range(len(trials))], models


def _slots(trials: Sequence[Trial]) -> np.ndarray:
    """What trials have asked, each padded to all it may ask, (m, MOST)."""
    return np.asarray([trial.asked + [0] * (MOST - len(trial.asked)) for trial in trials], dtype=int).reshape(-1, MOST)


def _starts(models: NestedModels, submodel: Submodel, known: np.ndarray | None, number: int) -> list[np.ndarray]:
    """Points spread over the priors, other ones each time, and where the last fit ended."""
    shares = spread(len(submodel.free))
    chosen = shares[(np.arange(_AFRESH) + _AFRESH * number) % len(shares)] if known is not None else shares
    starts = np.tile(models.neutral, (len(chosen), 1))
    starts[:, submodel.free] = models.box.quantiles(submodel.free, chosen)
    return [*starts, *([] if known is None else [known])]


def _next(case: Large, made: np.ndarray, trial: Trial, plain: FitState | None, seed: int) -> int:
    """The candidate that a design asks for next."""
    shares = np.asarray([trial.probability, 1 - trial.probability])
    state = State(trial.asked, shares, case.models, trial.fits, plain, made[trial.asked], case.cube, case.noise, seed)
    utilities = np.array(CRITERIA[trial.by](state), dtype=float)
    utilities[trial.asked] = -np.inf
    return int(np.nanargmax(utilities))


# Criteria: from a state to a utility of every candidate.


def _discriminate(state: State) -> np.ndarray:
    """The package's own: the expected log Bayes factor."""
    predictions, sigma = state.predicted()
    return expected_log_bayes_factor(predictions, 1 / sigma, state.shares)


def _box_hill(state: State) -> np.ndarray:
    """Box & Hill (1967), of each output by itself: the sum over both orders of their divergences, by the probabilities."""
    (one, other), sigma = state.predicted()
    apart = (one.mean - other.mean) ** 2
    own, others = (sigma**2 + np.sum(p.spread**2, axis=2) for p in (one, other))
    return (
        0.5
        * state.shares.prod()
        * np.sum((own - others) ** 2 / (own * others) + apart * (1 / own + 1 / others), axis=1)
    )


def _hunter_reiner(state: State) -> np.ndarray:
    """Hunter & Reiner (1965): the squared difference of the fitted models, in units of the noise."""
    (one, other), sigma = state.predicted()
    return np.sum(((one.mean - other.mean) / sigma) ** 2, axis=1)


def _of_discrepancy(name: str):
    """An acquisition of the package, by the Kriging model of the discrepancy of the plain law (Eq. 12)."""

    def utilities(state: State) -> np.ndarray:
        assert state.plain is not None
        outputs, ok = state.models.predict([(state.plain.x, state.plain.submodel)], np.arange(len(state.cube)))
        # Padded: what grew with the experiments would be compiled for every number of them.
        asked = [*state.asked, *[0] * (MOST - len(state.asked))]
        measured = np.pad(state.measured, ((0, MOST - len(state.measured)), (0, 0)))
        norms = _norms(jnp.asarray(measured), jnp.asarray(outputs[0]), jnp.asarray(ok[0]), jnp.asarray(asked))
        key, mask = jax.random.key(state.seed), jnp.arange(MOST) < len(state.asked)
        kriging = fit_kriging(jnp.asarray(state.cube[asked]), jnp.where(mask, norms, 0.0), mask, key=key)
        return np.asarray(ACQUISITIONS[name]()(kriging, jnp.asarray(state.cube), key))

    return utilities


@jax.jit
def _norms(measured, predicted, ok, asked):
    groups = np.arange(predicted.shape[1])
    here = predicted[asked]
    return discrepancy(measured, here, variance_over(predicted, ok, groups), jnp.ones(here.shape), groups)


def _sobol(state: State) -> np.ndarray:
    """The candidates in the order of their sequence."""
    return -np.arange(len(state.cube), dtype=float)


def _random(state: State) -> np.ndarray:
    """Chance."""
    return np.random.default_rng([state.seed, len(state.asked)]).uniform(size=len(state.cube))


CRITERIA = {
    "discriminate": _discriminate,
    "box_hill": _box_hill,
    "hunter_reiner": _hunter_reiner,
    "expected_improvement": _of_discrepancy("expected_improvement"),
    "max_variance": _of_discrepancy("max_variance"),
    "sobol": _sobol,
    "random": _random,
}
