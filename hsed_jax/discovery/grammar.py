"""The small grammar of the formulas: shapes of one coordinate, with their numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Number:
    """A number of a shape.

    Attributes:
        symbol: of one letter.
        meaning: in a sentence.
        prior: as in a study, from the lowest and highest value of the coordinate.
        grid: values to try.
    """

    symbol: str
    meaning: str
    prior: Callable[[float, float], dict[str, Any]]
    grid: Callable[[float, float], Float[np.ndarray, " g"]]


@dataclass(frozen=True)
class Shape:
    """A function of one coordinate x.

    Attributes:
        code: Python, of `{x}` and the symbols of its numbers in braces.
        latex: the same in LaTeX.
        text: the same in plain words of mathematics.
        numbers: its further arguments.
    """

    code: str
    latex: str
    text: str
    numbers: tuple[Number, ...] = ()

    def at(self, x: Float[np.ndarray, " n"], numbers: tuple[float, ...]) -> Float[np.ndarray, " n"]:
        """Its values."""
        known = {number.symbol: repr(float(value)) for number, value in zip(self.numbers, numbers, strict=True)}
        # The texts are defined only here; the file of an effect has the same.
        value = eval(self.code.format(x="x", **known), {"jnp": np, "x": x})
        return np.broadcast_to(np.asarray(value, dtype=float), x.shape)

    def tried(self, low: float, high: float) -> list[tuple[float, ...]]:
        """Numbers to try over a reach."""
        grids = [number.grid(low, high) for number in self.numbers]
        mesh = np.meshgrid(*grids, indexing="ij") if grids else []
        return [tuple(map(float, row)) for row in zip(*(m.ravel() for m in mesh), strict=True)] if grids else [()]


def _largest(low: float, high: float) -> float:
    return max(abs(low), abs(high), 1e-9)


def _inside(count: int) -> Callable[[float, float], np.ndarray]:
    return lambda low, high: np.linspace(low, high, count + 2)[1:-1]


def _uniform(low: float, high: float) -> dict[str, Any]:
    return {"uniform": [float(f"{low:.4g}"), float(f"{high:.4g}")]}


_POWER = Number(
    "p", "power", lambda low, high: {"lognormal": [0.3, 0.7]},
    lambda low, high: np.asarray([0.25, 0.4, 0.5, 0.65, 0.8, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0]),
)  # fmt: skip
_LENGTH = Number(
    "b", "length over which it changes", lambda low, high: {"lognormal": [float(np.log(0.3 * _largest(low, high))), 1.0]},
    lambda low, high: _largest(low, high) * np.asarray([0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0]),
)  # fmt: skip
_RATIO = Number(
    "c", "slope at negative values over slope at positive values", lambda low, high: {"normal": [0.0, 3.0]},
    lambda low, high: np.outer([-1.0, 1.0], [0.2, 0.4, 0.7, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0]).ravel(),
)  # fmt: skip
_FREQUENCY = Number(
    "k", "angle per unit", lambda low, high: {"lognormal": [float(np.log(4 / _largest(low, high))), 1.0]},
    lambda low, high: np.geomspace(0.7, 14.0, 40) / _largest(low, high),
)  # fmt: skip
_PLACE = Number("m", "where it is", _uniform, _inside(15))
_AWAY = Number(
    "m", "distance from zero", lambda low, high: _uniform(0.0, _largest(low, high)),
    lambda low, high: _inside(11)(0.0, _largest(low, high)),
)  # fmt: skip

SHAPES = (
    Shape("1.0", "1", "1"),
    Shape("{x}", "{x}", "{x}"),
    Shape("jnp.abs({x})", "|{x}|", "|{x}|"),
    Shape("{x} ** 2", "{x}^2", "{x}^2"),
    Shape("{x} * jnp.abs({x})", "{x}|{x}|", "{x}|{x}|"),
    Shape("{x} ** 3", "{x}^3", "{x}^3"),
    Shape("jnp.maximum(jnp.abs({x}), 1e-6) ** {p}", "|{x}|^{{{p}}}", "|{x}|^{p}", (_POWER,)),
    Shape(
        "jnp.sign({x}) * jnp.maximum(jnp.abs({x}), 1e-6) ** {p}", r"|{x}|^{{{p}}}\mathrm{{sign}}\,{x}", "|{x}|^{p} sign({x})",
        (_POWER,),
    ),
    Shape(
        "jnp.maximum({x}, 0.0) + {c} * jnp.minimum({x}, 0.0)", r"(\max({x},0)+{c}\min({x},0))",
        "(max({x}, 0) + {c} min({x}, 0))", (_RATIO,),
    ),
    Shape("jnp.tanh({x} / {b})", r"\tanh({x}/{b})", "tanh({x}/{b})", (_LENGTH,)),
    Shape("jnp.exp(-jnp.abs({x}) / {b})", "e^{{-|{x}|/{b}}}", "exp(-|{x}|/{b})", (_LENGTH,)),
    Shape("jnp.log(1.0 + jnp.abs({x}) / {b})", r"\ln(1+|{x}|/{b})", "ln(1 + |{x}|/{b})", (_LENGTH,)),
    Shape("{x} * jnp.exp(-jnp.abs({x}) / {b})", "{x}e^{{-|{x}|/{b}}}", "{x} exp(-|{x}|/{b})", (_LENGTH,)),
    Shape("jnp.sin({k} * {x})", r"\sin {k}{x}", "sin({k} {x})", (_FREQUENCY,)),
    Shape("jnp.cos({k} * {x})", r"\cos {k}{x}", "cos({k} {x})", (_FREQUENCY,)),
    Shape("jnp.maximum({x} - {m}, 0.0)", r"\max({x}-{m},0)", "max({x} - {m}, 0)", (_PLACE,)),
    Shape("jnp.maximum({m} - {x}, 0.0)", r"\max({m}-{x},0)", "max({m} - {x}, 0)", (_PLACE,)),
    Shape("jnp.maximum(jnp.abs({x}) - {m}, 0.0)", r"\max(|{x}|-{m},0)", "max(|{x}| - {m}, 0)", (_AWAY,)),
    Shape("jnp.maximum({x} - {m}, 0.0) ** 2", r"\max({x}-{m},0)^2", "max({x} - {m}, 0)^2", (_PLACE,)),
    Shape(
        "0.5 * (1.0 + jnp.tanh(({x} - {m}) / {b}))", r"\frac{{1}}{{2}}(1+\tanh(({x}-{m})/{b}))", "(1 + tanh(({x} - {m})/{b}))/2",
        (_PLACE, _LENGTH),
    ),
    Shape(
        "0.5 * (1.0 + jnp.tanh((jnp.abs({x}) - {m}) / {b}))", r"\frac{{1}}{{2}}(1+\tanh((|{x}|-{m})/{b}))",
        "(1 + tanh((|{x}| - {m})/{b}))/2", (_AWAY, _LENGTH),
    ),
    Shape(
        "jnp.exp(-((({x} - {m}) / {b}) ** 2))", "e^{{-(({x}-{m})/{b})^2}}", "exp(-(({x} - {m})/{b})^2)", (_PLACE, _LENGTH)
    ),
)  # fmt: skip
"""The simplest first."""
OF_DIRECTION = SHAPES[:2]
"""The shapes of a direction, which has two values."""
