r"""From a curve to formulas: formulas of the grammar for a fitted function, by their error and their size.

Around its fit a function has the misfit $\tfrac12(c-\hat c)^\top G(c-\hat c)$, with the parameters of the law adjusted. The
*data* therefore determine the cost of a formula, and a difference that the law can compensate has no cost.  The choice among
them comes later: each is fitted inside the simulation.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from hsed_jax.discovery.grammar import OF_DIRECTION, SHAPES, Shape
from hsed_jax.discovery.places import Place

# Cost [nats] of a number in a formula, and of a shape.
_NUMBER, _SHAPE = 4.0, 1.0
# Products are tried only for the best shapes of each coordinate alone; this is their number.
_PRODUCTS = 160
_NODES = 96
# Limits of a factor 1 + a s.
LEAST, MOST = 0.02, 50.0
# Trial sizes of a factor 1 + a s, over the largest |s|.
_SIZES = (-0.9, -0.7, -0.5, -0.3, -0.15, 0.15, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0)


class Term(NamedTuple):
    """A shape of a coordinate with its numbers."""

    shape: Shape
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class Formula:
    """A formula of a free function.

    Attributes:
        place: where it is.
        terms: a shape for every coordinate, whose product it is.
        size: factor of the product, over F_c; for a factor, `form` determines its use.
        form: `force`: the addend F_c a s; `exponential`: the factor e^{a s}; `linear`: the factor 1 + a s; `reciprocal`:
            1/(1 + a s).
        cost: loss against the curve [nats], plus the cost of its numbers.
    """

    place: Place
    terms: tuple[Term, ...]
    size: float
    form: str
    cost: float

    def value(self, *x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Its contribution at dimensionless coordinates: over F_c, or a factor."""
        product = self.size * np.prod([t.shape.at(v, t.numbers) for t, v in zip(self.terms, x, strict=True)], axis=0)
        if self.form == "exponential":
            return np.exp(product)
        return (
            product
            if self.form == "force"
            else np.clip(1 + product, LEAST, MOST) ** (1 if self.form == "linear" else -1)
        )


def formulas(
    place: Place,
    reaches: Sequence[tuple[float, float]],
    curve: Float[np.ndarray, " m"],
    strength: Float[np.ndarray, "m m"],
    count: int,
) -> list[Formula]:
    """The possible formulas of a fitted function, the most likely first, each with different shapes.

    Arguments:
        place: of the function.
        reaches: of its coordinates, dimensionless.
        curve: its coefficients.
        strength: G, their information matrix.
        count: how many.
    """
    grids = [_Grid(reach, of) for reach, of in zip(reaches, place.of, strict=True)]
    lower = np.linalg.cholesky(strength + 1e-9 * np.trace(strength) / len(strength) * np.eye(len(strength)))
    found: dict[tuple, Formula] = {}
    for terms, values in _products(place, grids, lower, curve):
        for form, size, coefficients in _forms(place, grids, values, lower, curve):
            left = lower.T @ (coefficients - curve)
            numbers = 1 + sum(len(term.numbers) for term in terms)
            shapes = sum(term.shape is not SHAPES[0] for term in terms)
            cost = 0.5 * float(left @ left) + _NUMBER * numbers + _SHAPE * shapes
            key = (form, *(id(term.shape) for term in terms))
            if key not in found or cost < found[key].cost:
                found[key] = Formula(place, terms, size, form, cost)
    return sorted(found.values(), key=lambda one: one.cost)[:count]


class _Grid:
    """A coordinate at the nodes of its polynomials, and the terms of it."""

    def __init__(self, reach: tuple[float, float], name: str):
        low, high = reach
        xi = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
        self.x = 0.5 * (low + high) + 0.5 * (high - low) * xi
        self.fitted = np.polynomial.chebyshev.chebvander(xi, _NODES - 1).T * (2 / _NODES)
        self.fitted[0] *= 0.5
        shapes = OF_DIRECTION if name == "direction" else SHAPES
        terms = [Term(shape, numbers) for shape in shapes for numbers in shape.tried(low, high)]
        every = np.stack([term.shape.at(self.x, term.numbers) for term in terms])
        # For a coordinate that is never negative, |x| is x.
        _, first = np.unique(np.round(every, 12), axis=0, return_index=True)
        self.terms = [terms[k] for k in np.sort(first)]
        self.values = every[np.sort(first)]


