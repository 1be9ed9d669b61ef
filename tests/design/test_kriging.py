"""Kriging against dense NumPy evaluations of Eqs. 8-11, SciPy's densities and optimiser, explicit refits, and its coverage."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.shares import by_default
from observations import of_largest, relative
from scipy.linalg import null_space
from scipy.optimize import minimize
from scipy.stats import norm, qmc

from hsed_jax.design.kriging import (
    KERNELS,
    _masked_correlation,
    _masked_trend,
    _restricted_objective,
    condition,
    fit_kriging,
)

LENGTHS, NUGGET = np.array([0.4, 0.9]), 1e-3
TRENDS = ("constant", "linear", "quadratic")


def branin(x):
    a, b = 15 * x[:, 0] - 5, 15 * x[:, 1]
    return (b - 5.1 / (4 * np.pi**2) * a**2 + 5 / np.pi * a - 6) ** 2 + 10 * (1 - 1 / (8 * np.pi)) * np.cos(a) + 10


def training_set(n=20, noise=0.05, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.random((n, 2))
    y = branin(x)
    return x, y + noise * y.std() * rng.standard_normal(n)


def dense_correlation(a, b, lengths, kernel):
    h = np.sqrt((((a[:, None] - b[None]) / lengths) ** 2).sum(-1))
    if kernel == "gaussian":
        return np.exp(-(h**2) / 2)
    if kernel == "matern32":
        return (1 + np.sqrt(3) * h) * np.exp(-np.sqrt(3) * h)
    return (1 + np.sqrt(5) * h + 5 * h**2 / 3) * np.exp(-np.sqrt(5) * h)


def dense_trend(x, trend):
    columns = {"constant": 1, "linear": 3, "quadratic": 6}[trend]
    u, v = x.T
    return np.stack([np.ones(len(x)), u, v, u * u, u * v, v * v], axis=1)[:, :columns]


def dense_kriging(x, y, new, lengths, nugget, kernel, trend, variance=None):
    """Eqs. 8-11 as printed; `variance` replaces σ² of Eq. 9."""
    inverse = np.linalg.inv(dense_correlation(x, x, lengths, kernel) + nugget * np.eye(len(x)))
    f, f_new, r = dense_trend(x, trend), dense_trend(new, trend), dense_correlation(x, new, lengths, kernel)
    information = f.T @ inverse @ f
    beta = np.linalg.solve(information, f.T @ inverse @ y)
    residual = y - f @ beta
    sigma2 = residual @ inverse @ residual / len(y) if variance is None else variance
    u = f.T @ inverse @ r - f_new.T
    mean = f_new @ beta + r.T @ inverse @ residual
    spread = 1 - np.sum(r * (inverse @ r), axis=0) + np.sum(u * np.linalg.solve(information, u), axis=0)
    return beta, sigma2, mean, sigma2 * spread


def conditioned(x, y, lengths=LENGTHS, nugget=NUGGET, planned=None, filler=0.0, **names):
    planned = len(y) if planned is None else planned
    inputs, responses = np.full((planned, 2), filler), np.full(planned, filler)
    inputs[: len(y)], responses[: len(y)] = x, y
    arrays = map(jnp.asarray, (inputs, responses, np.arange(planned) < len(y), lengths, float(nugget)))
    return condition(*arrays, **names)


def fitted(x, y, planned=43, filler=0.0, seed=0, **settings):
    inputs, responses = np.full((planned, 2), filler), np.full(planned, filler)
    inputs[: len(y)], responses[: len(y)] = x, y
    mask = np.arange(planned) < len(y)
    return fit_kriging(*map(jnp.asarray, (inputs, responses, mask)), key=jax.random.key(seed), **settings)


@pytest.mark.verification("design")
@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("kernel", by_default(KERNELS, lambda kernel: kernel == next(iter(KERNELS))))
def test_prediction_equals_the_printed_equations(kernel, trend, observed):
    x, y = training_set()
    new = np.random.default_rng(1).random((17, 2))
    model = conditioned(x, y, kernel=kernel, trend=trend)
    beta, sigma2, mean, variance = dense_kriging(x, y, new, LENGTHS, NUGGET, kernel, trend)
    got_mean, got_variance = model.predict(jnp.asarray(new))
    # Eq. 11 for a known σ²; estimated, it makes a Student t of that many degrees of freedom.
    freedom = len(y) - len(beta)
    variance = variance * 20 / freedom * (freedom / (freedom - 2))
    dense = "dense matrices in NumPy"
    observed("Kriging: trend (Eq. 8)", dense, relative(model.trend_coefficients, beta), 1e-8)
    observed("Kriging: process variance (Eq. 9)", dense, relative(model.process_variance, sigma2), 1e-9)
    observed("Kriging: mean (Eq. 10)", dense, of_largest(got_mean, mean), 1e-9)
    observed("Kriging: variance (Eq. 11)", dense, of_largest(got_variance, variance), 1e-7)


def test_means_at_tested_points_equal_predictions_there():
    x, y = training_set()
    model = conditioned(x, y, planned=26, trend="linear")
    means = np.asarray(model.tested_means())
    np.testing.assert_allclose(means[:20], model.predict(jnp.asarray(x))[0], rtol=1e-9)
    assert np.all(means[20:] == -np.inf)


@pytest.mark.whole
def test_chunks_do_not_show():
    x, y = training_set()
    model = conditioned(x, y)
    new = jnp.asarray(np.random.default_rng(2).random((2500, 2)))
    mean, variance = model.predict(new)
    for part in (slice(0, 3), slice(1022, 1026), slice(2490, 2500)):
        np.testing.assert_allclose(mean[part], model.predict(new[part])[0], rtol=1e-12)
        np.testing.assert_allclose(variance[part], model.predict(new[part])[1], rtol=1e-9)


@pytest.mark.parametrize("trend", TRENDS)
def test_tiny_nugget_interpolates_and_a_large_one_does_not(trend):
    x, y = training_set()
    mean, variance = conditioned(x, y, nugget=1e-10, trend=trend).predict(jnp.asarray(x))
    np.testing.assert_allclose(mean, y, rtol=1e-5)
    assert np.all(variance >= 0) and np.all(variance < 1e-7 * y.var())
    assert np.abs(conditioned(x, y, nugget=1e-1, trend=trend).predict(jnp.asarray(x))[0] - y).max() > 0.05 * y.std()


def log_restricted(x, y, contrasts, lengths, nugget, kernel):
    """Log density of the contrasts K'y, which no trend reaches, σ² integrated with 1/σ²; but for a constant."""
    matrix = dense_correlation(x, x, lengths, kernel) + nugget * np.eye(len(y))
    among, z = contrasts.T @ matrix @ contrasts, contrasts.T @ y
    return -0.5 * np.linalg.slogdet(among)[1] - 0.5 * len(z) * np.log(z @ np.linalg.solve(among, z))


