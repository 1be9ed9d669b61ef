"""Conjugate pairs: the imposed and the resisting quantity of a specimen, as the laboratory measures them.

A spring law relates two quantities whose product is a work.  They are called elongation [m] and force [N]; the same law, with
the same numbers, relates the rotation [rad] of a joint to its moment [N m], or the strain of a coupon to its stress [Pa]. The
numerics are therefore independent of pairs: units, symbols and words that are written for elongation and force
(`hsed_jax.physics.outputs`, the parameters of laws and effects) are translated here for display.
"""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from hsed_jax.physics.outputs import Output, output


@dataclass(frozen=True)
class Pair:
    """Names, SI units and symbols of elongation and force.

    Attributes:
        elongation, force: in words.
        elongation_unit, force_unit: SI.
        energy_unit: of the product; a strain and a stress give a work per volume, a shear angle and a shear force one per length.
        elongation_symbol, rate_symbol, force_symbol: in LaTeX.
        declared: by channel and quantity, factor to SI and text of the unit that a campaign declares, for display
            (`hsed_jax.physics.display`); not a part of the identity of the pair.
    """

    elongation: str
    force: str
    elongation_unit: str
    force_unit: str
    energy_unit: str
    elongation_symbol: str
    rate_symbol: str
    force_symbol: str
    declared: Mapping[str, tuple[float, str]] = field(
        default_factory=dict[str, tuple[float, str]], compare=False, repr=False
    )

    def __str__(self) -> str:
        """Return the pair with its units: rotation [rad] and moment [N*m]."""
        return f"{self.elongation} [{self.elongation_unit}] and {self.force} [{self.force_unit}]"

    def unit(self, si: str) -> str:
        """An SI unit written in N, m and J of the specimen, in those of the pair: N/m is N*m/rad of a rotation, Pa of a strain.

        Arguments:
            si: a product over a product at most, such as ``N*s/m`` or ``N^(1-n)/m``; other units stay.
        """
        own = {"N": self.force_unit, "m": self.elongation_unit, "J": self.energy_unit}
        above: list[str] = []
        below: list[str] = []
        for part, there, other in zip(si.split("/"), (above, below), (below, above), strict=False):
            for factor in part.split("*"):
                base, _, power = factor.partition("^")
                top, _, bottom = own.get(base, base).partition("/")
                there += [f"{unit}^{power}" if power else unit for unit in top.split("*") if unit != "1"]
                other += [f"{unit}^{power}" if power else unit for unit in bottom.split("*") if unit]
        over = "*".join(below)
        return ("*".join(above) or "1") + (f"/({over})" if len(below) > 1 else f"/{over}" if over else "")

    def words(self, text: str) -> str:
        """A text about elongations and forces, in the words of the pair."""

        def translated(match: re.Match[str]) -> str:
            word = self.elongation if match[1].lower() == "elongation" else self.force
            word = word[0].upper() + word[1:] if match[1][0].isupper() else word
            return word + ("" if not match[2] else "es" if word.endswith("s") else "s")

        return text if self == ELONGATION_AND_FORCE else re.sub(r"\b([Ee]longation|[Ff]orce)(s?)\b", translated, text)

    def called(self, name: str) -> str:
        """A channel or quantity in words: `peak_force` of a rotation is a peak moment, `storey2.force` is that of storey2."""
        words = name.replace("_", " ").replace(".", ": ")
        return self.words(words) if output(name).gains else words

    def output(self, name: str) -> Output:
        """Symbol, unit and meaning of a channel or quantity.

        Raises:
            KeyError: there is no such channel or quantity.
        """
        known = output(name)
        # Outputs without a gain are not measured on the specimen: the ground and the masses move in metres.
        if not known.gains:
            return known
        symbol = known.symbol
        for written, own in (
            (r"\\Delta\\dot u", self.rate_symbol),
            (r"\\Delta u", self.elongation_symbol),
            (r"(?<![A-Za-z\\])r(?![A-Za-z])", self.force_symbol),
        ):
            symbol = re.sub(written, lambda _, own=own: own, symbol)
        return dataclasses.replace(known, symbol=symbol, unit=self.unit(known.unit), meaning=self.words(known.meaning))


ELONGATION_AND_FORCE = Pair("elongation", "force", "m", "N", "J", r"\Delta u", r"\Delta\dot u", "r")
"""The pair of a specimen within a structure of masses, and the default."""
PAIRS = (
    ELONGATION_AND_FORCE,
    Pair("rotation", "moment", "rad", "N*m", "J", r"\theta", r"\dot\theta", "M"),
    Pair("strain", "stress", "1", "Pa", "J/m^3", r"\varepsilon", r"\dot\varepsilon", r"\sigma"),
    Pair("shear angle", "shear force", "rad", "N", "J/m", r"\gamma", r"\dot\gamma", "V"),
)
