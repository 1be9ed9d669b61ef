"""What a user may say in a study: names, types, defaults.  Nothing is computed here."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    field_validator,
    model_validator,
)

from hsed_jax.physics.outputs import QUANTITIES

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Ratio = Annotated[float, Field(ge=0, lt=1)]
End = int | Literal["ground"]
Value = float | str
"""A number, or the name of an input."""


class Section(BaseModel):
    """A part of a study: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SpringEntry(Section):
    """A linear spring of the structure."""

    between: tuple[End, End]
    stiffness: Annotated[float, Field(ge=0)]


class SpecimenEntry(Section):
    """Where the specimen sits; its elongation is the displacement of the second end less that of the first."""

    between: tuple[End, End]


class Rayleigh(Section):
    """Rayleigh damping C = alpha M + beta K."""

    alpha: Annotated[float, Field(ge=0)]
    beta: Annotated[float, Field(ge=0)]


class Damping(Section):
    """Modal or Rayleigh damping; the specimen counts with `specimen_stiffness` [N/m], or with the model's own A (`model`)."""

    modal: Ratio | list[Ratio] | None = None
    rayleigh: Rayleigh | None = None
    specimen_stiffness: Positive | Literal["model"]

    @model_validator(mode="after")
    def _one_kind(self) -> "Damping":
        if (self.modal is None) == (self.rayleigh is None):
            raise ValueError("give either modal or rayleigh")
        return self


class StructureEntry(Section):
    """Masses [kg], linear springs [N/m], the specimen and the damping."""

    masses: Annotated[list[Positive], Field(min_length=1)]
    springs: list[SpringEntry]
    specimen: SpecimenEntry
    damping: Damping


class PulseEntry(Section):
    """Near-fault pulse; a name refers to an input, a number is fixed."""

    V_P: Value
    T_P: Value
    gamma: Value = 2.0
    nu: Value = 0.10


class RecordedEntry(Section):
    """An accelerogram from a file, times a factor."""

    file: str
    scale: Value = 1.0


class ExcitationEntry(Section):
    """The ground motion, how long to simulate [s], and the step of the integration [s] (by default from the periods)."""

    near_fault_pulse: PulseEntry | None = None
    recorded: RecordedEntry | None = None
    duration: Positive | None = None
    step: Positive | None = None

    @model_validator(mode="after")
    def _at_most_one(self) -> "ExcitationEntry":
        if self.near_fault_pulse is not None and self.recorded is not None:
            raise ValueError("give either near_fault_pulse or recorded")
        if self.near_fault_pulse is not None and self.duration is None:
            raise ValueError("a near_fault_pulse needs a duration [s]")
        return self


def _prior(value: Any) -> Any:
    if isinstance(value, dict) and len(value) != 1:
        raise ValueError("a prior is one distribution with its arguments, such as {uniform: [0.0, 1.0]}")
    return value


PriorEntry = Annotated[dict[str, Any], BeforeValidator(_prior)]
ParameterEntry = float | PriorEntry
"""A fixed number, or a prior."""


class InputEntry(Section):
    """A variable input of the experiments: its distribution and its unit."""

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

    def written(self) -> dict[str, Any]:
        """As it stands in a study."""
        return {**self.prior, "unit": self.unit}


class ModelEntry(Section):
    """The computational simulator: the spring law, its parameters, its effects."""

    spring: Literal["bouc_wen"] = "bouc_wen"
    parameters: dict[str, ParameterEntry]
    effects: dict[str, dict[str, ParameterEntry]] = {}
    own_effects: list[str] = []
    """Python files with effects of your own, relative to the study; they join the catalogue."""


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


class VirtualEntry(Section):
    """A virtual laboratory: the specimen's true parameters and effects, and the noise of its sensors."""

    parameters: dict[str, float]
    effects: dict[str, dict[str, float]] = {}
    noise: ErrorsEntry | None = None
    test: Annotated[int, Field(ge=0)] = 0
    """Experiments at further inputs that are performed for testing and never fitted."""


class ExperimentsEntry(Section):
    """Where measurements come from: one of these."""

    virtual: VirtualEntry | None = None
    campaign: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ExperimentsEntry":
        if (self.virtual is None) == (self.campaign is None):
            raise ValueError("give one of virtual, campaign")
        return self


