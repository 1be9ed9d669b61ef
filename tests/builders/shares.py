"""Which cases of a test run by default, if a case costs much and the others are like it.  `.ci/whole` runs the others."""

from collections.abc import Callable, Iterable

import pytest

from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.forms import default_form, forms_of


def by_default(cases: Iterable, is_kept: Callable[..., bool]) -> list:
    """The cases for `parametrize`: those that are not kept are marked `whole`."""
    several = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*case, marks=() if is_kept(*case) else pytest.mark.whole) for case in several]


def is_simple(effect: str, label: str) -> bool:
    """Whether a form has the default driver or the default shape: a form with neither combines two that do."""
    form = forms_of(EFFECTS[effect])[label]
    return not form.driver or form.name == default_form(EFFECTS[effect]).name
