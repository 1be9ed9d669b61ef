"""What sections of a study are made of: the section itself, kinds of numbers, and errors of what is measured."""

import difflib
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    model_serializer,
    model_validator,
)

from hsed_jax.physics.laws import LAWS
from hsed_jax.plain import Number, shown

Positive = Annotated[Number, Field(gt=0)]


class Section(BaseModel):
    """A part of a study: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class NoiseEntry(Section):
    """Noise of an output: relative (of a quantity to its value, of a channel to its RMS), absolute (SI), or unknown."""

    relative: Positive | None = None
    absolute: Positive | None = None
    unknown: Literal[True] | None = None

    @property
    def kinds(self) -> int:
        """In how many ways the entry says how large the noise is."""
        return sum(kind is not None for kind in (self.relative, self.absolute, self.unknown))

    @model_validator(mode="after")
    def _one_kind(self) -> "NoiseEntry":
        if self.kinds != 1:
            raise ValueError("give exactly one of relative, absolute, unknown")
        return self


class ErrorEntry(NoiseEntry):
    """Error of an output, which a likelihood is made of: its size as of a noise, unknown ones inferred; without a size, as the
    campaign declares it.

    `correlated` says whether the noise of a history has a memory, which is then inferred; by default one is where the size of the
    noise is declared, and false takes every sample for news.  `inflate` counts as error what the model leaves beyond the
    declared one.
    """

    correlated: bool | None = None
    inflate: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> "ErrorEntry":
        if self.kinds > 1 or not self.model_fields_set:
            raise ValueError("give exactly one of relative, absolute, unknown")
        return self


TAGS = ("same error for all", "error per output")


def _kind(value: Any) -> str:
    """Which of the two shapes an error has: keys that are no kinds of errors must be names of outputs."""
    per_output = isinstance(value, dict) and bool(value) and not set(value) & set(ErrorEntry.model_fields)
    return TAGS[per_output]


ErrorsEntry = Annotated[
    Annotated[ErrorEntry, Tag(TAGS[0])] | Annotated[dict[str, ErrorEntry], Tag(TAGS[1])], Discriminator(_kind)
]
"""One error for all outputs, or one per output."""

NoisesEntry = Annotated[
    Annotated[NoiseEntry, Tag(TAGS[0])] | Annotated[dict[str, NoiseEntry], Tag(TAGS[1])], Discriminator(_kind)
]
"""One noise for all outputs, or one per output."""


def _known_law(name: str) -> str:
    if name not in LAWS:
        close = difflib.get_close_matches(name, LAWS, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise ValueError(
            f"there is no spring law {shown(name)}{hint}; laws are {', '.join(LAWS)}, or {{file: mine.py, class: MyLaw}}"
        )
    return name


class OwnLawEntry(Section):
    """A spring law of the user's own: a class in a Python file, relative to the study."""

    file: str
    law: str = Field(alias="class")

    @model_serializer
    def _as_written(self) -> dict[str, str]:
        return {"file": self.file, "class": self.law}


SpringEntry = Annotated[str, AfterValidator(_known_law)] | OwnLawEntry
"""A spring law by its name, or a user's own."""
