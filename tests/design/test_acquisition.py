"""Expected improvement against quadrature; choices: no repeats, deterministic ties, an optimum that is found."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from observations import relative
from scipy.integrate import quad
from scipy.stats import norm, t

from hsed_jax.design.acquisition import PerCost, choose, sobol_candidates
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.design.acquisitions.expected_improvement import (
    ExpectedImprovement,
    expected_improvement,
    log_expected_improvement,
    log_standard_improvement,
)
from hsed_jax.design.acquisitions.max_variance import MaxVariance
from hsed_jax.design.acquisitions.random import Random
from hsed_jax.design.acquisitions.sobol import Sobol
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


def improvement_of_twelve(mean, variance, best):
    """Expected improvement of a surrogate of 12 points and a constant: a Student t of 11 degrees of freedom, and its variance."""
    nu, scale = 11, np.sqrt(variance * 9 / 11)
    z = (mean - best) / scale
    return (mean - best) * t.cdf(z, nu) + scale * (nu + z**2) / (nu - 1) * t.pdf(z, nu)


def no_points(d=2):
    return jnp.zeros((1, d)), jnp.zeros(1, bool)


DEGREES = pytest.mark.parametrize("nu", [2, 3, 9, 40, 4000])


@pytest.mark.verification("design")
@DEGREES
@pytest.mark.parametrize(
    ("mean", "scale", "best"), [(1.0, 0.5, 0.7), (0.2, 0.3, 1.0), (-4.0, 2.0, 1.0), (5.0, 0.1, 1.0)]
)
def test_expected_improvement_is_the_integral(mean, scale, best, nu, observed):
    z = (mean - best) / scale
    truth = scale * quad(lambda x: t.sf(x, nu), -z, np.inf, epsabs=0, epsrel=1e-12, limit=500)[0]
    got = expected_improvement(jnp.array([mean]), jnp.array([scale]), best, nu)[0]
    observed("expected improvement of a Student t", "quadrature", relative(got, truth), 1e-8)
    closed = (mean - best) * t.cdf(z, nu) + scale * (nu + z**2) / (nu - 1) * t.pdf(z, nu)
    observed("expected improvement of a Student t", "closed form by SciPy", relative(got, closed), 1e-8)


@pytest.mark.verification("design")
def test_of_many_degrees_of_freedom_it_is_eq_14(observed):
    z = np.linspace(-6, 6, 25)
    got = expected_improvement(jnp.asarray(z), jnp.ones(25), 0.0, 1e9)
    error = relative(got, z * norm.cdf(z) + norm.pdf(z))
    observed("expected improvement of many degrees of freedom", "Eq. 14 by SciPy", error, 1e-6)


@pytest.mark.verification("design")
@DEGREES
def test_log_improvement_against_quadrature_without_cancellation(nu, observed):
    # E max(T + z, 0) = ψ(z) ∫ s ψ(s − z)/ψ(z) ds over s > 0: a positive integrand, over log s.
    z = np.r_[-np.logspace(3, -1, 25), 0.0, np.logspace(-1, 1, 7)]

    def truth_at(a):
        def integrand(x):
            # ψ(s − z)/ψ(z), written out: SciPy's density takes fifty times as long for one number.
            ratio = math.log1p((math.exp(x) - a) ** 2 / nu) - math.log1p(a**2 / nu)
            return math.exp(2 * x - (nu + 1) / 2 * ratio)

        bounds = zip(np.linspace(-30, 40, 15)[:-1], np.linspace(-30, 40, 15)[1:], strict=True)
        return t.logpdf(a, nu) + np.log(sum(quad(integrand, *part, epsabs=1e-16, epsrel=1e-12)[0] for part in bounds))

    truth = [truth_at(a) for a in z]
    off = np.abs(np.asarray(log_standard_improvement(jnp.asarray(z), nu)) - truth)
    # An error of a logarithm: absolute near zero, relative far from it.
    error = np.max(off / (np.abs(truth) + 3.0))
    observed("logarithm of the expected improvement", "quadrature", error, 1e-11)


def test_log_improvement_far_out():
    # There H is ψ(t) t²/(ν − 1)/ν: one term of its series is all that a float can show.
    z, nu = -np.array([1e8, 1e20, 1e50, 1e140]), 9
    got = np.asarray(log_standard_improvement(jnp.asarray(z), nu))
    truth = t.logpdf(z[0], nu) - (nu + 1) * np.log(z / z[0]) + 2 * np.log(-z) - np.log(nu * (nu - 1))
    np.testing.assert_allclose(got, truth, rtol=1e-12)
    assert np.all(np.isfinite(got)) and np.all(np.diff(got) < 0)
    up = np.array([1e4, 1e100])
    np.testing.assert_allclose(log_standard_improvement(jnp.asarray(up), nu), np.log(up), rtol=1e-14)


@pytest.mark.verification("design")
@DEGREES
def test_derivative_of_the_log_improvement_is_the_ratio_of_tails(nu, observed):
    # d/dz log E max(T + z, 0) = Ψ/E, on both sides of zero.
    z = np.linspace(-40, 6, 93)
    slope = jax.jit(jax.grad(lambda a: jnp.sum(log_standard_improvement(a, nu))))(jnp.asarray(z))
    truth = np.exp(t.logcdf(z, nu) - np.asarray(log_standard_improvement(jnp.asarray(z), nu)))
    observed("derivative of the log improvement", "ratio of tails by SciPy", relative(slope, truth), 1e-7)


@pytest.mark.parametrize("deviation", [1.0, 1e-8, 1e-30, 1e-200, 0.0])
def test_vanishing_deviation(deviation):
    means = jnp.array([-3.0, 0.5, 0.7, 2.0])

    def total(means, deviation):
        return jnp.sum(log_expected_improvement(means, jnp.full(4, deviation), 0.5, 9))

    assert np.all(np.isfinite(jax.jit(jax.grad(total, argnums=(0, 1)))(means, deviation)[0]))
    assert np.isfinite(jax.jit(jax.grad(total, argnums=1))(means, deviation))
    values = log_expected_improvement(means, jnp.full(4, deviation), 0.5, 9)
    assert np.all(np.isfinite(values))
    if deviation < 1e-3:
        np.testing.assert_allclose(
            expected_improvement(means, jnp.full(4, deviation), 0.5, 9), [0, 0, 0.2, 1.5], atol=1e-8
        )


def test_gradient_of_the_improvement_is_finite_at_a_tested_point():
    model = surrogate()
    improvement = ExpectedImprovement()
    points = jnp.concatenate([model.inputs[:2], model.inputs[:1] + 1e-9])
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(improvement(model, x, KEY))))(points)
    assert np.all(np.isfinite(gradient))


@pytest.mark.whole
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
    got = choose(model, x, *no_points(1), ExpectedImprovement(), KEY)
    # Three points and a constant: a Student t of two degrees of freedom, whose scale² is the variance of Eq. 11 times N/(N − p).
    truth = expected_improvement(mean, jnp.sqrt(variance / 2), best, 2)[0]
    np.testing.assert_allclose(got.value, truth, rtol=1e-10)
    np.testing.assert_allclose([got.mean, got.sd], [mean[0], np.sqrt(variance[0])], rtol=1e-12)


@pytest.mark.parametrize("name", ["expected_improvement", "max_variance"])
def test_choice_is_the_best_candidate(name):
    model, candidates = surrogate(), sobol_candidates(300, 2, 1)
    choice = choose(model, candidates, *no_points(), ACQUISITIONS[name](), KEY)
    mean, variance = map(np.asarray, model.predict(candidates))
    gained = improvement_of_twelve(mean, variance, float(model.tested_means().max()))
    value = {"expected_improvement": gained, "max_variance": variance}[name]
    assert choice.index == np.argmax(value)
    np.testing.assert_allclose([choice.value, np.exp(choice.log_value)], value.max(), rtol=1e-9)


def test_what_is_to_be_gained_counts_per_cost():
    model, candidates = surrogate(), sobol_candidates(300, 2, 1)
    mean, variance = map(np.asarray, model.predict(candidates))
    gained = improvement_of_twelve(mean, variance, float(model.tested_means().max()))
    costs = 0.01 + np.asarray(candidates)[:, 0]
    assert np.argmax(gained / costs) != np.argmax(gained)
    choice = choose(model, candidates, *no_points(), PerCost(ExpectedImprovement(), jnp.asarray(costs)), KEY)
    assert choice.index == np.argmax(gained / costs)
    np.testing.assert_allclose(choice.value, (gained / costs).max(), rtol=1e-9)
    alike = choose(model, candidates, *no_points(), PerCost(MaxVariance(), jnp.full(300, 7.0)), KEY)
    assert alike.index == np.argmax(variance)


@pytest.mark.parametrize("name", [name for name, known in ACQUISITIONS.items() if not known.of_rivals])
def test_no_acquisition_proposes_a_point_twice(name):
    model, candidates = surrogate(), sobol_candidates(8, 2, 2)
    tested, mask, order = jnp.zeros((8, 2)), jnp.zeros(8, bool), []
    for i in range(8):
        order.append(int(choose(model, candidates, tested, mask, ACQUISITIONS[name](), KEY).index))
        # what was performed differs from what was asked by rounding
        tested, mask = tested.at[i].set(candidates[order[-1]] + 5e-7), mask.at[i].set(True)
    assert sorted(order) == list(range(8))
    assert (order == list(range(8))) == (name == "sobol")
    with pytest.raises(ValueError, match="all 8 have been"):
        choose(model, candidates, tested, mask, ACQUISITIONS[name](), KEY)


def test_points_outside_the_tolerance_or_masked_out_are_no_repeats():
    model = surrogate()
    candidates = jnp.array([[0.2, 0.2], [0.8, 0.8]])
    near = candidates[:1] + jnp.array([2e-6, 0.0])
    assert choose(model, candidates, near, jnp.array([True]), Sobol(), KEY).index == 0
    assert choose(model, candidates, candidates[:1], jnp.array([False]), Sobol(), KEY).index == 0
    assert choose(model, candidates, candidates[:1], jnp.array([True]), Sobol(), KEY).index == 1


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
    picks = [int(choose(model, candidates, *no_points(), Random(), jax.random.key(k)).index) for k in (0, 0, 1, 2, 3)]
    assert picks[0] == picks[1] and len(set(picks)) > 2


def test_unknown_acquisition_is_refused():
    with pytest.raises(
        ValueError, match=r"there is no acquisition 'greedy'; allowed are .*, max_variance, random, sobol"
    ):
        ACQUISITIONS.known("greedy")


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


@pytest.mark.whole
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
            choice = choose(model, candidates, jnp.asarray(x), mask, ACQUISITIONS[name](), jax.random.fold_in(KEY, n))
            x[n] = candidates[int(choice.index)]
            y[n] = truth[int(choice.index)]
        return truth.max() - y.max()

    assert regret("expected_improvement") < 0.05  # the function spans 0.4 ... 308
    assert regret("random") > 0.05
