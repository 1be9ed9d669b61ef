"""The entry of a model that is a material of OpenSees."""

import difflib
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from hsed_jax.config.functions import CalledEntry
from hsed_jax.errors import UserError
from hsed_jax.models.opensees import MATERIALS
from hsed_jax.plain import Whole, shown
from hsed_jax.sections import ParameterEntry


def known_material(name: str) -> str:
    """The name of a material of the table.

    Raises:
        ValueError: there is no such material; the message names those that there are.
    """
    if name not in MATERIALS:
        close = difflib.get_close_matches(name, MATERIALS, n=1, cutoff=0.5)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise ValueError(f"there is no material {shown(name)}{hint}; allowed are {', '.join(MATERIALS)}")
    return name


def asked_material(name: str, option: str) -> str:
    """The name of a material that was asked for by an option, not by a study.

    Raises:
        UserError: there is no such material.
    """
    try:
        return known_material(name)
    except ValueError as error:
        raise UserError(f"{option}: {error}") from None


class OpenSeesEntry(CalledEntry):
    """A model that is a uniaxial material of OpenSees, along the elongation that was imposed."""

    opensees: Annotated[str, AfterValidator(known_material)]
    """The material, by the name of OpenSees."""
    parameters: dict[str, ParameterEntry] = {}
    """A number fixes a parameter, a prior frees it, `{}` is the prior of the table; what is left out is as the table has it."""
    search: Annotated[Whole, Field(ge=0)] = 2000
    """Simulations of the search without derivatives that comes before the descents; 0 leaves it out."""

    @property
    def code(self) -> list[str]:
        """What is executed where the model is built: nothing of the user's."""
        return []

    @property
    def described(self) -> tuple[str, str]:
        """What kind of model it is, and which."""
        return "opensees", self.opensees

    def located(self, folder: Path) -> "OpenSeesEntry":
        """The same: it names no file."""
        return self
