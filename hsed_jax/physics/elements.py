"""The specimens of a structure for the simulator, and the parts of a study that belong to each."""

from collections.abc import Mapping
from typing import NamedTuple

from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.laws.base import AbstractSpringLaw
from hsed_jax.physics.parameters import parameters_of


class Element(NamedTuple):
    """A specimen.

    Attributes:
        name: empty where it is the only one.
        law: of its spring.
        is_apart: it has its own model, and shares nothing with the others.
    """

    name: str = ""
    law: type[AbstractSpringLaw] = BoucWen
    is_apart: bool = False

    def has(self, owner: str) -> bool:
        """Whether effects of an owner act in it: its own, or the shared ones."""
        return owner == self.name or (not owner and not self.is_apart)

    def parameters[T](self, owners: Mapping[str, Mapping[str, T]]) -> dict[str, T]:
        """The parameters of its law: those shared, unless it has its own."""
        known = parameters_of(self.law)
        shared = {} if self.is_apart else {name: v for name, v in owners.get("", {}).items() if name in known}
        return {**shared, **(owners.get(self.name, {}) if self.name else {})}
