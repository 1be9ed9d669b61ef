"""Parts of the sections of a study: the section itself, kinds of numbers, and errors of the measurements."""

import difflib
import shlex
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PlainSerializer,
    Tag,
    WrapValidator,
    field_validator,
    model_serializer,
    model_validator,
)

from hsed_jax.errors import UserError
from hsed_jax.physics.declared import LAWS
from hsed_jax.plain import Number, is_file, shown

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
        """Number of given sizes of the noise."""
        return sum(kind is not None for kind in (self.relative, self.absolute, self.unknown))

    @model_validator(mode="after")
    def _one_kind(self) -> "NoiseEntry":
        if self.kinds != 1:
            raise ValueError("give exactly one of relative, absolute, unknown")
        return self


class ErrorEntry(NoiseEntry):
    """Error of an output for the likelihood. Its size is that of a noise; an unknown size is inferred; without a size, the
    campaign declares it.

    `correlated` states whether the noise of a history is autocorrelated, with an inferred correlation time. By default it is
    if the size of the noise is declared; false treats all samples as independent.  `inflate` counts the residual beyond the
    declared error as error, `discrepancy` learns it.  `of` gives the reference of a relative error: the prediction (for a
    quantity an error of its logarithm) or the measurement (Gaussian, with a given scale: Eqs. 2 to 4 of Abbiati & Marelli).
    """

    of: Literal["predicted", "measured"] = "predicted"
    correlated: bool | None = None
    inflate: bool = False
    discrepancy: bool = False

    @model_validator(mode="after")
    def _one_kind(self) -> "ErrorEntry":
        if self.kinds > 1 or not self.model_fields_set:
            raise ValueError("give exactly one of relative, absolute, unknown")
        if self.of == "measured" and self.relative is None:
            raise ValueError(
                "only a relative error can be a share of the measured values, such as {relative: 0.05, of: measured}"
            )
        if self.inflate and self.discrepancy:
            raise ValueError(
                "give inflate or discrepancy, not both: each describes how wrong the model is, inflate by a larger error, "
                "discrepancy by a learned process"
            )
        if self.unknown and self.discrepancy:
            raise ValueError(
                "a discrepancy needs a declared error (relative or absolute): with an unknown error, noise and model cannot be "
                "distinguished"
            )
        return self


TAGS = ("same error for all", "error per output")


def _kind(value: Any) -> str:
    """The shape of an error: keys that are not kinds of errors must be names of outputs."""
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


class ProgramEntry(Section):
    """A program, and its time limit [s]."""

    run: Annotated[str, Field(min_length=1)]
    """The program and its arguments; names in braces are replaced by values: `{folder}`, `{python}`, `{study}` and others."""
    timeout: Positive = 3600.0
    """Time limit of each call of the program [s]; give twice the time that it needs."""

    @model_validator(mode="before")
    @classmethod
    def _run_alone(cls, value: Any) -> Any:
        return {"run": value} if isinstance(value, str) else value

    @field_validator("run")
    @classmethod
    def _can_be_split(cls, text: str) -> str:
        if not shlex.split(text):
            raise ValueError("name a program")
        return text

    def words(self, folder: Path) -> tuple[str, ...]:
        """The program and its arguments; files beside the study by their whole path."""
        first, *rest = (word.replace("{study}", str(folder.absolute())) for word in shlex.split(self.run))
        # As in a shell, a program without a slash is searched in the path.
        rest = [str((folder / word).absolute()) if is_file(folder / word) else word for word in rest]
        return (str((folder / first).absolute()) if "/" in first else first, *rest)

    def located(self, folder: Path) -> "ProgramEntry":
        """The same with absolute paths."""
        return self.model_copy(update={"run": shlex.join(self.words(folder))})


def per_output[Entry: NoiseEntry](
    where: str, entry: Entry | dict[str, Entry] | None, outputs: list[str]
) -> dict[str, Entry]:
    """One entry for all outputs, or one per output, as one per output."""
    if entry is None:
        return {}
    if isinstance(entry, NoiseEntry):
        return dict.fromkeys(outputs, entry)
    for name in entry:
        if name not in outputs:
            raise UserError(f"{where}.{name}: this is not observed; observed are {', '.join(outputs)}")
    return dict(entry)


def one_distribution(value: Any) -> Any:
    """Refuse a prior that is more, or less, than one distribution with its arguments."""
    if isinstance(value, dict) and len(value) != 1:
        raise ValueError("a prior is one distribution with its arguments, such as {uniform: [0.0, 1.0]}")
    return value


