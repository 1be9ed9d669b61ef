"""The entries of structure and model in a study: masses, springs, damping, specimens, laws, parameters, effects."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from hsed_jax.config.functions import FunctionEntry
from hsed_jax.config.opensees import OpenSeesEntry
from hsed_jax.plain import Number, Whole
from hsed_jax.sections import (
    MODELS,
    EffectEntry,
    LevelsEntry,
    OwnLawEntry,
    ParameterEntry,
    Positive,
    PriorEntry,
    Section,
    SpringEntry,
)

Ratio = Annotated[Number, Field(ge=0, lt=1)]
End = Whole | Literal["ground"]
NotNegative = Annotated[Number, Field(ge=0)]


class LinearSpringEntry(Section):
    """A linear spring of the structure."""

    between: tuple[End, End]
    stiffness: NotNegative | PriorEntry


class SpecimenEntry(Section):
    """The ends of the specimen; its elongation is the displacement of the second end minus that of the first."""

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
    effects: dict[str, EffectEntry] = {}

    @property
    def code(self) -> list[str]:
        """Files that are executed where the model is built."""
        return [self.spring.file] if isinstance(self.spring, OwnLawEntry) else []

    @property
    def described(self) -> tuple[str, str]:
        """The kind and the name of the model."""
        return "law", self.spring.law if isinstance(self.spring, OwnLawEntry) else self.spring

    def located(self, folder: Path) -> "SpecimenModelEntry":
        """The same with absolute paths."""
        law = self.spring
        return self.model_copy(update={"spring": law.located(folder)}) if isinstance(law, OwnLawEntry) else self


class OneSpecimenEntry(SpecimenEntry):
    """One of several specimens; without its own model it shares that of the study."""

    model: SpecimenModelEntry | None = None


class StructureEntry(Section):
    """Masses [kg], linear springs [N/m], one specimen or several, damping; a number with a prior is calibrated with the law."""

    masses: Annotated[list[Positive | PriorEntry], Field(min_length=1)]
    springs: list[LinearSpringEntry] = []
    specimen: SpecimenEntry | None = None
    specimens: Annotated[dict[str, OneSpecimenEntry], Field(min_length=1)] | None = None
    """Several specimens have names, which precede their parameters and outputs: storey2.A, storey2.force."""
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

    def located(self, folder: Path) -> "StructureEntry":
        """The same with absolute paths."""
        several = {
            name: entry if entry.model is None else entry.model_copy(update={"model": entry.model.located(folder)})
            for name, entry in (self.specimens or {}).items()
        }
        return self.model_copy(update={"specimens": several or None})


class ModelEntry(SpecimenModelEntry):
    """The computational simulator: the spring law, its parameters, its effects."""

    levels: LevelsEntry = {}
    """Parameters that vary between specimens, by columns of the experiments, the outer ones first."""
    own_effects: list[str] = []
    """Python files with effects of your own, relative to the study; they join the catalogue."""

    @property
    def code(self) -> list[str]:
        """Files that are executed where the model is built."""
        return [*super().code, *self.own_effects]

    def located(self, folder: Path) -> "SpecimenModelEntry":
        """The same with absolute paths."""
        own = [str((folder / name).resolve()) for name in self.own_effects]
        return super().located(folder).model_copy(update={"own_effects": own})


def _kind_of_model(value: Any) -> str:
    keys = value if isinstance(value, dict) else getattr(value, "model_fields_set", ())
    return MODELS[2 if "opensees" in keys else 1 if {"function", "command"} & set(keys) else 0]


AnyModelEntry = Annotated[
    Annotated[ModelEntry, Tag(MODELS[0])]
    | Annotated[FunctionEntry, Tag(MODELS[1])]
    | Annotated[OpenSeesEntry, Tag(MODELS[2])],
    Discriminator(_kind_of_model),
]
"""A spring law with effects, a function, or a material of OpenSees."""
