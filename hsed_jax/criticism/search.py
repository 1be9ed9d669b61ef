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

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import chdtrc, logsumexp

from hsed_jax.criticism.compare import normalised_error
from hsed_jax.errors import UserError
from hsed_jax.inference.correlation import Judged, judge
from hsed_jax.inference.evidence import laplace
from hsed_jax.inference.likelihood import Error, magnitudes
from hsed_jax.inference.nested import Descent, NestedModels, Target, Task

MOST_EFFECTS = 4
# Posterior odds that a further effect needs.
_ODDS = 10.0
# Share of the squared held-out error, less the noise, that a further effect takes away.
_MATERIAL = 0.05
# Nats by which a model may fit worse than one it contains, before it is fitted again from there.
_CAUGHT = 5.0
# Of the most probable models so many are considered to go on from.
_TRIED = 5
_FOLDS = 6
_BLOCKS = 4

Set = frozenset[str]


class Measured(NamedTuple):
    """The training experiments.

    Attributes:
        values: measured outputs, SI, (n, J).
        used: where there is a measurement, (n, J).
        gaps: time since the sample before of the same history [s], infinite where there is none, (n, J).
        groups: output of each column, (J,).
        errors: of each output, (G,).
        noise: noise floor of the error (`hsed_jax.criticism.compare`).
    """

    values: Float[np.ndarray, "n J"]
    used: Bool[np.ndarray, "n J"]
    gaps: Float[np.ndarray, "n J"]
    groups: Int[np.ndarray, " J"]
    errors: tuple[Error, ...]
    noise: float

    @property
    def declared(self) -> Float[np.ndarray, " G"]:
        """s of each output, NaN where it is not declared."""
        return np.asarray([float(e.size) if isinstance(e.size, int | float) else np.nan for e in self.errors])

    def error(self, predicted: np.ndarray, scored: np.ndarray | None = None) -> float:
        """Normalised error of predictions (n, J), where something is scored (by default wherever it was measured)."""
        return normalised_error(self.values, predicted, self.used if scored is None else scored, self.groups)

    def scales(self, predicted: Float[np.ndarray, "r J"], used: np.ndarray | None = None) -> Float[np.ndarray, "r J"]:
        """c in σ = s·c of predictions: one, or their magnitude where an error is relative."""
        used = self.used if used is None else used
        relative = np.asarray([error.is_relative for error in self.errors])
        members = (self.groups[:, None] == np.arange(len(self.errors))).astype(float)
        size = np.asarray(magnitudes(jnp.asarray(predicted), jnp.asarray(used, float), members))
        return np.where(np.logical_and(relative[self.groups], size > 0), size, 1.0)

    def residual(self, predicted: np.ndarray) -> Float[np.ndarray, "n J"]:
        """Predictions less measurements over c; zero where there is no measurement."""
        return np.where(self.used, (predicted - self.values) / self.scales(predicted), 0.0)

    def left(self, predicted: np.ndarray) -> Float[np.ndarray, " G"]:
        """s of each output that would explain the residual of predictions: its RMS, never zero."""
        residual, outputs = self.residual(predicted), range(len(self.errors))
        owns = [self.used & (self.groups == output) for output in outputs]
        found = [float(np.sqrt(np.mean(residual[own] ** 2))) if own.any() else 1.0 for own in owns]
        return np.maximum(found, 1e-9)

    def sigma(self, errors: Float[np.ndarray, " G"], predicted: np.ndarray) -> Float[np.ndarray, "n J"]:
        """σ = s·c of predictions, SI; one where there is no measurement."""
        return np.where(self.used, errors[self.groups] * self.scales(predicted), 1.0)

    def judged(self, predicted: np.ndarray) -> Judged:
        """What the samples are worth beside predictions."""
        declared = ~np.isnan(self.declared)
        residual = self.residual(predicted) / np.where(declared, self.declared, self.left(predicted))[self.groups]
        correlated = [error.correlated for error in self.errors]
        return judge(residual, self.gaps, self.used, self.groups, declared, correlated)


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
        is_explained: whether the noise explains the residual of a fit; nothing is added to it then.
        report: called with what is being done, for a progress bar.

    Attributes:
        target: what the last round was judged with; `errors` s and `worth` per output are what it was made of.
        best: the set that is supported.
        path: the sets that were best, from none on.
    """

    def __init__(
        self,
        models: NestedModels,
        measured: Measured,
        law: Int[np.ndarray, " p"],
        effects: Mapping[str, Int[np.ndarray, " q"]],
        is_explained: Callable[[Descent], bool],
        report: Callable[[str], None] = lambda line: None,
    ):
        self._is_explained = is_explained
        self.models, self.measured, self.law, self.effects = models, measured, law, dict(effects)
        self._report = report
        self._fits: dict[Set, Descent] = {}
        self._fitted, self._left_out = _folds(measured.used, measured.groups)
        self.errors = np.where(np.isnan(measured.declared), 0.3, measured.declared)
        self.worth = np.ones(len(self.errors))
        self.target = self._target(measured.values, np.zeros(measured.values.shape))
        self.best: Set = frozenset()
        self.path: list[Set] = [self.best]
        self.scores: dict[str, float] = {}

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
        """Error on experiments left out in turn (on what comes later, where there is one experiment), for several sets."""
        tasks = [
            Task(self._free(effects), self._fits[effects].x, use)
            for effects in chosen
            for use in range(1, len(self._fitted))
        ]
        fits = self.models.fit(self.target, tasks)
        rows = np.arange(len(self.measured.values))
        everywhere, _ = self.models.predict([(f.x, f.free) for f in fits], rows)
        errors = []
        folds = len(self._fitted) - 1
        scored = self._left_out.any(axis=0)
        for number in range(len(chosen)):
            predicted = np.zeros_like(self.measured.values)
            for fold in range(folds):
                predicted = np.where(self._left_out[fold + 1], everywhere[number * folds + fold], predicted)
            errors.append(self.measured.error(predicted, scored))
        return errors

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
        for _ in range(2):
            ends = self.models.fit(self.target, tasks)
            self._fits[none] = min(ends, key=lambda f: f.cost)
            if not np.isfinite(self._fits[none].cost):
                raise UserError(
                    "the model's simulation diverges wherever a fit was started; check parameters and priors"
                )
            self.target = self._judged_by(self._fits[none])
            tasks = [Task(self.law, self._fits[none].x)]
        self.scores = self._score_tests()

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
            self._go_on(around, {s: self._fits[s].x for s in around})
            # A model cannot fit worse than one that it contains: where it does, it was caught on the way.
            caught = {s: x for s in around if (x := self._better_start(s)) is not None}
            self._go_on(list(caught), caught)

    def _go_on(self, sets: Sequence[Set], starts: Mapping[Set, np.ndarray]) -> None:
        ends = self.models.fit(self.target, [Task(self._free(s), starts[s]) for s in sets])
        self._fits |= dict(zip(sets, ends, strict=True))

    def _better_start(self, effects: Set) -> np.ndarray | None:
        """The end of a contained model that fits better, the further effects nearly absent; None where there is none."""
        inside = [effects - {e} for e in effects if effects - {e} in self._fits]
        if not inside:
            return None
        lowest = min(inside, key=lambda s: self._fits[s].cost)
        if self._fits[effects].cost <= self._fits[lowest].cost + _CAUGHT:
            return None
        start = self._fits[effects].x.copy()
        kept = self._free(lowest)
        start[kept] = self._fits[lowest].x[kept]
        for effect in effects - lowest:
            start[self.effects[effect][0]] = self.models.neutral[self.effects[effect][0]]
        return start

    def _next(self) -> Set:
        """The set to go on from: the most probable that is supported and predicts what was not used."""
        here = self.model(self.best)
        ranked = sorted((self.model(s) for s in self._around()), key=lambda m: -m.log_posterior)
        for candidate in ranked[:_TRIED]:
            if candidate.log_posterior <= here.log_posterior:
                break
            if len(candidate.effects) <= len(self.best):
                return candidate.effects
            if self._is_explained(here.fit):
                continue
            odds = candidate.log_posterior - here.log_posterior
            if odds > math.log(_ODDS) and self._is_material(candidate):
                return candidate.effects
        return self.best

    def _is_material(self, candidate: Model) -> bool:
        """Whether a further effect improves the prediction of what was not used: by a share of what is wrong with it, or
        by the last of it, so that the noise is all that is left."""
        floor = self.measured.noise**2
        before, now, then = (e**2 - floor for e in self.held_out([frozenset(), self.best, candidate.effects]))
        share = 0.0 if self._is_explained(candidate.fit) else _MATERIAL
        return then < now and now - then >= share * before

    def _neighbours(self) -> list[Set]:
        """The sets one change away from the best."""
        best, others = self.best, [e for e in self.effects if e not in self.best]
        fewer = [best - {e} for e in best]
        exchanged = [best - {out} | {new} for out in best for new in others]
        may_grow = len(best) < MOST_EFFECTS and (not best or not self._is_explained(self._fits[best]))
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

    def _score_tests(self) -> dict[str, float]:
        r"""Rao's score statistic of each candidate's amplitude at its neutral value, $\chi^2_1$ where it is absent.

        Source: Rao 1948; the law's parameters are projected out.
        """
        fit = self._fits[frozenset()]
        amplitudes = [columns[0] for columns in self.effects.values()]
        step = 1e-3
        x = self.models.neutral.copy()
        x[self.law] = fit.x[self.law]
        points = [(x, self.law)]
        for k in (*self.law, *amplitudes):
            moved = x.copy()
            moved[k] += -step if moved[k] + step > self.models.box.high[k] else step
            points.append((moved, np.append(self.law, k)))
        rows = np.arange(len(self.measured.values))
        outputs, ok = self.models.predict(points, rows)
        residual = self.target.standardised(0, rows, self.measured.values - outputs[0]).ravel()
        slopes = self.target.standardised(0, rows, (outputs[1:] - outputs[0]) * ok[1:, :, None])
        slopes = slopes.reshape(len(points) - 1, -1) / step
        basis, _ = np.linalg.qr(slopes[: len(self.law)].T)
        found = {}
        for effect, slope in zip(self.effects, slopes[len(self.law) :], strict=True):
            own = slope - basis @ (basis.T @ slope)
            power = float(own @ own)
            found[effect] = (
                float(own @ residual) ** 2 / power if power > 1e-12 * float(slope @ slope) and power > 0 else 0.0
            )
        return found

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


def score_p_value(statistic: float) -> float:
    """Probability of a score statistic like this where the effect is absent."""
    return float(chdtrc(1, statistic))


def _folds(used: np.ndarray, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What to fit and what to predict from it, (F, n, J) each, the first fold being all the data and nothing left out.

    Several experiments are left out in turn.  Of a single one the past predicts the future: the blocks of time before each
    block are fitted, since a specimen that has been damaged is another one.
    """
    n = len(used)
    if n > 1:
        fold = np.broadcast_to((np.arange(n) % min(n, _FOLDS))[:, None], used.shape)
        fitted = [used & (fold != k) for k in range(int(fold.max()) + 1)]
        left_out = [used & (fold == k) for k in range(int(fold.max()) + 1)]
    else:
        block = np.zeros(used.shape, dtype=int)
        for own in (groups == g for g in np.unique(groups)):
            order = np.cumsum(used[0, own]) - 1
            block[0, own] = np.clip(order * _BLOCKS // max(int(used[0, own].sum()), 1), 0, _BLOCKS - 1)
        fitted = [used & (block < k) for k in range(1, _BLOCKS)]
        left_out = [used & (block == k) for k in range(1, _BLOCKS)]
    return np.stack([used, *fitted]), np.stack([np.zeros_like(used), *left_out])


def _spread(parameters: int) -> np.ndarray:
    """Shares of the priors to start from, (starts, parameters)."""
    from scipy.stats import qmc

    if parameters == 1:
        return np.asarray([[0.1], [0.35], [0.65], [0.9]])
    count = 2 * (parameters + 1)
    return 0.1 + 0.8 * qmc.Sobol(parameters, scramble=True, rng=1).random_base2(count.bit_length())[:count]


def _text(effects: Set) -> str:
    return " + ".join(sorted(effects)) or "the model as it is"
