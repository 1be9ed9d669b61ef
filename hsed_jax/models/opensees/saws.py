"""SAWS: the ten parameters of a wood shear wall."""

from collections.abc import Mapping
from typing import ClassVar, final

from hsed_jax.models.opensees.base import (
    AbstractMaterial,
    Arguments,
    MaterialParameter,
    length,
    share,
    stiffness,
    strength,
)


@final
class SAWS(AbstractMaterial):
    """An exponential backbone with a falling branch, pinched reloading, and reloading that softens."""

    name: ClassVar[str] = "SAWS"
    reference: ClassVar[str] = "Folz & Filiatrault 2001"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        "k": stiffness(),
        "F_0": strength("F_0", "intercept of the asymptote of the backbone", 0.9),
        "f_I": share("f_I", "intercept of the pinched branch over F_0", 0.02, 0.9),
        "u_u": length("u_u", "elongation at the strength", 0.8, 0.5),
        "R1": share("R_1", "stiffness of the asymptote over initial stiffness", 0.002, 0.3),
        "R2": share("R_2", "stiffness of the falling branch over initial stiffness, with a changed sign", 0.001, 0.2),
        "R3": share("R_3", "stiffness of unloading over initial stiffness", 0.5, 2.0, bounds=(0.01, 10.0)),
        # OpenSees never ends if the pinched branch is stiffer than the asymptote.
        "r_4": share("R_4/R_1", "stiffness of the pinched branch over that of the asymptote", 0.02, 0.98),
        "alpha": share(r"\alpha", "power of the softening of reloading", 0.1, 1.0, bounds=(0.0, 2.0)),
        "beta": share(r"\beta", "elongation that reloading aims at, over the furthest one", 1.0, 1.5, bounds=(1.0, 3.0)),
    }  # fmt: skip

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Forces, elongation at the strength, stiffness, four ratios, α, β."""
        ratios = (p["R1"], -p["R2"], p["R3"], p["r_4"] * p["R1"])
        return (p["F_0"], p["f_I"] * p["F_0"], p["u_u"], p["k"], *ratios, p["alpha"], p["beta"])
