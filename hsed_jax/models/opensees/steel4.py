"""Steel4: kinematic and isotropic hardening of steel."""

from collections.abc import Mapping
from typing import ClassVar, final

from hsed_jax.models.opensees.base import (
    AbstractMaterial,
    Arguments,
    MaterialParameter,
    damage,
    share,
    stiffness,
    strength,
)


@final
class Steel4(AbstractMaterial):
    """Curved loops of steel with kinematic hardening, and isotropic hardening that is fast at first and slow afterwards."""

    name: ClassVar[str] = "Steel4"
    reference: ClassVar[str] = "Zsarnóczay 2013; Menegotto & Pinto 1973"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        "k": stiffness(),
        "F_y": strength("F_y", "yield force", 0.7),
        "b": share("b", "stiffness of kinematic hardening over initial stiffness", 0.0, 0.2),
        "R_0": share("R_0", "sharpness of the first yielding", 2.0, 30.0, bounds=(1.0, 100.0)),
        "r_1": share("r_1", "share of the sharpness that plastic excursions take", 0.5, 0.97),
        "r_2": share("r_2", "plastic excursion that takes half of it, over yield elongation", 0.02, 1.0, bounds=(1e-3, 10.0)),
        "b_i": damage("b_i", "stiffness of fast isotropic hardening over initial stiffness", 0.02),
        "rho_i": share(r"\rho_i", "size of fast isotropic hardening over yield force", 0.01, 1.5, bounds=(1e-3, 10.0)),
        "b_l": damage("b_l", "stiffness of slow isotropic hardening over initial stiffness", 0.002),
        "R_i": share("R_i", "sharpness of the transition between both", 5.0, 30.0, 20.0, bounds=(1.0, 100.0)),
    }  # fmt: skip

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Yield force, stiffness, kinematic and isotropic hardening; its plateau of yielding has the length 1."""
        kinematic, isotropic = (p["b"], p["R_0"], p["r_1"], p["r_2"]), (p["b_i"], p["rho_i"], p["b_l"], p["R_i"], 1.0)
        return (p["F_y"], p["k"], "-kin", *kinematic, "-iso", *isotropic)