def log_prior(lengths, nugget):
    """Of the logarithms, in two inputs."""
    of_lengths = norm(np.log(0.14 * np.sqrt(2)), 0.5).logpdf(np.log(lengths)).sum()
    return of_lengths + norm(np.log(0.007), 2.0).logpdf(np.log(nugget))


@pytest.mark.verification("design")
@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_log_posterior_is_that_of_the_contrasts_and_the_priors(kernel, trend, observed):
    x, y = training_set()
    contrasts = null_space(dense_trend(x, trend).T)

    def log_posterior(lengths, nugget):
        return log_restricted(x, y, contrasts, lengths, nugget, kernel) + log_prior(lengths, nugget)

    one, other = (np.array([0.4, 0.9]), 1e-3), (np.array([0.3, 1.5]), 1e-1)
    got = [conditioned(x, y, *h, kernel=kernel, trend=trend).log_posterior for h in (one, other)]
    error = relative(got[0] - got[1], log_posterior(*one) - log_posterior(*other))
    observed("Kriging: ratio of posterior densities of lengths and nugget", "density of the contrasts", error, 1e-8)


@pytest.mark.whole
@pytest.mark.verification("design")
@pytest.mark.parametrize(
    ("kernel", "trend", "n"), [("matern52", "constant", 43), ("matern32", "linear", 20), ("gaussian", "quadratic", 30)]
)
def test_fit_reaches_the_best_of_many_scipy_starts(kernel, trend, n, observed):
    x, y = training_set(n)
    low, high = np.log([0.02, 0.02, 1e-10]), np.log([20.0, 20.0, 1.0])
    contrasts = null_space(dense_trend(x, trend).T)

    def negative(logs):
        lengths, nugget = np.exp(logs[:2]), np.exp(logs[2])
        return -log_restricted(x, y, contrasts, lengths, nugget, kernel) - log_prior(lengths, nugget)

    rng = np.random.default_rng(0)
    runs = [
        minimize(
            negative, low + (high - low) * rng.random(3), method="L-BFGS-B", bounds=list(zip(low, high, strict=True))
        )
        for _ in range(8)
    ]
    model = fitted(x, y, kernel=kernel, trend=trend)
    lost = negative(np.log(np.append(model.lengths, model.nugget))) - min(run.fun for run in runs)
    observed("Kriging: log density that the fit misses", "best of 8 runs of SciPy's L-BFGS-B", max(lost, 0.0), 1e-6)


