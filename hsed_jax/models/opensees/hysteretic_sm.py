"""HystereticSM: a backbone of points with pinching, damage and unloading that softens."""

from collections.abc import Mapping
from typing import ClassVar, final

from hsed_jax.models.opensees.base import (
    AbstractMaterial,
    Arguments,
    MaterialParameter,
    damage,
    negative,
    share,
)
from hsed_jax.models.opensees.envelope import SHAPE, residual, three_points


@final
class HystereticSM(AbstractMaterial):
    r"""A backbone of three points, pinched reloading, damage by ductility and by energy, and unloading that softens.

    The points are yielding $(y F_m/k,\ y F_m)$, the strength $F_m$ at $F_m/k + u_p$, and the residual force $r F_m$ on the line
    that falls to zero within $u_c$.  The unloading stiffness is $k\,\mu^{-\beta}$ with the ductility μ.
    """

    name: ClassVar[str] = "HystereticSM"
    reference: ClassVar[str] = "Scott & Filippou 2000; Mazzoni 2022"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        **SHAPE,
        "y": share("y", "yield force over strength", 0.1, 0.98),
        "r": residual(),
        "pinchX": share("p_x", "elongation at which reloading stiffens, from none (0) to all of it (1)", 0.0, 1.0),
        "pinchY": share("p_y", "force at which reloading stiffens, from none (0) to all of it (1)", 0.0, 1.0),
        "damage1": damage("d_1", "damage by ductility", 0.02),
        "damage2": damage("d_2", "damage by energy", 0.05),
        "beta": share(r"\beta", "power of the ductility by which unloading softens", 0.0, 0.8),
        "negative": negative(),
    }  # fmt: skip

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Points of either side, pinching, damage, β."""
        points = three_points(p, p["y"])
        positive = [number for u, f in points for number in (f, u)]
        other = [number for u, f in points for number in (-f * p["negative"], -u)]
        pinch, loss = (p["pinchX"], p["pinchY"]), (p["damage1"], p["damage2"])
        return ("-posEnv", *positive, "-negEnv", *other, "-pinch", *pinch, "-damage", *loss, "-beta", p["beta"])