def _products(
    place: Place, grids: Sequence[_Grid], lower: np.ndarray, curve: np.ndarray
) -> Iterator[tuple[tuple[Term, ...], list[np.ndarray]]]:
    """Terms, or products of two, with their values at the nodes of every coordinate."""
    if len(grids) == 1:
        for term, values in zip(grids[0].terms, grids[0].values, strict=True):
            yield (term,), [values]
        return
    first, second = grids
    degrees = np.asarray(place.degrees)
    one = (first.values @ first.fitted.T)[:, degrees[:, 0]]
    two = (second.values @ second.fitted.T)[:, degrees[:, 1]]
    white = lower.T @ curve
    gains = np.zeros((len(one), len(two)))
    for i, row in enumerate(one):
        along = (row * two) @ lower
        gains[i] = (along @ white) ** 2 / np.maximum(np.sum(along**2, axis=1), 1e-300)
    # The best numbers of every pair of shapes, and the best pairs.
    best: dict[tuple[int, int], tuple[float, int, int]] = {}
    for flat in np.argsort(-gains, axis=None)[: 40 * _PRODUCTS]:
        i, j = np.unravel_index(flat, gains.shape)
        key = (id(first.terms[i].shape), id(second.terms[j].shape))
        best.setdefault(key, (float(gains[i, j]), int(i), int(j)))
    for _, i, j in sorted(best.values(), reverse=True)[:_PRODUCTS]:
        yield (first.terms[i], second.terms[j]), [first.values[i], second.values[j]]


def _forms(
    place: Place, grids: Sequence[_Grid], values: Sequence[np.ndarray], lower: np.ndarray, curve: np.ndarray
) -> Iterator[tuple[str, float, np.ndarray]]:
    """The ways in which a term may enter, with its size and the coefficients."""
    shape = values[0] if len(values) == 1 else np.multiply.outer(values[0], values[1])
    plain = _coefficients(place, grids, shape)
    along = lower.T @ plain
    power = float(along @ along)
    if power <= 0:
        return
    size = float(along @ (lower.T @ curve)) / power
    yield ("force" if place.slot == "force" else "exponential"), size, size * plain
    if place.slot == "force":
        return
    largest = float(np.abs(shape).max())
    for form, sign in (("linear", 1.0), ("reciprocal", -1.0)):

        def coefficients(share: float, sign: float = sign) -> np.ndarray:
            return _coefficients(place, grids, sign * np.log(np.maximum(1 + share / largest * shape, LEAST)))

        def misfit(share: float, coefficients: Callable[[float], np.ndarray] = coefficients) -> float:
            left = lower.T @ (coefficients(share) - curve)
            return float(left @ left)

        best = int(np.argmin([misfit(share) for share in _SIZES]))
        ends = _SIZES[max(best - 1, 0)], _SIZES[min(best + 1, len(_SIZES) - 1)]
        found: Any = minimize_scalar(misfit, bounds=ends, method="bounded")
        share = float(found.x)
        yield form, share / largest, coefficients(share)


def _coefficients(place: Place, grids: Sequence[_Grid], values: np.ndarray) -> np.ndarray:
    """Coefficients of the polynomials, in their order."""
    degrees = np.asarray(place.degrees)
    if len(grids) == 1:
        return (grids[0].fitted @ values)[degrees[:, 0]]
    return (grids[0].fitted @ values @ grids[1].fitted.T)[degrees[:, 0], degrees[:, 1]]


def in_text(formula: Formula, names: Sequence[str]) -> str:
    """A formula as a line, with its numbers."""
    parts = []
    for term, name in zip(formula.terms, names, strict=True):
        if term.shape is SHAPES[0] and len(formula.terms) > 1:
            continue
        known = {n.symbol: f"{value:.4g}" for n, value in zip(term.shape.numbers, term.numbers, strict=True)}
        # |u/u_c|, but (u/u_c)^2.
        is_bare = term.shape.text.count("{x}") == term.shape.text.count("|{x}|")
        parts.append(term.shape.text.format(x=name if is_bare or name.isalnum() else f"({name})", **known))
    inner = " ".join([f"{formula.size:.4g}", *(part for part in parts if part != "1")])
    sum_of = f"1 + {inner}" if formula.size >= 0 else f"1 - {inner.removeprefix('-')}"
    return {
        "force": f"F_c {inner}",
        "exponential": f"exp({inner})",
        "linear": sum_of,
        "reciprocal": f"1/({sum_of})",
    }[formula.form]