@pytest.mark.verification("design")
def test_gradient_of_the_restricted_likelihood_matches_differences(observed):
    x, y = map(jnp.asarray, training_set())
    value = jax.jit(lambda logs: objective(x, y, logs))

    logs, step = jnp.log(jnp.array([0.4, 0.9, 1e-3])), 1e-5
    differences = [(value(logs.at[i].add(step)) - value(logs.at[i].add(-step))) / (2 * step) for i in range(3)]
    error = relative(jax.jit(jax.grad(value))(logs), differences)
    observed("Kriging: gradient of the restricted likelihood", "central differences", error, 1e-6)


def objective(x, y, logs):
    mask = jnp.ones(len(y), bool)
    matrix = _masked_correlation(x, mask, jnp.exp(logs[:-1]), jnp.exp(logs[-1]), "matern52")
    return _restricted_objective(matrix, _masked_trend(x, mask, "linear"), y, jnp.sum(mask))


@pytest.mark.parametrize("filler", [0.0, 0.3, np.nan])
def test_padded_rows_have_no_influence(filler):
    x, y = training_set(15)
    new = jnp.asarray(np.random.default_rng(3).random((50, 2)))
    plain, padded = conditioned(x, y, trend="linear"), conditioned(x, y, planned=40, filler=filler, trend="linear")
    for a, b in zip(plain.predict(new), padded.predict(new), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10)
    np.testing.assert_allclose(plain.log_posterior, padded.log_posterior, rtol=1e-12)


@pytest.mark.whole
def test_padded_fit_equals_the_unpadded_one():
    x, y = training_set(15)
    plain, padded, noisy = fitted(x, y, planned=15), fitted(x, y), fitted(x, y, filler=np.nan)
    np.testing.assert_allclose(plain.log_posterior, padded.log_posterior, rtol=1e-10)
    np.testing.assert_allclose(plain.lengths, padded.lengths, rtol=1e-5)
    # What is in the padded rows does not matter to the last bit.
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(padded), jax.tree.leaves(noisy), strict=True))


@pytest.mark.whole
def test_one_program_serves_every_number_of_experiments():
    x, y = training_set(43)
    traces = []

    @jax.jit
    def fit(mask):
        traces.append(None)
        return fit_kriging(jnp.asarray(x), jnp.asarray(y), mask, key=jax.random.key(0)).log_posterior

    values = [fit(jnp.arange(43) < n) for n in (3, 10, 43)]
    assert len(traces) == 1 and np.all(np.isfinite(values))
    np.testing.assert_allclose(values[1], fitted(x[:10], y[:10]).log_posterior, rtol=1e-10)


