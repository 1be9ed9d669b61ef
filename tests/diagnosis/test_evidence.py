"""The evidence of a fit: against the exact marginal likelihood of linear Gaussian models, and against quadrature."""

from itertools import pairwise

import numpy as np
import pytest
from builders.shares import by_default
from scipy import stats
from scipy.integrate import quad

from hsed_jax.diagnosis.batch import Batch
from hsed_jax.diagnosis.box import Box
from hsed_jax.diagnosis.evidence import laplace, sample_posterior
from hsed_jax.diagnosis.fit_state import FitState, Target, Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.inference.priors import Prior

TIME = np.linspace(0.0, 3.0, 12)
DESIGN = np.stack([np.ones(12), TIME, np.sin(3 * TIME)], axis=1)
SIGMA = 0.3
MEANS, DEVIATIONS = np.array([0.5, -0.2, 0.1]), np.array([1.0, 0.4, 2.0])
DATA = DESIGN @ np.array([1.1, 0.1, -0.6]) + SIGMA * np.random.default_rng(3).standard_normal(12)
# What −½(r/σ)² leaves out of the density of the data.
LEFT_OUT = 12 * np.log(SIGMA * np.sqrt(2 * np.pi))


class Analytic(Batch):
    """Predictions by a formula f(θ) -> (L, J), θ of shape (P, L)."""

    def __init__(self, formula):
        self.formula = formula

    def __call__(self, thetas, experiments, samples=None):
        return self.formula(thetas.T), np.ones(len(thetas))


class Fragile(Analytic):
    """The same, and diverging where it is told to."""

    def __init__(self, formula, diverges):
        self.formula, self.diverges = formula, diverges

    def __call__(self, thetas, experiments, samples=None):
        ok = ~self.diverges(thetas.T)
        return np.where(ok[:, None], self.formula(thetas.T), 0.0), ok.astype(float)


def linear(columns):
    return lambda theta: theta[: len(columns)].T @ DESIGN[:, columns].T


def wave(theta):
    return theta[0][:, None] * WAVE


def fitted(formula, priors, data=DATA, sigma=SIGMA, start=None):
    models = NestedModels(Analytic(formula), Box(priors), np.array([float(p.quantile(0.5)) for p in priors.values()]))
    target = Target(data[None], np.full((1, data.size), sigma), np.ones((1, 1, data.size)), np.zeros((1, data.size)))
    start = models.neutral if start is None else models.box.x(np.asarray(start, dtype=float))
    (fit,) = models.fit(target, [Task(models.submodel(np.arange(len(priors))), start)])
    return models, target, fit


def normals(columns):
    return {str(k): Prior("normal", [MEANS[k], DEVIATIONS[k]]) for k in columns}


@pytest.mark.verification("inference")
@pytest.mark.parametrize("columns", [[0], [0, 1], [0, 1, 2], [2]])
def test_evidence_of_a_linear_gaussian_model_is_exact(columns, observed):
    models, target, fit = fitted(linear(columns), normals(columns))
    X = DESIGN[:, columns]
    covariance = X @ np.diag(DEVIATIONS[columns] ** 2) @ X.T + SIGMA**2 * np.eye(12)
    exact = stats.multivariate_normal(X @ MEANS[columns], covariance).logpdf(DATA) + LEFT_OUT
    # Second order is all there is, wherever the fit ended.
    observed(
        "log evidence of a linear model by Laplace's method", "SciPy joint normal", laplace(fit, models) - exact, 1e-3
    )
    sampled = sample_posterior(fit, models, target, 2000, 0)
    off = np.sqrt(sampled.effective) * (sampled.log_evidence - exact)
    observed("log evidence of a linear model by sampling, in standard errors", "SciPy joint normal", off, 4.0)
    assert sampled.effective > 1000


def test_sampled_moments_are_those_of_the_gaussian_posterior():
    columns = [0, 1, 2]
    models, target, fit = fitted(linear(columns), normals(columns))
    precision = DESIGN.T @ DESIGN / SIGMA**2 + np.diag(1 / DEVIATIONS**2)
    covariance = np.linalg.inv(precision)
    mean = covariance @ (DESIGN.T @ DATA / SIGMA**2 + MEANS / DEVIATIONS**2)
    sampled = sample_posterior(fit, models, target, 4000, 1)
    assert sampled.weights.sum() == pytest.approx(1.0) and sampled.thetas.shape == (4120, 3)
    for k in columns:
        sd = np.sqrt(covariance[k, k])
        moments = sampled.moments(k)
        assert moments["mean"] == pytest.approx(mean[k], abs=0.06 * sd)
        assert moments["sd"] == pytest.approx(sd, rel=0.05)
        assert moments["q05"] == pytest.approx(mean[k] - 1.645 * sd, abs=0.1 * sd)
        assert moments["q95"] == pytest.approx(mean[k] + 1.645 * sd, abs=0.1 * sd)


