"""A program that performs one experiment."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, final

from hsed_jax.errors import at
from hsed_jax.laboratories.kinds.base import MeasuredEntry, Site
from hsed_jax.registry import register
from hsed_jax.sections import ProgramEntry

if TYPE_CHECKING:
    from hsed_jax.laboratories.base import Laboratory


@final
@register
class CommandEntry(ProgramEntry, MeasuredEntry):
    """It runs your program; `command: TEXT` is short for its setting `run`."""

    performer: ClassVar[str] = "a program"
    use: ClassVar[str] = "another simulator, a test rig with a driver, a job on another computer"

    @property
    def described(self) -> str:
        """The program with its arguments."""
        return f"a specimen behind the command {self.run}"

    def located(self, folder: Path) -> "CommandEntry":
        """The same with absolute paths in its program."""
        return self.model_copy(update={"run": shlex.join(self.words(folder))})

    def laboratory(self, site: Site) -> "Laboratory":
        """The program, which gets a folder for each experiment."""
        from hsed_jax.laboratories.command import CommandLaboratory, check_template

        template = self.words(site.folder)
        at("experiments.command.run", check_template, template, site.inputs)
        return CommandLaboratory(template, site.programme, site.sensors, self.timeout, site.workspace)
