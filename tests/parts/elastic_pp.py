"""A material of OpenSees that a test adds to a copy of the package."""

from collections.abc import Mapping
from typing import ClassVar, final

from hsed_jax.models.opensees.base import AbstractMaterial, Arguments, MaterialParameter, stiffness, strength


@final
class ElasticPP(AbstractMaterial):
    """An elastic and perfectly plastic spring."""

    name: ClassVar[str] = "ElasticPP"
    reference: ClassVar[str] = "a test"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        "k": stiffness(),
        "F_y": strength("F_y", "yield force", 0.9),
    }

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Stiffness and yield elongation."""
        return (p["k"], p["F_y"] / p["k"])
