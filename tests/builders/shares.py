"""Which cases of a test run by default, if a case costs much and the others are like it.  `.ci/whole` runs the others."""

from collections.abc import Callable, Iterable

import pytest

from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.forms import forms_of


def by_default(cases: Iterable, is_kept: Callable[..., bool]) -> list:
    """The cases for `parametrize`: those that are not kept are marked `whole`."""
    several = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*case, marks=() if is_kept(*case) else pytest.mark.whole) for case in several]


def has_default_driver(effect: str, label: str) -> bool:
    """Whether a form has the first driver of its effect: the effects share the others."""
    return not forms_of(EFFECTS[effect])[label].driver
