"""The catalogue of effects as text, the output of `hsed effects`."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from hsed_jax.errors import UserError
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.effects.base import AbstractEffect, AbstractSpringEffect
from hsed_jax.physics.effects.forms import DRIVERS, forms_of
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.reporting.formulas import in_text

_BARS = "▁▂▃▄▅▆▇█"


def catalogue(effects: Catalogue) -> str:
    """One line per effect: name, family, action."""
    width = max(len(name) for name in effects)
    families = max(len(effect.family) for effect in effects.values())
    lines = [
        f"{name:{width}}  {effect.family:{families}}  {first_line(effect)}" for name, effect in sorted(effects.items())
    ]
    return "\n".join([*lines, "", "`hsed effects NAME` shows equation, parameters and reference."])


def entry(name: str, effects: Catalogue, curves_of: Callable[[type[AbstractSpringEffect]], Any]) -> str:
    """Equation, parameters, forms with their drivers, and reference of one effect.

    Arguments:
        name: of the effect.
        effects: the catalogue.
        curves_of: curves of the forms (`hsed_jax.analysis.form_curves`).

    Raises:
        UserError: there is no such effect.
    """
    if name not in effects:
        raise UserError(f"there is no effect {name!r}; the catalogue has {', '.join(sorted(effects))}")
    effect = effects[name]
    known = parameters_of(effect)
    lines = [f"{name} ({effect.family})", "", in_text(inspect.getdoc(effect) or ""), "", "parameters:"]
    lines += [line for p in known.values() if not p.shapes for line in _parameter(p)]
    if effect.forms:
        # An effect outside the spring has no state as abscissa.
        curves = curves_of(effect) if issubclass(effect, AbstractSpringEffect) else None
        lines += ["", "forms (`form: NAME`; the first is the default):"]
        lines += _forms(effect, curves.values if curves else {})
        if curves:
            lines += [f"  pictures: {curves.what} against {curves.across}; each curve has its own scale"]
        freed = {key for form in forms_of(effect).values() for key in form.free}
        if freed:
            lines += [
                "",
                "parameters of forms:",
                *(line for key in known if key in freed for line in _parameter(known[key])),
            ]
    if effect.drivers:
        lines += ["", "drivers x (`driver: NAME`; the first is the default):"]
        lines += [f"  {key}: {DRIVERS[key].words}, {in_text(DRIVERS[key].measure)}" for key in effect.drivers]
    return "\n".join([*lines, "", f"reference: {effect.reference}"])


def _parameter(known: Parameter) -> list[str]:
    prior = ", ".join(f"{kind} {arguments}" for kind, arguments in (known.prior or {}).items())
    neutral = "default" if known.shapes else "neutral"
    lines = [f"  {known.name} [{known.unit}]: {in_text(known.meaning)}; {neutral} {known.neutral:g}; prior {prior}"]
    if known.shapes:
        lines[0] = lines[0].replace(":", f", {in_text(known.symbol)}:", 1)
    if known.physical is not None:
        lines.append(f"    or {known.physical.name} [{known.physical.unit}]")
    return lines


def _forms(effect: type[AbstractEffect], curves: Mapping[str, Float[np.ndarray, " n"]]) -> list[str]:
    """Each form in a few lines: its name and equation, its free and fixed parameters, its source, and a picture."""
    known = parameters_of(effect)
    width = max(len(form.name) for form in effect.forms)
    lines = []
    for form in effect.forms:
        held = [f"{key} = {value:g}" for key, value in form.held.items() if not known[key].shapes]
        given = (("free", form.free), ("fixed", held), ("source", [form.reference] if form.reference else []))
        said = [f"{word}: {', '.join(names)}" for word, names in given if names]
        lines.append(f"  {form.name:{width}}  {in_text(form.equation) or 'as above'}")
        lines += [f"  {'':{width}}    {'; '.join(said)}"] if said else []
        lines += [f"  {'':{width}}    {_spark(curves[form.name])}"] if form.name in curves else []
    return lines


def _spark(values: Float[np.ndarray, " n"]) -> str:
    """A curve in a line of characters; a flat one if there is no curve."""
    values = values[::2]
    if np.ptp(values) < 1e-9:
        return "─" * len(values)
    heights = np.rint((len(_BARS) - 1) * (values - values.min()) / np.ptp(values)).astype(int)
    return "".join(_BARS[height] for height in heights)


def first_line(effect: type) -> str:
    """The action of an effect, in a few words."""
    return (inspect.getdoc(effect) or "").splitlines()[0].split(":")[0].rstrip(".")
