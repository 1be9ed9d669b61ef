"""The parts of a study, built: priors, parameters, effects; each fault names its key."""

from collections.abc import Mapping
from typing import Any

from hsed_jax.errors import UserError, at
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.parameters import Parameter


def check_names(where: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Refuse an unknown name, and list the known ones."""
    for name in given:
        if name not in known:
            raise UserError(f"{where}.{name}: there is no such parameter; allowed here are {', '.join(known)}")


def within(where: str, value: float, known: Parameter) -> float:
    """A fixed value, if it is possible.  For a physical form, bounds other than zero depend on scales that are unknown here."""
    is_physical = known.physical is not None and where.rpartition(".")[2] == known.physical.name != known.name
    low, high = known.lower, known.upper
    if is_physical:
        low, high = (0.0 if low == 0 else -float("inf")), (0.0 if high == 0 else float("inf"))
    if not low <= value <= high:
        raise UserError(f"{where}: {value:g} is outside the allowed range, {possible(known)}")
    return value


def possible(known: Parameter) -> str:
    """The bounds of a parameter, in words."""
    low = "" if known.lower == -float("inf") else f"at least {known.lower:g}"
    high = "" if known.upper == float("inf") else f"at most {known.upper:g}"
    return " and ".join(side for side in (low, high) if side)


def prior(where: str, entry: Mapping[str, Any]) -> Prior:
    """A prior; messages of its faults begin with the key."""
    ((name, arguments),) = entry.items()
    return at(where, Prior, str(name), arguments)


def in_study(file: Any, error: UserError) -> UserError:
    """The error with the file of the study at the beginning of its message, once; without a file, the unchanged error."""
    is_said = file is None or str(error).startswith(f"{file}: ")
    return error if is_said else UserError(f"{file}: {error}")
