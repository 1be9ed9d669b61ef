"""The results of a diagnosis, and their texts and tables."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hsed_jax.behaviour.findings import Behaviours
from hsed_jax.behaviour.names import is_far
from hsed_jax.criticism.compare import is_noise
from hsed_jax.criticism.prediction import Prediction, error_cell, error_change
from hsed_jax.physics.effects import called
from hsed_jax.physics.scales import Scales
from hsed_jax.tables import Table, Tabular, cell, odds

if TYPE_CHECKING:
    # A report reads these results and makes no fits.
    from hsed_jax.diagnosis.averaging import Averaged
    from hsed_jax.diagnosis.loadings import Loading

# Number of likely effects for which the notes give the reason why they are not named.
_SHOWN = 3


@dataclass(frozen=True)
class Candidate:
    """One effect of the catalogue, with its support by the measurements.

    Attributes:
        effect, family: of the catalogue.
        probability: of the effect, by all considered models that contain it (`hsed_jax.diagnosis.diagnose.stated_probabilities`).
        log_evidence_gain: of the model with it over the same model without it.
        rao_statistic, rao_p_value: Rao's score test of its amplitude in the first model (without candidates).
        estimate: its parameters, dimensionless and in physical units: mean, sd, 5 % and 95 % quantile, unit.
        error_train, error_test: normalised errors of the model with it.  The test error is that of the test split or, without
            one, of experiments left out in turn; it is infinite if a simulation fails.
        reason: why it is not named although it is likely; None if it is named or unlikely.
        score: gain in the log density of held-out data over the first model [nats] (`gain`), with the `standard_error`;
            None if it was not scored.
        form: label of the form of these results, selected by `hsed_jax.diagnosis.fits.Fits.top`; None if the label is empty.
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
        """The name of the effect, with the name of its opposite if the amplitude is negative."""
        return called(self.effect, {name: size["mean"] for name, size in self.estimate.items() if "mean" in size})

    def summary(self) -> dict[str, Any]:
        """As in `summary.json`; values that are missing or not finite are omitted."""
        found = {k: v for k, v in vars(self).items() if v is not None and v != {}}
        return {k: v for k, v in found.items() if not isinstance(v, float) or math.isfinite(v)}


