"""Units as laboratories write them in headers: ``[mm]``, ``(KN)``, ``Sec``, ``kN·m``."""

import functools
import re

from hsed_jax.errors import UserError
from hsed_jax.measurements.units import parse_unit

# The spelling that the units library reads, by the spellings of loggers and spreadsheets.
_SPELLINGS = {
    "mm": "millimeter millimeters millimetre millimetres millimètre millimètres",
    "cm": "centimeter centimeters centimetre centimetres",
    "m": "meter meters metre metres",
    "um": "µm μm micron microns micrometer micrometers",
    "inch": 'in in. inches " ″',
    "ft": "feet foot",
    "N": "newton newtons",
    "kN": "kilonewton kilonewtons",
    "MN": "meganewton",
    "daN": "",
    "kgf": "kp kg-f",
    "force_metric_ton": "tf tonf tnf",
    "lbf": "lb lbs lb-f pound pounds",
    "kip": "kips klbf klb kipf",
    "s": "sec secs sec. second seconds sek sekunden sekunde seg segundos secondes seconde secondi sekunden",
    "ms": "msec millisecond milliseconds",
    "min": "minute minutes minuten",
    "hour": "h hr hrs hours",
    "g": "",
    "m/s^2": "m/s² m/s2 m/sec^2 m/sec2 m/s/s m/s**2",
    "cm/s^2": "cm/s² cm/s2 gal gals",
    "mm/s^2": "mm/s² mm/s2",
    "rad": "radian radians",
    "mrad": "millirad milliradian",
    "deg": "° degree degrees grad-deg",
    "%": "percent pct prozent",
    "-": "– mm/mm m/m in/in",
    "mm/m": "‰",
    "um/m": "µm/m μm/m µε με ue ustrain µstrain microstrain micro-strain",
    "kN*m": "knm kn.m kn·m kn-m kn⋅m mkn",
    "kN*mm": "knmm kn.mm kn·mm kn-mm",
    "N*m": "nm n.m n·m n-m n⋅m",
    "N*mm": "nmm n.mm n·mm n-mm",
    "kip*inch": "kip-in kip.in kip·in kip*in k-in kip-inch",
    "kip*ft": "kip-ft kip.ft kip·ft",
    "lbf*ft": "lbf-ft lb-ft ft-lb ft-lbf",
    "MPa": "n/mm2 n/mm^2 n/mm² mn/m2 mn/m² megapascal",
    "kPa": "kn/m2 kn/m^2 kn/m²",
    "Pa": "n/m2 n/m^2 n/m²",
    "GPa": "kn/mm2 kn/mm² gigapascal",
    "psi": "lbf/in2 lb/in2",
    "ksi": "kip/in2",
}
# Units of other quantities than our channels: a row of them is still a row of units.
_OTHERS = """
v mv mv/v µv a ma °c degc c k hz khz bar mbar rpm kg w j kj ts rn volt volts 1/s mm/s mm/min mm/sec m/s in/s kn/s n/s °f
kn/mm db counts count
"""
_EXACT = {spelling: unit for unit, others in _SPELLINGS.items() for spelling in (unit, *others.split())}
# Prefixes and symbols that differ only by their case are left out: mN is not MN, and M is no metre.
_FOLDED = {spelling.casefold(): unit for spelling, unit in _EXACT.items() if unit not in ("MN",)}
_FOLDED = {spelling: unit for spelling, unit in _FOLDED.items() if spelling != "m"}
_ELSE = set(_OTHERS.split())
_PLAIN_WIDTH = {code: code - 0xFEE0 for code in range(0xFF01, 0xFF5F)}
_BRACKETS = re.compile(r"[\[(<{]\s*([^\[\](){}<>]*?)\s*[\])>}]")
_AFTER = re.compile(r"(.*?[^\W\d].*?)\s*(?:,|;|/| in | en )\s*(\S+)\s*")
_LAST = re.compile(r"(.*\w)[\s_]+(\S+)\s*")


@functools.cache
def spelled_unit(text: str) -> str | None:
    """The unit that a text spells, as `parse_unit` reads it; None where it spells none of a channel of a record.

    The case matters if it distinguishes two units (mN and MN).
    """
    bare = _bare(text)
    if bare in _EXACT:
        return _EXACT[bare]
    if re.fullmatch(r"[mM]N", bare):
        return bare
    return _FOLDED.get(bare.casefold())


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any quantity."""
    bare = _bare(text)
    return bool(bare) and (spelled_unit(bare) is not None or bare.casefold() in _ELSE or _is_known(text))


def without_unit(name: str) -> tuple[str, str]:
    """A header without its unit, and the unit as it is written; empty without one.

    The unit stands in brackets (``Force [kN]``), behind a comma, a slash or a word (``Force, kN``, ``F/kN``, ``Kraft in kN``), or
    it is the last word (``disp_mm``).  Full-width letters and brackets, as Japanese files have them, are read as plain ones.
    """
    name = name.translate(_PLAIN_WIDTH)
    for found in reversed(list(_BRACKETS.finditer(name))):
        if found[1] and (is_unit(found[1]) or found.end() == len(name.rstrip())):
            bare = f"{name[: found.start()]} {name[found.end() :]}".strip(" _-,;:/")
            return bare, "" if found[1].isdecimal() else found[1]
    for pattern in (_AFTER, _LAST):
        found = pattern.fullmatch(name)
        if found and (spelled_unit(found[2]) is not None or _bare(found[2]).casefold() in _ELSE) and len(found[1]) > 0:
            return found[1].strip(" _-,;:/"), _bare(found[2])
    return name.strip(), ""


def _bare(text: str) -> str:
    inner = _BRACKETS.fullmatch(text.strip())
    return (inner[1] if inner else text).strip()


@functools.cache
def _is_known(text: str) -> bool:
    """Whether a text in brackets is a unit that the units library knows."""
    if not _BRACKETS.fullmatch(text.strip()):
        return False
    try:
        parse_unit(_bare(text))
    except UserError:
        return False
    return True
