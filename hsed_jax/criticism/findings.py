"""What a diagnosis found, and how it shows itself."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from hsed_jax.criticism.prediction import Prediction, error_cell
from hsed_jax.tables import Table, Tabular, cell

SIGNIFICANT = 0.01


@dataclass(frozen=True)
class Candidate:
    """One effect of the catalogue, as the measurements see it.

    Attributes:
        effect, family: of the catalogue.
        probability: that it takes part, over all models that were looked at.
        log_evidence_gain: of the model with it over the same model without it.
        score, score_p_value: Rao's score test of its amplitude in the model as it is.
        estimate: of its parameters in both their forms: mean, sd, 5 % and 95 % quantile, unit.
        error_train, error_test: normalised errors of the model with it; test: of experiments that were not used, the test
            split or, without one, experiments left out in turn.
    """

    effect: str
    family: str
    probability: float
    log_evidence_gain: float
    score: float
    score_p_value: float
    estimate: dict[str, dict[str, Any]]
    error_train: float
    error_test: float

    def summary(self) -> dict[str, Any]:
        """As in `summary.json`."""
        return dict(vars(self))


@dataclass(frozen=True, repr=False)
class Diagnosis(Tabular):
    """What is missing.

    Attributes:
        verdict: `adequate`, `missing_effects`, `ambiguous` or `unexplained`.
        effects: the effects that are named, the most telling first.
        ranking: all candidates, the most probable first.
        look_alikes: groups of effects that the noise hides from one another.
        next_experiment: inputs (in declared units) that best separate the rivals of an ambiguous verdict.
        expected_log_bayes_factor: what that experiment is expected to tell [nats].
        separation: the same for every candidate experiment, between the rivals or the two most probable models.
        p_value, p_value_after: probability of the residual from the noise alone, before and with the named effects.
        error, error_after: normalised errors (train, test), before and with the named effects.
        noise_floor: of the training experiments.
        parameters: of the law, before and with the named effects.
        prediction: of the training experiments with the named effects.
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
    prediction: Prediction

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
        }
        optional = {
            "next_experiment": self.next_experiment,
            "expected_log_bayes_factor": self.expected_log_bayes_factor,
            "p_value": self.p_value,
            "p_value_after": self.p_value_after,
        }
        return content | {key: value for key, value in optional.items() if value is not None}

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        ends = " to ".join(error_cell(errors[1]) for errors in (self.error, self.error_after))
        fall = f"the error on experiments that were not used goes from {ends}"
        named = " and ".join(self.effects)
        if self.verdict == "adequate":
            return "nothing is missing that these measurements could show: the noise explains the residual"
        if self.verdict == "unexplained":
            return (
                "the model is wrong, and nothing in the catalogue mends it "
                f"(error {self.error[0]:.3f}, noise {self.noise_floor:.3f})"
            )
        left = ""
        if self.p_value_after is not None and self.p_value_after < SIGNIFICANT:
            left = (
                f"; what remains ({self.error_after[0]:.3f} against a noise of {self.noise_floor:.3f}) is not noise yet"
            )
        if self.verdict == "ambiguous":
            rivals = "; ".join(" or ".join(group) for group in self.look_alikes)
            return f"missing is {rivals}, which these measurements cannot tell apart; with {named}, {fall}{left}"
        alike = "".join(
            f"; {group[0]} looks like {' or '.join(group[1:])} within the noise" for group in self.look_alikes
        )
        return f"missing is {named}: {fall}{left}{alike}"

    def _table(self) -> Table:
        shown = [c for c in self.ranking if c.effect in self.effects or c.probability >= 0.001][:8] or self.ranking[:3]
        rows = []
        for c in shown:
            amplitude, size = next(iter(c.estimate.items()))
            unit = "" if size["unit"] == "1" else f" {size['unit']}"
            rows.append(
                (
                    c.effect,
                    c.family,
                    cell(c.probability),
                    cell(c.log_evidence_gain, ".1f"),
                    error_cell(c.error_train),
                    error_cell(c.error_test),
                    f"{amplitude} = {cell(size['mean'], '.3g')} ± {cell(size['sd'], '.2g')}{unit}",
                )
            )
        heads = ("effect", "family", "probability", "log-evidence", "error train", "error test", "estimate")
        notes = []
        if self.next_experiment is not None:
            inputs = ", ".join(f"{name} = {value:.4g}" for name, value in self.next_experiment.items())
            notes.append(f"the experiment that tells them apart best: {inputs}")
        return Table(f"{self.verdict}: {self.sentence}", heads, rows, notes)
