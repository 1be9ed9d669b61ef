"""An effect in its simplest shape is what its whole expression is where no parameter of a shape acts."""

from collections import defaultdict

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.diagnosis.batch import Part, Present, _present
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.base import AbstractSpringEffect, SpringPoint
from hsed_jax.physics.effects.forms import forms_of
from hsed_jax.physics.effects.shaped import Shaped, shapes_of
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.scales import Scales

SHAPED = [name for name, e in EFFECTS.items() if issubclass(e, AbstractSpringEffect) and shapes_of(e)]
POINT = SpringPoint(0.012, -0.3, 2e4, defaultdict(lambda: 0.02), Scales(3e4, 0.01, 0.2, 500.0), 4e4, 4e6)


def contributions(effect, values, is_shaped):
    def at(values):
        return Shaped.of(effect, values, jnp.asarray(is_shaped)).contribute(POINT)

    return jax.jit(at)(values)


@pytest.mark.whole
@pytest.mark.parametrize("name", SHAPED)
def test_an_effect_in_its_simplest_shape_contributes_what_the_whole_one_does(name):
    effect = EFFECTS[name]
    for form in forms_of(effect).values():
        values = {n: 1.2 * p.neutral + 0.05 if not p.shapes else p.neutral for n, p in parameters_of(effect).items()}
        values |= {n: v for n, v in form.held.items() if n not in shapes_of(effect)}
        whole = effect(**values).contribute(POINT)
        for is_shaped in (False, True):
            found = contributions(effect, values, is_shaped)
            for slot, value in whole.items():
                np.testing.assert_allclose(found[slot], value, rtol=1e-12)


def test_a_form_that_a_law_cannot_have_writes_to_no_slot_of_it():
    """Told no parameter of the form that writes to `nu`, as of a law without that slot, the effect writes to `n` alone."""
    found = contributions(EFFECTS["yield_sharpness"], {"delta": 0.5}, True)
    assert {slot: float(value) for slot, value in found.items()} == {"n": 0.5}


def test_the_shape_of_an_effect_is_not_computed_where_nothing_has_one():
    """The simplest shape knows no power: with the gate shut, a power of two is not seen."""
    effect = EFFECTS["stiffness_degradation"]
    values = {"delta": 0.5, "power": 2.0}
    linear, squared = (float(contributions(effect, values, is_shaped)["eta"]) for is_shaped in (False, True))
    x = 0.02 / 500.0
    assert linear == pytest.approx(1 + 0.5 * x) and squared == pytest.approx(1 + 0.5 * x**2)


def test_an_effect_has_a_shape_where_any_simulation_has_it_and_its_driver_is_none():
    names = ("delta", "driver_1", "power")
    present: Present = _present([Part("a", np.arange(3), np.array([0.0, 0.0, 1.0]), np.array([False, False, True]))], 3)
    assert set(names) <= {*parameters_of(EFFECTS["stiffness_degradation"])}
    assert shapes_of(EFFECTS["stiffness_degradation"]) & {*names} == {"power"}
    for thetas, acts, is_shaped in (
        ([[0.0, 0.0, 1.0]], False, False),
        ([[0.5, 1.0, 1.0], [0.0, 0.0, 1.0]], True, False),
        ([[0.5, 0.0, 1.0], [0.5, 0.0, 2.0]], True, True),
    ):
        found = present.acting(jnp.asarray(thetas))["a"]
        assert (bool(found.acts), bool(found.is_shaped)) == (acts, is_shaped)
