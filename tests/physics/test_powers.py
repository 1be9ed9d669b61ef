"""The logarithm and the powers of the laws, against NumPy's in extended precision."""

import jax
import numpy as np
import pytest

from hsed_jax.physics.powers import log, power


def numbers() -> np.ndarray:
    """Positive doubles of every size, close to one from both sides, and where the exponent changes."""
    rng = np.random.default_rng(0)
    sizes = np.exp(rng.uniform(-700, 700, 100_000))
    near_one = 1 + rng.choice([-1.0, 1.0], 100_000) * np.exp(rng.uniform(-36, -1, 100_000))
    edges = np.sqrt(0.5) * 2.0 ** np.arange(-60, 60)
    return np.concatenate([sizes, near_one, edges, np.nextafter(edges, 0), [1.0, np.finfo(float).tiny]])


def test_log_is_exact_to_three_units_in_the_last_place():
    x = numbers()
    exact = np.log(x.astype(np.longdouble))
    found = np.asarray(jax.jit(jax.vmap(log))(x))
    assert np.all(np.abs(found - exact) <= 3 * np.spacing(np.abs(exact).astype(float)))
    assert found[-2] == 0.0


def test_log_keeps_infinity_and_nan():
    assert log(np.inf) == np.inf
    assert np.isnan(log(np.nan))


@pytest.mark.parametrize("exponent", [-1.5, 0.3, 2.0])
def test_a_power_and_its_derivatives(exponent: float):
    x = np.asarray([1e-12, 0.4, 1.0, 3.7, 2e6])
    assert np.allclose(jax.vmap(power, (0, None))(x, exponent), x**exponent, rtol=1e-13)
    slopes = jax.vmap(jax.grad(power, argnums=(0, 1)), (0, None))(x, exponent)
    assert np.allclose(slopes[0], exponent * x ** (exponent - 1), rtol=1e-12)
    assert np.allclose(slopes[1], x**exponent * np.log(x), rtol=1e-12)
