"""Calibration against independent truth: grids, closed forms, SciPy; and warnings that come when they should."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.posteriors import EXACT, drawn, find, measured_at, posterior_of
from observations import relative
from scipy import stats
from scipy.integrate import quad, trapezoid
from scipy.optimize import minimize

from hsed_jax.config.load import load_study
from hsed_jax.criticism.prediction import predict
from hsed_jax.errors import UserError
from hsed_jax.inference.correlation import memory_of
from hsed_jax.inference.expansion import expand
from hsed_jax.inference.fit import fit
from hsed_jax.inference.likelihood import Error, data_of, log_likelihood
from hsed_jax.inference.maximum import maximise
from hsed_jax.inference.nuts import Chains, Convergence, Settings, convergence
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

EXPERIMENTS = 8


# Compiled as one, where each of their operations would be by itself.
log_density, log_posterior = eqx.filter_jit(Posterior.log_density), eqx.filter_jit(Posterior.log_posterior)
likelihood = eqx.filter_jit(log_likelihood)


# --- the paper's case against a grid -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def paper(request):
    """Eight experiments of the paper's case: what was built, and the data."""
    path = request.config.rootpath / "configs" / "paper.yaml"
    built = Built(load_study(path, [f"design.initial={EXPERIMENTS}", "design.iterations=0"]))
    design, state = built.design.sequential, built.design.sequential.init()
    for number, cube in enumerate(design.space.initial_design(EXPERIMENTS)):
        si = design.space.si(design.space.declared(cube[None]))
        measured = built.site.laboratory.perform(number, {name: float(x[0]) for name, x in si.items()})
        state = design.tell(state, cube.tolist(), [measured.quantities[q] for q in built.study.quantities])
    return built, design.data(state), state


@pytest.fixture(scope="module")
def paper_maximum(paper):
    built, data, _ = paper
    return find(built.inference.posterior, data)


def log_moments(s):
    """Mean and sd of log|1 + sε| by SciPy's adaptive quadrature."""
    weigh = lambda power, about=0.0: quad(  # noqa: E731
        lambda e: (np.log(abs(1 + s * e)) - about) ** power * stats.norm.pdf(e), -8, 8, limit=200
    )[0]
    mean = weigh(1)
    return mean, np.sqrt(weigh(2, mean))


@pytest.fixture(scope="module")
def paper_grid(paper):
    """Axes, log posterior density over (A, beta) on a fine grid, and its integral: vmap of the simulator, and SciPy."""
    built, data, _ = paper
    names = tuple(built.study.quantities)
    conditions = data.conditions
    prior = stats.uniform(2e5, 7e5).logpdf(5e5) + stats.uniform(0.5, 1.5).logpdf(1.0)

    @jax.jit
    def predict(A, beta):
        def one(c):
            return built.simulation.simulator.quantities({"A": A, "beta": beta}, c, names)[0]

        return jax.vmap(one)(conditions)

    def log_density(A, beta):
        thetas = jnp.asarray(np.stack([m.ravel() for m in np.meshgrid(A, beta, indexing="ij")]))
        predicted = np.asarray(jax.lax.map(lambda t: predict(*t), thetas.T, batch_size=64))
        # Eqs. 2 to 4 with the scale that the study gives: 5 % of each measured quantity.
        likelihood = stats.norm.logpdf(data.values, predicted, 0.05 * data.values)
        return likelihood.sum(axis=(1, 2)).reshape(len(A), len(beta)) + prior

    A, beta = np.linspace(2e5, 9e5, 29), np.linspace(0.5, 2.0, 25)
    coarse = log_density(A, beta)
    # e⁻¹² of the peak and a coarse cell around: what lies outside weighs less than 1e-4.
    inside = np.argwhere(coarse > coarse.max() - 12)
    (a0, b0), (a1, b1) = inside.min(axis=0) - 1, inside.max(axis=0) + 1
    A = np.linspace(A[max(a0, 0)], A[min(a1, 28)], 41)
    beta = np.linspace(beta[max(b0, 0)], beta[min(b1, 24)], 41)
    fine = log_density(A, beta)
    mass = trapezoid(trapezoid(np.exp(fine - fine.max()), beta, axis=1), A)
    return A, beta, fine, fine.max() + np.log(mass)


def moments(A, beta, log_density):
    """Mean, standard deviation and correlation of (A, beta) under a density on a grid."""
    weight = np.exp(log_density - log_density.max())
    weight /= weight.sum()
    points = np.stack(np.meshgrid(A, beta, indexing="ij"))
    mean = (weight * points).sum(axis=(1, 2))
    centred = points - mean[:, None, None]
    covariance = np.einsum("ij,aij,bij->ab", weight, centred, centred)
    sd = np.sqrt(np.diag(covariance))
    return mean, sd, covariance[0, 1] / sd.prod()