@dataclass(frozen=True)
class Judgement:
    """The relation of an effect to the specimens.

    Attributes:
        effect: of the catalogue.
        level: the column that identifies the specimens.
        verdict: `population` (all specimens have it), `specimens` (only those in `members` have it) or `scatter`.
        probability: of the verdict.
        members: the specimens that have it.
        of: by specimen, mean, sd, 5 % and 95 % quantile of its own size, dimensionless, and the `probability` of the effect.
    """

    effect: str
    level: str
    verdict: str
    probability: float
    members: Sequence[str]
    of: Mapping[str, Mapping[str, float]]

    @property
    def sentence(self) -> str:
        """The judgement in words."""
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
    """Models with the same behaviour, whatever their formulas.

    Attributes:
        effects: names of the effects by their behaviour.
        forms: of the representative model: the named model, or else the most probable one.
        weight: probability of all these models together, as of a `Candidate`.
        error_test: of the representative model, as in a `Candidate`.
        score: of the representative model, as in a `Candidate`.
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
    """The verdict with another width of the priors of the named effects; without a named effect, of all candidates.

    Attributes:
        width: factor on the width of the priors.
        verdict: as in a diagnosis.
        effects: the named effects.
        log_evidence_gain: of each named effect at this width; without one, of the candidate with the largest evidence.
        log_evidence_gain_before: the same with the original priors.
        is_same: whether verdict and effects are the same as with the original priors.
        leader: effects of the explanation that meets the conditions of a verdict only at this width; None without one.
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
        """The influence of the width on the verdict."""
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
        """An entry of `diagnosis.prior_widths` in `summary.json`; gains that are not finite are omitted."""
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
    """The result of a diagnosis.

    Attributes:
        verdict: `adequate`, `missing_effects`, `ambiguous`, `unexplained` or `undecided`.
        effects: the named effects, in the order of decreasing log evidence gain.
        ranking: the fitted candidates: first the named effects, then the others with the most probable one first.
        look_alikes: groups of effects that can replace one another, because their predictions differ by less than the noise or
            because they are rivals.
        next_experiment: inputs (in declared units) that best separate the rivals of an ambiguous verdict.
        expected_log_bayes_factor: of that experiment [nats].
        next_loading: the loading that best separates the rivals of a component test.
        separation: expected log Bayes factor of every candidate experiment, for the rivals or the two most probable models.
        p_value, p_value_after: probability that the noise alone causes the residual, without and with the named effects.
        error, error_after: normalised errors (train, test), without and with the named effects.
        noise_floor: of the training experiments.
        parameters: of the law, without and with the named effects.
        optimum: θ at the best fit of the model with the named effects, by name, SI; an improvement starts there.
        prediction: of the training experiments with the named effects.
        scales: characteristic values to which the amplitudes of the candidates are relative.
        notes: sentences on the procedure of the diagnosis.
        forms: labels of the forms of the named effects, unless these are the default forms.
        averaged: average of the predictions over the explanations of an ambiguous verdict; None for any other verdict.
        specimens: relation of the effects to the specimens, if the study has levels.
        opened: estimates of the first model for the parameters whose prior bounds are removed, because their calibrated
            values are on these bounds, SI.
        explanations: the models with a relevant weight, grouped by their behaviour, the most probable first.
        behaviour: of the specimens with the named effects, from numerical experiments.
        prior_widths: influence of narrower and wider priors of the effects on the verdict.
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
        """The name of an effect, with the name of its opposite if the amplitude is negative."""
        return next((candidate.called for candidate in self.ranking if candidate.effect == effect), effect)

    @property
    def alternatives(self) -> list[list[str]]:
        """The look-alikes, with the names of `called`."""
        return [[self.called(effect) for effect in group] for group in self.look_alikes]

    @property
    def is_explained(self) -> bool:
        """Whether the noise explains the residual of the model with the named effects."""
        return is_noise(self.p_value_after, self.error_after[0], self.noise_floor)

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        change = error_change(*(error_cell(errors[1]) for errors in (self.error, self.error_after)))
        fall = f"the error on experiments that were not fitted {change}"
        errors = f"error {self.error[0]:.3f}, noise {self.noise_floor:.3f}"
        if self.verdict == "adequate":
            return "nothing is missing that these measurements could show: the noise explains the residual"
        if self.verdict == "undecided":
            said = "whether anything is missing cannot be said: nothing is known of the noise, and no effect predicts what was"
            return f"{said} not fitted so much better that it need not be (error {self.error[0]:.3f})"
        if self.verdict == "unexplained" and self.opened and self.is_explained:
            return f"the priors exclude this specimen, and no effect is missing: {self._beyond}; widen them"
        larger = f"the residual is larger than the noise ({errors}), and no effect"
        if self.verdict == "unexplained" and self._unnamed:
            return f"{larger} is named; {self._unnamed[0].called} {self._instead(self._unnamed[0])}"
        if self.verdict == "unexplained":
            return f"{larger} of the catalogue explains it"
        left = ""
        if self.p_value_after is not None and not self.is_explained:
            apart = f"{self.error_after[0]:.3f} against a noise of {self.noise_floor:.3f}"
            left = f"; what remains ({apart}) is not noise yet"
        if self.verdict == "ambiguous":
            rivals = "; ".join(map(" or ".join, self.alternatives))
            return f"missing is {rivals}, which these measurements cannot tell apart; with {self._named}, {fall}{left}"
        alike = "".join(
            f"; {' or '.join(map(self.called, others))} in place of {self.called(first)} differs by less than the noise and is "
            "less probable, but not excluded"
            for first, *others in self.look_alikes
        )
        return f"missing is {self._named}: {fall}{left}{alike}"

    @property
    def _named(self) -> str:
        """The named effects; far above the noise, those after the first one are less certain (`LATER_FAR`)."""
        names = [self.called(e) + (f" ({self.forms[e]})" if e in self.forms else "") for e in self.effects]
        is_certain = self.is_explained or not is_far(self.noise_floor, self.error_after[1])
        first, further = (names, []) if is_certain else (names[:1], names[1:])
        return ", and less certainly ".join(" and ".join(group) for group in (first, further) if group)

    @property
    def _beyond(self) -> str:
        """The estimates of the first model after bounds of priors are removed."""
        values = " and ".join(f"{name} = {value:.4g}" for name, value in self.opened.items())
        return f"with the bounds open that the calibration leans on, the model as it is goes to {values}"

    @property
    def _of_priors(self) -> list[str]:
        """The influence of other priors on the verdict: one sentence if they do not change it."""
        if self.prior_widths and all(one.is_same for one in self.prior_widths):
            widths = " and ".join(one.words for one in self.prior_widths)
            return [f"the verdict stays the same with priors of the effects {widths}"]
        return [one.sentence for one in self.prior_widths]

    @property
    def _notes(self) -> list[str]:
        """The notes: behaviour, specimens, removed bounds, priors, procedure, differences between explanations, next loading, and
        the reasons why likely effects are not named."""
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
        """The influence of a likely effect on the error, and the reason why it is not named."""
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
