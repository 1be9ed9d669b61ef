"""The backbone that materials with points share: its parameters, and its points."""

from collections.abc import Mapping

from hsed_jax.models.opensees.base import MaterialParameter, length, share, stiffness, strength

SHAPE = {
    "k": stiffness(),
    "F_m": strength("F_m", "strength", 0.95),
    "u_p": length("u_p", "elongation from F_m/k to the strength", 0.3),
    "u_c": length("u_c", "elongation from the strength to zero force on the falling branch", 3.0),
}
"""Parameters of every such backbone."""


def residual() -> MaterialParameter:
    """The residual force."""
    return share("r", "residual force over strength", 0.01, 0.5, 0.05)


def three_points(p: Mapping[str, float], first: float) -> list[tuple[float, float]]:
    """A first point on the elastic line, the strength, and the residual force, each as elongation and force.

    Arguments:
        p: `k`, `F_m`, `u_p`, `u_c` and `r`.
        first: force of the first point over the strength, less than one.
    """
    top = p["F_m"] / p["k"] + p["u_p"]
    low = p["F_m"] * first
    return [(low / p["k"], low), (top, p["F_m"]), (top + (1 - p["r"]) * p["u_c"], p["r"] * p["F_m"])]


def four_points(p: Mapping[str, float]) -> list[tuple[float, float]]:
    """Cracking, yielding, strength, residual force, each as elongation and force; the slope falls from point to point.

    Arguments:
        p: `k`, `F_m`, `u_p`, `u_c`, `r`, `c`, `y` and `q`.
    """
    first, top, residual = three_points(p, p["c"])
    second = (first[0] + p["q"] * p["y"] * (top[0] - first[0]), first[1] + p["y"] * (top[1] - first[1]))
    # The first segment is the stiffest: where the second point would lie above its line, it is on the line.
    if second[1] > p["k"] * second[0]:
        second = (second[1] / p["k"] * (1 + 1e-9), second[1])
    return [first, second, top, residual]
