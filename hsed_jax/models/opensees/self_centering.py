"""SelfCentering: a flag-shaped loop."""

from collections.abc import Mapping
from typing import ClassVar, final

from hsed_jax.models.opensees.base import AbstractMaterial, Arguments, MaterialParameter, share, stiffness, strength


@final
class SelfCentering(AbstractMaterial):
    """A flag: elastic to the activation force, then stiffer or softer, and back to zero with little left behind."""

    name: ClassVar[str] = "SelfCentering"
    reference: ClassVar[str] = "Christopoulos, Tremblay, Kim & Lacerte 2008"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        "k": stiffness(),
        "F_a": strength("F_a", "activation force", 0.7),
        "b": share("b", "stiffness after activation over initial stiffness", 0.0005, 0.5),
        "beta": share(r"\beta", "height of the flag over activation force", 0.02, 0.99),
    }

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Initial stiffness, stiffness after activation, activation force, β."""
        return (p["k"], p["b"] * p["k"], p["F_a"], p["beta"])