@pytest.mark.whole
def test_warm_start_is_one_more_start_and_keys_are_reproducible():
    x, y = training_set(43)
    best = fitted(x, y)
    poor = fitted(x, y, starts=1, max_steps=3, seed=5)
    helped = fitted(x, y, starts=1, max_steps=3, seed=5, previous=(best.lengths, best.nugget))
    assert poor.log_posterior < best.log_posterior - 0.1
    assert helped.log_posterior > best.log_posterior - 0.01
    again = fitted(x, y)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(best), jax.tree.leaves(again), strict=True))


@pytest.mark.parametrize("trend", ["constant", "linear"])
@pytest.mark.parametrize("constant", [0.0, 7.3])
def test_constant_responses_give_a_constant_without_variance(trend, constant):
    x, _ = training_set(8)
    model = fitted(x, np.full(8, constant), trend=trend)
    mean, variance = model.predict(jnp.asarray(np.random.default_rng(4).random((9, 2))))
    np.testing.assert_allclose(mean, constant, rtol=1e-12)
    assert np.all(variance == 0) and np.all(np.isfinite(model.log_posterior))


def test_response_that_the_trend_explains_entirely():
    x, _ = training_set(12)
    model = fitted(x, 3 + 2 * x[:, 0] - x[:, 1], trend="linear")
    np.testing.assert_allclose(model.trend_coefficients, [3, 2, -1], atol=1e-6)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(model))


def test_repeated_inputs_with_different_responses():
    x, y = training_set(12)
    model = fitted(np.r_[x, x], np.r_[y, y + 20])
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(model))
    assert model.nugget > 1e-4
    np.testing.assert_allclose(model.predict(jnp.asarray(x))[0], y + 10, atol=40)


@pytest.mark.parametrize(
    ("n", "settings", "message"),
    [
        (3, {"trend": "linear"}, "linear trend in 2 inputs needs at least 4 points, but argument `inputs` holds 3"),
        (6, {"trend": "quadratic"}, "at least 7 points"),
        (1, {}, "constant trend in 2 inputs needs at least 2 points"),
        (9, {"kernel": "cubic"}, "matern52"),
        (9, {"trend": "cubic"}, "quadratic"),
        (9, {"length_bounds": (1.0, 0.1)}, "length_bounds"),
        (9, {"nugget_bounds": (0.0, 0.1)}, "nugget_bounds"),
        (9, {"starts": 0}, "starts"),
    ],
)
def test_what_cannot_be_fitted_is_refused(n, settings, message):
    x, y = training_set(n)
    # Names are checked by type as well under the test run's type checker.
    with pytest.raises(Exception, match=message):
        fitted(x, y, **settings)


def test_points_on_a_line_do_not_determine_a_plane():
    x = np.linspace(0, 1, 6)[:, None] * [1.0, 0.5]
    with pytest.raises(ValueError, match="do not"):
        fitted(x, x[:, 0], trend="linear")
    with pytest.raises(ValueError, match="finite"):
        fitted(x, np.where(x[:, 0] > 0.5, np.nan, 0))


@pytest.mark.parametrize("d", by_default([1, 3], lambda d: d == 3))
def test_one_and_three_inputs(d):
    rng = np.random.default_rng(6)
    x, new = rng.random((25, d)), rng.random((40, d))
    arrays = map(jnp.asarray, (x, np.sin(2 * x).sum(1), np.ones(25, bool)))
    model = fit_kriging(*arrays, trend="linear", key=jax.random.key(0))
    mean, variance = (np.asarray(found) for found in model.predict(jnp.asarray(new)))
    error = np.abs(mean - np.sin(2 * new).sum(1))
    # 25 points are many along one input and few in three: there the prior keeps the lengths short, and the bands know.
    assert np.sqrt(np.mean(error**2)) < (1e-3 if d == 1 else 0.2 * np.std(np.sin(2 * new).sum(1)))
    assert np.all(error < 4 * np.sqrt(variance))


