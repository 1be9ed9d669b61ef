"""The schema of a study: names, types, defaults.  Nothing is computed here."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr, create_model, field_validator, model_validator

from hsed_jax.config.excitation_entry import ExcitationEntry
from hsed_jax.config.experiments import ExperimentsEntry
from hsed_jax.config.mechanics import AnyModelEntry, ModelEntry, SpecimenModelEntry, StructureEntry
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.errors import UserError
from hsed_jax.inference.samplers import SAMPLERS
from hsed_jax.measurements import Campaign
from hsed_jax.measurements.findings import DoubtKind
from hsed_jax.physics.names import of_each
from hsed_jax.physics.outputs import ALLOWED, EQ_18, QUANTITIES, is_quantity
from hsed_jax.plain import Number, Whole, name_fault, shown
from hsed_jax.sections import ErrorsEntry, InputEntry, Positive, Section
from hsed_jax.tables import Table, Tabular

if TYPE_CHECKING:
    # Reading a study does not load JAX, so a wrong key is reported at once.
    from hsed_jax.physics.effects.base import AbstractEffect

Count = Annotated[Whole, Field(ge=1)]


class KrigingEntry(Section):
    """The surrogate of the discrepancy."""

    trend: Literal["constant", "linear", "quadratic"] = "constant"
    kernel: Literal["matern32", "matern52", "gaussian"] = "matern52"
    starts: Count = 10


class StopEntry(Section):
    """Rules that stop a design before its iterations are used up."""

    expected_improvement: Positive | None = None
    """Stop when the largest expected improvement falls below this."""
    stable_map: Positive | None = None
    """Stop when no parameter of the MAP moved by more than this share of itself over three steps."""
    posterior_width: Positive | None = None
    """Stop when the 90 % interval of every parameter is narrower than this share of its mean."""
    verdict: bool = False
    """Stop when the diagnosis, made after every step, names a missing effect."""


_Limit: Any = Positive
_LIMITS: Any = {known.limit: (_Limit | None, None) for known in QUANTITIES.values() if known.limit is not None}


class LimitsEntry(create_model("LimitsEntry", __base__=Section, **_LIMITS)):
    """Limits of specimen, actuator and masses (SI): inputs whose predicted response exceeds a limit are not requested.

    Besides those below, the limits of the quantities that have one (`hsed_jax.physics.outputs`).
    """

    velocity: Positive | None = None
    """Largest rate of the elongation [m/s]."""
    probability: Annotated[Number, Field(gt=0, lt=1)] = 0.05
    """Accepted probability of exceeding a limit."""


class CostEntry(Section):
    """The cost of an experiment, in any unit; the acquisition is divided by it."""

    fixed: Annotated[Number, Field(ge=0)] = 1.0
    """Cost of every experiment."""
    per: Annotated[dict[str, Number], Field(min_length=1)]
    """Additional cost for each declared unit of an input."""


class DesignEntry(Section):
    """The sequential design of experiments."""

    initial: Count = 3
    iterations: Annotated[Whole, Field(ge=0)] = 40
    candidates: Count = 16384
    acquisition: Annotated[str, AfterValidator(ACQUISITIONS.known)] = "expected_improvement"
    stop: StopEntry = StopEntry()
    limits: LimitsEntry | None = None
    cost: CostEntry | None = None
    replicates: bool = False
    """Whether inputs of earlier experiments, or inputs next to them, may be requested."""
    variance: Literal["inputs", "inputs_and_parameters"] = "inputs"
    """The distribution of the variance in Eq. 12."""
    kriging: KrigingEntry = KrigingEntry()


class CalibrationEntry(Section):
    """Sizes of the calibration: starts of the MAP; chains, adaptation and kept draws per chain of NUTS."""

    sampler: Annotated[str, AfterValidator(SAMPLERS.known)] = "auto"
    """Importance sampling is as exact as NUTS and many times faster if its weights are reliable, which it tests; `auto` tries
    it first, and uses NUTS if they are unreliable (for an improved model it warns instead).  `laplace` is the Gaussian around
    the MAP, without sampling."""
    starts: Count = 4
    chains: Count = 4
    warmup: Count = 150
    draws: Count = 500
    step_warmup: Count = 40
    step_draws: Count = 60
    """Draws of the posterior at each step of the design, only for the choice and the report."""
    seconds: Positive | None = None
    """Time limit of NUTS in a calibration; the draws made until then are reported, with a warning."""
    target_acceptance: Annotated[Number, Field(gt=0, lt=1)] = 0.8


_ALL = "all"


class MeasurementsEntry(Section):
    """Settings of the measurements."""

    accept: dict[str, DoubtKind | list[DoubtKind]] | list[dict[str, DoubtKind]] = {}
    """Accepted doubts, by experiment; `all` is every experiment."""
    samples: Annotated[int, Field(ge=100)] = 4000
    """Longer records of component tests are thinned to about this number of samples."""
    height: Positive | None = None
    """Height [m] over which the elongation is a drift: the check of the data judges the drift ratio."""

    def accepted(self, campaign: Campaign | None) -> frozenset[tuple[str, str]]:
        """The accepted doubts of a campaign: experiment and kind.

        Raises:
            UserError: an experiment was not measured.
        """
        entries = self.accept if isinstance(self.accept, list) else [self.accept]
        pairs = [pair for entry in entries for pair in entry.items()]
        known = [] if campaign is None else [experiment.id for experiment in campaign]
        found = set()
        for experiment, kinds in pairs:
            if experiment != _ALL and experiment not in known:
                raise UserError(
                    f"measurements.accept: there is no measured experiment {experiment!r}; measured are "
                    f"{', '.join(known) or 'none'}"
                )
            ids = known if experiment == _ALL and _ALL not in known else [experiment]
            # A doubt of the structure concerns all experiments.
            found |= {
                (id, kind) for id in [*ids, experiment] for kind in ([kinds] if isinstance(kinds, str) else kinds)
            }
        return frozenset(found)


class ScalesEntry(Section):
    """Characteristic values that make the amplitudes of effects dimensionless (SI); by default from the data."""

    force: Positive
    elongation: Positive
    rate: Positive
    energy: Positive


class ImproveEntry(Section):
    """The effects to add to the model; by default those that the diagnosis names."""

    add: Annotated[list[str], Field(min_length=1)] | None = None


Step = Literal["design", "calibrate", "compare", "diagnose", "discover", "improve"]


class Study(Tabular, Section):
    """A study, as written in its YAML file."""

    study: str
    seed: Annotated[Whole, Field(ge=0, lt=2**32)] = 0
    structure: StructureEntry | None = None
    excitation: ExcitationEntry | None = None
    inputs: dict[str, InputEntry] = {}
    model: AnyModelEntry = ModelEntry()
    experiments: ExperimentsEntry
    measurements: MeasurementsEntry = MeasurementsEntry()
    observe: Literal["quantities", "histories"] = "quantities"
    channels: Annotated[list[str], Field(min_length=1)] | None = None
    """Channels to fit and compare when histories are observed; by default all that were measured."""
    quantities: Annotated[list[str], Field(min_length=1)] = list(EQ_18)
    error: ErrorsEntry | None = None
    scales: ScalesEntry | None = None
    steps: Annotated[list[Step], Field(min_length=1)] = ["design", "calibrate"]
    design: DesignEntry = DesignEntry()
    calibration: CalibrationEntry = CalibrationEntry()
    improve: ImproveEntry = ImproveEntry()

    @model_validator(mode="before")
    @classmethod
    def _quantities_of_each(cls, value: Any) -> Any:
        structure = value.get("structure") if isinstance(value, dict) else None
        several = structure.get("specimens") if isinstance(structure, dict) else None
        if isinstance(several, dict) and "quantities" not in value:
            return {**value, "quantities": list(of_each([str(name) for name in several], EQ_18))}
        return value

    @field_validator("study")
    @classmethod
    def _names_a_folder(cls, name: str) -> str:
        if fault := name_fault(name):
            raise ValueError(f"{shown(name)} names the folder of the run, too; {fault}")
        return name

    @field_validator("quantities")
    @classmethod
    def _known_quantities(cls, names: list[str]) -> list[str]:
        for name in names:
            if not is_quantity(name):
                raise ValueError(f"there is no quantity {shown(name)}; allowed are {ALLOWED}")
        return names

    @field_validator("quantities", "channels")
    @classmethod
    def _each_once(cls, names: list[str] | None) -> list[str] | None:
        given = names or []
        for name in given:
            if given.count(name) > 1:
                raise ValueError(f"{shown(name)} appears twice")
        return names

    _folder: Path = PrivateAttr(default=Path())
    _file: str | None = PrivateAttr(default=None)
    _own_effects: "tuple[type[AbstractEffect], ...]" = PrivateAttr(default=())

    @property
    def folder(self) -> Path:
        """The folder of the study's file, where relative paths start from."""
        return self._folder

    @property
    def file(self) -> str | None:
        """The file that the study was read from, as the user named it."""
        return self._file

    @property
    def own_effects(self) -> "tuple[type[AbstractEffect], ...]":
        """Effects that were given from Python, besides those of the files of `model.own_effects`."""
        return self._own_effects

    def with_own_effects(self, *effects: "type[AbstractEffect]") -> "Study":
        """The study with effects of your own in its catalogue, given from Python and not in a file.

        Arguments:
            effects: their classes.
        """
        study = self.model_copy()
        study._own_effects = (*self._own_effects, *effects)
        return study

    @property
    def needs_loops(self) -> bool:
        """Whether its steps look for effects, which need a loop in the measurements."""
        return not {"diagnose", "discover"}.isdisjoint(self.steps)

    @property
    def code(self) -> list[str]:
        """Files that are executed when the study is built: its model, laws, effects, and its laboratory that is a
        Python function.
        """
        models, laboratory = (
            [file for model in self.models.values() for file in model.code],
            self.experiments.laboratory,
        )
        return list(dict.fromkeys([*models, *([] if laboratory is None else laboratory.code)]))

    @property
    def models(self) -> dict[str, SpecimenModelEntry | AnyModelEntry]:
        """The model of the study, and those of specimens that have their own, by their keys."""
        several = (None if self.structure is None else self.structure.specimens) or {}
        own = {name: entry.model for name, entry in several.items() if entry.model is not None}
        return {"model": self.model} | {f"structure.specimens.{name}.model": model for name, model in own.items()}

    def _table(self) -> Table:
        def words(name: str, given: Any) -> str:
            if isinstance(given, InputEntry):
                return f"{words(name, given.prior)} {given.unit}"
            if given == {}:
                given = "its default prior"
            elif isinstance(given, dict):
                ((kind, numbers),) = given.items()
                given = f"{kind} {', '.join(map(str, numbers)) if isinstance(numbers, list) else numbers}"
            return f"{name} {given}"

        def of_model(key: str, model: SpecimenModelEntry | AnyModelEntry) -> list[tuple[str, str]]:
            of = "" if key == "model" else f" of {key.split('.')[2]}"
            kind, which = model.described
            return [
                (f"{kind}{of}", which),
                *((f"parameter{of}", words(name, given)) for name, given in model.parameters.items()),
                *(
                    (f"effect{of}", " ".join([name, *(words(k, v) for k, v in given.items())]))
                    for name, given in model.effects.items()
                ),
            ]

        rows = [
            *(row for key, model in self.models.items() if model.parameters for row in of_model(key, model)),
            *(("input", words(name, entry)) for name, entry in self.inputs.items()),
            ("observed", "time histories" if self.observe == "histories" else ", ".join(self.quantities)),
            ("steps", ", ".join(self.steps)),
        ]
        return Table(f"study {self.study}: a model of {self.experiments.described}", rows=rows)

    def written(self) -> dict[str, Any]:
        """The study with every default written out, ready for YAML; reading it again gives the same study."""
        plain = self.model_dump(mode="json", exclude_none=True)
        plain["model"] = self.model.located(self.folder).model_dump(mode="json", exclude_none=True)
        plain["experiments"] = self.experiments.located(self.folder).model_dump(mode="json", exclude_none=True)
        if self.structure is not None:
            plain["structure"] = self.structure.located(self.folder).model_dump(mode="json", exclude_none=True)
        for settings in plain.get("excitation", {}).values():
            if isinstance(settings, dict) and "file" in settings:
                settings["file"] = str((self.folder / settings["file"]).resolve())
        return plain