def test_where_the_data_pull_a_parameter_beyond_its_bound_the_others_are_drawn_for_the_bound():
    # Three nearly equal columns: without the bound of the first parameter, the other two would be far from where they are.
    random = np.random.default_rng(3)
    X = np.stack([TIME, TIME + 0.1 * np.sin(3 * TIME), TIME + 0.1 * random.standard_normal(12)], axis=1)
    data = X @ np.array([-4.0, 3.0, 2.0]) + 0.05 * random.standard_normal(12)
    priors = {"0": Prior("uniform", [0.0, 4.0]), "1": Prior("normal", [0.0, 5.0]), "2": Prior("normal", [0.0, 5.0])}
    models, target, fit = fitted(lambda theta: theta.T @ X.T, priors, data, sigma=0.05)
    # By quadrature over the first parameter; where it is known, the other two are Gaussian.
    first, Z = np.linspace(0.0, 1.0, 4001), X[:, 1:]
    covariance = np.linalg.inv(Z.T @ Z / 0.05**2 + np.eye(2) / 25)
    density = stats.multivariate_normal(np.zeros(12), 25 * Z @ Z.T + 0.05**2 * np.eye(12)).logpdf(
        data - first[:, None] * X[:, 0]
    )
    shares = np.exp(density - density.max()) / np.exp(density - density.max()).sum()
    means = (data - first[:, None] * X[:, 0]) @ Z @ covariance / 0.05**2
    sampled = sample_posterior(fit, models, target, 240, 0)
    assert sampled.effective > 30
    assert sampled.moments(0)["mean"] == pytest.approx(shares @ first, rel=0.3)
    for k in (1, 2):
        exact = shares @ means[:, k - 1]
        sd = np.sqrt(covariance[k - 1, k - 1] + shares @ (means[:, k - 1] - exact) ** 2)
        assert sampled.moments(k)["mean"] == pytest.approx(exact, abs=0.3 * sd)
        assert sampled.moments(k)["sd"] == pytest.approx(sd, rel=0.25)


