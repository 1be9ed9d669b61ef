"""What adding the missing effects did: the trail of the error, and what became of the parameters."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hsed_jax.criticism.compare import Comparison


@dataclass(frozen=True)
class Step:
    """The model with some of the effects.

    Attributes:
        effects: added so far.
        error_train, error_test: normalised errors; test: of experiments that were not used, None where there are none.
        parameters: θ_MAP by name, SI.
    """

    effects: list[str]
    error_train: float
    error_test: float | None
    parameters: dict[str, float]


@dataclass(frozen=True)
class Trail:
    """How the error falls as effects are added.

    Attributes:
        steps: from the model as it was to the one with all effects.
        noise_floor: of the training experiments.
    """

    steps: Sequence[Step]
    noise_floor: float

    def summary(self) -> dict[str, Any]:
        """The key `improvement` of `summary.json`."""
        steps = [{k: v for k, v in vars(step).items() if v is not None} for step in self.steps]
        return {"steps": steps, "noise_floor": self.noise_floor}

    def __repr__(self) -> str:
        width = max(len(_label(step)) for step in self.steps)
        lines = [f"{'':{width}}  error train   test  parameters"]
        for step in self.steps:
            test = "   –  " if step.error_test is None else f"{step.error_test:6.3f}"
            values = ", ".join(f"{name} {value:.4g}" for name, value in step.parameters.items() if "error." not in name)
            lines.append(f"{_label(step):{width}}  {step.error_train:11.3f} {test}  {values}")
        return "\n".join([*lines, f"{'noise':{width}}  {self.noise_floor:11.3f}"])

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(repr(self))}</pre>"


def step_of(effects: Sequence[str], comparison: Comparison, parameters: dict[str, float]) -> Step:
    """One step of the trail, from a comparison."""
    test = None if comparison.test is None else comparison.test.error
    return Step(list(effects), comparison.train.error, test, parameters)


def _label(step: Step) -> str:
    return f"+ {step.effects[-1]}" if step.effects else "model as it was"
