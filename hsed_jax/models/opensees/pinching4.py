"""Pinching4: a backbone of four points, pinched reloading, and three kinds of damage."""

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
from hsed_jax.models.opensees.envelope import SHAPE, four_points, residual


@final
class Pinching4(AbstractMaterial):
    r"""A backbone of four points, pinched reloading, and damage of stiffness, reloading and strength.

    The points are cracking $(c F_m/k,\ c F_m)$, yielding at the force $[c + y(1-c)]F_m$, the strength $F_m$ at $F_m/k + u_p$, and
    the residual force $r F_m$ on the line that falls to zero within $u_c$.  Each damage index is
    $g_1\,\mu^{g_3} + g_2\,(E/E_m)^{g_4}$ with exponents of one and $E_m$ = `gE` times the energy of a monotonic test.  It is at
    most `limit`.
    """

    name: ClassVar[str] = "Pinching4"
    reference: ClassVar[str] = "Lowes, Mitra & Altoontash 2003"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        **SHAPE,
        "c": share("c", "cracking force over strength", 0.1, 0.95),
        "y": share("y", "force of the second point, from cracking (0) to strength (1)", 0.05, 0.95),
        "q": share("q", "elongation of the second point over that of a straight line", 0.05, 0.95, 0.4),
        "r": residual(),
        "rDisp": share(r"r_u", "elongation at which reloading begins, over the furthest one", -0.3, 0.9, bounds=(-1.0, 1.0)),
        "rForce": share(r"r_F", "force at which reloading begins, over that of the furthest point", 0.0, 0.9, bounds=(-1.0, 1.0)),
        "uForce": share(r"u_F", "force after unloading, over the strength", -0.5, 0.5, bounds=(-1.0, 1.0)),
        "gK1": damage(r"g_{K1}", "loss of unloading stiffness with the furthest elongation", 0.3, 0.0),
        "gK2": damage(r"g_{K2}", "loss of unloading stiffness with the energy", 0.3),
        "gD1": damage(r"g_{D1}", "loss of reloading stiffness with the furthest elongation", 0.3, 0.0),
        "gD2": damage(r"g_{D2}", "loss of reloading stiffness with the energy", 0.3),
        "gF1": damage(r"g_{F1}", "loss of strength with the furthest elongation", 0.3, 0.0),
        "gF2": damage(r"g_{F2}", "loss of strength with the energy", 0.3),
        "gE": MaterialParameter("g_E", "1", "energy that counts as one, over that of a monotonic test", value=10.0, lower=1e-6),
        "limit": share(r"g_{lim}", "largest damage index", 0.5, 0.95, 0.9),
        "negative": negative(),
    }  # fmt: skip

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Four points of either side as force and elongation, pinching of either side, damage, its energy and kind."""
        points = [number for u, f in four_points(p) for number in (f, u)]
        other = [-number * (p["negative"] if i % 2 == 0 else 1.0) for i, number in enumerate(points)]
        pinching = [p["rDisp"], p["rForce"], p["uForce"]]
        losses = [number for kind in "KDF" for number in (p[f"g{kind}1"], p[f"g{kind}2"], 1.0, 1.0, p["limit"])]
        return (*points, *other, *pinching, *pinching, *losses, p["gE"], "energy")
