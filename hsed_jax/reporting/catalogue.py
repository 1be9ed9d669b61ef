"""The catalogue of effects as text: what `hsed effects` prints."""

import inspect

from hsed_jax.errors import UserError
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.parameters import parameters_of


def catalogue(effects: Catalogue) -> str:
    """One line per effect: name, family, what it does."""
    width = max(len(name) for name in effects)
    families = max(len(effect.family) for effect in effects.values())
    lines = [
        f"{name:{width}}  {effect.family:{families}}  {_first_line(effect)}" for name, effect in sorted(effects.items())
    ]
    return "\n".join([*lines, "", "`hsed effects NAME` shows equation, parameters and reference."])


def entry(name: str, effects: Catalogue) -> str:
    """Equation, parameters in both forms, and reference of one effect.

    Raises:
        UserError: there is no such effect.
    """
    if name not in effects:
        raise UserError(f"there is no effect {name!r}; the catalogue has {', '.join(sorted(effects))}")
    effect = effects[name]
    lines = [f"{name} ({effect.family})", "", inspect.getdoc(effect) or "", "", "parameters:"]
    for known in parameters_of(effect).values():
        prior = ", ".join(f"{kind} {arguments}" for kind, arguments in (known.prior or {}).items())
        lines.append(f"  {known.name} [{known.unit}]: {known.meaning}; neutral {known.neutral:g}; prior {prior}")
        if known.physical is not None:
            lines.append(f"    or {known.physical.name} [{known.physical.unit}]")
    return "\n".join([*lines, "", f"reference: {effect.reference}"])


def _first_line(effect: type) -> str:
    return (inspect.getdoc(effect) or "").splitlines()[0].split(":")[0].rstrip(".")
