"""The structure in OpenSees; the specimen is a material of OpenSees or of the user's own."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, final

from pydantic import Field

from hsed_jax.errors import UserError, at
from hsed_jax.laboratories.kinds.base import SimulatedEntry, Site, Wanted, noise_of
from hsed_jax.plain import Number
from hsed_jax.registry import register
from hsed_jax.sections import Positive, Section

if TYPE_CHECKING:
    from hsed_jax.laboratories.base import Laboratory
    from hsed_jax.laboratories.sensors import Sensors


class OwnMaterialEntry(Section):
    """A file that defines the material of the specimen."""

    file: str
    """A Python or Tcl file that defines the material, relative to the study."""


@final
@register
class OpenSeesEntry(SimulatedEntry):
    """It shakes the structure in OpenSees; the specimen is a material of OpenSees or yours."""

    performer: ClassVar[str] = "OpenSees"
    use: ClassVar[str] = "materials of OpenSees that this package does not have"

    material: Literal["BoucWen", "BWBN", "Steel02"] | OwnMaterialEntry
    """The material of the specimen: `BoucWen`, `BWBN`, `Steel02`, or `{file: my_specimen.tcl}`."""
    parameters: dict[str, Number] = {}
    """Parameters of the material (N, m), with the names of OpenSees; an omitted parameter is neutral."""
    step: Positive | None = None
    """Step of the analysis [s]; by default a fiftieth of that of the simulator. Use a smaller step if a material is
    stiffer than the structure.
    """
    timeout: Annotated[Number, Field(gt=0)] = 600.0
    """Time limit of one experiment [s]."""

    @property
    def described(self) -> str:
        """The material."""
        material = self.material
        return f"a specimen in OpenSees, {material.file if isinstance(material, OwnMaterialEntry) else material}"

    def located(self, folder: Path) -> "OpenSeesEntry":
        """The same with an absolute path of its material."""
        if not isinstance(self.material, OwnMaterialEntry):
            return self
        material = OwnMaterialEntry(file=str((folder / self.material.file).resolve()))
        return self.model_copy(update={"material": material})

    def sensors(self, wanted: Wanted) -> "Sensors":
        """Some quantities from all steps of OpenSees, the others from the record."""
        from hsed_jax.laboratories.opensees import QUANTITIES

        if wanted.channels:
            return self._measuring(wanted, wanted.channels, ())
        sources = (name for quantity in wanted.quantities for name in wanted.sources[quantity])
        channels = tuple(dict.fromkeys(["elongation", "force", *sources]))
        return self._measuring(wanted, channels, tuple(name for name in wanted.quantities if name in QUANTITIES))

    def laboratory(self, site: Site) -> "Laboratory":
        """OpenSees in a separate process."""
        from hsed_jax.laboratories import opensees
        from hsed_jax.laboratories.command import CommandLaboratory

        if site.driver != "ground_acceleration":
            raise UserError("experiments.opensees: it needs a ground motion, but the study has another excitation")
        structure = site.structure_of("opensees", self.structure)
        if isinstance(self.material, OwnMaterialEntry):
            file = site.folder / self.material.file
            material = at("experiments.opensees", opensees.own_material, file, self.parameters)
        else:
            material = at("experiments.opensees", opensees.built_in, self.material, self.parameters)
        opensees.require_openseespy()
        assert site.programme.timeline.step is not None
        step = site.programme.timeline.step / opensees.STEPS_PER_STEP if self.step is None else self.step
        files = {"model.json": opensees.as_json(opensees.model(structure, material, step))}
        command = CommandLaboratory(
            opensees.program(), site.programme, site.sensors, self.timeout, site.workspace, files
        )
        return opensees.OpenSeesLaboratory(command, noise_of(site.sensors), site.seed)