# --- what the bands hold ------------------------------------------------------------------------------------------

SPLIT = 60  # new points of each field


def matern_field(n, random):
    """Responses at n points and at new ones, of a field whose lengths are anything from 0.2 to 1.5."""
    x = random.random((n + SPLIT, 2))
    lengths = np.exp(random.uniform(np.log(0.2), np.log(1.5), 2))
    matrix = dense_correlation(x, x, lengths, "matern52") + 1e-9 * np.eye(len(x))
    return x, np.linalg.cholesky(matrix) @ random.standard_normal(len(x))


def coverage(field, n, noise, fields, seed=0):
    """Share of new responses in their 90 % bands, over random designs of n points; noise in units of the field's sd."""
    random, inside = np.random.default_rng(seed), []
    for number in range(fields):
        x, y = field(n, random)
        measured = y[:n] + noise * random.standard_normal(n)
        mean, variance = fitted(x[:n], measured, planned=n, starts=6, seed=number).predict(jnp.asarray(x[n:]))
        inside.append(np.abs(y[n:] - mean) < 1.645 * np.sqrt(variance))
    return np.mean(inside)


@pytest.mark.whole
@pytest.mark.verification("design")
def test_bands_of_eight_points_hold_what_they_say(observed):
    # 40 fields of 60 correlated responses scatter by 2 %.  Maximum likelihood with σ² of Eq. 9: 67 %.
    share = coverage(matern_field, 8, 0.05, 40)
    observed("Kriging: share of new responses in 90 % bands, 8 points", "90 %", share - 0.9, 0.05, share=share)


@pytest.fixture(scope="module")
def papers_field(request):
    """The discrepancy of the paper's case at the MAP of fifteen experiments, over the inputs, in units of its sd."""
    from hsed_jax.config.load import load_study
    from hsed_jax.design.discrepancy import discrepancy
    from hsed_jax.inference.maximum import maximise
    from hsed_jax.physics.simulator import Conditions
    from hsed_jax.study.build import Built

    path = request.config.rootpath / "configs" / "paper.yaml"
    built = Built(load_study(path, ["design.initial=15", "design.iterations=0"]))
    design, names = built.design.sequential, built.study.quantities
    state = design.init()

    def measured(cube):
        si = built.experiments.space.si(built.experiments.space.declared(cube))
        exact = [built.site.laboratory.exact({k: float(v[i]) for k, v in si.items()}) for i in range(len(cube))]
        return si, np.asarray([[row[name] for name in names] for row in exact])

    cube = design.space.initial_design(15)
    for point, outputs in zip(cube, measured(cube)[1], strict=True):
        state = design.tell(state, point.tolist(), outputs.tolist())
    theta = maximise(design.posterior, design.data(state), design.starting_points(state)).theta
    points = qmc.Sobol(2, rng=3).random(1024)
    si, values = measured(points)
    conditions = Conditions({name: jnp.asarray(x) for name, x in si.items()})
    predicted = design.posterior.predict(theta, conditions, jnp.asarray(1024))[0]
    norms = discrepancy(
        jnp.asarray(values), predicted, jnp.var(predicted, axis=0), jnp.ones(values.shape), np.arange(len(names))
    )
    norms = np.asarray(norms) / np.std(norms)

    def some(n, random):
        chosen = random.permutation(1024)[: n + SPLIT]
        return points[chosen], norms[chosen]

    return some


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("n", [8, 15, 40])
@pytest.mark.parametrize("kind", ["matern", "paper"])
def test_bands_of_90_percent_hold_85_to_95_percent(kind, n, noise, papers_field):
    found = coverage(matern_field if kind == "matern" else papers_field, n, noise, 150, seed=n)
    print(f"\nKriging: {kind}, {n} points, noise {noise}: {found:.3f}")
    assert 0.85 <= found <= 0.95
