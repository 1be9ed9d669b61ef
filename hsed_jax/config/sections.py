"""What sections of a study are made of: the section itself, kinds of numbers, and errors of what is measured."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from hsed_jax.plain import Number

Positive = Annotated[Number, Field(gt=0)]


class Section(BaseModel):
    """A part of a study: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ErrorEntry(Section):
    """Error of an output: relative to what was measured, absolute (SI), or unknown and inferred (relative)."""

    relative: Positive | None = None
    absolute: Positive | None = None
    unknown: Literal[True] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "ErrorEntry":
        if sum(kind is not None for kind in (self.relative, self.absolute, self.unknown)) != 1:
            raise ValueError("give exactly one of relative, absolute, unknown")
        return self


TAGS = ("same error for all", "error per output")


def _error_kind(value: Any) -> str:
    """Which of the two shapes an error has: keys that are no kinds of errors must be names of outputs."""
    per_output = isinstance(value, dict) and bool(value) and not set(value) & set(ErrorEntry.model_fields)
    return TAGS[per_output]


ErrorsEntry = Annotated[
    Annotated[ErrorEntry, Tag(TAGS[0])] | Annotated[dict[str, ErrorEntry], Tag(TAGS[1])], Discriminator(_error_kind)
]
"""One error for all outputs, or one per output."""