PriorEntry = Annotated[dict[str, Any], BeforeValidator(one_distribution)]


def prior_or_default(value: Any) -> Any:
    """Refuse a prior that is not one distribution; `{}` is the default one."""
    return value if value == {} else one_distribution(value)


def _by_parameter(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    for name in value:
        if not isinstance(name, str) or value.count(name) > 1:
            raise ValueError(f"this is a list of parameters, each once, such as [A, beta], but one is {shown(name)}")
    return {name: {} for name in value}


def _spread(value: Any) -> Any:
    if not isinstance(value, dict):
        raise ValueError(
            f"a spread has a prior, such as {{half_normal: 0.1}}, or {{}} for the default one, but it is {shown(value)}"
        )
    return prior_or_default(value)


SpreadEntry = Annotated[dict[str, Any], BeforeValidator(_spread)]
LevelsEntry = dict[str, Annotated[dict[str, SpreadEntry], Field(min_length=1), BeforeValidator(_by_parameter)]]
"""By column of the experiments, the parameters that vary with it: a list, or by name the prior of each spread."""
MODELS = ("a model of a spring law", "a model that is a function", "a model that is a material of OpenSees")
"""The shapes of `model`, as validation names them."""


class InputEntry(Section):
    """An input or a calibrated parameter: its distribution and its unit."""

    prior: PriorEntry
    unit: str = "1"

    @model_validator(mode="before")
    @classmethod
    def _distribution_and_unit(cls, value: Any) -> Any:
        if isinstance(value, dict) and "prior" not in value:
            rest = {name: given for name, given in value.items() if name != "unit"}
            if len(rest) != 1:
                given = ", ".join(map(str, value)) or "nothing"
                example = "{uniform: [1.5, 3.0], unit: m/s}"
                raise ValueError(f"give one distribution and unit, such as {example}; given are {given}")
            return {"prior": rest, "unit": value.get("unit", "1")}
        return value

    @model_serializer
    def _as_written(self) -> dict[str, Any]:
        return {**self.prior, "unit": self.unit}


def _known_law(name: str) -> str:
    if name not in LAWS:
        close = difflib.get_close_matches(name, LAWS, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise ValueError(
            f"there is no spring law {shown(name)}{hint}; laws are {', '.join(LAWS)}, or one of your own: mine.py:MyLaw"
        )
    return name


class OwnLawEntry(Section):
    """A spring law of the user: a class in a Python file, relative to the study."""

    file: str
    law: str = Field(alias="class")

    @model_validator(mode="before")
    @classmethod
    def _file_and_class(cls, value: Any) -> Any:
        """`mine.py:MyLaw`, the usual name of the user's code."""
        file, colon, law = value.rpartition(":") if isinstance(value, str) else ("", "", "")
        return {"file": file, "class": law} if colon else value

    @model_serializer
    def _as_written(self) -> dict[str, str]:
        return {"file": self.file, "class": self.law}

    def located(self, folder: Path) -> "OwnLawEntry":
        """The same with an absolute path: written elsewhere, a relative path would lead elsewhere."""
        return self.model_copy(update={"file": str((folder / self.file).resolve())})


SpringEntry = Annotated[str, AfterValidator(_known_law)] | OwnLawEntry
"""A spring law by its name, or a user's own."""

ParameterEntry = Number | Annotated[dict[str, Any], BeforeValidator(prior_or_default)]
"""A fixed number, or a prior; `{}` is the prior of the law or the catalogue."""
FORM, DRIVER = "form", "driver"
"""Keys of an effect that are not parameters: its form and its driver."""


def _effect(value: Any, validated: Any) -> Any:
    if not isinstance(value, dict):
        return validated(value)
    said = {key: value[key] for key in (FORM, DRIVER) if key in value}
    for key, word in said.items():
        if not isinstance(word, str):
            raise ValueError(f"its {key} must be a word, but it is {shown(word)}")
    return said | validated({key: entry for key, entry in value.items() if key not in said})


EffectEntry = Annotated[dict[str, ParameterEntry], WrapValidator(_effect), PlainSerializer(dict)]
"""An effect: its form and driver, if they differ from the default ones, and its parameters."""
TrueEffectEntry = Annotated[dict[str, Number], WrapValidator(_effect), PlainSerializer(dict)]
"""The same of a virtual specimen: every parameter is a number."""
