"""Expected improvement against quadrature; choices: no repeats, deterministic ties, an optimum that is found."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from scipy.integrate import quad
from scipy.special import log_ndtr
from scipy.stats import norm

from hsed_jax.design.acquisition import (
    ACQUISITIONS,
    PerCost,
    choose,
    expected_improvement,
    log_expected_improvement,
    log_standard_improvement,
    sobol_candidates,
)
from hsed_jax.design.kriging import condition, fit_kriging

KEY = jax.random.key(0)


def branin(x):
    a, b = 15 * x[:, 0] - 5, 15 * x[:, 1]
    return (b - 5.1 / (4 * np.pi**2) * a**2 + 5 / np.pi * a - 6) ** 2 + 10 * (1 - 1 / (8 * np.pi)) * np.cos(a) + 10


def surrogate(n=12, planned=16):
    rng = np.random.default_rng(0)
    x, y = np.zeros((planned, 2)), np.zeros(planned)
    x[:n] = rng.random((n, 2))
    y[:n] = -branin(x[:n])
    arrays = map(jnp.asarray, (x, y, np.arange(planned) < n, np.array([0.4, 0.9]), 1e-4))
    return condition(*arrays)


def no_points(d=2):
    return jnp.zeros((1, d)), jnp.zeros(1, bool)


@pytest.mark.parametrize(
    ("mean", "deviation", "best"), [(1.0, 0.5, 0.7), (0.2, 0.3, 1.0), (-4.0, 2.0, 1.0), (5.0, 0.1, 1.0)]
)
def test_expected_improvement_is_the_integral(mean, deviation, best):
    truth = quad(
        lambda y: (y - best) * norm.pdf(y, mean, deviation),
        best,
        max(best, mean) + 12 * deviation,
        points=[mean] if mean > best else None,
        epsabs=1e-14,
        epsrel=1e-12,
    )[0]
    got = expected_improvement(jnp.array([mean]), jnp.array([deviation]), best)[0]
    np.testing.assert_allclose(got, truth, rtol=1e-9)
    eq14 = (mean - best) * (1 - norm.cdf((best - mean) / deviation)) + deviation * norm.pdf((best - mean) / deviation)
    np.testing.assert_allclose(got, eq14, rtol=1e-9)


def test_log_improvement_against_quadrature_without_cancellation():
    # φ(z) + zΦ(z) = φ(z) ∫ s exp(zs − s²/2) ds over s > 0: a positive integrand, scaled here to its own width.
    z = np.r_[-np.logspace(3, -1, 25), -5 - 1e-9, -5 + 1e-9, 0.0, np.logspace(-1, 1, 7)]
    width = 1 / np.maximum(1.0, -z)
    integrals = [
        w**2
        * quad(lambda s, a=a, w=w: s * np.exp(a * w * s - (w * s) ** 2 / 2), 0, 60, epsabs=0, epsrel=1e-12, limit=200)[
            0
        ]
        for a, w in zip(z, width, strict=True)
    ]
    truth = norm.logpdf(z) + np.log(integrals)
    np.testing.assert_allclose(log_standard_improvement(jnp.asarray(z)), truth, rtol=1e-12, atol=3e-13)


def test_log_improvement_far_out():
    z = -jnp.array([1e4, 1e6, 1e8, 1e50, 1e150])
    got = np.asarray(log_standard_improvement(z))
    # One term of the asymptotic series is all that a float can show there.
    np.testing.assert_allclose(got, norm.logpdf(np.asarray(z)) - 2 * np.log(-np.asarray(z)), rtol=1e-14)
    assert np.all(np.isfinite(got)) and np.all(np.diff(got) < 0)
    up = np.array([10.0, 1e3, 1e100])
    np.testing.assert_allclose(log_standard_improvement(jnp.asarray(up)), np.log(up), rtol=1e-14)


def test_derivative_of_the_log_improvement_is_the_ratio_of_tails():
    # d/dz log(φ + zΦ) = Φ/(φ + zΦ), on both sides of the switch
    z = np.r_[np.linspace(-40, 6, 93), -1e3, -1e5]
    slope = jax.jit(jax.grad(lambda a: jnp.sum(log_standard_improvement(a))))(jnp.asarray(z))
    truth = np.exp(log_ndtr(z) - np.asarray(log_standard_improvement(jnp.asarray(z))))
    np.testing.assert_allclose(slope[:-2], truth[:-2], rtol=1e-9)
    np.testing.assert_allclose(slope[-2:], -z[-2:], rtol=1e-5)


@pytest.mark.parametrize("deviation", [1.0, 1e-8, 1e-30, 1e-200, 0.0])
def test_vanishing_deviation(deviation):
    means = jnp.array([-3.0, 0.5, 0.7, 2.0])

    def total(means, deviation):
        return jnp.sum(log_expected_improvement(means, jnp.full(4, deviation), 0.5))

    assert np.all(np.isfinite(jax.jit(jax.grad(total, argnums=(0, 1)))(means, deviation)[0]))
    assert np.isfinite(jax.jit(jax.grad(total, argnums=1))(means, deviation))
    values = log_expected_improvement(means, jnp.full(4, deviation), 0.5)
    assert np.all(np.isfinite(values))
    if deviation < 1e-3:
        np.testing.assert_allclose(
            expected_improvement(means, jnp.full(4, deviation), 0.5), [0, 0, 0.2, 1.5], atol=1e-8
        )


def test_gradient_of_the_improvement_is_finite_at_a_tested_point():
    model = surrogate()
    improvement = ACQUISITIONS["expected_improvement"]
    points = jnp.concatenate([model.inputs[:2], model.inputs[:1] + 1e-9])
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(improvement(model, x, KEY))))(points)
    assert np.all(np.isfinite(gradient))


def test_improvement_is_over_the_largest_mean_not_the_largest_datum():
    model = condition(
        *map(
            jnp.asarray,
            (np.array([[0.1], [0.1], [0.9]]), np.array([0.0, 2.0, 0.5]), np.ones(3, bool), np.array([0.5]), 0.5),
        )
    )
    x = jnp.array([[0.3]])
    mean, variance = model.predict(x)
    best = model.predict(model.inputs)[0].max()
    assert best < 1.9
    got = choose(model, x, *no_points(1), "expected_improvement", KEY)
    np.testing.assert_allclose(got.value, expected_improvement(mean, jnp.sqrt(variance), best)[0], rtol=1e-10)
    np.testing.assert_allclose([got.mean, got.sd], [mean[0], np.sqrt(variance[0])], rtol=1e-12)


@pytest.mark.parametrize("name", ["expected_improvement", "max_variance"])
def test_choice_is_the_best_candidate(name):
    model, candidates = surrogate(), sobol_candidates(300, 2, 1)
    choice = choose(model, candidates, *no_points(), name, KEY)
    mean, variance = map(np.asarray, model.predict(candidates))
    sd = np.sqrt(variance)
    z = (mean - float(model.tested_means().max())) / sd
    value = {"expected_improvement": sd * (norm.pdf(z) + z * norm.cdf(z)), "max_variance": variance}[name]
    assert choice.index == np.argmax(value)
    np.testing.assert_allclose([choice.value, np.exp(choice.log_value)], value.max(), rtol=1e-9)


def test_what_is_to_be_gained_counts_per_cost():
    model, candidates = surrogate(), sobol_candidates(300, 2, 1)
    mean, variance = map(np.asarray, model.predict(candidates))
    sd = np.sqrt(variance)
    z = (mean - float(model.tested_means().max())) / sd
    gained, costs = sd * (norm.pdf(z) + z * norm.cdf(z)), 0.01 + np.asarray(candidates)[:, 0]
    assert np.argmax(gained / costs) != np.argmax(gained)
    choice = choose(
        model, candidates, *no_points(), PerCost(ACQUISITIONS["expected_improvement"], jnp.asarray(costs)), KEY
    )
    assert choice.index == np.argmax(gained / costs)
    np.testing.assert_allclose(choice.value, (gained / costs).max(), rtol=1e-9)
    alike = choose(model, candidates, *no_points(), PerCost(ACQUISITIONS["max_variance"], jnp.full(300, 7.0)), KEY)
    assert alike.index == np.argmax(variance)


@pytest.mark.parametrize("name", ACQUISITIONS)
def test_no_acquisition_proposes_a_point_twice(name):
    model, candidates = surrogate(), sobol_candidates(8, 2, 2)
    tested, mask, order = jnp.zeros((8, 2)), jnp.zeros(8, bool), []
    for i in range(8):
        order.append(int(choose(model, candidates, tested, mask, name, KEY).index))
        # what was performed differs from what was asked by rounding
        tested, mask = tested.at[i].set(candidates[order[-1]] + 5e-7), mask.at[i].set(True)
    assert sorted(order) == list(range(8))
    assert (order == list(range(8))) == (name == "sobol")
    with pytest.raises(ValueError, match="all 8 have been"):
        choose(model, candidates, tested, mask, name, KEY)


def test_points_outside_the_tolerance_or_masked_out_are_no_repeats():
    model = surrogate()
    candidates = jnp.array([[0.2, 0.2], [0.8, 0.8]])
    near = candidates[:1] + jnp.array([2e-6, 0.0])
    assert choose(model, candidates, near, jnp.array([True]), "sobol", KEY).index == 0
    assert choose(model, candidates, candidates[:1], jnp.array([False]), "sobol", KEY).index == 0
    assert choose(model, candidates, candidates[:1], jnp.array([True]), "sobol", KEY).index == 1


def test_ties_go_to_the_first_and_failed_utilities_to_none():
    model, candidates = surrogate(), sobol_candidates(6, 2, 3)

    class Fixed(eqx.Module):
        utilities: Float[Array, " M"]

        def __call__(self, kriging, candidates, key):
            return self.utilities

    tie = Fixed(jnp.array([jnp.nan, 0.0, 2.0, 1.0, 2.0, jnp.nan]))
    assert choose(model, candidates, *no_points(), tie, KEY).index == 2
    assert choose(model, candidates, candidates[2:3], jnp.array([True]), tie, KEY).index == 4


def test_random_order_follows_the_key():
    model, candidates = surrogate(), sobol_candidates(64, 2, 4)
    picks = [int(choose(model, candidates, *no_points(), "random", jax.random.key(k)).index) for k in (0, 0, 1, 2, 3)]
    assert picks[0] == picks[1] and len(set(picks)) > 2


def test_unknown_acquisition_is_refused():
    with pytest.raises(ValueError, match="max_variance"):
        choose(surrogate(), sobol_candidates(4, 2, 0), *no_points(), "greedy", KEY)


def test_sobol_candidates():
    points = np.asarray(sobol_candidates(1000, 2, 7))
    assert points.shape == (1000, 2) and points.dtype == np.float64
    assert np.all((points >= 0) & (points <= 1))
    assert np.array_equal(points[:300], sobol_candidates(300, 2, 7))
    assert not np.array_equal(points, sobol_candidates(1000, 2, 8))
    # 512 points of a (0, 2)-sequence: one in each of the 512 boxes of 1/16 x 1/32
    boxes = np.floor(points[:512] * [16, 32]).astype(int)
    assert len(np.unique(boxes, axis=0)) == 512
    assert sobol_candidates(1, 3, 0).shape == (1, 3)
    with pytest.raises(ValueError, match="at least 1"):
        sobol_candidates(0, 2, 0)


def test_expected_improvement_finds_the_optimum_of_branin_and_random_does_not():
    candidates = sobol_candidates(2048, 2, 0)
    truth = -branin(np.asarray(candidates))
    first, planned = 6, 31

    def regret(name):
        x, y = np.zeros((planned, 2)), np.zeros(planned)
        x[:first] = np.asarray(sobol_candidates(first, 2, 9))
        y[:first] = -branin(x[:first])
        for n in range(first, planned):
            mask = jnp.arange(planned) < n
            model = fit_kriging(jnp.asarray(x), jnp.asarray(y), mask, key=KEY)
            choice = choose(model, candidates, jnp.asarray(x), mask, name, jax.random.fold_in(KEY, n))
            x[n] = candidates[int(choice.index)]
            y[n] = truth[int(choice.index)]
        return truth.max() - y.max()

    assert regret("expected_improvement") < 0.05  # the function spans 0.4 ... 308
    assert regret("random") > 0.05
