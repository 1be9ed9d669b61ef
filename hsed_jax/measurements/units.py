"""Units and dimensions: the unit of each channel and quantity, and its conversion to SI."""

import functools
import re
import unicodedata
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from hsed_jax.backend import cache_folder
from hsed_jax.errors import UserError
from hsed_jax.physics.outputs import ALLOWED, CHANNELS, PER_MASS, channel, is_quantity
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE, Pair
from hsed_jax.plain import shown


@dataclass(frozen=True)
class Dimension:
    """A physical dimension: its name, its SI unit, and units that a message may suggest."""

    name: str
    si: str
    examples: str


TIME = Dimension("time", "s", "s, ms, min")
LENGTH = Dimension("length", "m", "m, cm, mm, inch")
VELOCITY = Dimension("velocity", "m/s", "m/s, cm/s, mm/s, inch/s")
ACCELERATION = Dimension("acceleration", "m/s^2", "m/s^2, cm/s^2, Gal, g (standard gravity)")
FORCE = Dimension("force", "N", "N, kN, MN, lbf, kip")
ENERGY = Dimension("energy", "J", "J, kJ, kN*mm, N*m, kip*inch")
# Dimensions of the other pairs in which a specimen may be measured.
_OF_PAIRS = (
    Dimension("angle", "rad", "rad, mrad, deg, %"),
    Dimension("angular velocity", "rad/s", "rad/s, mrad/s, deg/s"),
    Dimension("moment", "N*m", "N*m, kN*m, kip*inch"),
    Dimension("strain", "1", "-, %, mm/m"),
    Dimension("strain rate", "1/s", "1/s, %/s"),
    Dimension("stress", "Pa", "Pa, kPa, MPa, GPa, psi, ksi"),
    Dimension("energy per volume", "J/m^3", "J/m^3, kJ/m^3, MPa"),
    Dimension("energy per length", "J/m", "J/m, kJ/m, kN"),
)

_BY_UNIT = {d.si: d for d in (TIME, LENGTH, VELOCITY, ACCELERATION, FORCE, ENERGY, *_OF_PAIRS)}
DIMENSIONLESS = {"-", "–", "1"}
"""Texts of the unit of a pure number."""
# The results of pint for the most frequent units: by dimension in base dimensions and SI unit, their factors.  pint takes as long
# to load as all else that reads a study, so it is used only for the other units.
_USUAL: dict[tuple[str, str], dict[str, int | str]] = {
    ("[time]", "s"): {"s": 1, "ms": "1/1000"},
    ("[length]", "m"): {"m": 1, "cm": "1/100", "mm": "1/1000"},
    ("[length]*[time]^-1", "m*s^-1"): {"m/s": 1, "cm/s": "1/100", "mm/s": "1/1000"},
    ("[length]*[time]^-2", "m*s^-2"): {"m/s^2": 1, "m/s2": 1, "cm/s^2": "1/100", "Gal": "1/100", "g": "9.80665"},
    ("[length]*[mass]*[time]^-2", "kg*m*s^-2"): {"N": 1, "kN": 1000, "MN": 1_000_000, "J/m": 1},
    ("[length]^2*[mass]*[time]^-2", "kg*m^2*s^-2"): {"J": 1, "kJ": 1000, "kN*mm": 1, "N*m": 1, "kN*m": 1000},
    ("[length]^-1*[mass]*[time]^-2", "kg*m^-1*s^-2"): {
        "Pa": 1,
        "kPa": 1000,
        "MPa": 1_000_000,
        "GPa": 10**9,
        "J/m^3": 1,
    },
    ("[mass]*[time]^-2", "kg*s^-2"): {"N/m": 1, "kN/m": 1000, "N/mm": 1000, "kN/mm": 1_000_000},
    ("[time]^-1", "s^-1"): {"1/s": 1},
    ("[time]^-1", "rad*s^-1"): {"rad/s": 1},
    ("dimensionless", "rad"): {"rad": 1, "mrad": "1/1000"},
    ("dimensionless", "1"): {"%": "1/100"},
}
USUAL = {
    text: (Fraction(factor), formula, si) for (formula, si), units in _USUAL.items() for text, factor in units.items()
}
"""Factor to SI, dimension in base dimensions and SI unit, by text."""
# A long number, or a power of a power: pint would compute all its digits.
_ENDLESS = re.compile(r"\d{3}|\d[eE]|\d[\s)]*(\*\*|\^)")


def dimension_of(unit: str) -> Dimension:
    """Return the dimension of an SI unit that a channel, quantity or setting is declared in."""
    return _BY_UNIT[unit]


def channel_dimension(name: str, pair: Pair = ELONGATION_AND_FORCE) -> Dimension:
    """Return the dimension of a canonical channel (`hsed_jax.physics.outputs`) of a specimen measured in a pair.

    Raises:
        UserError: `name` is not a canonical channel.
    """
    try:
        channel(name)
    except KeyError:
        mass = ", ".join([*(f"{stem}_<i>[_absolute]" for stem in PER_MASS), "applied_force_<i>"])
        raise UserError(f"unknown channel {name!r}; allowed: {', '.join(CHANNELS)}, and for mass i {mass}") from None
    return _BY_UNIT[pair.output(name).unit]


