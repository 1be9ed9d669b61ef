r"""Fits of sets of effects, each effect in several forms, and what evidence and prediction say of them.

The evidence of a set is the sum of those of its forms, which share its prior probability, $Z_S = \sum_f p(f)\,Z_f$: half of it
belongs to the default form of each effect and half to the others alike.  So many forms buy nothing, and an effect is compared
with another whatever formulas the two have.
"""

# SciPy comes without types.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from hsed_jax.diagnosis.evidence import laplace
from hsed_jax.diagnosis.fit_state import FitState, Submodel, Target, Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import FormColumns, Forms
from hsed_jax.diagnosis.score import ODDS

# A fit that another one shows to be improvable by more nats than this goes on from there.
_CAUGHT = 0.1
# An amplitude this close to its neutral value, in coordinates of order one, is none.
_ABSENT = 1e-3
# Another shape may make good what a form lacks of the best one of its set: so much of what that gains over an effect less.
_SHAPE = 0.5
# Of choices that are judged with other errors so many, those that lead, are fitted again.
_LEAD = 12
# Forms this many nats below the best one of their set are given up.
_HOPELESS = 8.0

Set = frozenset[str]
Choice = frozenset[tuple[str, str]]
"""Effects, each with the label of its form."""


class Model(NamedTuple):
    """A set of effects, fitted in one form or several.

    Attributes:
        effects: the set.
        forms: of each effect the form in which it is taken, by its label.
        shares: of each effect the probabilities of its forms.
        fit: where the fit of these forms ended.
        log_evidence: log Z over the forms.
        log_posterior: log Z plus the log prior of the set.
        probability: by what its forms predict; zero where none of them was scored.
    """

    effects: Set
    forms: Mapping[str, str]
    shares: Mapping[str, Mapping[str, float]]
    fit: FitState
    log_evidence: float
    log_posterior: float
    probability: float


