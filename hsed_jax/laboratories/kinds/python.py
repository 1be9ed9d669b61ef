"""A Python function that performs one experiment."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, final

from pydantic import model_validator

from hsed_jax.errors import UserError, at
from hsed_jax.laboratories.kinds.base import MeasuredEntry, Site
from hsed_jax.registry import register

if TYPE_CHECKING:
    from hsed_jax.laboratories.base import Laboratory


@final
@register
class PythonEntry(MeasuredEntry):
    """It calls your function; `python: rig.py:perform` is short for its settings `file` and `function`."""

    performer: ClassVar[str] = "a Python function"
    use: ClassVar[str] = "the same as a command, from Python or a notebook"

    file: str | None = None
    """File with the function, relative to the study; without a file, Python gives the function."""
    function: str = "perform"
    """Name of the function."""

    @model_validator(mode="before")
    @classmethod
    def _file_and_function(cls, value: Any) -> Any:
        if isinstance(value, str):
            file, _, function = value.rpartition(":")
            return {"file": file, "function": function} if file else {"file": function}
        return value

    @property
    def code(self) -> list[str]:
        """The file of the function."""
        return [] if self.file is None else [self.file]

    @property
    def described(self) -> str:
        """True: it is a function."""
        return "a specimen behind a Python function"

    def located(self, folder: Path) -> "PythonEntry":
        """The same with an absolute path of its file."""
        return self if self.file is None else self.model_copy(update={"file": str((folder / self.file).resolve())})

    def laboratory(self, site: Site) -> "Laboratory":
        """The function of the file, or the one that Python gave."""
        from hsed_jax.laboratories.python import PythonLaboratory, function_of

        function = site.function
        if function is None:
            if self.file is None:
                raise UserError("experiments.python.file: this key is required, unless a function is given from Python")
            function = at("experiments.python", function_of, site.folder / self.file, self.function)
        return PythonLaboratory(function, site.programme, site.sensors)
