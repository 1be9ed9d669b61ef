r"""The models of Ibarra, Medina and Krawinkler: bilinear, peak-oriented and pinched, with deterioration by energy.

The backbone yields at $F_y$, hardens to $h F_y$ within the plastic elongation $u_p$, and falls to zero within $u_c$.  Each of the
deteriorations (strength, capping, reloading, unloading stiffness) uses up a reference energy $F_y\,\Lambda$; the parameter is the
rate $d = 1/\Lambda$ [1/m], and zero switches the deterioration off (Λ = 0 in OpenSees).
"""

from collections.abc import Mapping
from typing import ClassVar, final

from hsed_jax.models.opensees.base import (
    AbstractMaterial,
    Arguments,
    MaterialParameter,
    Scaled,
    length,
    negative,
    share,
    stiffness,
    strength,
)

# The elongation of failure, far beyond the falling branch: no specimen loses its force at once.
_NEVER = 1e3


def _rate(symbol: str, meaning: str) -> MaterialParameter:
    return MaterialParameter(symbol, "1/m", meaning, Scaled("path", 0.3, inverse=True), lower=0.0)


_BACKBONE = {
    "k": stiffness(),
    "F_y": strength("F_y", "yield force", 0.85),
    "u_p": length("u_p", "plastic elongation from yielding to the strength", 0.4),
    "u_c": length("u_c", "elongation from the strength to zero force on the falling branch", 3.0),
    "h": share("h", "strength over yield force", 1.001, 1.5, bounds=(1.0, 10.0)),
    "r": share("r", "residual force over yield force", 0.0, 0.5, 0.0),
}
_RATES = {
    "d_S": _rate("d_S", "rate of the loss of strength"),
    "d_C": _rate("d_C", "rate of the loss of the falling branch"),
    "d_A": _rate("d_A", "rate of the acceleration of reloading"),
    "d_K": _rate("d_K", "rate of the loss of unloading stiffness"),
}


def _backbone(p: Mapping[str, float]) -> Arguments:
    """Stiffness and both sides: plastic, post-capping and ultimate elongation, yield force, ratios of strength and residual."""
    last = _NEVER * (p["F_y"] / p["k"] + p["u_p"] + p["u_c"])
    side = (p["u_p"], p["u_c"], last)
    ratios = (p["h"], p["r"])
    return (p["k"], *side, p["F_y"], *ratios, *side, p["F_y"] * p["negative"], *ratios)


def _deterioration(p: Mapping[str, float], kinds: str) -> Arguments:
    """Λ of each kind, then exponents and the factors of either side."""
    capacities = [1 / rate if (rate := p[f"d_{kind}"]) > 0 else 0.0 for kind in kinds]
    return (*capacities, *[1.0] * len(kinds), 1.0, 1.0)


@final
class IMKBilin(AbstractMaterial):
    """A bilinear backbone with a falling branch; strength, falling branch and unloading stiffness deteriorate."""

    name: ClassVar[str] = "IMKBilin"
    reference: ClassVar[str] = "Ibarra, Medina & Krawinkler 2005; Lignos & Krawinkler 2011"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        **_BACKBONE,
        **{name: known for name, known in _RATES.items() if name != "d_A"},
        "negative": negative(),
    }

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Backbone, then Λ of strength, falling branch and unloading stiffness."""
        return (*_backbone(p), *_deterioration(p, "SCK"))


@final
class IMKPeakOriented(AbstractMaterial):
    """The backbone of `IMKBilin`; reloading aims at the furthest point, and may deteriorate."""

    name: ClassVar[str] = "IMKPeakOriented"
    reference: ClassVar[str] = "Ibarra, Medina & Krawinkler 2005"
    parameters: ClassVar[dict[str, MaterialParameter]] = {**_BACKBONE, **_RATES, "negative": negative()}

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """Backbone, then Λ of strength, falling branch, reloading and unloading stiffness."""
        return (*_backbone(p), *_deterioration(p, "SCAK"))


@final
class IMKPinching(AbstractMaterial):
    """The backbone of `IMKBilin`; reloading is pinched before it aims at the furthest point."""

    name: ClassVar[str] = "IMKPinching"
    reference: ClassVar[str] = "Ibarra, Medina & Krawinkler 2005"
    parameters: ClassVar[dict[str, MaterialParameter]] = {
        **_BACKBONE,
        **_RATES,
        "kappaF": share(r"\kappa_F", "force of the break point over the largest force", 0.05, 0.95),
        "kappaD": share(r"\kappa_D", "elongation of the break point over the permanent one", 0.05, 0.95),
        "negative": negative(),
    }

    @staticmethod
    def arguments(p: Mapping[str, float]) -> Arguments:
        """As `IMKPeakOriented`, and the break point of reloading."""
        return (*_backbone(p), *_deterioration(p, "SCAK"), p["kappaF"], p["kappaD"])
