"""What a diagnosis found, and how it shows itself."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hsed_jax.behaviour.findings import Behaviours
from hsed_jax.criticism.compare import is_noise
from hsed_jax.criticism.prediction import Prediction, error_cell
from hsed_jax.physics.effects import called
from hsed_jax.physics.scales import Scales
from hsed_jax.tables import Table, Tabular, cell, odds

if TYPE_CHECKING:
    # A report reads findings and fits nothing.
    from hsed_jax.diagnosis.averaging import Averaged
    from hsed_jax.diagnosis.loadings import Loading

# Of so many likely effects it is said why they are not named.
_SHOWN = 3


@dataclass(frozen=True)
class Candidate:
    """One effect of the catalogue, as the measurements see it.

    Attributes:
        effect, family: of the catalogue.
        probability: that it takes part, over all models that were looked at.
        log_evidence_gain: of the model with it over the same model without it.
        rao_statistic, rao_p_value: Rao's score test of its amplitude in the model as it is.
        estimate: of its parameters in both their forms: mean, sd, 5 % and 95 % quantile, unit.
        error_train, error_test: normalised errors of the model with it; test: of experiments that were not used, the test
            split or, without one, experiments left out in turn; infinite where a simulation fails.
        reason: why it is not named though it is likely; None where it is named, or unlikely.
        score: by how many nats the model with it predicts what is left out better than the model as it is (`gain`), with the
            `standard_error`; None where it was not scored.
        form: the one of its forms in which all of this is said, the most probable one or, under a wrong model, the one that
            predicts best; None where it has but one.
        forms: probabilities of its forms.
    """

    effect: str
    family: str
    probability: float
    log_evidence_gain: float
    rao_statistic: float
    rao_p_value: float
    estimate: dict[str, dict[str, Any]]
    error_train: float
    error_test: float
    reason: str | None = None
    score: Mapping[str, float] | None = None
    form: str | None = None
    forms: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def called(self) -> str:
        """The name of the effect, and what it is where its amplitude is negative."""
        return called(self.effect, {name: size["mean"] for name, size in self.estimate.items() if "mean" in size})

    def summary(self) -> dict[str, Any]:
        """As in `summary.json`; what is not finite, or not there, is absent."""
        found = {k: v for k, v in vars(self).items() if v is not None and v != {}}
        return {k: v for k, v in found.items() if not isinstance(v, float) or math.isfinite(v)}


@dataclass(frozen=True)
class Judgement:
    """What an effect is to the specimens.

    Attributes:
        effect: of the catalogue.
        level: the column that tells the specimens apart.
        verdict: `population` (all have it), `specimens` (those in `members` do, the others do not) or `scatter`.
        probability: of the verdict.
        members: that have it.
        of: by member mean, sd, 5 % and 95 % quantile of its size by itself, dimensionless, and the `probability` that it has it.
    """

    effect: str
    level: str
    verdict: str
    probability: float
    members: Sequence[str]
    of: Mapping[str, Mapping[str, float]]

    @property
    def sentence(self) -> str:
        """In words."""
        said = {
            "population": f"is of the population: all {len(self.of)} of {self.level} have it",
            "specimens": f"is of {self.level} {' and '.join(self.members) or 'few'} only, {len(self.members)} of {len(self.of)}",
            "scatter": f"is scatter: its size is no property of any {self.level}",
        }[self.verdict]
        return f"{self.effect} {said} (probability {self.probability:.2f})"

    def summary(self) -> dict[str, Any]:
        """As in `summary.json`."""
        return {**vars(self), "members": list(self.members), "of": {m: dict(v) for m, v in self.of.items()}}


@dataclass(frozen=True)
class Explained:
    """Models that do the same, whatever formulas fitted.

    Attributes:
        effects: what they are called.
        forms: of the one that predicts best.
        weight: of all of them.
        error_test: of that one, as of a `Candidate`.
        score: of that one, as of a `Candidate`.
    """

    effects: Sequence[str]
    forms: Mapping[str, str]
    weight: float
    error_test: float
    score: Mapping[str, float] | None

    def summary(self) -> dict[str, Any]:
        """An entry of `diagnosis.explanations` in `summary.json`."""
        content = {"weight": self.weight, "effects": list(self.effects), "forms": dict(self.forms)}
        test = {"error_test": self.error_test} if math.isfinite(self.error_test) else {}
        return content | test | ({"score": dict(self.score)} if self.score else {})


@dataclass(frozen=True)
class PriorWidth:
    """What the verdict is where the priors of the named effects (without one, of all candidates) have another width.

    Attributes:
        width: times the width of the priors.
        verdict: as of a diagnosis.
        effects: that are named.
        log_evidence_gain: of each named effect (without one, of the candidate of most evidence), at this width.
        log_evidence_gain_before: the same with the priors as they are.
        is_same: whether verdict and effects are those with the priors as they are.
        leader: effects of the explanation that then leads by the demands of a verdict; None without one.
    """

    width: float
    verdict: str
    effects: Sequence[str]
    log_evidence_gain: Mapping[str, float]
    log_evidence_gain_before: Mapping[str, float]
    is_same: bool
    leader: tuple[str, ...] | None = None

    @property
    def words(self) -> str:
        """The width in words."""
        return f"{self.width:g} times wider" if self.width > 1 else f"{1 / self.width:g} times narrower"

    @property
    def sentence(self) -> str:
        """What the width does to the verdict."""
        gains = ", ".join(
            f"{effect} {self.log_evidence_gain_before[effect]:.1f} to {gain:.1f}"
            for effect, gain in self.log_evidence_gain.items()
        )
        told = f" (log evidence gain: {gains})" if gains else ""
        if self.is_same:
            return f"with priors of the effects {self.words} the verdict stays the same{told}"
        named = " and ".join(self.effects if self.leader is None else self.leader) or "no effect"
        return (
            f"caution: the verdict depends on the priors; with priors of the effects {self.words} it "
            f"{f'is {self.verdict} and names' if self.leader is None else 'leads to'} {named}{told}"
        )

    def summary(self) -> dict[str, Any]:
        """An entry of `diagnosis.prior_widths` in `summary.json`; a gain that is not finite is absent."""
        gains = {effect: gain for effect, gain in self.log_evidence_gain.items() if math.isfinite(gain)}
        return {
            "width": self.width,
            "verdict": self.verdict,
            "effects": list(self.effects),
            "log_evidence_gain": gains,
            "is_same": self.is_same,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, repr=False)
class Diagnosis(Tabular):
    """What is missing.

    Attributes:
        verdict: `adequate`, `missing_effects`, `ambiguous`, `unexplained` or `undecided`.
        effects: the effects that are named, the most telling first.
        ranking: all candidates, the most probable first.
        look_alikes: groups of effects whose predictions differ by less than the noise, none of them excluded by the evidence.
        next_experiment: inputs (in declared units) that best separate the rivals of an ambiguous verdict.
        expected_log_bayes_factor: what that experiment is expected to tell [nats].
        next_loading: the loading that separates the rivals of a component test best.
        separation: the same for every candidate experiment, between the rivals or the two most probable models.
        p_value, p_value_after: probability of the residual from the noise alone, before and with the named effects.
        error, error_after: normalised errors (train, test), before and with the named effects.
        noise_floor: of the training experiments.
        parameters: of the law, before and with the named effects.
        optimum: θ of the model with the named effects at its best fit, by name, SI: where an improvement starts.
        prediction: of the training experiments with the named effects.
        scales: characteristic values that amplitudes of the candidates are relative to.
        notes: sentences on how the diagnosis was made.
        forms: labels of the forms of the named effects, where these are not the default ones.
        averaged: predictions over all explanations of an ambiguous verdict; None of any other.
        specimens: what effects are to the specimens, where the study has levels.
        opened: parameters of the model as it is whose bounds were left open, since the calibration leans on them: where they
            go then, SI.
        explanations: the models that count by what they do, the most probable first.
        behaviour: what the specimens do with the named effects, by numerical experiments.
        prior_widths: what narrower and wider priors of the effects do to the verdict.
    """

    verdict: str
    effects: list[str]
    ranking: list[Candidate]
    look_alikes: list[list[str]]
    next_experiment: dict[str, float] | None
    expected_log_bayes_factor: float | None
    separation: np.ndarray
    p_value: float | None
    p_value_after: float | None
    error: tuple[float, float]
    error_after: tuple[float, float]
    noise_floor: float
    parameters: dict[str, dict[str, dict[str, float]]]
    optimum: Mapping[str, float]
    prediction: Prediction
    scales: Scales
    notes: Sequence[str] = ()
    forms: Mapping[str, str] = field(default_factory=dict[str, str])
    averaged: "Averaged | None" = None
    next_loading: "Loading | None" = None
    specimens: Sequence[Judgement] = ()
    opened: Mapping[str, float] = field(default_factory=dict[str, float])
    explanations: Sequence[Explained] = ()
    behaviour: Behaviours = field(default_factory=Behaviours)
    prior_widths: Sequence[PriorWidth] = ()

    def summary(self) -> dict[str, Any]:
        """The key `diagnosis` of `summary.json`."""
        content: dict[str, Any] = {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": self.effects,
            "ranking": [candidate.summary() for candidate in self.ranking],
            "look_alikes": self.look_alikes,
            "error": {"train": [self.error[0], self.error_after[0]], "test": [self.error[1], self.error_after[1]]},
            "noise_floor": self.noise_floor,
            "parameters": self.parameters,
            "explanations": [one.summary() for one in self.explanations],
            "behaviour_sentence": self.behaviour.sentence,
            "behaviour": [one.summary() for one in self.behaviour.changes],
            "notes": self._notes,
        }
        optional = {
            "next_experiment": self.next_experiment,
            "expected_log_bayes_factor": self.expected_log_bayes_factor,
            "next_loading": None if self.next_loading is None else self.next_loading.summary(),
            "p_value": self.p_value,
            "p_value_after": self.p_value_after,
            "averaged": None if self.averaged is None else self.averaged.summary(),
            "specimens": [one.summary() for one in self.specimens] or None,
            "opened": dict(self.opened) or None,
            "prior_widths": [one.summary() for one in self.prior_widths] or None,
        }
        return content | {key: value for key, value in optional.items() if value is not None}

    def called(self, effect: str) -> str:
        """The name of an effect, and what it is where its amplitude is negative."""
        return next((candidate.called for candidate in self.ranking if candidate.effect == effect), effect)

    @property
    def alternatives(self) -> list[list[str]]:
        """The look-alikes as they are called."""
        return [[self.called(effect) for effect in group] for group in self.look_alikes]

    @property
    def is_explained(self) -> bool:
        """Whether the noise explains what the named effects leave."""
        return is_noise(self.p_value_after, self.error_after[0], self.noise_floor)

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        ends = " to ".join(error_cell(errors[1]) for errors in (self.error, self.error_after))
        fall = f"the error on experiments that were not used goes from {ends}"
        named = " and ".join(self.called(e) + (f" ({self.forms[e]})" if e in self.forms else "") for e in self.effects)
        errors = f"error {self.error[0]:.3f}, noise {self.noise_floor:.3f}"
        if self.verdict == "adequate":
            return "nothing is missing that these measurements could show: the noise explains the residual"
        if self.verdict == "undecided":
            return (
                "whether anything is missing cannot be said: nothing is known of the noise, and no effect predicts "
                f"what was not used so much better that it need not be (error {self.error[0]:.3f})"
            )
        if self.verdict == "unexplained" and self.opened and self.is_explained:
            return f"the priors exclude this specimen, and no effect is missing: {self._beyond}; widen them"
        if self.verdict == "unexplained" and self._unnamed:
            first = self._unnamed[0]
            return f"the model is wrong, and no effect is named ({errors}); {first.called} {self._instead(first)}"
        if self.verdict == "unexplained":
            return f"the model is wrong, and nothing in the catalogue mends it ({errors})"
        left = ""
        if self.p_value_after is not None and not self.is_explained:
            left = (
                f"; what remains ({self.error_after[0]:.3f} against a noise of {self.noise_floor:.3f}) is not noise yet"
            )
        if self.verdict == "ambiguous":
            rivals = "; ".join(map(" or ".join, self.alternatives))
            return f"missing is {rivals}, which these measurements cannot tell apart; with {named}, {fall}{left}"
        alike = "".join(
            f"; {' or '.join(map(self.called, others))} in place of {self.called(first)} differs by less than the noise and is "
            "less probable, but not excluded"
            for first, *others in self.look_alikes
        )
        return f"missing is {named}: {fall}{left}{alike}"

    @property
    def _beyond(self) -> str:
        """Where the model goes when the bounds of priors are open."""
        values = " and ".join(f"{name} = {value:.4g}" for name, value in self.opened.items())
        return f"with the bounds open that the calibration leans on, the model as it is goes to {values}"

    @property
    def _of_priors(self) -> list[str]:
        """What other priors do to the verdict: one sentence where they do nothing."""
        if self.prior_widths and all(one.is_same for one in self.prior_widths):
            widths = " and ".join(one.words for one in self.prior_widths)
            return [f"the verdict stays the same with priors of the effects {widths}"]
        return [one.sentence for one in self.prior_widths]

    @property
    def _notes(self) -> list[str]:
        """What effects are to the specimens, how the diagnosis was made, what explanations differ in, and why likely effects are
        not named."""
        between = [] if self.averaged is None else [self.averaged.sentence]
        does = self.behaviour.sentence
        return [
            *([f"what the model with them does: {does}"] if does else []),
            *(one.sentence for one in self.specimens),
            *([self._beyond] if self.opened else []),
            *self._of_priors,
            *self.notes,
            *between,
            *([] if self.next_loading is None else [self.next_loading.sentence]),
            *(f"{c.called} {self._instead(c)}" for c in self._unnamed[:_SHOWN]),
        ]

    @property
    def _unnamed(self) -> list[Candidate]:
        """Likely effects that are not named, the most probable first."""
        return [candidate for candidate in self.ranking if candidate.reason is not None]

    def _instead(self, candidate: Candidate) -> str:
        """What a likely effect does to the error, and why it is not named."""
        before, after = f"{self.error_after[1]:.3f}", f"{candidate.error_test:.3f}"
        if math.isinf(candidate.error_test):
            change = "cannot be simulated in the held-out experiments"
        elif after == before:
            change = f"leaves the held-out error at {before}"
        else:
            does = "lowers" if candidate.error_test < self.error_after[1] else "raises"
            change = f"{does} the held-out error from {before} to {after}"
        return f"{change}, not named because {candidate.reason}"

    def _table(self) -> Table:
        shown = [c for c in self.ranking if c.effect in self.effects or c.probability >= 0.001][:8] or self.ranking[:3]
        rows: list[tuple[str, ...]] = []
        for c in shown:
            amplitude, size = next(iter(c.estimate.items()))
            unit = "" if size["unit"] == "1" else f" {size['unit']}"
            rows.append(
                (
                    c.called if c.form is None else f"{c.called} ({c.form})",
                    c.family,
                    cell(c.probability),
                    "–" if c.score is None else f"{c.score['gain']:.1f} ± {c.score['standard_error']:.1f}",
                    error_cell(c.error_train),
                    error_cell(c.error_test),
                    f"{amplitude} = {cell(size['mean'], '.3g')} ± {cell(size['sd'], '.2g')}{unit}",
                )
            )
        heads = ("effect", "family", "probability", "predicts better [nats]", "error train", "error test", "estimate")
        notes = self._notes
        if self.next_experiment is not None:
            inputs = ", ".join(f"{name} = {value:.4g}" for name, value in self.next_experiment.items())
            assert self.expected_log_bayes_factor is not None
            apart = f"odds of {odds(self.expected_log_bayes_factor)} are expected from it"
            notes.append(f"the experiment that tells them apart best: {inputs}; {apart}")
        return Table(f"{self.verdict}: {self.sentence}", heads, rows, notes)
