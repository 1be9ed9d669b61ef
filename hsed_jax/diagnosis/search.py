r"""The set of effects that the measurements support: a search over nested models, by their predictions.

Forward steps add the effect with the best support.  After each step, all models one change away are fitted (one effect fewer, one
more, one exchanged for another or for a pair), so that a wrong step can be reversed.  The evidence of the fits selects the models
to score: by the log density of data that a model was not fitted to (`hsed_jax.diagnosis.score`), or by the evidence if the noise
explains the best fit.  A further effect always needs the score.  Sets of k out of K effects share the prior probability of their
size, $2^{-k-1}/\binom{K}{k}$, so that a catalogue of thirty candidates does not favour a false effect.  Test experiments are not
fitted; at the end, they choose between the fitted sets.

**The errors of the models are estimated, not assumed.**  No specimen follows a textbook formula exactly.  All models of a round
are therefore judged with the same errors: the error of an output is the declared one or the residual of the best model, whichever
is larger.  Samples of a correlated residual count with their effective number (`hsed_jax.inference.correlation`).  The best model
is the most probable one if each model has errors of its own (`Measured.surprise`).
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.diagnosis.fit_state import FitState, Target, Task
from hsed_jax.diagnosis.fits import Choice, Fits, Model, Set, less_one, names_of
from hsed_jax.diagnosis.measured import Measured, Standard
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Forms, amplitude_of, of_other_drivers, of_other_shapes
from hsed_jax.diagnosis.propose import beside, pairs, predicted_gains_of
from hsed_jax.diagnosis.score import ODDS, Gain, HeldOut, largest_alike, material, weights_of
from hsed_jax.diagnosis.scores import Linearisation, score_p_value, telling
from hsed_jax.errors import UserError

MOST_EFFECTS = 4
# A p-value of the score tests below this level (for all candidates) continues a search even if the noise explains the residual.
_STRICT = 1e-3
# The squared noise may differ from its expectation by this many standard deviations.
_DEVIATIONS = 3.0
# Number of sets that are scored, the ones with the largest evidence, and number of forms of each.
_POOL, _FORMS = 6, 2
# Number of leading models from which the next one is selected.
_TRIED = 5
# Pairs: number of other single effects, the most probable ones, and number of effects beside each, by predicted gain.
_OTHERS, _BESIDE = 3, 2
# All forms are fitted of this many sets (three times as many without a named effect), if they are at most this many nats below
# the set with the largest evidence, or gain at least half as much.
_DEEP, _NEAR = 2, 10.0
# Number of leading sets of a search over fewer experiments that are fitted to all experiments.
_ADOPTED = 2
# Number of drivers for which all shapes of a form are fitted, if one of them may be the most probable form.
_DRIVERS = 2


class Search:
    """The search and its results.

    Arguments:
        models: the large model.
        measured: the experiments to fit.
        law: indices of the parameters that every model has.
        effects: the forms of each candidate.
        is_explained: whether the noise explains the residual of a fit; then only a significant score test adds an effect.
        report: receives the current activity, for a progress bar.
        test: experiments that are never fitted, in the rows after the measured ones.  At the end, they choose between the sets.
        start: known x of the first model, (P,): one of the starts of its fit.

    Attributes:
        held_out: predictions of data that the models were not fitted to.
        standard: what the models of the last round are judged by.
        best: the supported set.
        path: the sets that were best, from the empty set on.
        scores: Rao's score statistic of each candidate in the first model.
        on_round: called before the first round and after each.
        missed: by how many nats the best fit of the first model is better than the fit from `start`.
    """

    def __init__(
        self,
        models: NestedModels,
        measured: Measured,
        law: Int[np.ndarray, " p"],
        effects: Mapping[str, Forms],
        is_explained: Callable[[FitState], bool],
        report: Callable[[str], None] = lambda line: None,
        test: Measured | None = None,
        start: Float[np.ndarray, " P"] | None = None,
    ):
        self._is_explained, self._report = is_explained, report
        self._start, self.held_out = start, HeldOut(models, measured, test)
        self.models, self.measured, self.law, self.effects = models, measured, law, dict(effects)
        self._fits = Fits(models, law, effects)
        errors = np.where(np.isnan(measured.declared), 0.3, measured.declared)
        sigma, uses = measured.sigma(errors, measured.values), self.held_out.folds.fitted * 1.0
        target = Target(measured.values, sigma, uses, np.zeros(measured.values.shape))
        self.standard = Standard(errors, np.ones(len(errors)), target)
        self.best: Set = frozenset()
        self.path: list[Set] = [self.best]
        self.scores: dict[str, float] = {}
        self.missed = 0.0
        self.on_round: Callable[[], None] = lambda: None
        self._tried: set[Set] = set()
        self._pairs, self._near = list[Set](), dict[Set, list[Set]]()
        self._pointed: dict[Set, tuple[FitState, Target, Set]] = {}

    def run(self) -> None:
        """Search, starting with the first model (without effects)."""
        self.on_round()
        while True:
            self._report(f"models around {_text(self.best)}")
            around = self._neighbours()
            self._fit(around)
            # If no effect will be named, only the possible size of each candidate is reported.
            if self.best or self.is_open():
                self._fit_pairs()
                self._deepen([*around, *self._pairs])
            self._judge()
            if not self.best and not self.by_evidence:
                self._report("every effect beside any law")
                rows = telling(self.standard.target, self._fits.best(self.best))
                self._fits.look_all_over(self.standard.target, rows)
                self._judge()
            self._score()
            before, self.best = self.best, self._next()
            self.on_round()
            if self.best in self.path:
                break
            self.path.append(self.best)
        if (test := self.held_out.test) is not None:
            self.best = self._smallest_that_predicts(test.scatter)
        if self.best != before:
            self._judge()
        self._score(is_over=True)

    def adopt(self, coarse: "Search") -> None:
        """Judge the sets of a search over fewer experiments: the best one (also less one effect), its path, the leading ones."""
        leading = [m.effects for m in coarse.all()[:_ADOPTED]]
        sets = dict.fromkeys([coarse.best, *less_one(coarse.best), *coarse.path, *leading])
        choices = {coarse._fits.top(s): [coarse._fits.best(s).x] for s in sets if s}
        self._fits.fit(self.standard.target, choices, choices)
        self.best, self.path = coarse.best, coarse.path
        self._judge()
        self._score(is_over=True)

    def model(self, effects: Iterable[str]) -> Model:
        """A model that was fitted."""
        chosen = frozenset(effects)
        return self._fits.model(chosen, self._log_prior(len(chosen)))

    def all(self) -> list[Model]:
        """The fitted models around the best set whose simulations succeed, the most probable first."""
        found = [m for m in map(self.model, self._around()) if math.isfinite(m.fit.cost)]
        return sorted(found, key=lambda m: (-m.probability, -m.log_posterior))

    @property
    def by_evidence(self) -> bool:
        """Whether the noise explains the best fit: then no model is wrong as far as the data show, and the evidence is exact."""
        return self._is_explained(self._lowest())

    def unseen(self, chosen: Sequence[Set]) -> list[float]:
        """Error of several sets on the experiments that are never fitted; without any, on data that are left out in turn."""
        return self.held_out.unseen(self.standard.target, [self._fits.best(effects) for effects in chosen])

    def odds(self, one: Set, other: Set) -> float:
        """Odds of one set against another by their scores."""
        densities = self.held_out.densities(self.standard.target, [self._fits.best(s) for s in (one, other)])
        weights = weights_of(densities, np.asarray([self._log_prior(len(s)) for s in (one, other)]))
        return float(weights[0] / max(weights[1], 1e-300))

    def gains(self, chosen: Sequence[Set], over: Set) -> list[Gain]:
        """Gain of sets over another set in log density, by piece of the held-out data [nats]."""
        before, *after = self.held_out.densities(self.standard.target, [self._fits.best(s) for s in (over, *chosen)])
        return [Gain(own - before) for own in after]

    def pointed_at(self, chosen: Set) -> Set:
        """The candidates with a significant score test around a fitted set; the level accounts for their number."""
        fit = self._fits.best(chosen)
        of_fit, of_target, found = self._pointed.get(chosen, (None, None, Set()))
        if of_fit is not fit or of_target is not self.standard.target:
            others = {name: amplitude_of(forms) for name, forms in self.effects.items() if name not in chosen}
            scores = Linearisation(self.models, self.standard.target, fit).score_tests(others)
            found = frozenset(n for n, score in scores.items() if score_p_value(score, len(self.effects)) < _STRICT)
            self._pointed[chosen] = fit, self.standard.target, found
        return found

    def obstacle(self, larger: Set, here: Set) -> str | None:
        """The reason why a set with more effects than another one is not named instead; None without a reason."""
        if self.held_out.test is not None:
            before, unseen = self.unseen([here, larger])
            if not unseen <= before:
                return "the model predicts the experiments that were not fitted better without it"
        return self._unsupported(larger, here)

    def _smallest_that_predicts(self, scatter: float) -> Set:
        """The smallest set with the least test error, up to what is not material.

        The choice is made last and between all fitted sets: what describes the fitted experiments best may predict others badly.
        The best set stays if its squared error is larger by at most three times `scatter`.  If the noise explains the best set,
        the evidence is exact, and only the sets of the path are compared with it.
        """
        is_noise = self._is_explained(self._fits.best(self.best))
        sets = self.path if is_noise else [*self.path, *(m.effects for m in self.all() if self._is_supported(m))]
        unseen = dict(zip(sets, self.unseen(sets), strict=True))
        limit = largest_alike(self.measured.noise, unseen[Set()], min(unseen.values()))
        stays = is_noise or unseen[self.best] ** 2 <= min(unseen.values()) ** 2 + _DEVIATIONS * scatter
        alike = [s for s, error in unseen.items() if error <= limit or (stays and s == self.best)]
        return min(alike, key=lambda s: (len(s), stays and s != self.best, -self.model(s).probability, unseen[s]))

    def _is_supported(self, model: Model) -> bool:
        """Whether each effect of a model raises the evidence of the fitted measurements."""
        return all(model.log_evidence > self.model(s).log_evidence for s in less_one(model.effects) if s in self._fits)

    def _unsupported(self, larger: Set, here: Set) -> str | None:
        """The reason why the fitted measurements do not support a set with more effects than another one; None without one."""
        odds = self.odds(larger, here)
        if odds < ODDS:
            return f"its odds of {odds:.2g} by what it predicts are less than {ODDS:.0f}"
        fits = [self._fits.best(effects) for effects in (Set(), here, larger)]
        if self._is_explained(fits[1]) and not larger & self.pointed_at(here):
            return "the noise explains what is left, and no score test is sure of it"
        before, now, after = self.held_out.errors(self.standard.target, fits)
        if not now**2 - after**2 >= material(self.measured.noise, before, now):
            return f"with training experiments left out in turn the error goes from {now:.3f} to {after:.3g} only"
        return None

    def exchange(self, effect: str, other: str, driver: str, is_right: Callable[[Model], bool]) -> bool:
        """Exchange an effect of the best set for one with the same behaviour, if that predicts about as well; whether it does.

        Arguments:
            effect: of the best set.
            other: the effect with the name of the behaviour.
            driver: of the behaviour; of the forms of `other`, those with this driver or the default one are tried.
            is_right: whether the behaviour of a model has the new name, too.
        """
        rest, instead = self._in_forms(self.best - {effect}), self.best - {effect} | {other}
        forms = [(other, label) for label, form in self.effects[other].items() if form.form.driver in ("", driver)]
        for own in (forms[:1], forms[1:]):  # the other forms start near the first one
            self._fits.fit(self.standard.target, [rest | {form} for form in own])
        before, now, then = self.unseen([Set(), self.best, instead])
        if then > largest_alike(self.measured.noise, before, now) or not is_right(self.model(instead)):
            return False
        self.best = instead
        self.path.append(instead)
        self._score(is_over=True)
        return True

    def start(self) -> None:
        """Fit the first model (without effects), and test every candidate by its score statistic."""
        self._report("the model as it is")
        submodel, starts = self.models.submodel(self.law), self._fits.starts_of_law()
        tasks = [Task(submodel, start, rivals=0) for start in starts]
        tasks += [] if self._start is None else [Task(submodel, self._start)]
        for _ in range(2):
            ends = self.models.fit(self.standard.target, tasks)
            fit = min(ends, key=lambda f: f.cost)
            if len(ends) > len(starts):
                self.missed = ends[-1].cost - fit.cost
            if not np.isfinite(fit.cost):
                raise UserError("the model diverges wherever a fit was started; check parameters and priors")
            self.standard = self.measured.standard(fit.predicted, self.held_out.folds.fitted)
            tasks = [Task(submodel, fit.x)]
            self._fits.set_law(fit)
        defaults = {effect: amplitude_of(forms) for effect, forms in self.effects.items()}
        self.scores = Linearisation(self.models, self.standard.target, self._fits.best(Set())).score_tests(defaults)

    def _fit(self, around: Sequence[Set]) -> None:
        """Fit the sets around the best one: its subsets in its forms, and sets with a new effect as `beside` proposes them."""
        target = self.standard.target
        self._fits.fit(target, [self._in_forms(s) for s in around if s <= self.best])
        grown: dict[Set, list[str]] = {}
        for larger in (s for s in around if not s <= self.best):
            grown.setdefault(larger & self.best, []).extend(larger - self.best)
        starts: dict[Choice, list[np.ndarray]] = {}
        for base, others in grown.items():
            if base in self._fits and base not in self._tried:
                self._tried.add(base)
                fit, effects = self._fits.best(base), {e: self.effects[e] for e in others}
                gains = predicted_gains_of(self.models, target, fit, effects, self._is_explained(fit))
                starts |= beside(gains, self._fits.top(base), base == self.best)
        self._fits.fit(target, starts, starts)

    def _fit_pairs(self) -> None:
        """Fit pairs in place of the one effect of the best set, if that leaves more than the noise: one may have replaced two."""
        self._pairs = []
        if len(self.best) != 1 or self._is_explained(self._fits.best(self.best)):
            return
        self._report(f"pairs in place of {_text(self.best)}")
        others = {e: forms for e, forms in self.effects.items() if e not in self.best}
        singles = (self.model({e}) for e in others if frozenset({e}) in self._fits)
        leading = sorted(singles, key=lambda m: -m.log_posterior)[:_OTHERS]
        chosen = [(self._fits.top(m.effects), m.fit) for m in leading]
        starts = pairs(self.models, self.standard.target, chosen, others, _BESIDE)
        self._pairs = list(dict.fromkeys(names_of(choice) for choice in starts))
        self._fits.fit(self.standard.target, starts, starts)

    def _in_forms(self, effects: Set) -> Choice:
        """Some effects of the best set, in their forms there."""
        best = dict(self._fits.top(self.best))
        return frozenset((effect, best[effect]) for effect in effects)

    def _deepen(self, sets: Iterable[Set]) -> None:
        """Fit the sets with the largest evidence in further forms of each effect: with other drivers, then in other shapes."""
        ranked = sorted((self.model(s) for s in sets if s in self._fits), key=lambda m: -m.log_posterior)
        # If the noise is small, a formula that is not that of the specimen costs many nats.
        top = ranked[0].log_posterior
        enough = min(top - _NEAR, 0.5 * (top + self.model(self.best).log_posterior))
        near = [m for m in ranked[: _DEEP if self.best else 3 * _DEEP] if m.log_posterior >= enough]
        for others, several in ((of_other_drivers, 1), (of_other_shapes, _DRIVERS)):
            self._report(f"forms of {_text(near[0].effects)}")
            choices: list[Choice] = []
            leading = [choice for m in near for choice in self._fits.leading(m.effects, several)]
            for own, (effect, label) in ((choice, form) for choice in leading for form in sorted(choice)):
                # An effect of the best set changes its form only in that set: comparisons with other effects keep its form.
                if effect not in self.best or names_of(own) == self.best:
                    choices += [own - {(effect, label)} | {(effect, o)} for o in others(self.effects[effect], label)]
            self._fits.fit(self.standard.target, dict.fromkeys(choices))

    def _judge(self) -> None:
        """Judge all sets with the errors of the best fit."""
        around = self._around()
        for _ in range(2):
            self.standard = self.measured.standard(self._lowest().predicted, self.held_out.folds.fitted)
            self._fits.judge(self.standard.target, around)

    def _score(self, is_over: bool = False) -> None:
        """Give the leading choices their probabilities, from their scores or their evidence.

        All other choices have none, and neither has one that predicts the test experiments worse than the first model.  When the
        search `is_over`, larger sets than the best one count only if they contain its effects; unless the noise explains the
        best set, a choice with a materially larger test error has no probability.
        """
        self._report("what they predict of what is left out")
        if is_over:
            # The ranking compares the best set with the sets that lack one of its effects.
            self._fits.fit(self.standard.target, [self._in_forms(less) for less in less_one(self.best)])
        always = [self._fits.top(s) for s in (Set(), self.best, *less_one(self.best)) if s in self._fits]
        counted = [s for s in self._around() if not is_over or len(s) <= max(len(self.best), 1) or s > self.best]
        ranked = sorted(map(self.model, counted), key=lambda m: -m.log_posterior)
        likely = [choice for m in ranked[:_POOL] for choice in self._fits.likeliest(m.effects, _FORMS)]
        pool = list(dict.fromkeys([*always, *likely]))
        fits = [self._fits[choice] for choice in pool]
        evidence = [[self._fits.log_evidence(choice)] for choice in pool]
        densities = np.asarray(evidence) if self.by_evidence else self.held_out.densities(self.standard.target, fits)
        if self.held_out.test is not None:
            unseen = np.asarray(self.held_out.unseen(self.standard.target, fits))
            first, best = (float(unseen[pool.index(self._fits.top(s))]) for s in (Set(), self.best))
            decides = is_over and not self._is_explained(self._fits.best(self.best))
            limit = min(first, largest_alike(self.measured.noise, first, best)) if decides else first
            densities[unseen > limit] = -np.inf
        priors = np.asarray([self._log_prior(len(choice)) + self._fits.log_share(choice) for choice in pool])
        self._fits.probabilities = dict(zip(pool, weights_of(densities, priors).tolist(), strict=True))

    def _next(self) -> Set:
        """The next set: the most probable one that the measurements support."""
        sets = [m.effects for m in self.all()[:_TRIED]]
        return next((s for s in sets if len(s) <= len(self.best) or self._unsupported(s, self.best) is None), self.best)

    def _neighbours(self) -> list[Set]:
        """The sets one change away from the best one.  It is decided once whether they include larger sets."""
        best = self.best
        if best not in self._near:
            others, bases = [e for e in self.effects if e not in best], less_one(best)
            extended = [*bases, best] if self._may_grow() else bases
            self._near[best] = [best, *bases, *(base | {new} for base in extended for new in others)]
        return self._near[best]

    def _may_grow(self) -> bool:
        """Whether a further effect can be material, if it leaves only the noise."""
        if not self.best:
            return True
        if len(self.best) == MOST_EFFECTS or not self.is_open():
            return False
        before, now = self.held_out.errors(self.standard.target, [self._fits.best(s) for s in (Set(), self.best)])
        noise = max(self.measured.noise**2 - _DEVIATIONS * self.measured.scatter, 0.0)
        return now**2 - noise >= material(self.measured.noise, before, now)

    def is_open(self) -> bool:
        """Whether a further effect has something to explain, by the size of the residual or by a score test."""
        return not self._is_explained(self._fits.best(self.best)) or bool(self.pointed_at(self.best))

    def _around(self) -> list[Set]:
        """The fitted sets around the best one, and the set of each single candidate that none of them contains."""
        sets = [s for s in dict.fromkeys([Set(), *self.path, *self._neighbours(), *self._pairs]) if s in self._fits]
        alone = [frozenset({e}) for e in self.effects if not any(e in s for s in sets)]
        return [*sets, *(s for s in alone if s in self._fits)]

    def _lowest(self) -> FitState:
        """The best fit of the round: each fit has the errors that it leaves itself, and the prior of its set counts."""

        def cost(effects: Set) -> float:
            fit, log_prior = self._fits.best(effects), self._log_prior(len(effects))
            log_prior += float(self.models.box.log_density(fit.x[None], fit.free).sum())
            surprise = self.measured.surprise(fit.predicted, self.standard, len(fit.free))
            return surprise - log_prior if np.isfinite(fit.cost) else math.inf

        return self._fits.best(min(self._around(), key=cost))

    def _log_prior(self, size: int) -> float:
        return -(size + 1) * math.log(2) - math.log(math.comb(len(self.effects), size))


def _text(effects: Set) -> str:
    return " + ".join(sorted(effects)) or "the model as it is"
