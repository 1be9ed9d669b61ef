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
        ValueError: there is no such material; the message lists the existing ones.
    """
    if name not in MATERIALS:
        close = difflib.get_close_matches(name, MATERIALS, n=1, cutoff=0.5)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise ValueError(f"there is no material {shown(name)}{hint}; allowed are {', '.join(MATERIALS)}")
    return name


def asked_material(name: str, option: str) -> str:
    """The name of a material from an option of a command.

    Raises:
        UserError: there is no such material.
    """
    try:
        return known_material(name)
    except ValueError as error:
        raise UserError(f"{option}: {error}") from None


class OpenSeesEntry(CalledEntry):
    """A model that is a uniaxial material of OpenSees, along the imposed elongation."""

    opensees: Annotated[str, AfterValidator(known_material)]
    """The material, by the name of OpenSees."""
    parameters: dict[str, ParameterEntry] = {}
    """A number fixes a parameter, a prior frees it, `{}` is the prior of the table. An omitted parameter has its entry
    of the table.
    """
    search: Annotated[Whole, Field(ge=0)] = 2000
    """Number of simulations of the derivative-free search before the descents; 0 skips the search."""

    @property
    def code(self) -> list[str]:
        """Files that are executed when the model is built: none of the user."""
        return []

    @property
    def described(self) -> tuple[str, str]:
        """The kind and the name of the model."""
        return "opensees", self.opensees

    def located(self, folder: Path) -> "OpenSeesEntry":
        """The same: it names no file."""
        return self
