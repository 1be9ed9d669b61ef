r"""Which set of effects do the measurements support?  A search over nested models, by evidence.

Forward steps add the effect that is supported best; after each, every model one change away (an effect less, one more, one
exchanged for another) is fitted, so that a wrong first step is taken back.  Sets of k out of K effects share the prior
probability of their size, $2^{-k-1}/\binom{K}{k}$: looking at thirty candidates does not invent physics.

**How wrong a model may be is learned, not assumed.**  A real specimen follows no textbook formula.  All models of a round are
therefore judged with the errors that the best of them leaves: the error of an output is the declared one or that model's
residual, whichever is larger, and samples of a correlated residual count for what they are worth
(`hsed_jax.inference.correlation`).  Where the noise is all there is, both are as declared.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.held_out import folds_of, left_out_predictions
from hsed_jax.diagnosis.measured import Measured
from hsed_jax.diagnosis.nested import Descent, NestedModels, Target, Task
from hsed_jax.diagnosis.scores import score_p_value, score_tests
from hsed_jax.errors import UserError

MOST_EFFECTS = 4
# Posterior odds that a further effect needs.
_ODDS = 10.0
# Share of the squared held-out error, less the noise, that a further effect takes away.
_MATERIAL = 0.05
# A score test opens the gate that the size of the residual keeps shut, at this level for all candidates together.
_STRICT = 1e-3
# By this share a further effect may raise the squared error on experiments that nothing is fitted to: they are few.
_CHANCE = 0.05
# A fit that another one shows to be improvable by more nats than this goes on from there.
_CAUGHT = 0.1
# An amplitude this close to its neutral value, in coordinates of order one, is none.
_ABSENT = 1e-3
# Of the most probable models so many are considered to go on from.
_TRIED = 5

Set = frozenset[str]


class Model(NamedTuple):
    """A set of effects, fitted.

    Attributes:
        effects: the set.
        fit: where its fit ended.
        log_evidence: log Z.
        log_posterior: log Z plus the log prior of the set.
    """

    effects: Set
    fit: Descent
    log_evidence: float
    log_posterior: float


class Search:
    """The search, and what it has found.

    Arguments:
        models: the large model.
        measured: the experiments to fit.
        law: indices of the parameters that every model has.
        effects: indices of the parameters of each candidate, the amplitude first.
        is_explained: whether the noise explains the size of a fit's residual; nothing is added to it then, unless a score test
            is sure of it.
        report: called with what is being done, for a progress bar.
        test: experiments that nothing is fitted to, the rows after those measured: an effect that predicts them worse is not
            named.
        start: the model without further effects as it is known already, (P,): one of the starts of its fit.

    Attributes:
        target: what the last round was judged with; `errors` s and `worth` per output are what it was made of.
        best: the set that is supported.
        path: the sets that were best, from none on.
        scores: Rao's score statistic of each candidate in the model as it is.
        missed: by how many nats the best fit of the model as it is beats the one from `start`.
    """

    def __init__(
        self,
        models: NestedModels,
        measured: Measured,
        law: Int[np.ndarray, " p"],
        effects: Mapping[str, Int[np.ndarray, " q"]],
        is_explained: Callable[[Descent], bool],
        report: Callable[[str], None] = lambda line: None,
        test: Measured | None = None,
        start: Float[np.ndarray, " P"] | None = None,
    ):
        self._is_explained = is_explained
        self._test, self._start = test, start
        self.models, self.measured, self.law, self.effects = models, measured, law, dict(effects)
        self._report = report
        self._fits: dict[Set, Descent] = {}
        self._folds = folds_of(measured.used, measured.groups)
        self._fitted = self._folds.fitted
        self.errors = np.where(np.isnan(measured.declared), 0.3, measured.declared)
        self.worth = np.ones(len(self.errors))
        self.target = self._target(measured.values, np.zeros(measured.values.shape))
        self.best: Set = frozenset()
        self.path: list[Set] = [self.best]
        self.scores: dict[str, float] = {}
        self.missed = 0.0

    def run(self) -> None:
        """Search, from the model as it is."""
        while True:
            self._report(f"models around {_text(self.best)}")
            self._fit(self._neighbours())
            self._judge()
            found = self._next()
            if found == self.best:
                return
            if found in self.path:
                self.best = found
                self._judge()
                return
            self.best = found
            self.path.append(found)

    def model(self, effects: Iterable[str]) -> Model:
        """A model that was fitted."""
        chosen = frozenset(effects)
        fit = self._fits[chosen]
        log_evidence = laplace(fit, self.models)
        return Model(chosen, fit, log_evidence, log_evidence + self._log_prior(len(chosen)))

    def all(self) -> list[Model]:
        """All models that were fitted to the end of the last round, the most probable first."""
        found = [self.model(effects) for effects in self._around()]
        return sorted(found, key=lambda m: -m.log_posterior)

    def probabilities(self, models: Sequence[Model]) -> np.ndarray:
        """Posterior probabilities of models, among themselves."""
        heights = np.asarray([m.log_posterior for m in models])
        return np.exp(heights - logsumexp(heights))

    def held_out(self, chosen: Sequence[Set]) -> list[float]:
        """Error on experiments left out in turn (on what comes later, where there is one experiment), for several sets.

        Infinite where a simulation fails: what cannot be predicted is no improvement.
        """
        fits = [self._fits[effects] for effects in chosen]
        predictions = left_out_predictions(self.models, self.target, self._folds, fits)
        scored = self._folds.left_out.any(axis=0)
        return [math.inf if p is None else self.measured.error(p, scored) for p in predictions]

    def unseen(self, chosen: Sequence[Set]) -> list[float]:
        """Error on the experiments that nothing is fitted to, for several sets; without any, on those left out in turn."""
        if self._test is None:
            return self.held_out(chosen)
        rows = len(self.measured.values) + np.arange(len(self._test.values))
        fits = [self._fits[effects] for effects in chosen]
        outputs, ok = self.models.predict([(f.x, f.free) for f in fits], rows)
        return [
            self._test.error(predicted) if converged.all() else math.inf
            for predicted, converged in zip(outputs, ok, strict=True)
        ]

    def harms(self, larger: Set, here: Set = frozenset()) -> bool:
        """Whether a set predicts the experiments that nothing is fitted to worse than another one, or not at all."""
        if self._test is None:
            return False
        now, then = self.unseen([here, larger])
        return not then**2 <= (1 + _CHANCE) * now**2

    def pointed_at(self, chosen: Set) -> Set:
        """The candidates that a score test around a fitted set is sure of, with their number accounted for."""
        others = {name: columns for name, columns in self.effects.items() if name not in chosen}
        scores = score_tests(self.models, self.target, self._fits[chosen], others) if others else {}
        return frozenset(name for name, score in scores.items() if score_p_value(score, len(self.effects)) < _STRICT)

    def obstacle(self, larger: Model) -> str | None:
        """Why a model with one effect more than the best is not the one to go on from; None where nothing is against it."""
        here = self.model(self.best)
        odds = larger.log_posterior - here.log_posterior
        if odds <= math.log(_ODDS):
            return f"its posterior odds of {math.exp(odds):.2g} are less than {_ODDS:.0f}"
        if self._is_explained(here.fit) and not larger.effects & self.pointed_at(self.best):
            return "the noise explains what is left, and no score test is sure of it"
        if self.harms(larger.effects, self.best):
            now, then = self.unseen([self.best, larger.effects])
            return f"it takes the error on experiments that were not used from {now:.3f} to {then:.3g}"
        before, now, then = self.held_out([frozenset(), self.best, larger.effects])
        # By a share of what is wrong with the prediction, or by the last of it, so that the noise is all that is left.
        share = 0.0 if self._is_explained(larger.fit) else _MATERIAL
        floor = self.measured.noise**2
        if not then < now or now**2 - then**2 < share * (before**2 - floor):
            return f"with training experiments left out in turn the error goes from {now:.3f} to {then:.3g} only"
        return None

    # The rounds.

    def start(self) -> None:
        """The model without further effects, and a first look at every candidate from its gradient."""
        from scipy.stats import qmc

        self._report("the model as it is")
        starts = np.tile(self.models.neutral, (8, 1))
        shares = 0.1 + 0.8 * qmc.Sobol(len(self.law), scramble=True, rng=0).random_base2(3)
        starts[1:, self.law] = self.models.box.quantiles(self.law, shares[1:])
        none: Set = frozenset()
        tasks = [Task(self.law, start, rivals=0) for start in starts]
        tasks += [] if self._start is None else [Task(self.law, self._start)]
        for _ in range(2):
            ends = self.models.fit(self.target, tasks)
            self._fits[none] = min(ends, key=lambda f: f.cost)
            if len(ends) > len(starts):
                self.missed = ends[-1].cost - self._fits[none].cost
            if not np.isfinite(self._fits[none].cost):
                raise UserError(
                    "the model's simulation diverges wherever a fit was started; check parameters and priors"
                )
            self.target = self._judged_by(self._fits[none])
            tasks = [Task(self.law, self._fits[none].x)]
        self.scores = score_tests(self.models, self.target, self._fits[none], self.effects)

    def _fit(self, sets: Iterable[Set]) -> None:
        """Fit what has not been fitted, from several starts; the rest goes on from where it was."""
        tasks, owners = [], []
        for number, effects in enumerate(sets):
            if effects in self._fits:
                continue
            for start in self._starts(effects):
                tasks.append(Task(self._free(effects), start, rivals=number))
                owners.append(effects)
        for owner, fit in zip(owners, self.models.fit(self.target, tasks), strict=True):
            if owner not in self._fits or fit.cost < self._fits[owner].cost:
                self._fits[owner] = fit

    def _judge(self) -> None:
        """Take the errors from the best model of the round, and fit all again with them."""
        around = self._around()
        for _ in range(2):
            lowest = min(around, key=lambda s: self._fits[s].cost - self._log_prior(len(s)))
            self.target = self._judged_by(self._fits[lowest])
            self._fits |= self._go_on({s: self._fits[s].x for s in around})
            self._reconcile(around)

    def _go_on(self, starts: Mapping[Set, np.ndarray]) -> dict[Set, Descent]:
        tasks = [Task(self._free(effects), start) for effects, start in starts.items()]
        return dict(zip(starts, self.models.fit(self.target, tasks), strict=True))

    def _reconcile(self, sets: Sequence[Set]) -> None:
        """No model fits worse than one that it contains, nor than a larger one whose further effect is absent: where one does,
        it was caught on the way, and goes on from there."""
        for size in sorted({len(s) for s in sets}):
            caught = {s: x for s in sets if len(s) == size and (x := self._better_start(s, sets)) is not None}
            self._fits |= {s: fit for s, fit in self._go_on(caught).items() if fit.cost < self._fits[s].cost}

    def _better_start(self, effects: Set, sets: Sequence[Set]) -> np.ndarray | None:
        """Where the fit of another set shows this model to fit better than it does; None where none does."""
        here, options = self._fits[effects], []
        for other in sets:
            if len(other ^ effects) != 1:
                continue
            (changed,) = other ^ effects
            fit, columns = self._fits[other], self.effects[changed]
            x, absent = fit.x.copy(), self.models.neutral[columns[0]]
            if changed in effects:
                x[columns] = here.x[columns]
                x[columns[0]] = absent
                options.append((fit.cost - self._log_density(x, columns), x))
            elif abs(x[columns[0]] - absent) < _ABSENT:
                options.append((fit.cost + self._log_density(x, columns), x))
        cost, x = min(options, key=lambda option: option[0], default=(math.inf, here.x))
        return x if cost < here.cost - _CAUGHT else None

    def _log_density(self, x: np.ndarray, columns: np.ndarray) -> float:
        return float(self.models.box.log_density(x[None], columns).sum())

    def _next(self) -> Set:
        """The set to go on from: the most probable that is supported and predicts what was not used."""
        here = self.model(self.best)
        ranked = sorted((self.model(s) for s in self._around()), key=lambda m: -m.log_posterior)
        for candidate in ranked[:_TRIED]:
            if candidate.log_posterior <= here.log_posterior:
                break
            is_larger = len(candidate.effects) > len(self.best)
            if self.obstacle(candidate) is None if is_larger else not self.harms(candidate.effects):
                return candidate.effects
        return self.best

    def _neighbours(self) -> list[Set]:
        """The sets one change away from the best."""
        best, others = self.best, [e for e in self.effects if e not in self.best]
        fewer = [best - {e} for e in best]
        exchanged = [best - {out} | {new} for out in best for new in others]
        is_open = not best or not self._is_explained(self._fits[best]) or bool(self.pointed_at(best))
        may_grow = len(best) < MOST_EFFECTS and is_open
        more = [best | {new} for new in others] if may_grow else []
        return [best, *fewer, *exchanged, *more]

    def _around(self) -> list[Set]:
        return [s for s in dict.fromkeys([frozenset(), *self.path, *self._neighbours()]) if s in self._fits]

    def _starts(self, effects: Set) -> list[np.ndarray]:
        """Points to fit a set from: the best fitted subset, with what it lacks at several values."""
        known = max((s for s in self._fits if s < effects), key=lambda s: (len(s), -self._fits[s].cost))
        new = [k for effect in sorted(effects - known) for k in self.effects[effect]]
        shares = _spread(len(new))
        starts = np.tile(self._fits[known].x, (len(shares), 1))
        starts[:, new] = self.models.box.quantiles(np.asarray(new), shares)
        return list(starts)

    # What models are judged with.

    def _judged_by(self, fit: Descent) -> Target:
        measured = self.measured
        self.errors = np.fmax(measured.declared, measured.left(fit.predicted))
        judged = measured.judged(fit.predicted)
        self.worth = judged.worth
        return self._target(fit.predicted, judged.memory)

    def _target(self, predicted: np.ndarray, memory: np.ndarray) -> Target:
        measured = self.measured
        weights = self._fitted * self.worth[measured.groups]
        return Target(measured.values, measured.sigma(self.errors, predicted), weights, memory)

    def _free(self, effects: Set) -> np.ndarray:
        return np.concatenate([self.law, *(self.effects[e] for e in sorted(effects))]).astype(int)

    def _log_prior(self, size: int) -> float:
        return -(size + 1) * math.log(2) - math.log(math.comb(len(self.effects), size))


def _spread(parameters: int) -> np.ndarray:
    """Shares of the priors to start from, (starts, parameters)."""
    from scipy.stats import qmc

    if parameters == 1:
        return np.asarray([[0.1], [0.35], [0.65], [0.9]])
    count = 2 * (parameters + 1)
    return 0.1 + 0.8 * qmc.Sobol(parameters, scramble=True, rng=1).random_base2(count.bit_length())[:count]


def _text(effects: Set) -> str:
    return " + ".join(sorted(effects)) or "the model as it is"
