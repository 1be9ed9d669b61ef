"""Types and shapes are checked while tests run, in the first call of each test."""

import jax.numpy as jnp
import pytest
from jaxtyping import TypeCheckError

from hsed_jax.physics.declared import Setting
from hsed_jax.physics.spectra import response_spectrum

WRONG = {
    "shape": lambda: response_spectrum(jnp.zeros((2, 2)), 0.01, jnp.ones(2)),
    "type of a field": lambda: Setting(3, "m"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("again", range(2))
@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_refused_in_the_first_call_of_every_test(wrong, again):
    with pytest.raises(TypeCheckError):
        WRONG[wrong]()


def test_later_calls_in_a_test_are_not_looked_at():
    Setting("length", "m")
    assert Setting(3, "m").meaning == 3  # type: ignore[arg-type]