def test_the_same_seed_gives_the_same_sample_and_another_a_different_one():
    models, target, fit = fitted(linear([0, 1]), normals([0, 1]))
    first, again, other = (sample_posterior(fit, models, target, 200, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.thetas, again.thetas)
    assert first.log_evidence == again.log_evidence != other.log_evidence


# --- an amplitude on its bound ---------------------------------------------------------------------------------------

WAVE = DESIGN[:, 2]


def pulled(distance):
    """Data whose best amplitude lies so many standard deviations from zero; the standard deviation."""
    sd = SIGMA / np.sqrt(WAVE @ WAVE)
    across = np.random.default_rng(1).standard_normal(12) * SIGMA
    across -= WAVE * (WAVE @ across) / (WAVE @ WAVE)
    return distance * sd * WAVE + across, sd


@pytest.mark.verification("inference")
@pytest.mark.parametrize("distance", [-12.0, -3.0, -1.0, 0.0, 1.0, 4.0])
@pytest.mark.parametrize("scale", by_default([0.05, 1.0], lambda scale: scale == 1.0))
def test_evidence_of_an_amplitude_on_its_bound_is_that_of_quadrature(distance, scale, observed):
    data, sd = pulled(distance)
    models, target, fit = fitted(wave, {"a": Prior("half_normal", scale)}, data)
    amplitude = models.theta(fit.x, fit.submodel)[0]
    if distance != 0:
        assert (amplitude == pytest.approx(0.0, abs=1e-12)) == (distance < 0)
    offset = 0.5 * np.sum(data**2) / SIGMA**2

    def density(a, power=0):
        misfit = 0.5 * np.sum((data - a * WAVE) ** 2) / SIGMA**2 - offset
        return a**power * np.exp(-misfit) * stats.halfnorm(scale=scale).pdf(a)

    most = (max(distance, 0.0) + 9) * sd
    edges = [0.0, *np.linspace(0.02, 1, 12) ** 2 * most]
    total, first, second = (sum(quad(density, a, b, args=(n,))[0] for a, b in pairwise(edges)) for n in range(3))
    exact = np.log(total) - offset
    problem = "log evidence of an amplitude on its bound"
    observed(f"{problem} by Laplace's method", "quadrature", laplace(fit, models) - exact, 2e-3)
    sampled = sample_posterior(fit, models, target, 1500, 0)
    observed(f"{problem} by sampling", "quadrature", sampled.log_evidence - exact, 0.08)
    moments = sampled.moments(0)
    assert moments["mean"] == pytest.approx(first / total, rel=0.08)
    assert moments["sd"] == pytest.approx(np.sqrt(second / total - (first / total) ** 2), rel=0.1)
    assert moments["q05"] >= 0.0


@pytest.fixture(scope="module")
def two_amplitudes():
    """Two effects much alike, both resting on zero: models, target, fit and the evidence by quadrature."""
    other = WAVE + 0.5 * np.cos(3 * TIME)
    data = -0.2 * WAVE + 0.1 * np.random.default_rng(2).standard_normal(12)
    priors = {"a": Prior("half_normal", 0.5), "b": Prior("half_normal", 0.5)}
    models, target, fit = fitted(lambda theta: wave(theta) + theta[1][:, None] * other, priors, data, start=(0.3, 0.3))
    np.testing.assert_allclose(models.theta(fit.x, fit.submodel), 0.0, atol=1e-12)
    grid = np.linspace(0, 2.0, 801)
    a, b = np.meshgrid(grid, grid, indexing="ij")
    misfit = 0.5 * np.sum((a[..., None] * WAVE + b[..., None] * other - data) ** 2, axis=-1) / SIGMA**2
    height = np.exp(-misfit) * stats.halfnorm(scale=0.5).pdf(a) * stats.halfnorm(scale=0.5).pdf(b)
    return models, target, fit, np.log(np.trapezoid(np.trapezoid(height, grid), grid))


@pytest.mark.verification("inference")
def test_evidence_of_two_amplitudes_on_their_bounds_by_sampling(two_amplitudes, observed):
    models, target, fit, exact = two_amplitudes
    off = sample_posterior(fit, models, target, 4000, 0).log_evidence - exact
    observed("log evidence of two amplitudes on their bounds by sampling", "quadrature", off, 0.05)


@pytest.mark.verification("inference")
def test_evidence_of_two_amplitudes_on_their_bounds_by_laplace(two_amplitudes, observed):
    models, _, fit, exact = two_amplitudes
    off = laplace(fit, models) - exact
    observed("log evidence of two amplitudes on their bounds by Laplace's method", "quadrature", off, 0.5)


# --- parameters that the data do not tell ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "arguments"), [("uniform", [-2.0, 5.0]), ("normal", [1.0, 3.0]), ("half_normal", 0.7)]
)
def test_a_parameter_that_does_nothing_leaves_the_evidence_as_it_was(name, arguments):
    alone, target, fit = fitted(linear([0, 1]), normals([0, 1]))
    without = laplace(fit, alone)
    models, target, fit = fitted(linear([0, 1]), {**normals([0, 1]), "idle": Prior(name, arguments)})
    assert laplace(fit, models) == pytest.approx(without, abs=0.01)
    sampled = sample_posterior(fit, models, target, 4000, 0)
    assert sampled.log_evidence == pytest.approx(without, abs=0.06)
    # Its posterior is its prior.
    prior = {"uniform": stats.uniform(-2, 7), "normal": stats.norm(1, 3), "half_normal": stats.halfnorm(scale=0.7)}
    moments = sampled.moments(2)
    assert moments["mean"] == pytest.approx(prior[name].mean(), abs=0.06 * prior[name].std())
    assert moments["sd"] == pytest.approx(prior[name].std(), rel=0.06)
    assert moments["q95"] == pytest.approx(prior[name].ppf(0.95), abs=0.12 * prior[name].std())


def test_a_useless_parameter_costs_what_occam_says():
    # A parameter that the data tell to be nothing: its price is the share of its prior that survives.
    zero = DATA - DESIGN @ np.linalg.lstsq(DESIGN, DATA, rcond=None)[0] + DESIGN[:, :2] @ np.array([1.0, 0.2])
    small, _, fit = fitted(linear([0, 1]), normals([0, 1]), zero)
    price = laplace(fit, small)
    for width in (1.0, 10.0):
        models, _, fit = fitted(linear([0, 1, 2]), {**normals([0, 1]), "c": Prior("uniform", [-width, width])}, zero)
        gain = laplace(fit, models) - price
        basis, _ = np.linalg.qr(DESIGN[:, :2])
        own = WAVE - basis @ (basis.T @ WAVE)
        sd = SIGMA / np.sqrt(own @ own)
        assert gain == pytest.approx(np.log(sd * np.sqrt(2 * np.pi) / (2 * width)), abs=0.1)


