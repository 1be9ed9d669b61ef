"""The Python interface: what a calibrated model of a component test leaves of the measured force, learned."""

from dataclasses import dataclass
from typing import Any

from hsed_jax.analysis.calibration import Calibration, compare
from hsed_jax.criticism import compare as comparing
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.prediction import Prediction, error_cell, error_change
from hsed_jax.criticism.remainder import Remainder, can_be_learned, remainder_of
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign
from hsed_jax.physics.names import own_name
from hsed_jax.tables import Table, Tabular


@dataclass(frozen=True, repr=False)
class WithRemainder(Tabular):
    """A calibrated model with its remainder.

    Attributes:
        calibration: the model.
        remainder: what it leaves, as a function of the path of the elongation.
        before, after: the model without and with the remainder, compared with the same measurements.
    """

    calibration: Calibration
    remainder: Remainder
    before: Comparison
    after: Comparison

    def predict(self, campaign: Campaign | None = None) -> Prediction:
        """Predict the completed experiments of a campaign, with the remainder.

        Arguments:
            campaign: the experiments; by default those of the calibration, training and test.
        """
        return self.remainder.corrected(self.calibration.predict(campaign))

    @property
    def helps(self) -> bool:
        """Whether the error on experiments that were not fitted is smaller with the remainder; False without such experiments."""
        return (
            self.before.test is not None
            and self.after.test is not None
            and self.after.test.error < self.before.test.error
        )

    @property
    def sentence(self) -> str:
        """The share of the held-out error that the remainder removes."""
        if self.before.test is None or self.after.test is None:
            return "what the model leaves is learned as a function of the path; no experiment was held out to judge it"
        first, last = self.before.test.error, self.after.test.error
        share = f"{100 * (1 - (last / first) ** 2):.0f} %" if self.helps else "nothing"
        return (
            "what the model leaves, learned from the fitted rows as a function of the path of the elongation (the remainder), "
            f"explains {share} of the squared error on experiments that were not fitted: the error "
            f"{error_change(error_cell(first), error_cell(last))}"
        )

    def summary(self) -> dict[str, Any]:
        """The key `improvement.remainder` of `summary.json`."""
        found = self.after.summary()
        splits = {split: found[split] for split in ("train", "test") if split in found}
        return {"sentence": self.sentence, "helps": self.helps, "comparison": splits}

    def _table(self) -> Table:
        rows = [
            (name, error_cell(one.train.error), error_cell(None if one.test is None else one.test.error))
            for name, one in (("model", self.before), ("with the remainder", self.after))
        ]
        return Table(self.sentence, ("", "error train", "error test"), rows)


def has_remainder(calibration: Calibration) -> bool:
    """Whether a remainder can be learned: in a component test whose only observed output is a long enough force history."""
    posterior = calibration.fit.posterior
    return (
        calibration.built.experiments.component_test
        and [own_name(name) for name in posterior.outputs] == ["force"]
        and posterior.groups.size > 1
        and calibration.fit.discrepancy is None
        and can_be_learned(calibration.train)
    )


def learn_remainder(calibration: Calibration) -> WithRemainder:
    """Learn what a calibrated model leaves of the measured force, as a function of the path of the elongation.

    A Kriging model predicts the residual over features of the path (`hsed_jax.criticism.remainder`). It corrects predictions of
    paths that resemble the fitted ones. The parameters of the model and the named effects stay.

    Arguments:
        calibration: a model of component tests, such as `hx.improve(fit, diagnosis).calibration`.

    Raises:
        UserError: the study does not observe one history of a force in component tests, or it learns a model discrepancy.

    Example:
        ```python
        better = hx.improve(fit, diagnosis)
        with_remainder = hx.learn_remainder(better.calibration)
        with_remainder.predict().mean  # force of all tests, with the remainder [N]
        ```
    """
    if not has_remainder(calibration):
        raise UserError(
            "a remainder is learned of component tests whose only observed output is the history of a force, from at least 20 "
            "fitted samples, and of a model without a learned discrepancy (observe: histories, channels: [force], error: "
            "{discrepancy: false})"
        )
    posterior = calibration.fit.posterior
    remainder = remainder_of(calibration.train, bool(posterior.is_declared[0]))
    test = None if calibration.test is None else remainder.corrected(calibration.test)
    train = remainder.corrected(calibration.train)
    after = comparing.compare(train, test, posterior.is_declared, posterior.fitted, [])
    return WithRemainder(calibration, remainder, compare(calibration), after)