@pytest.mark.whole
@pytest.mark.verification("paper")
def test_map_of_the_papers_case_is_the_top_of_the_grid(paper_maximum, paper_grid, observed):
    A, beta, log_density, _ = paper_grid
    i, j = np.unravel_index(log_density.argmax(), log_density.shape)
    for k, (name, axis, top) in enumerate((("A", A, i), ("beta", beta, j))):
        off = float(paper_maximum.theta[k] - axis[top]) / (axis[1] - axis[0])
        observed(f"MAP of {name}, 8 experiments: distance in cells", "top of a grid of the posterior", off, 1.0)
    # Not below any point of the grid, and not above it by more than a cell can hide.
    assert -1e-6 < float(paper_maximum.log_posterior) - log_density.max() < 0.5
    assert bool(paper_maximum.converged)


@pytest.mark.whole
@pytest.mark.verification("paper")
def test_laplace_evidence_of_the_papers_case_is_the_grids_integral(paper_maximum, paper_grid, observed):
    # The posterior is nearly Gaussian.
    off = float(paper_maximum.log_evidence) - paper_grid[3]
    observed("log evidence by Laplace's method, 8 experiments", "integral over a grid", off, 0.1)


@pytest.mark.whole
@pytest.mark.verification("paper")
@EXACT
def test_draws_of_the_papers_case_have_the_moments_of_the_grid(paper, paper_maximum, paper_grid, sampler, observed):
    built, data, _ = paper
    chains = drawn(built.inference.posterior, data, paper_maximum, Settings(4, 100, 500, sampler=sampler))
    assert chains.sampler == sampler
    # NUTS did without the simulator's derivatives here.
    assert sampler != "nuts" or 0 < chains.emulator_error < 0.1
    judged = convergence(chains)
    assert judged.warning(built.inference.posterior.names) is None
    mean, sd, correlation = moments(*paper_grid[:3])
    draws = np.asarray(chains.theta).reshape(-1, 2)
    # Four standard errors of the Monte Carlo, from the effective sample size.
    error, worth = 4 / np.sqrt(judged.ess_bulk.min()), np.sqrt(judged.ess_bulk.min())
    off = {
        "means": worth * (draws.mean(axis=0) - mean) / sd,
        "standard deviations": worth * (draws.std(axis=0) / sd - 1),
    }
    for name, values in off.items():
        observed(f"{name} of the posterior by {sampler}, in standard errors", "grid of the posterior", values, 4.0)
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(correlation, abs=error * (1 - correlation**2) + 0.01)


@pytest.mark.whole
def test_draws_of_the_gaussian_around_the_mode_are_near_the_grids(paper, paper_maximum, paper_grid):
    built, data, _ = paper
    chains = drawn(built.inference.posterior, data, paper_maximum, Settings(4, 100, 500, sampler="laplace"))
    mean, sd, _ = moments(*paper_grid[:3])
    draws = np.asarray(chains.theta).reshape(-1, 2)
    assert chains.sampler == "laplace"
    assert float(chains.log_density.max()) == pytest.approx(
        float(log_density(built.inference.posterior, paper_maximum.start, data)), abs=0.02
    )
    assert (np.abs(draws.mean(axis=0) - mean) < 0.3 * sd).all()
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.2)


@pytest.mark.whole
def test_gauss_newton_covariance_of_the_papers_case_is_near_the_grids(paper_maximum, paper_grid):
    _, sd, _ = moments(*paper_grid[:3])
    # A quadratic approximation at the mode of a slightly skew density.
    np.testing.assert_allclose(np.sqrt(np.diag(paper_maximum.covariance)), sd, rtol=0.15)


# --- the likelihood ----------------------------------------------------------------------------------------------


def random_data(n, J, seed=0):
    rng = np.random.default_rng(seed)
    values, predicted = rng.normal(size=(n, J)), rng.normal(size=(n, J))
    used, sigma = rng.uniform(size=(n, J)) < 0.7, rng.uniform(0.05, 2.0, (n, J))
    data = data_of(Conditions({}), values, used, np.full((n, J), np.inf), n)
    return data, values, used, predicted, sigma


def compared_by_hand(predicted, values, used, sigma):
    """z and log σ, zero where nothing is used."""
    z, log_sigma = (predicted - values) / sigma, np.broadcast_to(np.log(sigma), values.shape)
    return tuple(jnp.asarray(np.where(used, x, 0.0)) for x in (z, log_sigma))


@pytest.mark.verification("inference")
def test_log_likelihood_is_the_sum_of_normal_log_densities_over_what_was_measured(observed):
    data, values, used, predicted, sigma = random_data(7, 3)
    expected = stats.norm.logpdf(values, predicted, sigma)[used].sum()
    found = likelihood(*compared_by_hand(predicted, values, used, sigma), jnp.ones(7), data)
    observed("log likelihood of independent errors (Eqs. 3 and 4)", "SciPy normal", relative(found, expected), 1e-13)


