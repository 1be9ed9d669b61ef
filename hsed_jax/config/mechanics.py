"""What a user may say of the structure and of the model: masses, springs, damping, specimens, laws, parameters, effects."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from hsed_jax.config.sections import Positive, Section, SpringEntry
from hsed_jax.plain import Number, Whole

Ratio = Annotated[Number, Field(ge=0, lt=1)]
End = Whole | Literal["ground"]


def _prior(value: Any) -> Any:
    if isinstance(value, dict) and len(value) != 1:
        raise ValueError("a prior is one distribution with its arguments, such as {uniform: [0.0, 1.0]}")
    return value


def _prior_or_default(value: Any) -> Any:
    return value if value == {} else _prior(value)


PriorEntry = Annotated[dict[str, Any], BeforeValidator(_prior)]
ParameterEntry = Number | Annotated[dict[str, Any], BeforeValidator(_prior_or_default)]
"""A fixed number, or a prior; `{}` is the prior that law or catalogue have for it."""
NotNegative = Annotated[Number, Field(ge=0)]


class LinearSpringEntry(Section):
    """A linear spring of the structure."""

    between: tuple[End, End]
    stiffness: NotNegative | PriorEntry


class SpecimenEntry(Section):
    """Where the specimen sits; its elongation is the displacement of the second end less that of the first."""

    between: tuple[End, End]


class Rayleigh(Section):
    """Rayleigh damping C = alpha M + beta K."""

    alpha: NotNegative | PriorEntry
    beta: NotNegative | PriorEntry


class Damping(Section):
    """Modal or Rayleigh damping; a specimen counts with `specimen_stiffness` [N/m], or with that of the model (`model`)."""

    modal: Ratio | PriorEntry | list[Ratio | PriorEntry] | None = None
    rayleigh: Rayleigh | None = None
    specimen_stiffness: Positive | Literal["model"] | dict[str, Positive]
    """One number for all specimens, or one for each by name."""

    @model_validator(mode="after")
    def _one_kind(self) -> "Damping":
        if (self.modal is None) == (self.rayleigh is None):
            raise ValueError("give either modal or rayleigh")
        return self


class SpecimenModelEntry(Section):
    """A spring law, its parameters, its effects."""

    spring: SpringEntry = "bouc_wen"
    parameters: dict[str, ParameterEntry] = {}
    effects: dict[str, dict[str, ParameterEntry]] = {}


class OneSpecimenEntry(SpecimenEntry):
    """One of several specimens; without a model of its own it shares that of the study."""

    model: SpecimenModelEntry | None = None


class StructureEntry(Section):
    """Masses [kg], linear springs [N/m], one specimen or several, damping; a number with a prior is calibrated with the law."""

    masses: Annotated[list[Positive | PriorEntry], Field(min_length=1)]
    springs: list[LinearSpringEntry] = []
    specimen: SpecimenEntry | None = None
    specimens: Annotated[dict[str, OneSpecimenEntry], Field(min_length=1)] | None = None
    """Several by name, which stands before what belongs to each: storey2.A, storey2.force."""
    damping: Damping

    @model_validator(mode="after")
    def _one_or_several(self) -> "StructureEntry":
        if (self.specimen is None) == (self.specimens is None):
            raise ValueError("give either specimen, or specimens by name")
        return self

    @property
    def places(self) -> list[tuple[End, End]]:
        """The ends of every specimen."""
        several = self.specimens or {}
        return [self.specimen.between] if self.specimen is not None else [entry.between for entry in several.values()]


class ModelEntry(SpecimenModelEntry):
    """The computational simulator: the spring law, its parameters, its effects."""

    own_effects: list[str] = []
    """Python files with effects of your own, relative to the study; they join the catalogue."""