class Fits:
    """What has been fitted.

    Arguments:
        models: the large model.
        law: indices of the parameters that every model has.
        effects: the forms of each candidate.

    Attributes:
        probabilities: of the choices that were scored by what they predict.
    """

    def __init__(self, models: NestedModels, law: Int[np.ndarray, " p"], effects: Mapping[str, Forms]):
        self.models, self.law, self.effects = models, law, effects
        self._known: dict[Choice, FitState] = {}
        self._hopeless: set[Choice] = set()
        self._evidence: dict[Choice, tuple[FitState, float]] = {}
        self.probabilities: dict[Choice, float] = {}

    def __contains__(self, effects: Set) -> bool:
        """Whether a set was fitted in any form."""
        return bool(self.of(effects))

    def of(self, effects: Set) -> list[Choice]:
        """The forms of a set that were fitted."""
        return [choice for choice in self._known if names_of(choice) == effects]

    def starts_of_law(self) -> Float[np.ndarray, "8 P"]:
        """Points all over the priors of the law, without effects; the first is the neutral one."""
        return np.stack([self.models.neutral, *self._everywhere(self.law)[1:]])

    def set_law(self, fit: FitState) -> None:
        """Take the fit of the model without effects."""
        self._known[frozenset()] = fit

    def top(self, effects: Set) -> Choice:
        """The forms in which a set that was fitted is taken: of those that predict as well as the best, the ones of fewest
        parameters; where none was scored, those of most evidence."""
        scored = {c: p for c in self.of(effects) if (p := self.probabilities.get(c, 0.0)) > 0}
        if not scored:
            return max(self.of(effects), key=self._worth)
        alike = [choice for choice, p in scored.items() if ODDS * p >= max(scored.values())]
        return min(alike, key=lambda choice: (len(self._known[choice].free), -scored[choice]))

    def likeliest(self, effects: Set, most: int) -> list[Choice]:
        """The forms of a set that was fitted of most evidence, at most so many."""
        return sorted(self.of(effects), key=self._worth, reverse=True)[:most]

    def __getitem__(self, choice: Choice) -> FitState:
        """The fit of a choice."""
        return self._known[choice]

    def leading(self, effects: Set, most: int) -> list[Choice]:
        """The most probable forms of a set that was fitted, one of each driver and at most so many, as far as another shape may
        make them the best."""
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
        """The fit of a set in the forms in which it is taken."""
        return self._known[self.top(effects)]

    def model(self, effects: Set, log_prior: float) -> Model:
        """A set that was fitted, over its forms."""
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
        """Fit what has not been fitted, from several starts: those that are given, or what is near."""
        new = [choice for choice in choices if choice not in self._known and choice not in self._hopeless]
        self._fit_from(target, {choice: (starts or {}).get(choice) or self._starts(choice) for choice in new})

    def judge(self, target: Target, sets: Sequence[Set]) -> None:
        """Judge sets with other errors, and fit the choices that lead then again, each from where it was; forms that are far
        below others of their set are left."""
        kept: list[Choice] = []
        for effects in sets:
            choices = self.of(effects)
            highest = max(self._worth(choice) for choice in choices)
            for choice in choices:
                if self._worth(choice) > highest - _HOPELESS or len(choices) == 1:
                    kept.append(choice)
                else:
                    self._hopeless.add(choice)
                    del self._known[choice]
        self._known |= self._go_on(target, {choice: self._known[choice].x for choice in kept}, stay=True)
        lead = sorted(kept, key=self._worth, reverse=True)[:_LEAD]
        self._known |= self._go_on(target, {choice: self._known[choice].x for choice in lead})
        self._reconcile(target, lead)

    def look_again(self, target: Target, choices: Sequence[Choice]) -> None:
        """Fit choices from points all over the priors of their effects: what was best with other errors need not be so now."""
        self._fit_from(target, {c: self._all_over(self._known[c].x, c) for c in choices})

    def look_all_over(self, target: Target) -> None:
        """Fit each effect alone, in its simplest shape, from points all over the priors of law and effect: beside another law it
        may be what it cannot be beside the fitted one."""
        starts: dict[Choice, list[np.ndarray]] = {}
        for effect, forms in self.effects.items():
            label, form = next(iter(forms.items()))
            starts[frozenset({(effect, label)})] = self._everywhere(np.concatenate([self.law, form.columns]))
        self._fit_from(target, starts)

    def submodel(self, choice: Choice) -> Submodel:
        """The nested model of a choice."""
        forms = [self._form(pair) for pair in sorted(choice)]
        held = {column: value for form in forms for column, value in form.held.items()}
        return self.models.submodel(np.concatenate([self.law, *(form.columns for form in forms)]).astype(int), held)

    def _fit_from(self, target: Target, starts: Mapping[Choice, Sequence[np.ndarray]]) -> None:
        """Fit choices, each from its starts, which are rivals, and keep the best of each that is known."""
        tasks = [
            Task(self.submodel(choice), start, rivals=number)
            for number, (choice, own) in enumerate(starts.items())
            for start in own
        ]
        owners = [choice for choice, own in starts.items() for _ in own]
        for owner, fit in zip(owners, self.models.fit(target, tasks), strict=True):
            if owner not in self._known or fit.cost < self._known[owner].cost:
                self._known[owner] = fit

    def _all_over(self, x: np.ndarray, pairs: Iterable[tuple[str, str]]) -> list[np.ndarray]:
        """Points at which effects have values from all over their priors, and everything else is as it is at x."""
        columns = np.concatenate([self._form(pair).columns for pair in sorted(pairs)])
        return self._with_shares(x, columns, spread(len(columns)))

    def _everywhere(self, columns: np.ndarray) -> list[np.ndarray]:
        """Points at which some parameters have values from all over their priors, and the others are neutral."""
        from scipy.stats import qmc

        shares = 0.1 + 0.8 * qmc.Sobol(len(columns), scramble=True, rng=0).random_base2(3)
        return self._with_shares(self.models.neutral, columns, shares)

    def _with_shares(self, x: np.ndarray, columns: np.ndarray, shares: Float[np.ndarray, "s q"]) -> list[np.ndarray]:
        """Points at which these shares of the priors of some parameters lie below them, and everything else is as it is at x."""
        starts = np.tile(x, (len(shares), 1))
        starts[:, columns] = self.models.box.quantiles(columns, shares)
        return list(starts)

    def _drivers(self, choice: Choice) -> Choice:
        return frozenset((pair[0], self._form(pair).form.driver) for pair in choice)

    def _form(self, pair: tuple[str, str]) -> FormColumns:
        effect, label = pair
        return self.effects[effect][label]

    def _go_on(self, target: Target, starts: Mapping[Choice, np.ndarray], stay: bool = False) -> dict[Choice, FitState]:
        # Each is a start of its own, and ends where it cannot catch up with the others.
        tasks = [
            Task(self.submodel(choice), start, rivals=number, known=self._known[choice], stays=stay)
            for number, (choice, start) in enumerate(starts.items())
        ]
        return dict(zip(starts, self.models.fit(target, tasks), strict=True))

    def _reconcile(self, target: Target, choices: Sequence[Choice]) -> None:
        """No model fits worse than one that it contains, nor than a larger one whose further effect is absent: where one does,
        it was caught on the way, and goes on from there."""
        for size in sorted({len(c) for c in choices}):
            caught = {c: x for c in choices if len(c) == size and (x := self._better_start(c, choices)) is not None}
            self._known |= {c: fit for c, fit in self._go_on(target, caught).items() if fit.cost < self._known[c].cost}

    def _better_start(self, choice: Choice, choices: Sequence[Choice]) -> np.ndarray | None:
        """Where the fit of another choice shows this model to fit better than it does; None where none does."""
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
        """Points to fit from: where other forms of the same effects are, or else the best fitted part with what it lacks at
        several values."""
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
                # Where it is that other form, which it may contain, and where it is not.
                starts[0, new] = self.models.neutral[new]
                starts[1:, new] = self.models.box.quantiles(new, np.tile([[0.75], [0.3]], len(new)))
            return list(starts)
        known = max((c for c in self._known if c < choice), key=lambda c: (len(c), -self._known[c].cost))
        return self._all_over(self._known[known].x, choice - known)

    # What a choice is worth.

    def _worth(self, choice: Choice) -> float:
        """log Z plus the log prior of its forms."""
        return self._log_evidence(choice) + self.log_share(choice)

    def log_share(self, choice: Choice) -> float:
        """Log prior probability of the forms among those of their effects."""
        return sum(self._log_share(pair) for pair in choice)

    def _log_share(self, pair: tuple[str, str]) -> float:
        others = len(self.effects[pair[0]]) - 1
        if not others:
            return 0.0
        return -math.log(2) if self._form(pair).form.is_default else -math.log(2 * others)

    def _log_evidence(self, choice: Choice) -> float:
        fit = self._known[choice]
        if choice not in self._evidence or self._evidence[choice][0] is not fit:
            self._evidence[choice] = (fit, laplace(fit, self.models))
        return self._evidence[choice][1]


def names_of(choice: Choice) -> Set:
    """The effects of a choice."""
    return frozenset(effect for effect, _ in choice)


def spread(parameters: int, each: int = 2) -> np.ndarray:
    """Shares of the priors to start from, so many for each parameter and one more, (starts, parameters)."""
    from scipy.stats import qmc

    if parameters == 1:
        return np.asarray([[0.1], [0.35], [0.65], [0.9]])
    count = each * (parameters + 1)
    return 0.1 + 0.8 * qmc.Sobol(parameters, scramble=True, rng=1).random_base2(count.bit_length())[:count]