@pytest.mark.verification("inference")
def test_log_likelihood_of_noise_with_a_memory_is_the_joint_normal_density(observed):
    # Two outputs of 12 samples at uneven times; one sample was not measured, and the memory begins anew after it.
    rng, m = np.random.default_rng(3), 12
    time = np.cumsum(rng.uniform(0.5, 1.5, m))
    gaps = np.tile(np.concatenate([[np.inf], np.diff(time)]), 2)[None]
    groups, times, sigma = np.repeat([0, 1], m), np.asarray([2.0, 0.0]), np.repeat([0.3, 0.7], m)
    values, predicted, used = rng.normal(size=(1, 2 * m)), rng.normal(size=(1, 2 * m)), np.ones((1, 2 * m), bool)
    used[0, 5] = False
    data = data_of(Conditions({}), values, used, gaps, 1)
    data = data._replace(memory=jnp.asarray(memory_of(np.asarray(data.gaps), times, groups)))
    correlation = np.eye(2 * m)
    for part in (slice(0, 5), slice(6, m)):
        correlation[part, part] = np.exp(-np.abs(time[part, None] - time[part]) / times[0])
    keep = used[0]
    covariance = (correlation * sigma[:, None] * sigma)[np.ix_(keep, keep)]
    expected = stats.multivariate_normal(predicted[0, keep], covariance).logpdf(values[0, keep])
    found = likelihood(*compared_by_hand(predicted, values, used, sigma), jnp.ones(1), data)
    observed("log likelihood of autocorrelated noise", "SciPy joint normal", relative(found, expected), 1e-12)


@pytest.mark.whole
@pytest.mark.verification("inference")
def test_a_relative_error_of_a_quantity_is_one_of_its_logarithm(observed):
    # y = θ x (1 + sε): the density of log y and its mode in closed form; anchored on the data the mode would be another.
    x, y, s = np.array([1.0, 2.0, 3.0]), np.array([1.3, 1.7, 4.1]), 0.1
    data = measured_at(x, y[:, None])
    posterior = Posterior(
        Predictor(lambda theta, c: (theta[0] * c.inputs["x"][None], True)),
        {"t": Prior("loguniform", [0.1, 10.0])},
        [Error(s, is_relative=True)],
        ["y"],
        np.arange(1),
    )
    mean, sd = log_moments(s)
    for theta in (0.8, 1.2, 2.0):
        u = posterior.unconstrain(jnp.asarray([theta]))
        expected = (stats.norm.logpdf(np.log(y), np.log(theta * x) + mean, sd) - np.log(y)).sum()
        expected -= np.log(theta) + np.log(np.log(100))
        error = relative(log_posterior(posterior, u, data), expected)
        observed("log posterior with a relative error", "log-normal, moments by quadrature", error, 1e-5)
    # The prior's density falls as 1/θ: one of log θ that is flat, less log θ.
    mode = np.exp(np.mean(np.log(y / x)) - mean - sd**2 / 3)
    found = find(posterior, data)
    observed("MAP with a relative error", "closed form", relative(found.theta[0], mode), 1e-4)
    assert float(found.covariance[0, 0]) == pytest.approx((mode * sd) ** 2 / 3, rel=1e-2)


@pytest.mark.whole
def test_a_relative_error_of_what_was_measured_is_gaussian_of_a_given_scale():
    # y = θ x + s y ε and a history y = θ x + s RMS(y) ε: least squares whose weights do not depend on θ.
    x, y, s = np.array([1.0, 2.0, 3.0]), np.array([1.3, 1.7, 4.1]), 0.1
    history = np.array([[1.0, -2.0], [2.5, 3.0], [1.0, 0.0]])

    def respond(theta, c):
        return theta[0] * c.inputs["x"] * jnp.ones(3), True

    posterior = Posterior(
        Predictor(respond),
        {"t": Prior("uniform", [0.1, 10.0])},
        [Error(s, is_relative=True, of_measured=True)] * 2,
        ["y", "h"],
        np.array([0, 1, 1]),
    )
    values = np.column_stack([y, history])
    data = measured_at(x, values)
    sigma = s * np.column_stack([y, *[np.sqrt(np.mean(history**2, axis=1))] * 2])
    for theta in (0.8, 1.2, 2.0):
        u = posterior.unconstrain(jnp.asarray([theta]))
        expected = stats.norm.logpdf(values, theta * x[:, None], sigma).sum() - np.log(9.9)
        assert float(log_posterior(posterior, u, data)) == pytest.approx(expected, rel=1e-9)
    weights = (x[:, None] / sigma) ** 2
    mode = (weights * values / x[:, None]).sum() / weights.sum()
    found = find(posterior, data)
    assert float(found.theta[0]) == pytest.approx(mode, rel=1e-5)
    assert float(found.covariance[0, 0]) == pytest.approx(1 / weights.sum(), rel=1e-3)


@pytest.mark.parametrize("s", [pytest.param(0.05, marks=pytest.mark.slow), 0.2])
def test_estimates_from_relative_errors_are_not_biased(s):
    random, x, campaigns = np.random.default_rng(2), np.ones(40), 12
    posterior = Posterior(
        Predictor(lambda theta, c: (theta[0] * c.inputs["x"][None], True)),
        {"t": Prior("uniform", [0.1, 10.0])},
        [Error(s, is_relative=True)],
        ["y"],
        np.arange(1),
    )
    found = [
        float(find(posterior, measured_at(x, (2 * (1 + s * random.standard_normal(40)))[:, None]), 1).theta[0])
        for _ in range(campaigns)
    ]
    # The spread of one estimate is 2 s/√40; anchored on the data they would be 2 s² too small.
    assert abs(np.mean(found) - 2) < 2.5 * 2 * s / np.sqrt(40 * campaigns)


