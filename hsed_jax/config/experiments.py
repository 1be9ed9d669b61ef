"""What a user may say of where measurements come from: a campaign, or one of the laboratories."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from hsed_jax.config.mechanics import TrueEffectEntry
from hsed_jax.config.sections import NoisesEntry, OwnLawEntry, Positive, ProgramEntry, Section, SpringEntry
from hsed_jax.measurements.declaration import ChannelEntry
from hsed_jax.plain import Number, Whole


class VirtualEntry(Section):
    """A virtual laboratory: its specimen's law (by default the model's), its true parameters and effects, and sensors' noise."""

    spring: SpringEntry | None = None
    parameters: dict[str, Number]
    effects: dict[str, TrueEffectEntry] = {}
    structure: dict[str, Number] = {}
    """Numbers of the structure that the study gives priors, such as mass_2 (SI)."""
    noise: NoisesEntry | None = None
    test: Annotated[Whole, Field(ge=0)] = 0
    """Experiments at further inputs that are performed for testing and never fitted."""


class MeasuredEntry(Section):
    """What a laboratory outside this program measures, as in campaign.yaml; by default what is observed, in SI."""

    channels: dict[str, ChannelEntry] = {}
    quantities: dict[str, ChannelEntry] = {}


class CommandEntry(MeasuredEntry, ProgramEntry):
    """A program that performs one experiment, and how long it may take [s]."""


class PythonEntry(MeasuredEntry):
    """A function that performs one experiment, in a file relative to the study; without a file it is given from Python."""

    file: str | None = None
    function: str = "perform"

    @model_validator(mode="before")
    @classmethod
    def _file_and_function(cls, value: Any) -> Any:
        if isinstance(value, str):
            file, _, function = value.rpartition(":")
            return {"file": file, "function": function} if file else {"file": function}
        return value


class FolderEntry(MeasuredEntry):
    """People or a controller, who find requests in folders of the run and leave measurements there."""


class OwnMaterialEntry(Section):
    """A file that defines the specimen's material: Python or Tcl."""

    file: str


class OpenSeesEntry(Section):
    """The structure in OpenSees, the specimen a material of OpenSees or the user's own."""

    material: Literal["BoucWen", "BWBN", "Steel02"] | OwnMaterialEntry
    parameters: dict[str, Number] = {}
    structure: dict[str, Number] = {}
    """Numbers of the structure that the study gives priors, such as mass_2 (SI)."""
    noise: NoisesEntry | None = None
    step: Positive | None = None
    """Of the analysis [s]; by default a fiftieth of that of the simulator."""
    timeout: Positive = 600.0


LaboratoryEntry = VirtualEntry | FolderEntry | CommandEntry | PythonEntry | OpenSeesEntry


class ExperimentsEntry(Section):
    """Where measurements come from: one of these."""

    virtual: VirtualEntry | None = None
    campaign: str | None = None
    folder: FolderEntry | None = None
    command: CommandEntry | None = None
    python: PythonEntry | None = None
    opensees: OpenSeesEntry | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ExperimentsEntry":
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"give exactly one of {', '.join(type(self).model_fields)}; given are {', '.join(given) or 'none'}"
            )
        return self

    @property
    def kind(self) -> str:
        """Which it is."""
        return next(name for name in type(self).model_fields if getattr(self, name) is not None)

    @property
    def laboratory(self) -> LaboratoryEntry | None:
        """What performs experiments; None where they were measured already."""
        return None if self.kind == "campaign" else getattr(self, self.kind)

    def described(self) -> str:
        """What it is, for a title."""
        if self.virtual is not None:
            law = self.virtual.spring
            known = "" if law is None else f" ({law.law if isinstance(law, OwnLawEntry) else law})"
            return f"a virtual specimen{known} with {', '.join(self.virtual.effects) or 'no effects'}"
        if self.campaign is not None:
            return f"the campaign {self.campaign}"
        if self.folder is not None:
            return "a laboratory that is asked by hand"
        if self.opensees is not None:
            material = self.opensees.material
            return f"a specimen in OpenSees, {material.file if isinstance(material, OwnMaterialEntry) else material}"
        if self.command is not None:
            return f"a specimen behind the command {self.command.run}"
        return "a specimen behind a Python function"

    def located(self, folder: Path) -> "ExperimentsEntry":
        """The same with absolute paths: written elsewhere, a relative path would lead elsewhere."""

        def absolute(name: str) -> str:
            return str((folder / name).resolve())

        changes: dict[str, Any] = {}
        if self.campaign is not None:
            changes["campaign"] = absolute(self.campaign)
        if self.virtual is not None and isinstance(law := self.virtual.spring, OwnLawEntry):
            own = OwnLawEntry.model_validate({"file": absolute(law.file), "class": law.law})
            changes["virtual"] = self.virtual.model_copy(update={"spring": own})
        if self.command is not None:
            changes["command"] = self.command.located(folder)
        if self.python is not None and self.python.file is not None:
            changes["python"] = self.python.model_copy(update={"file": absolute(self.python.file)})
        if self.opensees is not None and isinstance(self.opensees.material, OwnMaterialEntry):
            material = OwnMaterialEntry(file=absolute(self.opensees.material.file))
            changes["opensees"] = self.opensees.model_copy(update={"material": material})
        return self.model_copy(update=changes)
