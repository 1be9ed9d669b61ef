"""People or a controller: requests are in a folder of the run, and the measurements arrive there days later."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NoReturn, final

from hsed_jax.laboratories.kinds.base import MeasuredEntry, Site
from hsed_jax.registry import register

if TYPE_CHECKING:
    from hsed_jax.laboratories.base import Laboratory


@final
@register
class FolderEntry(MeasuredEntry):
    """It waits for people or a controller; `folder: {}` is enough for the names and SI units of the study."""

    performer: ClassVar[str] = "people or a controller"
    use: ClassVar[str] = "real specimens, days between request and measurement"
    is_asked: ClassVar[bool] = True

    @property
    def described(self) -> str:
        """True: people perform the requests."""
        return "a laboratory that is asked by hand"

    def laboratory(self, site: Site) -> "Laboratory":
        """A laboratory that performs no experiment by itself."""
        del site
        return FolderLaboratory()


@dataclass(frozen=True)
class FolderLaboratory:
    """Performs nothing by itself; `hsed_jax.runs.ask_tell` writes its requests and takes its answers."""

    def perform(self, number: int, inputs: Mapping[str, float]) -> NoReturn:
        """Refuse, because the experiment is pending.

        Raises:
            Awaited: always.
        """
        from hsed_jax.laboratories.base import Awaited

        raise Awaited
