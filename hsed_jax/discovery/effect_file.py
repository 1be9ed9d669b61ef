"""A formula, or a curve without a formula, as a complete Python file with an effect, which the user can read and change."""

import json
import math
import textwrap
from collections.abc import Sequence
from string import Template

import numpy as np

from hsed_jax.discovery.formulas import LEAST, MOST, Formula
from hsed_jax.discovery.grammar import SHAPES
from hsed_jax.discovery.places import Place
from hsed_jax.physics.effects.coordinates import COORDINATES, needs_of, states_of
from hsed_jax.physics.effects.free_function import DEGREES, powers_of

_FILE = Template('''\
"""$title

Written by `hsed discover`.  An effect of your own: change its name, its formula, its priors.
"""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.effects.coordinates import $imports
from hsed_jax.physics.parameters import parameter
$states_import

@register
@final
class $class_name(AbstractSpringEffect):
    r"""$words.

$equation

    $reach
    """

    name: ClassVar[str] = "$name"
    family: ClassVar[str] = "learned"
    reference: ClassVar[str] = "hsed discover"
    needs_time: ClassVar[bool] = $needs_time

$parameters

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """Its contribution to the slot `$slot`."""
$body
$memory''')
_NEEDS = Template('''
    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The states of the path that it uses."""
        return needs_of($coordinates)
''')
_FADES = Template('''
    @property
    def states(self) -> tuple[str, ...]:
        """The states that fade."""
        return states_of($coordinates)

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Rates of the states that fade."""
        return fading($coordinates, point, self.fade)
''')
_POINTS = 201


def source_of(formula: Formula, reaches: Sequence[tuple[float, float]], name: str) -> str:
    """The file of a formula.

    Arguments:
        formula: the formula, its numbers as found; they are the defaults of its parameters.
        reaches: of its coordinates, dimensionless.
        name: of the effect.
    """
    place = formula.place
    # Its contribution is of order one, for any size of the shapes.
    ends = [np.linspace(low, high, _POINTS) for low, high in reaches]
    largest = math.prod(
        float(np.abs(term.shape.at(x, term.numbers)).max()) for term, x in zip(formula.terms, ends, strict=True)
    )
    parameters = [_parameter("a", "its size", 0.0, {"normal": [0.0, float(f"{1 / max(largest, 1e-9):.3g}")]})]
    code, latex = [], []
    for number, (term, reach) in enumerate(zip(formula.terms, reaches, strict=True), 1):
        if term.shape is SHAPES[0] and len(formula.terms) > 1:
            continue
        known = {n.symbol: f"{n.symbol}_{number}" for n in term.shape.numbers}
        for n, value in zip(term.shape.numbers, term.numbers, strict=True):
            words = f"{n.meaning}, in {COORDINATES[place.of[number - 1]].words}"
            parameters.append(_parameter(known[n.symbol], words, value, n.prior(*reach)))
        code.append(_wrapped(term.shape.code.format(x=f"x_{number}", **{k: f"self.{v}" for k, v in known.items()})))
        latex.append(term.shape.latex.format(x=f"x_{number}", **{k: _symbol(v) for k, v in known.items()}))
    product = " * ".join(["self.a", *code])
    equation = "a\\," + "\\;".join(latex)
    values = {
        "force": ("point.scales.force * {}", "F_c\\,{}"),
        "exponential": ("jnp.exp({})", "e^{{{}}}"),
        "linear": (f"jnp.clip(1.0 + {{}}, {LEAST}, {MOST})", "1 + {}"),
        "reciprocal": (f"1.0 / jnp.clip(1.0 + {{}}, {LEAST}, {MOST})", "1/(1 + {})"),
    }
    written, shown = values[formula.form]
    return _source(place, reaches, name, parameters, written.format(product), shown.format(equation), [])


