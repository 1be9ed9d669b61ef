"""The effect of an improvement: the fall of the error, and the change of the parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.prediction import error_cell, error_change
from hsed_jax.physics.effects import called
from hsed_jax.tables import Table, Tabular, cell


@dataclass(frozen=True)
class Step:
    """The model with some of the effects.

    Attributes:
        effects: added so far.
        error_train, error_test: normalised errors; test: of experiments that were not fitted, None without them.
        parameters: θ_MAP by name, SI.
    """

    effects: list[str]
    error_train: float
    error_test: float | None
    parameters: dict[str, float]


@dataclass(frozen=True, repr=False)
class Trail(Tabular):
    """The fall of the error as effects are added.

    Attributes:
        steps: from the first model to the one with all effects.
        noise_floor: of the training experiments.
        notes: sentences on how it was made.
    """

    steps: Sequence[Step]
    noise_floor: float
    notes: Sequence[str] = ()

    def summary(self) -> dict[str, Any]:
        """The key `improvement` of `summary.json`."""
        steps = [{k: v for k, v in vars(step).items() if v is not None} for step in self.steps]
        return {"steps": steps, "noise_floor": self.noise_floor, "notes": list(self.notes)}

    @property
    def sentence(self) -> str:
        """The reduction of the error, on held-out experiments if they exist."""
        first, last = self.steps[0], self.steps[-1]
        ends = [error_cell(s.error_train if last.error_test is None else s.error_test) for s in (first, last)]
        which = "the fitted experiments" if last.error_test is None else "experiments that were not fitted"
        if len(self.steps) == 1:
            return f"nothing was added: the error on {which} is {ends[0]} (noise {self.noise_floor:.3f})"
        return f"the error on {which} {error_change(*ends)} (noise {self.noise_floor:.3f})"

    def _table(self) -> Table:
        names = list(dict.fromkeys(name for step in self.steps for name in step.parameters if "error." not in name))
        rows: list[Sequence[str]] = [
            (
                f"+ {called(step.effects[-1], step.parameters)}" if step.effects else "model as it was",
                error_cell(step.error_train),
                error_cell(step.error_test),
                *(cell(step.parameters.get(name), ".4g") for name in names),
            )
            for step in self.steps
        ]
        rows.append(("noise", cell(self.noise_floor), *[""] * (len(names) + 1)))
        return Table(self.sentence, ("", "error train", "error test", *names), rows, self.notes)


def step_of(effects: Sequence[str], comparison: Comparison, parameters: dict[str, float]) -> Step:
    """One step of the trail, from a comparison."""
    test = None if comparison.test is None else comparison.test.error
    return Step(list(effects), comparison.train.error, test, parameters)