def test_missing_values_may_hold_anything():
    def respond(theta, conditions):
        return theta[0] * conditions.inputs["x"] * jnp.ones(2), True

    errors = [Error(0.1, is_relative=True), Error(0.3)]
    posterior = Posterior(Predictor(respond), {"t": Prior("uniform", [0.1, 9.0])}, errors, ["y", "z"], np.arange(2))
    data = measured_at(np.ones(3), [[1.0, np.nan], [np.nan, 2.0], [1.5, 1.0]])
    junk = data._replace(values=jnp.where(data.weights > 0, data.values, -1e30))
    u = jnp.asarray([0.1])
    assert float(log_density(posterior, u, data)) == float(log_density(posterior, u, junk))


@pytest.mark.whole
def test_padding_the_data_changes_no_number(paper, paper_maximum):
    built, data, state = paper
    design = Built(
        built.study.model_copy(update={"design": built.study.design.model_copy(update={"iterations": 5})})
    ).design.sequential
    larger = design.init()
    for trial in state.trials:
        larger = design.tell(larger, trial.point.cube.tolist(), trial.outputs.tolist())
    padded = design.data(larger)
    assert padded.values.shape[0] == EXPERIMENTS + 5
    u = np.asarray(paper_maximum.u) + 0.1
    # Of the data alone a search and the draws have compiled both.
    heights = [float(log_density(built.inference.posterior, u, of)) for of in (padded, data)]
    (found,), (expected,) = (expand(built.inference.posterior, of, [u]) for of in (padded, data))
    assert heights[0] == pytest.approx(heights[1], rel=1e-13)
    np.testing.assert_allclose(found.log_density, heights[0], rtol=1e-13)
    np.testing.assert_allclose(found.log_posterior, expected.log_posterior, rtol=1e-13)
    np.testing.assert_allclose(found.curvature, expected.curvature, rtol=1e-9)


def test_a_diverged_simulation_is_a_very_unlikely_one_and_not_a_number_that_is_missing():
    posterior = posterior_of(
        lambda t, c: (jnp.where(t[0] > 0.5, jnp.nan, t[0])[None] * c.inputs["x"], True),
        {"t": Prior("uniform", [0, 1])},
        [1.0],
    )
    data = measured_at(np.ones(3), np.full((3, 1), 0.4))
    good, bad = (float(log_density(posterior, posterior.unconstrain(jnp.array([t])), data)) for t in (0.4, 0.6))
    assert np.isfinite(bad) and bad < good - 1e5
    assert float(find(posterior, data).theta[0]) == pytest.approx(0.4, abs=1e-4)


# --- linear models, where everything has a closed form -----------------------------------------------------------

X = np.linspace(0.2, 2.0, 10)
SIGMA = 2e4


def line(theta, conditions):
    """θ₀ + θ₁x, in the magnitudes of a stiffness."""
    return (theta[0] + 1e5 * theta[1] * conditions.inputs["x"])[None], True


def line_data(seed=1):
    truth = np.stack([np.ones_like(X), 1e5 * X], axis=1) @ [4.2e5, 0.8]
    return measured_at(X, (truth + SIGMA * np.random.default_rng(seed).standard_normal(X.size))[:, None])


@pytest.mark.verification("inference")
@pytest.mark.parametrize("noise", [SIGMA, 40 * SIGMA], ids=["data rule", "prior rules"])
def test_normal_priors_and_a_linear_model_give_the_closed_form_to_rounding(noise, observed):
    priors = {"A": Prior("normal", [5e5, 1e5]), "beta": Prior("normal", {"loc": 1.0, "scale": 0.3})}
    data = line_data()
    found = find(posterior_of(line, priors, [noise]), data)
    H, m, S = np.stack([np.ones_like(X), 1e5 * X], axis=1), np.array([5e5, 1.0]), np.diag([1e5**2, 0.3**2])
    y = np.asarray(data.values)[:, 0]
    covariance = np.linalg.inv(H.T @ H / noise**2 + np.linalg.inv(S))
    mean = covariance @ (H.T @ y / noise**2 + np.linalg.inv(S) @ m)
    evidence = stats.multivariate_normal(H @ m, H @ S @ H.T + noise**2 * np.eye(X.size)).logpdf(y)
    # The mode of the prior is found on a grid of its quantiles; the optimiser stops at 1e-6.
    observed("linear model: MAP", "closed form", relative(found.theta, mean), 1e-4)
    observed("linear model: covariance", "closed form", relative(found.covariance, covariance), 1e-6)
    observed("linear model: log evidence", "SciPy joint normal", float(found.log_evidence) - evidence, 1e-3)


