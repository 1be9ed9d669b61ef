"""A virtual laboratory: its specimen is simulated, with effects that the model may lack."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, final

from pydantic import Field

from hsed_jax.laboratories.kinds.base import SimulatedEntry, Site, noise_of
from hsed_jax.plain import Number, Whole
from hsed_jax.registry import register
from hsed_jax.sections import OwnLawEntry, SpringEntry, TrueEffectEntry

if TYPE_CHECKING:
    from hsed_jax.laboratories.base import Laboratory


@final
@register
class VirtualEntry(SimulatedEntry):
    """A simulation with effects that the model may lack."""

    performer: ClassVar[str] = "a virtual laboratory"
    use: ClassVar[str] = "a trial of a design, a diagnosis, an effect of your own"

    spring: SpringEntry | None = None
    """The law of the virtual specimen, written as `model.spring`; by default the law of the model."""
    parameters: dict[str, Number]
    """True parameters of the virtual specimen (SI)."""
    effects: dict[str, TrueEffectEntry] = {}
    """Its true effects, in any form and with any driver: `{stiffness_degradation: {eta: 2.0e-5}}`."""
    test: Annotated[Whole, Field(ge=0)] = 0
    """Number of further experiments that are performed for testing and never fitted; 4 are enough to test an improvement."""

    @property
    def code(self) -> list[str]:
        """The file of a law of the user's own."""
        return [self.spring.file] if isinstance(self.spring, OwnLawEntry) else []

    @property
    def further(self) -> int:
        """Its setting `test`."""
        return self.test

    @property
    def described(self) -> str:
        """The law, if it differs from that of the model, and the effects."""
        law = self.spring
        known = "" if law is None else f" ({law.law if isinstance(law, OwnLawEntry) else law})"
        return f"a virtual specimen{known} with {', '.join(self.effects) or 'no effects'}"

    def located(self, folder: Path) -> "VirtualEntry":
        """The same with an absolute path of its law."""
        law = self.spring
        return self.model_copy(update={"spring": law.located(folder)}) if isinstance(law, OwnLawEntry) else self

    def laboratory(self, site: Site) -> "Laboratory":
        """The virtual specimens and their sensors."""
        from hsed_jax.laboratories.virtual import VirtualLaboratory

        sensors = site.sensors
        channels = tuple(name for name in sensors.channels if name != "time")
        return VirtualLaboratory(*site.virtual, site.quantities, channels, noise_of(sensors), site.seed)
