"""The table of parameters for a paper, in Markdown and LaTeX: unit, mean, 90 % interval and prior of each."""

import re
from typing import NamedTuple

from hsed_jax.exports.calibrated import Calibrated
from hsed_jax.inference.priors import Prior

_HEADS = ("parameter", "symbol", "unit", "mean", "90 % interval", "prior")


class Row(NamedTuple):
    """A parameter.

    Attributes:
        name: as in the study.
        symbol: LaTeX, without dollars; empty without one.
        unit: SI.
        mean, low, high: of the posterior; the 5 % and the 95 % quantile.
        prior: in words.
    """

    name: str
    symbol: str
    unit: str
    mean: float
    low: float
    high: float
    prior: str


def rows(model: Calibrated) -> list[Row]:
    """The calibrated parameters, those of inferred errors last."""
    priors, units, found = model.priors, model.built.mechanics.units, []
    for name, told in model.posterior.items():
        known = model.known(name)
        in_units = known is not None and known.physical is not None and name.endswith(f".{known.physical.name}")
        symbol = "" if known is None or in_units else known.symbol
        prior = _words(priors[name]) if name in priors else ""
        found.append(Row(name, symbol, units.get(name, "1"), told["mean"], told["q05"], told["q95"], prior))
    return found


def markdown(table: list[Row]) -> str:
    """The table in Markdown."""
    lines = [_HEADS, ("---",) * len(_HEADS)]
    for row in table:
        symbol = f"${row.symbol}$" if row.symbol else "–"
        lines.append((f"`{row.name}`", symbol, row.unit, _number(row.mean, row),
                      f"{_number(row.low, row)} to {_number(row.high, row)}", row.prior or "–"))  # fmt: skip
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def latex(table: list[Row]) -> str:
    """The table in LaTeX; it needs the package booktabs."""
    lines = [" & ".join(_HEADS).replace("%", r"\%")]
    body = []
    for row in table:
        symbol = f"${row.symbol}$" if row.symbol else "--"
        cells = (rf"\texttt{{{_escaped(row.name)}}}", symbol, _latex_unit(row.unit), f"${_latex_number(row.mean, row)}$",
                 f"${_latex_number(row.low, row)}$ to ${_latex_number(row.high, row)}$", _escaped(row.prior) or "--")  # fmt: skip
        body.append(" & ".join(cells))
    middle = "".join(f"{line} \\\\\n" for line in body)
    return (
        f"\\begin{{tabular}}{{llllll}}\n\\toprule\n{lines[0]} \\\\\n\\midrule\n{middle}\\bottomrule\n\\end{{tabular}}\n"
    )


def _number(value: float, row: Row) -> str:
    """Digits according to the width of the interval, at least two."""
    width = abs(row.high - row.low)
    size = max(abs(value), abs(row.mean))
    digits = 3
    while digits < 8 and width and 10.0 ** (1 - digits) * size > 0.05 * width:
        digits += 1
    return f"{value:.{digits}g}"


def _latex_number(value: float, row: Row) -> str:
    mantissa, _, exponent = _number(value, row).partition("e")
    return rf"{mantissa} \times 10^{{{int(exponent)}}}" if exponent else mantissa


def _latex_unit(unit: str) -> str:
    """`N*s/m` as N\\,s/m, powers raised."""
    raised = re.sub(r"\^\(([^)]*)\)|\^(-?\w+)", lambda m: f"$^{{{m[1] or m[2]}}}$", unit)
    return raised.replace("*", r"\,")


def _escaped(text: str) -> str:
    return re.sub(r"([_%&#$])", r"\\\1", text)


def _words(prior: Prior) -> str:
    given = prior.arguments
    numbers = list(given.values()) if isinstance(given, dict) else given if isinstance(given, list | tuple) else [given]
    return f"{prior.name.replace('_', ' ')}({', '.join(f'{number:g}' for number in numbers)})"