@pytest.mark.verification("inference")
def test_uniform_priors_and_a_linear_model_give_the_gaussian_integral(observed):
    priors = {"A": Prior("uniform", [2e5, 9e5]), "beta": Prior("uniform", [0.0, 2.0])}
    data = line_data()
    found = find(posterior_of(line, priors, [SIGMA]), data)
    H, y = np.stack([np.ones_like(X), 1e5 * X], axis=1), np.asarray(data.values)[:, 0]
    best, covariance = np.linalg.lstsq(H, y, rcond=None)[0], SIGMA**2 * np.linalg.inv(H.T @ H)
    peak = stats.norm.logpdf(y, H @ best, SIGMA).sum()
    evidence = peak + 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1] - np.log(7e5 * 2.0)
    observed("linear model, uniform priors: MAP", "least squares", relative(found.theta, best), 1e-4)
    observed("linear model, uniform priors: log evidence", "closed form", float(found.log_evidence) - evidence, 0.1)


@pytest.mark.whole
@pytest.mark.verification("inference")
def test_lognormal_prior_of_a_stiffness_is_as_good_as_any(observed):
    priors = {"A": Prior("lognormal", [13.0, 0.4]), "beta": Prior("half_normal", 2.0)}
    data = line_data()
    posterior = posterior_of(line, priors, [SIGMA])
    found = find(posterior, data)
    y = np.asarray(data.values)[:, 0]

    def minus_log_posterior(t):
        A, beta = 1e5 * t[0], t[1]
        prior = stats.lognorm(0.4, scale=np.exp(13.0)).logpdf(A) + stats.halfnorm(scale=2.0).logpdf(beta)
        return -stats.norm.logpdf(y, A + 1e5 * beta * X, SIGMA).sum() - prior

    best = minimize(minus_log_posterior, [4.0, 0.8], method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10})
    error = relative(found.theta, [1e5 * best.x[0], best.x[1]])
    observed("linear model, log-normal and half-normal priors: MAP", "SciPy Nelder-Mead", error, 1e-3)
    assert float(found.log_posterior) == pytest.approx(-best.fun, abs=1e-5)


# --- unknown errors ----------------------------------------------------------------------------------------------


# Of this module and not of a test: both samplers have the programs of one model.


def proportional(theta, conditions):
    return (theta[0] * conditions.inputs["x"])[None], True


@pytest.mark.verification("inference")
@EXACT
def test_posterior_of_an_unknown_error_is_the_closed_form(sampler, observed):
    # y = θx + ε with a flat prior of θ: p(s | y) ∝ p(s) s^(1−n) exp(−RSS/2s²)
    rng = np.random.default_rng(3)
    x = rng.uniform(0.5, 2.0, 15)
    y = 1.3 * x + 0.2 * rng.standard_normal(15)
    prior = Prior("half_normal", 0.3)
    posterior = posterior_of(proportional, {"t": Prior("uniform", [-50, 50])}, [prior])
    assert posterior.names == ("t", "error.y0")
    data = measured_at(x, y[:, None])
    found = find(posterior, data)
    chains = drawn(posterior, data, found, Settings(4, 200, 1000, sampler=sampler))
    judged = convergence(chains)
    assert judged.warning(posterior.names) is None
    best = x @ y / (x @ x)
    rss = ((y - best * x) ** 2).sum()
    s = np.linspace(0.02, 1.5, 20001)
    density = np.exp(stats.halfnorm(scale=0.3).logpdf(s) - 14 * np.log(s) - rss / (2 * s**2) - 20)
    density /= trapezoid(density, s)
    mean = trapezoid(s * density, s)
    sd = np.sqrt(trapezoid((s - mean) ** 2 * density, s))
    draws = np.asarray(chains.theta)[..., 1].ravel()
    worth = np.sqrt(judged.ess_bulk[1])
    problem = f"unknown error by {sampler}, in standard errors"
    observed(f"{problem}: mean", "density on a line", worth * (draws.mean() - mean) / sd, 4.0)
    observed(f"{problem}: standard deviation", "density on a line", worth * (draws.std() / sd - 1), 8.0)
    # The joint mode is another point: there s^n, not s^(n−1).
    joint = s[np.argmax(stats.halfnorm(scale=0.3).logpdf(s) - 15 * np.log(s) - rss / (2 * s**2))]
    np.testing.assert_allclose(found.theta, [best, joint], rtol=2e-3)


@pytest.mark.whole
def test_an_unknown_relative_error_is_recovered(paper):
    built, data, _ = paper
    # The model's own predictions at known parameters with 10 % noise, many times over.
    truth = {"A": 4.5e5, "beta": 0.9}
    names = tuple(built.study.quantities)
    conditions = data.conditions
    exact = np.asarray(jax.vmap(lambda c: built.simulation.simulator.quantities(truth, c, names)[0])(conditions))
    noisy = exact * (1 + 0.1 * np.random.default_rng(5).standard_normal(exact.shape))
    study = built.study.model_copy(update={"error": None})
    posterior = Built(study).inference.posterior
    assert posterior.names[2:] == tuple(f"error.{q}" for q in names)
    found = find(posterior, data._replace(values=jnp.asarray(noisy)))
    # Eight values each: 0.1 within a quarter in standard deviation; 0.04 to 0.2 is three of them.
    assert ((np.asarray(found.theta[2:]) > 0.04) & (np.asarray(found.theta[2:]) < 0.2)).all()
    sd = np.sqrt(np.diag(found.covariance))
    assert (np.abs(np.asarray(found.theta[:2]) - [4.5e5, 0.9]) < 3.5 * sd[:2]).all()


