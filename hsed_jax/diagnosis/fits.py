r"""Fits of sets of effects, each effect in several forms, and the comparison of these fits by evidence and by score.

The evidence of a set is the sum over its forms, $Z_S = \sum_f p(f)\,Z_f$.  The forms of an effect share its prior probability:
the default form has half of it, and the other forms have equal parts of the other half.  Adding forms therefore does not raise
the probability of an effect, and two effects are compared independently of their formulas.
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.fit_state import FitState, Submodel, Target, Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import FormColumns, Forms
from hsed_jax.diagnosis.score import ODDS

# A fit restarts at the point of another fit if this lowers its cost by more than this many nats.
_CAUGHT = 0.1
# An amplitude this close to its neutral value, in coordinates of order one, counts as absent.
_ABSENT = 1e-3
# Another shape may compensate for a deficit of this share of the gain of the best form over the best smaller set.
_SHAPE = 0.5
# After a change of the errors, this many choices are fitted again: the ones with the largest evidence.
_LEAD = 12
# Forms this many nats below the best form of their set are rejected.
_HOPELESS = 8.0

Set = frozenset[str]
Choice = frozenset[tuple[str, str]]
"""Effects, each with the label of its form."""


class Model(NamedTuple):
    """A set of effects, fitted in one or several forms.

    Attributes:
        effects: the set.
        forms: by effect, the label of its selected form.
        shares: by effect, the probabilities of its forms.
        fit: the fit state with the selected forms.
        log_evidence: log Z over the forms.
        log_posterior: log Z plus the log prior of the set.
        probability: sum over its forms, from their scores; zero if none of them was scored.
    """

    effects: Set
    forms: Mapping[str, str]
    shares: Mapping[str, Mapping[str, float]]
    fit: FitState
    log_evidence: float
    log_posterior: float
    probability: float


class Fits:
    """All fits so far.

    Arguments:
        models: the large model.
        law: indices of the parameters that every model has.
        effects: the forms of each candidate.

    Attributes:
        probabilities: of the scored choices, from their scores.
    """

    def __init__(self, models: NestedModels, law: Int[np.ndarray, " p"], effects: Mapping[str, Forms]):
        self.models, self.law, self.effects = models, law, effects
        self._known: dict[Choice, FitState] = {}
        # The same choices by their set: a search asks for them thousands of times.
        self._of: dict[Set, list[Choice]] = {}
        self._hopeless: set[Choice] = set()
        self._evidence: dict[Choice, tuple[FitState, float]] = {}
        self.probabilities: dict[Choice, float] = {}

    def __contains__(self, effects: Set) -> bool:
        """Whether a set was fitted in any form."""
        return bool(self._of.get(effects))

    def of(self, effects: Set) -> list[Choice]:
        """The fitted forms of a set."""
        return list(self._of.get(effects, ()))

    def starts_of_law(self) -> Float[np.ndarray, "8 P"]:
        """Points spread over the priors of the law parameters, without effects; the first one is the neutral point."""
        return np.stack([self.models.neutral, *self._everywhere(self.law)[1:]])

    def set_law(self, fit: FitState) -> None:
        """Store the fit of the model without effects."""
        self._store({frozenset(): fit})

    def top(self, effects: Set) -> Choice:
        """The selected forms of a fitted set: of the forms that predict about as well as the best, those with the fewest
        parameters; if none was scored, those with the largest evidence."""
        scored = {c: p for c in self.of(effects) if (p := self.probabilities.get(c, 0.0)) > 0}
        if not scored:
            return max(self.of(effects), key=self._worth)
        alike = [choice for choice, p in scored.items() if ODDS * p >= max(scored.values())]
        return min(alike, key=lambda choice: (len(self._known[choice].free), -scored[choice]))

    def likeliest(self, effects: Set, most: int) -> list[Choice]:
        """The forms of a fitted set with the largest evidence, at most `most` of them."""
        return sorted(self.of(effects), key=self._worth, reverse=True)[:most]

    def __getitem__(self, choice: Choice) -> FitState:
        """The fit state of a choice."""
        return self._known[choice]

    def leading(self, effects: Set, most: int) -> list[Choice]:
        """The most probable forms of a fitted set, one for each combination of drivers and at most `most` of them.  Forms far
        below the best form are omitted, because another shape cannot compensate for the difference."""
        worths = {choice: self._worth(choice) for choice in self.of(effects)}
        ranked = sorted(worths, key=lambda choice: -worths[choice])
        of_drivers: dict[Choice, Choice] = {}
        for choice in ranked:
            of_drivers.setdefault(self._drivers(choice), choice)
        fewer = [effects - {e} for e in effects if effects - {e} in self]
        below = max((self._worth(self.top(less)) for less in fewer), default=-math.inf)
        least = worths[ranked[0]] - _SHAPE * (worths[ranked[0]] - below)
        return [choice for choice in list(of_drivers.values())[:most] if worths[choice] >= least]

    def best(self, effects: Set) -> FitState:
        """The fit state of a set with its selected forms."""
        return self._known[self.top(effects)]

    def model(self, effects: Set, log_prior: float) -> Model:
        """The result for a fitted set, over its forms."""
        choices, top = self.of(effects), self.top(effects)
        worths = np.asarray([self._worth(choice) for choice in choices])
        total = float(np.asarray(logsumexp(worths)))
        predicted = np.asarray([self.probabilities.get(choice, 0.0) for choice in choices])
        weights = (
            predicted if predicted.any() else np.exp(worths - total) if math.isfinite(total) else np.ones(len(choices))
        )
        shares: dict[str, dict[str, float]] = {effect: {} for effect in sorted(effects)}
        for choice, share in zip(choices, weights / weights.sum(), strict=True):
            for effect, label in choice:
                shares[effect][label] = shares[effect].get(label, 0.0) + float(share)
        return Model(effects, dict(top), shares, self._known[top], total, total + log_prior, float(predicted.sum()))

    def fit(
        self, target: Target, choices: Iterable[Choice], starts: Mapping[Choice, list[np.ndarray]] | None = None
    ) -> None:
        """Fit the choices that are not fitted yet, from the given starts or from points near earlier fits."""
        new = [choice for choice in choices if choice not in self._known and choice not in self._hopeless]
        self._fit_from(target, {choice: (starts or {}).get(choice) or self._starts(choice) for choice in new})

    def judge(self, target: Target, sets: Sequence[Set]) -> None:
        """Evaluate sets with other errors, and continue the fits of the leading choices from where they ended.  Forms far below
        the best form of their set are rejected."""
        kept: list[Choice] = []
        for effects in sets:
            choices = self.of(effects)
            highest = max(self._worth(choice) for choice in choices)
            for choice in choices:
                if self._worth(choice) < highest - _HOPELESS:
                    self._hopeless.add(choice)
                    self._of[effects].remove(choice)
                    del self._known[choice]
                else:  # also if the simulations of every form diverge
                    kept.append(choice)
        self._store(self._go_on(target, {choice: self._known[choice].x for choice in kept}, stay=True))
        lead = sorted(kept, key=self._worth, reverse=True)[:_LEAD]
        self._store(self._go_on(target, {choice: self._known[choice].x for choice in lead}))
        self._reconcile(target, lead)

    def look_all_over(self, target: Target, rows: Int[np.ndarray, " r"]) -> None:
        """Fit each effect alone, in its default form, from points spread over the priors of law and effect.

        With other parameters of the law, an effect may explain more than with the fitted ones.  The experiments in `rows` select
        the leading effects.
        """
        starts: dict[Choice, list[np.ndarray]] = {}
        for effect, forms in self.effects.items():
            label, form = next(iter(forms.items()))
            starts[frozenset({(effect, label)})] = self._everywhere(np.concatenate([self.law, form.columns]))
        selected = np.isin(np.arange(len(target.values)), rows)[:, None]
        best = self._raced(replace(target, weights=target.weights * selected), starts)
        leading = sorted(best, key=lambda choice: best[choice].cost)[:_LEAD]
        self._fit_from(target, {choice: [best[choice].x] for choice in leading})

    def submodel(self, choice: Choice) -> Submodel:
        """The submodel of a choice."""
        forms = [self._form(pair) for pair in sorted(choice)]
        held = {column: value for form in forms for column, value in form.held.items()}
        return self.models.submodel(np.concatenate([self.law, *(form.columns for form in forms)]).astype(int), held)

    def _fit_from(self, target: Target, starts: Mapping[Choice, Sequence[np.ndarray]]) -> None:
        """Fit choices from their starts, and store the best fit of each choice."""
        self._store_better(self._raced(target, starts))

    def _store_better(self, found: Mapping[Choice, FitState]) -> None:
        """Store the fits with a lower cost than the stored ones."""
        self._store({c: fit for c, fit in found.items() if c not in self._known or fit.cost < self._known[c].cost})

    def _store(self, found: Mapping[Choice, FitState]) -> None:
        """Store fits in place of earlier ones."""
        for choice in found:
            if choice not in self._known:
                self._of.setdefault(names_of(choice), []).append(choice)
        self._known |= found

    def _raced(self, target: Target, starts: Mapping[Choice, Sequence[np.ndarray]]) -> dict[Choice, FitState]:
        """The best fit of each choice from its starts, of which only the leading ones continue."""
        tasks = [
            Task(self.submodel(choice), start, rivals=number)
            for number, (choice, own) in enumerate(starts.items())
            for start in own
        ]
        best: dict[Choice, FitState] = {}
        for owner, fit in zip(
            [c for c, own in starts.items() for _ in own], self.models.fit(target, tasks), strict=True
        ):
            if owner not in best or fit.cost < best[owner].cost:
                best[owner] = fit
        return best

    def _all_over(self, x: np.ndarray, pairs: Iterable[tuple[str, str]]) -> list[np.ndarray]:
        """Points with values of the effects that are spread over their priors; all other coordinates are those of x."""
        columns = np.concatenate([self._form(pair).columns for pair in sorted(pairs)])
        return self._with_shares(x, columns, spread(len(columns)))

    def _everywhere(self, columns: np.ndarray) -> list[np.ndarray]:
        """Points with values of some parameters that are spread over their priors; all others are neutral."""
        from scipy.stats import qmc

        shares = 0.1 + 0.8 * qmc.Sobol(len(columns), scramble=True, rng=0).random_base2(3)
        return self._with_shares(self.models.neutral, columns, shares)

    def _with_shares(self, x: np.ndarray, columns: np.ndarray, shares: Float[np.ndarray, "s q"]) -> list[np.ndarray]:
        """Points with some parameters at these quantile levels of their priors; all other coordinates are those of x."""
        starts = np.tile(x, (len(shares), 1))
        starts[:, columns] = self.models.box.quantiles(columns, shares)
        return list(starts)

    def _drivers(self, choice: Choice) -> Choice:
        return frozenset((pair[0], self._form(pair).form.driver) for pair in choice)

    def _form(self, pair: tuple[str, str]) -> FormColumns:
        effect, label = pair
        return self.effects[effect][label]

    def _go_on(self, target: Target, starts: Mapping[Choice, np.ndarray], stay: bool = False) -> dict[Choice, FitState]:
        # Each start belongs to a different fit; a fit ends if it cannot catch up with the best one.
        tasks = [
            Task(self.submodel(choice), start, rivals=number, known=self._known[choice], stays=stay)
            for number, (choice, start) in enumerate(starts.items())
        ]
        return dict(zip(starts, self.models.fit(target, tasks), strict=True))

    def _reconcile(self, target: Target, choices: Sequence[Choice]) -> None:
        """Correct fits that ended in a local minimum: a model fits at least as well as each of its submodels, and as a larger
        model whose additional effect is absent.  If it does not, its fit continues from the point of the other model."""
        for size in sorted({len(c) for c in choices}):
            caught = {c: x for c in choices if len(c) == size and (x := self._better_start(c, choices)) is not None}
            self._store_better(self._go_on(target, caught))

    def _better_start(self, choice: Choice, choices: Sequence[Choice]) -> np.ndarray | None:
        """The point of another fit at which this model has a lower cost than at its own point; None without one."""
        here = self._known[choice]
        options: list[tuple[float, np.ndarray]] = []
        for other in choices:
            if len(other ^ choice) != 1:
                continue
            (changed,) = other ^ choice
            fit, columns = self._known[other], self._form(changed).columns
            x, absent = fit.x.copy(), self.models.neutral[columns[0]]
            if changed in choice:
                x[columns] = here.x[columns]
                x[columns[0]] = absent
                options.append((fit.cost - self._log_density(x, columns), x))
            elif abs(x[columns[0]] - absent) < _ABSENT:
                options.append((fit.cost + self._log_density(x, columns), x))
        cost, x = min(options, key=lambda option: option[0], default=(math.inf, here.x))
        return x if cost < here.cost - _CAUGHT else None

    def _log_density(self, x: np.ndarray, columns: np.ndarray) -> float:
        return float(self.models.box.log_density(x[None], columns).sum())

    def _starts(self, choice: Choice) -> list[np.ndarray]:
        """Starts of a fit: near the fit with another form of one effect, or else at the best fitted submodel, with several values
        of the effects that it lacks."""
        same = [c for c in self.of(names_of(choice)) if len(c - choice) == 1]
        if same:
            near = min(same, key=lambda c: (self._drivers(c) != self._drivers(choice), self._known[c].cost))
            x = self._known[near].x
            (changed,) = choice - near
            (instead,) = near - choice
            columns = self._form(changed).columns
            new = np.setdiff1d(columns, self._form(instead).columns)
            starts = np.tile(x, (3 if new.size else 2, 1))
            starts[1, columns[0]] = self.models.box.quantiles(columns[:1], np.asarray([[0.5]]))[0, 0]
            if new.size:
                # One start where the new form equals the other form, if it contains that form, and two starts where it differs.
                starts[0, new] = self.models.neutral[new]
                starts[1:, new] = self.models.box.quantiles(new, np.tile([[0.75], [0.3]], len(new)))
            return list(starts)
        known = max((c for c in self._known if c < choice), key=lambda c: (len(c), -self._known[c].cost))
        return self._all_over(self._known[known].x, choice - known)

    # The evidence of a choice.

    def _worth(self, choice: Choice) -> float:
        """log Z plus the log prior of its forms."""
        return self.log_evidence(choice) + self.log_share(choice)

    def log_share(self, choice: Choice) -> float:
        """Log prior probability of the forms of a choice among all forms of their effects."""
        return sum(self._log_share(pair) for pair in choice)

    def _log_share(self, pair: tuple[str, str]) -> float:
        others = len(self.effects[pair[0]]) - 1
        if not others:
            return 0.0
        return -math.log(2) if self._form(pair).form.is_default else -math.log(2 * others)

    def log_evidence(self, choice: Choice) -> float:
        """Log evidence of a choice, without the prior of its forms [nats]."""
        fit = self._known[choice]
        if choice not in self._evidence or self._evidence[choice][0] is not fit:
            self._evidence[choice] = (fit, laplace(fit, self.models))
        return self._evidence[choice][1]


def names_of(choice: Choice) -> Set:
    """The effects of a choice."""
    return frozenset(effect for effect, _ in choice)


def less_one(effects: Set) -> list[Set]:
    """The sets with one effect fewer, in the same order in every process: the names of stored fits depend on this order."""
    return [effects - {effect} for effect in sorted(effects)]


def spread(parameters: int, each: int = 2) -> np.ndarray:
    """Quantile levels of starts: `each` for every parameter and `each` more, four for one parameter, (starts, parameters)."""
    from scipy.stats import qmc

    if parameters == 1:
        return np.asarray([[0.1], [0.35], [0.65], [0.9]])
    count = each * (parameters + 1)
    return 0.1 + 0.8 * qmc.Sobol(parameters, scramble=True, rng=1).random_base2(count.bit_length())[:count]
