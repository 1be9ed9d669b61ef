"""Ground motions in the PEER format `.AT2`: four lines of header, then accelerations in g at equal steps."""

import re
from pathlib import Path

import numpy as np

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements.sheets import read_text
from hsed_jax.measurements.units import parse_unit
from hsed_jax.plain import MOST, in_range, shown

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?"
# Fixed-width columns may touch: a number ends at a blank or at the sign of the next one.
_SAMPLE = re.compile(rf"\s*({_NUMBER})(?=[\s+-]|$)")
_COUNT = re.compile(r"NPTS\s*=\s*(\d+)", re.IGNORECASE)
_STEP = re.compile(rf"\bDT\s*=\s*({_NUMBER})", re.IGNORECASE)
_COUNT_AND_STEP = re.compile(rf"\s*(\d+)\s+({_NUMBER})\s+NPTS\s*,\s*DT", re.IGNORECASE)  # the older header


def read_at2(path: str | Path) -> tuple[float, np.ndarray]:
    """Read a ground motion.

    Arguments:
        path: A PEER `.AT2` file, in g.

    Returns:
        The time step [s] and the accelerations (n,) [m/s²].

    Raises:
        UserError: NPTS or DT is missing in the header, the unit is not g, text is among the numbers (with its row), or
            the number of samples differs from NPTS.

    Example:
        >>> step, acceleration = hx.read_at2("motion.AT2")
        >>> step, acceleration.size
        (0.01, 4)
    """
    path = Path(path)
    lines = read_text(path).splitlines()
    start, samples, dt = _header(path, lines)
    values = []
    for row, line in enumerate(lines[start:], start + 1):
        position, end = 0, len(line.rstrip())
        while position < end:
            match = _SAMPLE.match(line, position)
            if match is None:
                raise UserError(
                    f"{path}, row {row}: {shown(line[position:].strip())} is not a number; only accelerations in g"
                )
            values.append(_float(match[1]))
            if abs(values[-1]) > MOST:
                raise UserError(f"{path}, row {row}: {shown(match[1])} g is out of range")
            position = match.end()
    if len(values) != samples or not values:
        raise UserError(
            f"{path}: {len(values)} samples where the header says NPTS={samples}; the file is cut or damaged"
        )
    return dt, parse_unit("g").to_si(np.array(values))


def write_at2(path: str | Path, dt: float, acceleration, title: str = "ground motion") -> None:
    """Write a ground motion as PEER `.AT2`, which keeps eight digits.

    Arguments:
        path: File to write.
        dt: Time step [s].
        acceleration: Accelerations (n,) [m/s²].
        title: Second line of the header.
    """
    values = parse_unit("g").from_si(np.asarray(acceleration, dtype=float))
    lines = ["PEER STRONG MOTION DATABASE RECORD", " ".join(title.split()), "ACCELERATION TIME SERIES IN UNITS OF G"]
    lines.append(f"NPTS= {len(values)}, DT= {float(dt)!r} SEC")
    lines += ["".join(f"{v:16.7E}" for v in values[i : i + 5]) for i in range(0, len(values), 5)]
    write_whole(Path(path), "\n".join(lines) + "\n")


def _header(path: Path, lines: list[str]) -> tuple[int, int, float]:
    """Return the number of lines of the header, the number of samples, and the time step [s]."""
    for row, line in enumerate(lines[:20], 1):
        count, step, both = _COUNT.search(line), _STEP.search(line), _COUNT_AND_STEP.match(line)
        if both:
            samples, dt = both[1], _float(both[2])
        elif count and step:
            samples, dt = count[1], _float(step[1])
        else:
            continue
        if len(samples) > 12:
            raise UserError(
                f"{path}, row {row}: NPTS is a number of {len(samples)} digits; it is the number of samples"
            )
        unit = re.search(r"UNITS?\s+(?:OF|ARE)\s+\(?([\w/^*]+)", " ".join(lines[: row - 1]).upper())
        if unit and unit[1] != "G":
            raise UserError(f"{path}: the header says units of {unit[1]}; an .AT2 file holds accelerations in g")
        if not (dt > 0 and in_range(dt)):
            raise UserError(f"{path}, row {row}: DT is {dt:g}; the time step is positive")
        return row, int(samples), dt
    raise UserError(f"{path}: no line with NPTS= and DT= in the header; a PEER .AT2 file has one before the numbers")


def _float(text: str) -> float:
    return float(text.upper().replace("D", "E"))