# --- bounds, modes -----------------------------------------------------------------------------------------------


@pytest.mark.verification("inference")
@EXACT
def test_a_map_beyond_the_prior_lies_on_its_bound_and_the_draws_do_not_care(sampler, observed):
    # The likelihood's peak, 1.2, is outside of the prior [0, 1]: the posterior is a truncated normal.
    posterior = posterior_of(proportional, {"t": Prior("uniform", [0.0, 1.0])}, [0.3])
    data = measured_at(np.ones(4), np.full((4, 1), 1.2))
    found = find(posterior, data)
    # The logistic flattens towards the bound; the descent stops 1.2e-3 before it, where the density is down by 1 %.
    assert 1.0 - 2e-3 < float(found.theta[0]) <= 1.0
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in found)
    truth = stats.truncnorm((0 - 1.2) / 0.15, (1 - 1.2) / 0.15, loc=1.2, scale=0.15)
    chains = drawn(posterior, data, found, Settings(4, 200, 1000, sampler=sampler))
    judged = convergence(chains)
    assert judged.divergences == 0 and judged.rhat[0] < 1.02
    worth, draws = np.sqrt(judged.ess_bulk[0]), np.asarray(chains.theta).ravel()
    problem = f"posterior on a bound by {sampler}, in standard errors"
    off = worth * (draws.mean() - truth.mean()) / truth.std()
    observed(f"{problem}: mean", "SciPy truncated normal", off, 4.0)
    observed(f"{problem}: standard deviation", "SciPy truncated normal", worth * (draws.std() / truth.std() - 1), 8.0)


def test_draws_start_at_the_map_if_a_small_change_near_a_bound_changes_the_response_much():
    # With s = logit t, the second output has the same value in several valleys; the first one prefers the one at s = 7.
    def respond(theta, conditions):
        s = jnp.log(theta[0] / (1 - theta[0]))
        return jnp.stack([s, jnp.sin(3 * s)]) * conditions.inputs["x"], True

    posterior, x = posterior_of(respond, {"t": Prior("uniform", [0.0, 1.0])}, [0.5, 0.02]), np.linspace(0.5, 1.0, 8)
    data = measured_at(x, x[:, None] * [7.0, np.sin(21.0)])
    found = maximise(posterior, data, np.asarray([[6.9]]))
    assert float(found.u[0]) == pytest.approx(7.0, abs=1e-3)
    assert float(found.start[0]) == pytest.approx(7.0, abs=0.1)
    draws = np.asarray(drawn(posterior, data, found, Settings(4, 100, 500, sampler="importance")).theta)
    assert np.abs(np.log(draws / (1 - draws)) - 7.0).max() < 0.1


def test_several_starts_find_the_better_of_two_modes():
    # θ² has two solutions; the second output favours the negative one, which lies away from the prior's middle.
    def respond(theta, conditions):
        return jnp.stack([theta[0] ** 2, 0.3 * theta[0]]) * conditions.inputs["x"], True

    posterior = posterior_of(respond, {"t": Prior("uniform", [-2.0, 3.0])}, [0.1, 0.2])
    data = measured_at(np.ones(3), np.tile([[1.0, -0.3]], (3, 1)))
    assert float(find(posterior, data, starts=1).theta[0]) > 0.5  # the worse mode: one start is not enough
    assert float(find(posterior, data, starts=8).theta[0]) == pytest.approx(-1.0, abs=1e-3)


@pytest.mark.whole
def test_what_was_thrown_against_a_bound_comes_back():
    # A damped oscillation: from the middle of the priors the first step goes to the lower bound of the frequency, where the
    # logistic is flat, and a descent that ends there has five times the damping.
    def respond(theta, conditions):
        x = conditions.inputs["x"]
        return (jnp.exp(-theta[1] * x) * jnp.cos(theta[0] * x))[None], True

    times = np.linspace(0.1, 4.0, 30)
    posterior = posterior_of(
        respond, {"w": Prior("uniform", [1.0, 9.0]), "c": Prior("loguniform", [0.01, 30.0])}, [0.01]
    )
    found = find(posterior, measured_at(times, (np.exp(-0.2 * times) * np.cos(2 * times))[:, None]), starts=2)
    assert np.asarray(found.theta) == pytest.approx([2.0, 0.2], rel=1e-3)


@pytest.mark.whole
def test_a_known_start_is_not_left_for_the_middle_of_the_prior_because_the_error_starts_large():
    # An oscillation has a mode near each of many frequencies. With an error of its prior's size, a thousand times too large, the
    # prior alone decides on the first steps.
    def respond(theta, conditions):
        return jnp.cos(theta[0] * conditions.inputs["x"])[None], True

    times = np.linspace(0.1, 4.0, 30)
    noise = 0.02 * np.random.default_rng(2).standard_normal(30)
    posterior = posterior_of(respond, {"w": Prior("normal", [2.0, 0.5])}, [Prior("lognormal", [3.0, 2.0])])
    data = measured_at(times, (np.cos(6.0 * times) + noise)[:, None])
    found = fit(posterior, data, starts=1, settings=Settings(2, 10, 20, sampler="importance"), key=jax.random.key(0),
                units={"w": "rad/s"}, start=jnp.asarray([6.05]))  # fmt: skip
    assert found.map["w"] == pytest.approx(6.0, abs=0.01) and found.map["error.y0"] == pytest.approx(0.02, rel=0.3)


