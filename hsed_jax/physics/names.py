"""Names of outputs and parameters: the name of the owner (specimen, effect or structure) is in front, with a dot.

`storey2.force` is the force of the specimen `storey2`, `storey2.slip.delta` a parameter of its effect `slip`, and
`structure.mass_1` a number of the structure.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence

SPECIMEN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""The pattern of the name of a specimen."""
OWNER = "structure"
"""The prefix of a parameter of the structure, like the name of an effect for a parameter of an effect."""


def named(owner: str, name: str) -> str:
    """The name of an output of one specimen; that of a single specimen has no prefix."""
    return f"{owner}.{name}" if owner else name


def owner_of(name: str) -> str:
    """The specimen of an output, or the owner of a parameter: the part before the last dot; empty without one."""
    return name.rpartition(".")[0]


def own_name(name: str) -> str:
    """A name without its owner."""
    return name.rpartition(".")[2]


def of_each(owners: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """These outputs of every specimen."""
    return tuple(named(owner, name) for owner in owners for name in names)


def by_owner[T](values: Mapping[str, T]) -> dict[str, dict[str, T]]:
    """Values by owner, and then by their own names."""
    found: dict[str, dict[str, T]] = defaultdict(dict)
    for name, value in values.items():
        found[owner_of(name)][own_name(name)] = value
    return found


def spring_name(index: int) -> str:
    """The name of a linear spring that acts as a specimen, from its index."""
    return f"spring_{index + 1}"


def number_of_spring(owner: str) -> int | None:
    """Index of the linear spring of the structure that has this name; None without one."""
    match = re.fullmatch(r"spring_([1-9]\d*)", owner)
    return None if match is None else int(match[1]) - 1