def quantity_dimension(name: str, pair: Pair = ELONGATION_AND_FORCE) -> Dimension:
    """Return the dimension of a canonical quantity (`hsed_jax.physics.outputs`) of a specimen measured in a pair.

    Raises:
        UserError: `name` is not a canonical quantity.
    """
    if is_quantity(name):
        return _BY_UNIT[pair.output(name).unit]
    raise UserError(f"unknown quantity {name!r}; allowed: {ALLOWED}")


@dataclass(frozen=True)
class Unit:
    """A unit as the user wrote it, its exact factor to SI, and the SI unit."""

    text: str
    factor: Fraction
    si: str

    def to_si(self, values: Any) -> Any:
        """Convert numbers (float or array of any shape) in this unit to SI."""
        # Dividing by 1000 rounds once, multiplying by 0.001 twice: 25.4 mm becomes the same double as 0.0254 m.
        if self.factor.numerator == 1:
            return values / float(self.factor.denominator)
        return values * float(self.factor)

    def from_si(self, values: Any) -> Any:
        """Convert SI numbers (float or array) to this unit, so that `to_si` gives the same numbers back if any can.

        Rounding makes plain division miss by a unit in the last place; the neighbours of the quotient are tried too.
        """
        if self.factor == 1:
            return values
        si = np.asarray(values, dtype=float)
        with np.errstate(all="ignore"):
            quotient = si * float(self.factor.denominator) if self.factor.numerator == 1 else si / float(self.factor)
            result, below, above = quotient, quotient, quotient
            for _ in range(2):
                below, above = np.nextafter(below, -np.inf), np.nextafter(above, np.inf)
                for neighbour in (below, above):
                    better = (self.to_si(result) != si) & (self.to_si(neighbour) == si)
                    result = np.where(better, neighbour, result)
        return result if np.ndim(values) else float(result)

    def snap(self, values: Any) -> Any:
        """Move SI numbers, by at most the last place, to numbers that writing in this unit preserves."""
        return values if self.factor == 1 else self.to_si(self.from_si(values))


def parse_unit(text: str, dimension: Dimension | None = None) -> Unit:
    """Read a unit such as ``mm``, ``kN``, ``kN*mm``, ``m/s^2``, ``g``, ``%`` or ``-``.

    Arguments:
        text: The unit.  ``g`` is standard gravity; ``-`` and ``1`` are dimensionless.
        dimension: The required dimension of the unit; `None` allows anything (an input of an experiment).

    Raises:
        UserError: The unit is unknown, has an offset (degC), or has another dimension.
    """
    expected = f"expected a unit of {dimension.name}, such as {dimension.examples}" if dimension else "see pint's units"
    try:
        factor, formula, si = _in_si(text)
    except ValueError as error:
        raise UserError(f"{error}; {expected}") from None
    if dimension and formula != _in_si(dimension.si)[1]:
        raise UserError(f"unit {text!r} does not measure {dimension.name} (it is {formula}); {expected}")
    return Unit(text, factor, si)


def measures(text: str, dimension: Dimension) -> bool:
    """Return whether a text is a unit, and measures a dimension."""
    try:
        return _in_si(text)[1] == _in_si(dimension.si)[1]
    except ValueError:
        return False


@functools.cache
def _registry():
    import pint

    exact: Any = Fraction  # pint declares float and accepts any type of number
    try:
        # Reading pint's table of units takes a quarter of a second, so the result is kept.
        folder = cache_folder()
        kept = None if folder is None else folder / "pint"
        return pint.UnitRegistry(non_int_type=exact, cache_folder=kept)
    except Exception:  # the folder cannot be written to, or a file in it is damaged, which may raise anything
        return pint.UnitRegistry(non_int_type=exact)


@functools.cache
def _in_si(text: str) -> tuple[Fraction, str, str]:
    """Return the factor to SI, the dimension in base dimensions, and the SI unit."""
    if text.strip() in DIMENSIONLESS:
        return Fraction(1), "dimensionless", "1"
    return USUAL[text] if text in USUAL else _by_pint(text)


def _by_pint(text: str) -> tuple[Fraction, str, str]:
    # pint reads g as gram; in this field it is gravity.  A spreadsheet's m/s2 means m/s^2.
    spelled = re.sub(r"(?<![A-Za-z_])g(?![A-Za-z_])", "standard_gravity", text)
    spelled = re.sub(r"(?<=[A-Za-z])(\d)", r"**\1", spelled)
    if len(text) > 100 or _ENDLESS.search(unicodedata.normalize("NFKC", spelled)):
        raise ValueError(f"unknown unit {shown(text)}")
    registry = _registry()
    try:
        unit = registry.parse_units(spelled)
        one = registry.Quantity(Fraction(1), unit)
        two = registry.Quantity(Fraction(2), unit).to_base_units().magnitude
        base = one.to_base_units()
        proportional = two == 2 * base.magnitude
    except Exception:  # pint raises any exception from AttributeError to TokenError on unreadable text
        raise ValueError(f"unknown unit {shown(text)}") from None
    if not text.strip():
        raise ValueError("the unit is empty")
    if not proportional:
        raise ValueError(f"unit {text!r} has an offset or is logarithmic and cannot be scaled to SI")
    symbols = {registry.get_symbol(name): power for name, power in base.unit_items()}
    return Fraction(base.magnitude), _product(base.dimensionality) or "dimensionless", _product(symbols) or "1"


def _product(powers) -> str:
    return "*".join(name if power == 1 else f"{name}^{power}" for name, power in sorted(powers.items()))