# --- whether to believe the draws --------------------------------------------------------------------------------


def chains_of(theta, diverging=None) -> Chains:
    shape = theta.shape[:2]
    diverging = np.zeros(shape, bool) if diverging is None else diverging
    return Chains(
        jnp.asarray(theta), jnp.zeros(shape), jnp.asarray(diverging), jnp.ones(shape, int), jnp.full(shape[0], 0.5)
    )


def white(seed=0):
    return np.random.default_rng(seed).standard_normal((4, 500, 2))


def test_good_chains_give_no_warning():
    judged = convergence(chains_of(white()))
    assert judged.warning(("A", "beta")) is None
    assert (judged.rhat < 1.01).all() and (judged.ess_bulk > 1000).all() and judged.divergences == 0


def test_chains_that_disagree_are_named():
    theta = white()
    theta[0, :, 1] += 1.0
    warning = convergence(chains_of(theta)).warning(("A", "beta"))
    assert "R-hat of beta" in warning and "of A" not in warning


def test_chains_that_crawl_are_named():
    theta = white()
    for t in range(1, 500):
        theta[:, t, 0] = 0.99 * theta[:, t - 1, 0] + np.sqrt(1 - 0.99**2) * theta[:, t, 0]
    assert "ESS of A" in convergence(chains_of(theta)).warning(("A", "beta"))


def test_a_warning_says_once_what_many_parameters_have():
    judged = Convergence(np.asarray([1.0, 1.02, 1.0, 1.0, 1.0]), np.asarray([399.0, 100.0, 315.0, 500.0, 200.0]), 0)
    assert judged.warning(("A", "beta", "n", "gamma", "delta")) == (
        "R-hat of beta is 1.020 (should be at most 1.01); "
        "bulk ESS of A, beta, n and 1 other is down to 100 (should be at least 400)"
    )


def test_divergences_are_counted():
    diverging = np.zeros((4, 500), bool)
    diverging[1, 7] = diverging[3, 9] = True
    assert "2 divergent transitions" in convergence(chains_of(white(), diverging)).warning(("A", "beta"))


def test_chains_that_stand_still_are_not_believed():
    theta = white()
    theta[..., 0] = 1.0
    assert "R-hat of A" in convergence(chains_of(theta)).warning(("A", "beta"))


@pytest.mark.parametrize("shape", [(1, 100), (4, 2), (1, 1)])
def test_draws_too_few_to_judge_are_not_believed_and_do_no_harm(shape):
    judged = convergence(chains_of(np.random.default_rng(0).standard_normal((*shape, 2))))
    assert "A" in judged.warning(("A", "beta"))


# --- priors ------------------------------------------------------------------------------------------------------

SPELLINGS = {
    "uniform": ("uniform", [2.0, 5.0], stats.uniform(2, 3)),
    "Uniform": ("Uniform", {"low": 2.0, "high": 5.0}, stats.uniform(2, 3)),
    "normal": ("normal", [5e5, 1e5], stats.norm(5e5, 1e5)),
    "lognormal": ("lognormal", [1.0, 0.5], stats.lognorm(0.5, scale=np.e)),
    "log_normal": ("log_normal", {"loc": 1.0, "scale": 0.5}, stats.lognorm(0.5, scale=np.e)),
    "half_normal": ("half_normal", 2.0, stats.halfnorm(scale=2.0)),
    "half_normal by name": ("half_normal", {"scale": 2.0}, stats.halfnorm(scale=2.0)),
    "truncated_normal": (
        "truncated_normal", {"loc": 1.0, "scale": 0.5, "low": 0.0, "high": 2.0}, stats.truncnorm(-2, 2, 1.0, 0.5)
    ),
    "LogUniform": ("LogUniform", {"low": 1e5, "high": 1e6}, stats.loguniform(1e5, 1e6)),
    "Gamma": ("Gamma", {"concentration": 2.0, "rate": 4.0}, stats.gamma(2.0, scale=0.25)),
    "student_t": ("student_t", {"df": 5, "loc": 0.0, "scale": 2.0}, stats.t(5, scale=2.0)),
}  # fmt: skip


@pytest.mark.parametrize("case", SPELLINGS)
def test_a_prior_has_scipys_density_and_quantiles(case):
    name, arguments, truth = SPELLINGS[case]
    prior = Prior(name, arguments)
    shares = np.array([0.1, 0.5, 0.9])
    values = truth.ppf(shares)
    np.testing.assert_allclose(prior.log_density(jnp.asarray(values)), truth.logpdf(values), rtol=1e-9, atol=1e-9)
    # Some quantiles come from 4096 samples.
    sampled = case in ("Gamma", "student_t")
    np.testing.assert_allclose(prior.quantile(shares), values, rtol=1e-7, atol=0.1 * truth.std() if sampled else 1e-9)
    # One that a program asked for first is a number outside of it, too.
    jax.jit(lambda x: x * prior.quantile(0.9))(2.0)
    np.testing.assert_allclose(prior.quantile(0.9), prior.quantile(shares)[2], rtol=1e-12)