# --- a curved posterior ----------------------------------------------------------------------------------------------


def banana(theta):
    return np.stack([theta[0], theta[1] - theta[0] ** 2], axis=1)


@pytest.mark.verification("inference")
def test_evidence_of_a_curved_posterior_by_sampling_is_that_of_quadrature(observed):
    priors = {"a": Prior("normal", [0.0, 1.0]), "b": Prior("uniform", [-2.0, 6.0])}
    data, sigma = np.array([0.6, 0.3]), 0.5
    models, target, fit = fitted(banana, priors, data, sigma)
    a, b = np.linspace(-5, 5, 1001), np.linspace(-2, 6, 1601)
    A, B = np.meshgrid(a, b, indexing="ij")
    misfit = 0.5 * ((A - data[0]) ** 2 + (B - A**2 - data[1]) ** 2) / sigma**2
    height = np.exp(-misfit) * stats.norm.pdf(A) / 8.0

    def integral(values):
        return np.trapezoid(np.trapezoid(values, b), a)

    total = integral(height)
    sampled = sample_posterior(fit, models, target, 4000, 0)
    observed("log evidence of a curved posterior by sampling", "quadrature", sampled.log_evidence - np.log(total), 0.05)
    for k, values in ((0, A), (1, B)):
        mean = integral(height * values) / total
        sd = np.sqrt(integral(height * (values - mean) ** 2) / total)
        assert sampled.moments(k)["mean"] == pytest.approx(mean, abs=0.08 * sd)
        assert sampled.moments(k)["sd"] == pytest.approx(sd, rel=0.1)


def test_an_interval_of_a_few_telling_draws_is_no_point():
    # The slope at the fit promises an interval of 1, and almost everywhere within it the model is far off.
    def rough(theta):
        x = np.stack(theta, axis=1)
        return 0.01 * x + 0.3 * (1 - np.cos(40 * x))

    priors = {name: Prior("normal", [0.0, 1.0]) for name in "abcd"}
    models, target, fit = fitted(rough, priors, np.zeros(4), 0.01)
    sampled = sample_posterior(fit, models, target, 60, 0)
    assert sampled.effective < 10 < 1 / np.sum(sampled.weights**2)
    for k in range(4):
        assert sampled.moments(k)["q95"] - sampled.moments(k)["q05"] > 0.1


def test_beside_many_bounds_an_interval_is_that_of_the_gaussian_up_to_them():
    # Twelve amplitudes rest on their bounds: one draw in four thousand is within all of them.
    names = [f"a{k}" for k in range(12)]
    models, target, fit = fitted(
        lambda theta: theta.T - 0.02, {n: Prior("half_normal", 1.0) for n in names}, np.full(12, -0.1), 0.1
    )
    sampled = sample_posterior(fit, models, target, 40, 0)
    assert (sampled.thetas >= 0).all()
    for k in range(12):
        assert sampled.moments(k)["q95"] - sampled.moments(k)["q05"] > 0.02


def test_evidence_leaves_out_where_the_simulation_diverges():
    # Half of the posterior is gone: half of the evidence, too.
    models, target, fit = fitted(wave, {"a": Prior("normal", [0.0, 1.0])}, pulled(0.0)[0])
    whole = sample_posterior(fit, models, target, 4000, 0).log_evidence
    models = NestedModels(Fragile(wave, lambda theta: theta[0] < 0), models.box, np.zeros(1))
    sampled = sample_posterior(fit, models, target, 4000, 0)
    assert sampled.log_evidence == pytest.approx(whole - np.log(2), abs=0.06)
    assert np.all(sampled.thetas[sampled.weights > 0, 0] >= 0)


def test_a_fit_that_diverged_has_no_evidence():
    models, _, fit = fitted(linear([0]), normals([0]))
    assert laplace(FitState(fit.submodel, fit.x, 0), models) == -np.inf


def test_a_sample_that_diverges_everywhere_has_no_evidence_and_is_survived():
    models, target, fit = fitted(linear([0]), normals([0]))
    models = NestedModels(Fragile(linear([0]), lambda theta: theta[0] < np.inf), models.box, np.zeros(1))
    sampled = sample_posterior(fit, models, target, 50, 0)
    assert sampled.log_evidence == -np.inf and sampled.effective == 0.0
    assert np.isfinite(list(sampled.moments(0).values())).all()