def source_of_curve(place: Place, reaches: Sequence[tuple[float, float]], coefficients: np.ndarray, name: str) -> str:
    """The file of a curve.

    Arguments:
        place: of the function.
        reaches: of its coordinates, dimensionless.
        coefficients: of its polynomials.
        name: of the effect.
    """
    full = np.zeros(len(DEGREES))
    full[[DEGREES.index(degree) for degree in place.degrees]] = coefficients
    powers = powers_of(full)
    lines, along = [], []
    for number, (low, high) in enumerate(reaches, 1):
        lines.append(f"xi_{number} = (x_{number} - {0.5 * (low + high):.8g}) / {0.5 * (high - low):.8g}")
    for n in range(1 if len(place.of) == 1 else 4):
        own = [float(p) for (_, k), p in zip(DEGREES, powers, strict=True) if k == n]
        if any(own):
            lines.append(f"c_{n} = {_list(own)}")
            lines.append(f"y_{n} = sum(c * xi_1**m for m, c in enumerate(c_{n}))")
            along.append(f"y_{n}" + (f" * xi_2**{n}" if n else ""))
    value = f"self.a * ({' + '.join(along)})"
    written = f"point.scales.force * {value}" if place.slot == "force" else f"jnp.exp({value})"
    shown = "F_c\\,a\\,f" if place.slot == "force" else "e^{a f}"
    of = ", ".join(f"x_{n}" for n in range(1, len(place.of) + 1))
    parameters = [_parameter("a", "share of the learned curve", 0.0, {"normal": [1.0, 0.3]})]
    return _source(place, reaches, name, parameters, written, f"{shown}({of})", lines)


def _source(
    place: Place,
    reaches: Sequence[tuple[float, float]],
    name: str,
    parameters: Sequence[str],
    value: str,
    equation: str,
    lines: Sequence[str],
) -> str:
    of = place.of
    body = [
        f'x_{n} = within("{c}", point, {low:.6g}, {high:.6g})'
        for n, (c, (low, high)) in enumerate(zip(of, reaches, strict=True), 1)
    ]
    body += [*lines, f'return {{"{place.slot}": {value}}}']
    held = ", ".join(
        f"$x_{n} = {COORDINATES[c].symbol}$, {COORDINATES[c].words}, from {low:.3g} to {high:.3g}"
        for n, (c, (low, high)) in enumerate(zip(of, reaches, strict=True), 1)
    )
    fades, needs = (bool(known(of)) for known in (states_of, needs_of))
    if fades:
        words = "time in which it fades, over u_c/v_c"
        parameters = [*parameters, _parameter("fade", words, place.fade, {"lognormal": [0.9, 1.0]})]
    coordinates = {"coordinates": "(" + "".join(f'"{c}", ' for c in of).rstrip(" " if len(of) == 1 else ", ") + ")"}
    memory = (_NEEDS.substitute(coordinates) if needs else "") + (_FADES.substitute(coordinates) if fades else "")
    used = {"fading": fades, "needs_of": needs, "states_of": fades, "within": True}
    words = place.words[0].upper() + place.words[1:]
    return _FILE.substitute(
        title=f"{words}: learned from measurements.",
        imports=", ".join(name for name, is_used in used.items() if is_used),
        states_import="from hsed_jax.physics.states import SharedState\n" if needs else "",
        class_name="".join(part.capitalize() for part in name.split("_")),
        words=_wrap(words, 4),
        equation=textwrap.indent(f"${place.slot.replace('force', 'r')} \\leftarrow {equation}$", "    "),
        reach=_wrap(f"The measurements cover {held}; beyond this range each stays at its end.", 4),
        name=name,
        needs_time=any(COORDINATES[c].needs_time for c in of),
        parameters=textwrap.indent("\n".join(parameters), "    "),
        slot=place.slot,
        body=textwrap.indent("\n".join(body), "        "),
        memory=memory,
    )


def _parameter(name: str, meaning: str, default: float, prior: dict) -> str:
    bounds = "lower=1e-6, " if "lognormal" in prior else ""
    told = f'"{_symbol(name)}", "1", "{meaning}"'
    return f"{name}: Scalar = parameter(\n    {told},\n    neutral={default:.6g}, {bounds}prior={json.dumps(prior)},\n)"


def _symbol(name: str) -> str:
    return {"fade": r"\\tau"}.get(name, name)


def _wrapped(code: str) -> str:
    is_one = " " not in code or (code.endswith(")") and code.count("(") == 1)
    return code if is_one else f"({code})"


def _wrap(text: str, indent: int) -> str:
    return textwrap.fill(text, 116, subsequent_indent=" " * indent, break_long_words=False)


def _list(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:.12g}" for v in values) + "]"
