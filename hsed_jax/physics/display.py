"""The unit of a displayed number, for figures, reports, the terminal and the checks of data.

If the campaign declares a unit other than plain SI, such as inches or kip, values of this kind are shown in it, also derived
ones such as a predicted force or the amplitude of a cycle. Other values are shown in SI with a suitable prefix.
"""

import re

import numpy as np
import numpy.typing as npt

from hsed_jax.physics.names import named, owner_of
from hsed_jax.physics.outputs import output
from hsed_jax.physics.pairs import Pair


def readable(unit: str, *values: npt.ArrayLike) -> tuple[float, str]:
    """Divisor and unit with which the largest of `values` is easy to read: (1000.0, "kN") for 2.5e5 N, mm below 1 m.

    Only units that usually have a prefix in this field change: those that begin with N, J or Pa, and m or rad alone.
    """
    largest = max((float(v[np.isfinite(v)].max(initial=0.0)) for v in map(np.abs, values)), default=0.0)
    if unit in ("m", "rad") and 0 < largest < 1:
        return 1e-3, f"m{unit}"
    if re.match(r"(N|J|Pa)(?!\^)\b", unit):
        prefixes = [*([(1e9, "G")] if unit.startswith("Pa") else []), (1e6, "M"), (1e3, "k")]
        return next(((d, prefix + unit) for d, prefix in prefixes if largest >= d), (1.0, unit))
    return 1.0, unit


def shown(pair: Pair, name: str, *values: npt.ArrayLike) -> tuple[float, str]:
    """Divisor and unit of a displayed channel or quantity: the declared unit, otherwise SI with a suitable prefix.

    Arguments:
        pair: that the specimen is measured in, with the units that its campaign declares.
        name: of the channel or quantity.
        values: SI.

    Raises:
        KeyError: there is no such channel or quantity.
    """
    return _declared(pair, name) or readable(pair.output(name).unit, *values)


def shown_in(pair: Pair, si: str, *values: npt.ArrayLike) -> tuple[float, str]:
    """Divisor and unit of a displayed elongation, force, rate, stiffness or work of a specimen.

    Arguments:
        pair: that the specimen is measured in, with the units that its campaign declares.
        si: unit of it, written in N, m and J.
        values: SI.
    """
    if si in ("m", "N"):
        return shown(pair, "elongation" if si == "m" else "force", *values)
    if si == "m/s":
        known, unit = _declared(pair, "elongation"), pair.unit(si)
        # A rate in mm/s or m/s is as easily read for an elongation in mm.
        if known is not None and not np.log10(known[0]).is_integer():
            return known[0], f"{known[1]}/s"
        is_small = readable("m", *values)[0] < 1
        return (1e-3, f"m{unit}") if is_small and unit in ("m/s", "rad/s") else (1.0, unit)
    if si == "N/m" and pair.elongation_unit != "1":
        across, up = _declared(pair, "elongation"), _declared(pair, "force")
        if across is not None and up is not None:
            return up[0] / across[0], f"{up[1]}/{across[1]}"
    return readable(pair.unit(si), *values)


def amount(pair: Pair, name: str, value: float, digits: int = 3) -> str:
    """A value (SI) of a channel or quantity with its unit as it is declared, for a message about the data.

    Arguments:
        pair: that the specimen is measured in, with the units that its campaign declares.
        name: of the channel or quantity.
        value: SI.
        digits: that count.
    """
    divisor, unit = _declared(pair, name) or (1.0, pair.output(name).unit)
    return f"{value / divisor:.{digits}g} {unit}".removesuffix(" 1")


def _declared(pair: Pair, name: str) -> tuple[float, str] | None:
    """Factor to SI and text of a unit that the campaign declares, unless it is SI without a prefix."""
    found = pair.declared.get(name)
    if found is None and output(name).gains:
        # A quantity of a specimen follows from its elongation and force.
        unit = pair.output(name).unit
        sources = {pair.elongation_unit: "elongation", pair.force_unit: "force"}
        if unit in sources:
            found = pair.declared.get(named(owner_of(name), sources[unit]), pair.declared.get(sources[unit]))
    return None if found is None or found[0] == 1.0 else found
