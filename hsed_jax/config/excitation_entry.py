"""The entry of the excitation in a study: a section for each kind, made from its declared settings."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from hsed_jax.physics.declared import DECLARED, Declared, Setting
from hsed_jax.plain import Number, Whole
from hsed_jax.sections import Positive, Section

Value = Number | str
_TYPES: dict[str, Any] = {
    "number": Value,
    "numbers": Annotated[list[Value], Field(min_length=1)],
    "whole": Annotated[Whole, Field(ge=1)],
}


def _field(setting: Setting) -> tuple[Any, Any]:
    """The type and the default of a setting, for a field of pydantic."""
    kind: Any = Literal[*setting.words] if setting.kind == "word" else _TYPES[setting.kind]
    if setting.is_optional:
        return kind | None, None
    return kind, ... if setting.default is None else setting.default


def _section(excitation: Declared) -> type[Section]:
    fields: dict[str, Any] = {"file": (str, ...)} if excitation.of_file else {}
    fields |= {name: _field(known) for name, known in excitation.settings.items()}
    return create_model(f"{excitation.name.title().replace('_', '')}Entry", __base__=Section, **fields)


_KINDS: Any = {name: (_section(excitation) | None, None) for name, excitation in DECLARED.items()}


class ExcitationEntry(create_model("ExcitationEntry", __base__=Section, **_KINDS)):
    """The excitation of the experiments, the duration of the simulation [s], and the step of the integration [s] (by default
    from the periods).

    A setting that is a name refers to an input; a number is fixed.
    """

    duration: Positive | None = None
    step: Positive | None = None

    @property
    def excitation(self) -> Declared | None:
        """The excitation that is given."""
        return next((known for name, known in DECLARED.items() if getattr(self, name) is not None), None)

    @property
    def settings(self) -> Mapping[str, Any]:
        """Its settings by name."""
        return {} if self.excitation is None else getattr(self, self.excitation.name).model_dump()

    @property
    def channel(self) -> str:
        """The channel that measures it; where every experiment brings its record, that of a ground motion."""
        return (
            "ground_acceleration" if self.excitation is None else self.excitation.kind.channel.format(**self.settings)
        )

    @model_validator(mode="after")
    def _at_most_one(self) -> "ExcitationEntry":
        given = [name for name in DECLARED if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"give either {' or '.join(given)}")
        excitation = self.excitation
        if excitation is None:
            return self
        if excitation.is_endless and self.duration is None:
            raise ValueError(f"a {excitation.name} needs a duration [s]")
        if excitation.kind.protocol == "displacement" and (self.duration, self.step) != (None, None):
            raise ValueError(
                f"leave out duration and step: the settings of {excitation.name} determine the duration, and the spring "
                "determines the step"
            )
        return self
