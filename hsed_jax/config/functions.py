"""The entry of a model other than a spring law: a Python function, or a program."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from hsed_jax.plain import Number, shown
from hsed_jax.sections import InputEntry, LevelsEntry, ProgramEntry, Section


class CalledEntry(Section):
    """A called model instead of a spring law: it has no effects."""

    levels: LevelsEntry = {}
    effects: ClassVar[dict[str, dict[str, Number | dict[str, Any]]]] = {}
    """None: they are a spring law's."""
    own_effects: ClassVar[list[str]] = []


class FunctionEntry(CalledEntry):
    """A model that is a function, `FILE:NAME` relative to the study, or a program; its parameters have the names it gives them.

    `derivatives` selects its derivatives: by JAX or by differences; by default by JAX if JAX can trace it.
    """

    function: str | None = None
    command: ProgramEntry | None = None
    derivatives: Literal["jax", "differences"] | None = None
    parameters: Annotated[dict[str, Number | InputEntry], Field(min_length=1)]

    @model_validator(mode="after")
    def _one_kind(self) -> "FunctionEntry":
        if (self.function is None) == (self.command is None):
            raise ValueError("give either function or command")
        if self.command is not None and self.derivatives == "jax":
            raise ValueError("the derivatives of a command are always differences")
        return self

    @field_validator("function")
    @classmethod
    def _file_and_name(cls, text: str | None) -> str | None:
        file, _, name = (text or "mine.py:respond").rpartition(":")
        if not file or not name.isidentifier():
            raise ValueError(f"this is FILE:NAME, such as mine.py:respond, but it is {shown(text)}")
        return text

    @field_validator("parameters")
    @classmethod
    def _are_names(cls, given: dict[str, Number | InputEntry]) -> dict[str, Number | InputEntry]:
        for name in given:
            if not name.isidentifier():
                raise ValueError(f"a parameter has a name such as k_1, but one is {shown(name)}")
        return given

    @property
    def file_and_name(self) -> tuple[str, str]:
        """The file of the function, and its name in it."""
        assert self.function is not None
        file, _, name = self.function.rpartition(":")
        return file, name

    @property
    def code(self) -> list[str]:
        """Files that are executed when the model is built."""
        return [self.file_and_name[0] if self.command is None else self.command.run]

    @property
    def described(self) -> tuple[str, str]:
        """The kind and the name of the model."""
        return ("function", self.function or "") if self.command is None else ("command", self.command.run)

    def located(self, folder: Path) -> "FunctionEntry":
        """The same with absolute paths: written elsewhere, a relative path would lead elsewhere."""
        if self.command is not None:
            return self.model_copy(update={"command": self.command.located(folder)})
        file, name = self.file_and_name
        return self.model_copy(update={"function": f"{(folder / file).resolve()}:{name}"})