@pytest.mark.parametrize("case", SPELLINGS)
def test_unconstrained_coordinates_are_of_order_one_finite_at_the_bounds_and_inverted(case):
    name, arguments, truth = SPELLINGS[case]
    posterior = posterior_of(lambda t, c: (t, True), {"t": Prior(name, arguments)}, [1.0])
    inside = truth.ppf([0.01, 0.3, 0.5, 0.99])

    @jax.jit
    @jax.vmap
    def there_and_back(value):
        u = posterior.unconstrain(value[None])
        return u, posterior.constrain(u)

    u, back = map(np.asarray, there_and_back(np.array([*inside, *truth.support()])))
    assert (abs(u[:4]) < 12).all()
    np.testing.assert_allclose(back[:4, 0], inside, rtol=1e-9)
    assert np.isfinite(u).all() and np.isfinite(back).all()
    slopes = jax.jit(jax.vmap(jax.grad(lambda x: posterior.constrain(x[None])[0])))
    slope = np.asarray(slopes(np.array([-30.0, 0.0, 30.0])))
    assert np.isfinite(slope).all() and (slope >= 0).all()


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("unifrom", [0, 1], "uniform, normal, lognormal, half_normal, truncated_normal"),
        ("poisson", 3.0, "scalar continuous"),
        ("delta", 3.0, "plain number"),
        ("uniform", [1.0], "low, high"),
        ("uniform", [1.0, 2.0, 3.0], "low, high"),
        ("uniform", {"low": 0.0, "hi": 1.0}, "low, high"),
        ("uniform", ["a", 1.0], "low, high"),
        ("uniform", None, "low, high"),
        ("uniform", [5.0, 2.0], "lower bound 5 must lie below the upper bound 2"),
        ("uniform", [0.0, float("inf")], "finite"),
        ("normal", [0.0, -1.0], "scale"),
        ("half_normal", [], "scale"),
    ],
)
def test_a_wrong_prior_is_refused_with_what_is_allowed(name, arguments, words):
    with pytest.raises(UserError, match=words):
        Prior(name, arguments)


# --- a model that does not explain the data ----------------------------------------------------------------------


def straight(theta, conditions):
    return (theta[0] + theta[1] * conditions.inputs["x"])[None], True


def bent(curvature, inflate):
    """A straight line calibrated on a bent one, noise as declared."""
    x = np.linspace(-1, 1, 60)
    noise = 0.1 * np.random.default_rng(1).standard_normal(x.size)
    data = measured_at(x, (1 + 2 * x + curvature * x**2 + noise)[:, None])
    errors = [Error(0.1, inflate=inflate)]
    posterior = Posterior(
        Predictor(straight),
        {"a": Prior("normal", [0.0, 10.0]), "b": Prior("normal", [0.0, 10.0])},
        errors,
        ["y"],
        np.arange(1),
    )
    settings = Settings(2, 1, 200, sampler="laplace")
    found = fit(posterior, data, starts=2, settings=settings, key=jax.random.key(0), units={}, errors=errors)
    design = np.stack([np.ones_like(x), x], axis=1)
    residual = np.asarray(data.values)[:, 0] - design @ np.asarray(found.maximum.theta)
    return found, float(np.sqrt(np.mean(residual**2)) / 0.1), np.linalg.inv(design.T @ design / 0.1**2)


@pytest.mark.whole
def test_what_the_model_leaves_is_said_beside_the_intervals():
    right, left, _ = bent(0.0, False)
    assert right.doubt is None and right.chi2_per_datum == pytest.approx(left**2) and right.p_value > 0.01
    wrong, left, covariance = bent(2.0, False)
    assert wrong.chi2_per_datum == pytest.approx(left**2) and left > 5 and wrong.p_value < 1e-10
    assert "does not explain the data" in wrong.doubt and "inflate" in wrong.doubt and wrong.doubt in repr(wrong)
    np.testing.assert_allclose(wrong.maximum.covariance, covariance, rtol=1e-2, atol=1e-12)


def test_inflated_errors_are_as_large_as_what_is_left_and_the_chi_square_stays_that_of_the_declared():
    wrong, left, covariance = bent(2.0, True)
    assert wrong.chi2_per_datum == pytest.approx(left**2)
    np.testing.assert_allclose(wrong.maximum.covariance, left**2 * covariance, rtol=2e-2, atol=1e-12)
    assert "count the rest as error" in wrong.doubt
    # A comparison measures by the noise, whatever counts as error: only the band is as wide as what is left.
    predicted = predict(wrong, wrong.data, ())
    np.testing.assert_allclose(predicted.sigma, 0.1)
    np.testing.assert_allclose(predicted.sd, 0.1 * left, rtol=0.1)
    # Where the noise is all there is, nothing is widened by much.
    right, left, covariance = bent(0.0, True)
    np.testing.assert_allclose(right.maximum.covariance, max(left, 1) ** 2 * covariance, rtol=2e-2, atol=1e-12)