class KrigingEntry(Section):
    """The surrogate of the discrepancy."""

    trend: Literal["constant", "linear", "quadratic"] = "constant"
    kernel: Literal["matern32", "matern52", "gaussian"] = "matern52"
    starts: Count = 10


class DesignEntry(Section):
    """The sequential design of experiments."""

    initial: Count = 3
    iterations: Annotated[int, Field(ge=0)] = 40
    candidates: Count = 16384
    acquisition: Literal["expected_improvement", "max_variance", "discriminate", "random", "sobol"] = (
        "expected_improvement"
    )
    tolerance: Positive | None = None
    """Stop when the largest expected improvement falls below this."""
    variance: Literal["inputs", "inputs_and_parameters"] = "inputs"
    """Over what the variance in Eq. 12 is taken."""
    kriging: KrigingEntry = KrigingEntry()


class CalibrationEntry(Section):
    """Sizes of the calibration: starts of the MAP; chains, adaptation and kept draws per chain of NUTS."""

    starts: Count = 4
    chains: Count = 4
    warmup: Count = 150
    draws: Count = 500
    step_warmup: Count = 40
    step_draws: Count = 60
    """Of the posterior at each step of the design, which only steers and reports."""
    target_acceptance: Annotated[float, Field(gt=0, lt=1)] = 0.8


class ScalesEntry(Section):
    """Characteristic values that make the amplitudes of effects dimensionless (SI); by default from the data."""

    force: Positive
    elongation: Positive
    rate: Positive
    energy: Positive


class ImproveEntry(Section):
    """The effects to add to the model; by default those that the diagnosis names."""

    add: Annotated[list[str], Field(min_length=1)] | None = None


Step = Literal["design", "calibrate", "compare", "diagnose", "improve"]


class Study(Section):
    """A study, as written in its YAML file."""

    study: Annotated[str, Field(pattern=r"^\w[\w.\- ]*$")]
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    structure: StructureEntry | None = None
    excitation: ExcitationEntry | None = None
    inputs: dict[str, InputEntry] = {}
    model: ModelEntry
    experiments: ExperimentsEntry
    observe: Literal["quantities", "histories"] = "quantities"
    channels: list[str] | None = None
    """Channels to fit and compare when histories are observed; by default all that were measured."""
    quantities: Annotated[list[str], Field(min_length=1)] = list(QUANTITIES)
    error: ErrorsEntry | None = None
    correlated_errors: bool = True
    """Let the samples of a history whose residual is correlated in time count for as many as they are worth."""
    scales: ScalesEntry | None = None
    steps: Annotated[list[Step], Field(min_length=1)] = ["design", "calibrate"]
    design: DesignEntry = DesignEntry()
    calibration: CalibrationEntry = CalibrationEntry()
    improve: ImproveEntry = ImproveEntry()

    @field_validator("quantities")
    @classmethod
    def _known_quantities(cls, names: list[str]) -> list[str]:
        for name in names:
            if name not in QUANTITIES:
                raise ValueError(f"there is no quantity {name!r}; allowed are {', '.join(QUANTITIES)}")
            if names.count(name) > 1:
                raise ValueError(f"{name} stands twice")
        return names

    _folder: Path = PrivateAttr(default=Path())
    _file: str | None = PrivateAttr(default=None)

    @property
    def folder(self) -> Path:
        """Where relative paths start from: the folder of the study's file."""
        return self._folder

    @property
    def file(self) -> str | None:
        """The file that the study was read from, as the user named it."""
        return self._file

    def written(self) -> dict[str, Any]:
        """The study with every default written out, ready for YAML; reading it again gives the same study."""
        plain = self.model_dump(mode="json", exclude_none=True)
        plain["inputs"] = {name: entry.written() for name, entry in self.inputs.items()}
        # Written elsewhere, a relative path would lead elsewhere.
        if self.experiments.campaign is not None:
            plain["experiments"]["campaign"] = str((self.folder / self.experiments.campaign).absolute())
        plain["model"]["own_effects"] = [str((self.folder / name).absolute()) for name in self.model.own_effects]
        if self.excitation is not None and self.excitation.recorded is not None:
            plain["excitation"]["recorded"]["file"] = str((self.folder / self.excitation.recorded.file).absolute())
        return plain
