"""What is physically possible of the free parameters of a study."""

import math
from typing import TYPE_CHECKING

from hsed_jax.config.functions import FunctionEntry
from hsed_jax.inference.leaning import ANYTHING, Range
from hsed_jax.physics.names import own_name

if TYPE_CHECKING:
    from hsed_jax.study.build import Built


def possible_of(built: "Built") -> dict[str, Range]:
    """Lowest and highest value of each free parameter that physics allows, SI; nothing is known of those of a function."""
    if isinstance(built.study.model, FunctionEntry):
        return {}
    return {name: _possible(built, name) for name in built.parameters[0]}


def _possible(built: "Built", name: str) -> Range:
    known = built.naming.known(name)
    if known is None:
        return ANYTHING
    bounds = (known.lower, known.upper)
    is_physical = known.physical is not None and own_name(name) == known.physical.name
    if not is_physical or all(bound == 0 or math.isinf(bound) for bound in bounds):
        return bounds
    assert known.physical is not None
    low, high = (bound * float(known.physical.factor(built.scales)) for bound in bounds)
    return low, high
