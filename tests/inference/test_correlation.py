"""Correlated residuals: their autocorrelation time in closed form, and intervals that cover because samples are discounted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from hsed_jax.inference.correlation import autocorrelation_time, estimate_noise, noise_of, size_p_value, worths
from hsed_jax.inference.fit import fit
from hsed_jax.inference.likelihood import Error, data_of, whitened
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.simulator import Conditions

RHO = 0.8


def ar1(random, rho, size):
    """A stationary AR(1) series of unit variance, (…, m)."""
    innovations = np.sqrt(1 - rho**2) * random.standard_normal(size)
    innovations[..., 0] /= np.sqrt(1 - rho**2)
    return signal.lfilter([1.0], [1.0, -rho], innovations, axis=-1)


@pytest.mark.parametrize("rho", [0.3, 0.6, 0.9])
def test_autocorrelation_time_of_an_ar1_series_is_its_closed_form(rho):
    series = ar1(np.random.default_rng(1), rho, (60, 4000))
    found = np.asarray([autocorrelation_time(row) for row in series])
    expected = (1 + rho) / (1 - rho)
    # Measured: 1.83 against 1.86, 3.94 against 4.00, 18.6 against 19.0.  The window truncates e⁻⁵ of the sum and the
    # removal of the mean biases by about τ²/m, together less than 6 %; a single series scatters by sqrt(2(2K+1)/m) of τ.
    standard_error = found.std(ddof=1) / np.sqrt(len(found))
    assert abs(found.mean() - expected) < 0.06 * expected + 3 * standard_error
    window = 5 * expected
    assert found.std(ddof=1) < 1.3 * expected * np.sqrt(2 * (2 * window + 1) / 4000)


def test_autocorrelation_time_of_white_noise_is_one():
    random = np.random.default_rng(2)
    found = np.asarray([autocorrelation_time(random.standard_normal(500)) for _ in range(1000)])
    # A correlation beyond three standard deviations has probability 0.27 % (half of it positive): 1.35 in 1000.
    assert np.count_nonzero(found > 1) <= 6


def test_autocorrelation_time_lies_between_one_and_the_number_of_samples():
    assert autocorrelation_time(np.zeros(100)) == 1.0
    assert autocorrelation_time(np.arange(5.0)) == 1.0
    assert autocorrelation_time((-1.0) ** np.arange(100)) == 1.0
    assert 10 < autocorrelation_time(np.linspace(-1, 1, 100)) <= 100


def test_scale_and_offset_of_a_residual_do_not_change_its_autocorrelation_time():
    series = ar1(np.random.default_rng(3), 0.7, 300)
    assert autocorrelation_time(1e6 * series + 3e7) == pytest.approx(autocorrelation_time(series), rel=1e-9)


def test_worth_of_an_output_is_the_reciprocal_of_the_median_time_over_its_experiments():
    random = np.random.default_rng(4)
    m = 400
    residual = np.concatenate([ar1(random, 0.8, (3, m)), random.standard_normal((3, m))], axis=1)
    weights = np.ones_like(residual)
    weights[2, :m] = 0.0  # the third experiment did not measure the first output
    weights[0, m - 100 : m] = 0.0  # and the first a shorter record, its padding full of nonsense
    residual[0, m - 100 : m] = 1e6
    groups = np.repeat([0, 1], m)
    found = worths(residual, weights, groups)
    taus = [autocorrelation_time(residual[0, : m - 100]), autocorrelation_time(residual[1, :m])]
    np.testing.assert_allclose(found, [1 / np.median(taus), 1.0], rtol=1e-12)


def test_an_output_that_nobody_measured_is_worth_what_it_is():
    np.testing.assert_array_equal(worths(np.ones((2, 6)), np.zeros((2, 6)), np.repeat([0, 1], 3)), [1.0, 1.0])


# --- the memory of the noise ---------------------------------------------------------------------------------------


def gaps_of(shape):
    gaps = np.ones(shape)
    gaps[:, 0] = np.inf
    return gaps


@pytest.mark.parametrize("rho", [0.2, 0.9, 0.97])
def test_memory_of_noise_of_declared_size_is_found_beside_a_smooth_error_of_the_model(rho):
    random, shape = np.random.default_rng(6), (6, 640)
    wrong = 2 * np.sin(np.linspace(0, 20, shape[1]))
    for error in (0.0, wrong):
        found = [
            noise_of(ar1(random, rho, shape) + error, gaps_of(shape), np.ones(shape, bool), None) for _ in range(40)
        ]
        remembered = np.exp(-1 / np.asarray([noise.time for noise in found]))
        # A change of 2·20/640 = 0.06 a sample from the model's error adds 0.002 to ½E(Δz)² at most.
        assert abs(remembered.mean() - rho) < 0.003 + 3 * remembered.std() / np.sqrt(40)
        assert remembered.std() < 1.5 * (1 - rho) * np.sqrt(3 / np.prod(shape)) + 1e-3


def test_white_noise_has_no_memory_nor_has_noise_that_is_smaller_than_declared():
    random, shape = np.random.default_rng(7), (4, 300)
    for size in (1.0, 0.5):
        found = [
            noise_of(size * random.standard_normal(shape), gaps_of(shape), np.ones(shape, bool), None)
            for _ in range(200)
        ]
        assert sum(noise.time > 0 for noise in found) <= 3


def test_uneven_samples_have_one_memory_time():
    random, m = np.random.default_rng(8), 4000
    gaps = np.concatenate([[np.inf], random.uniform(0.2, 3.0, m - 1)])[None]
    rho, z = np.exp(-gaps / 5.0)[0], random.standard_normal(m)
    for k in range(1, m):
        z[k] = rho[k] * z[k - 1] + np.sqrt(1 - rho[k] ** 2) * z[k]
    assert noise_of(z[None], gaps, np.ones((1, m), bool), None).time == pytest.approx(5.0, rel=0.15)


@pytest.mark.parametrize("noise", ["white", "t5", "0.2", "0.9"])
def test_size_of_the_residual_is_judged_rightly_whatever_the_shape_and_memory_of_the_noise(noise):
    random, shape = np.random.default_rng(9), (4, 400)
    gaps, used, groups, values = gaps_of(shape), np.ones(shape, bool), np.zeros(shape[1], int), []
    for _ in range(600):
        if noise == "t5":
            z = random.standard_t(5, shape) / np.sqrt(5 / 3)
        else:
            z = ar1(random, 0.0 if noise == "white" else float(noise), shape)
        estimate = estimate_noise(z, gaps, used, groups, np.ones(1, bool), [None])
        values.append(size_p_value(z, used, estimate.memory, {0: estimate.noises[0]}, groups, 0))
    # 600 of them: 1 % scatters by 0.4 %.
    assert np.mean(np.asarray(values) < 0.01) <= 0.02
    assert 0.06 < np.mean(np.asarray(values) < 0.1) < 0.15


# --- what it is for: intervals that cover --------------------------------------------------------------------------

SAMPLES, EXPERIMENTS, REPETITIONS = 640, 6, 100
TRUTH = np.asarray([2.0, -1.0])


def curves() -> np.ndarray:
    """Two smooth curves of time, (m, 2): an offset, and a wave."""
    t = np.linspace(0, 1, SAMPLES)
    return np.stack([np.ones_like(t), np.sin(2 * np.pi * t)], axis=1)


def covered(errors: list[Error], rho: float) -> float:
    """Share of truths within their 90 % intervals (Gauss–Newton at the MAP)."""
    basis = jnp.asarray(curves())
    posterior = Posterior(
        Predictor(lambda theta, conditions: (conditions.inputs["gain"] * (basis @ theta), jnp.asarray(True))),
        {"a": Prior("normal", [0.0, 10.0]), "b": Prior("normal", [0.0, 10.0])},
        errors,
        ["y"],
        np.zeros(SAMPLES, dtype=int),
    )
    settings, random, inside = Settings(2, 1, 50, sampler="laplace"), np.random.default_rng(5), []
    conditions, shape = Conditions({"gain": jnp.ones(EXPERIMENTS)}), (EXPERIMENTS, SAMPLES)
    for _ in range(REPETITIONS):
        values = (curves() @ TRUTH) + 0.5 * ar1(random, rho, shape)
        data = data_of(conditions, values, np.ones(shape, bool), gaps_of(shape), EXPERIMENTS)
        found = fit(
            posterior, data, starts=2, settings=settings, key=jax.random.key(0), units={}, errors=errors
        ).maximum
        sd = np.sqrt(np.diag(found.covariance))[:2]
        inside.append(np.abs(np.asarray(found.theta)[:2] - TRUTH) < 1.645 * sd)
    return float(np.mean(inside))


@pytest.mark.slow
@pytest.mark.parametrize("times", [10, 33, 82])
def test_intervals_cover_where_the_noise_has_a_memory(times):
    # So many correlation times to a record: τ = (1 + ρ)/(1 − ρ).
    tau = SAMPLES / times
    # 200 nearly independent trials scatter by 2.1 %.
    assert 0.85 <= covered([Error(0.5)], (tau - 1) / (tau + 1)) <= 0.95


@pytest.mark.slow
def test_intervals_cover_where_the_noise_is_white():
    assert 0.85 <= covered([Error(0.5)], 0.0) <= 0.95


@pytest.mark.slow
def test_samples_counted_as_independent_give_intervals_that_do_not_cover():
    # τ = 9 makes the intervals three times too narrow: |N(0, 1)| < 1.645/3 in 42 %.
    assert 0.25 < covered([Error(0.5, correlated=False)], RHO) < 0.60


@pytest.mark.whole
def test_a_memory_is_inferred_with_the_size_where_the_study_says_that_there_is_one():
    assert 0.83 <= covered([Error(Prior("half_normal", 3.0), correlated=True)], RHO) <= 0.96


@pytest.mark.whole
def test_intervals_under_a_long_memory_that_is_not_told_cover():
    """A linear model, records of ten correlation times: 90 % intervals hold the truth in 90 % of 800 campaigns."""
    random, rho, records, m = np.random.default_rng(11), 0.949, 4, 395
    t = np.linspace(0, 6, m)
    slopes = np.stack([[np.sin(w * t), t / 6 * np.cos(w * t)] for w in (2.0, 3.1, 4.3, 5.2)])  # (records, p, m)
    gaps, used = np.full((records, m), t[1]), np.ones((records, m), dtype=bool)
    gaps[:, 0] = np.inf

    def solved(noise, memory, worth):
        shares = np.sqrt(worth)
        along = shares * whitened(slopes, memory[:, None]).transpose(1, 0, 2).reshape(2, -1)
        of_noise = shares * whitened(noise, memory).ravel()
        covariance = np.linalg.inv(along @ along.T)
        return covariance @ along @ of_noise, np.sqrt(np.diag(covariance))

    held = []
    for _ in range(800):
        noise, memory, worth = ar1(random, rho, (records, m)), np.zeros((records, m)), 1.0
        for _ in range(3):
            off, _ = solved(noise, memory, worth)
            residual = np.einsum("p,epm->em", off, slopes) - noise
            told = estimate_noise(residual, gaps, used, np.zeros(m, int), np.array([True]), [None])
            memory, worth = told.memory, float(told.worth[0])
        off, sd = solved(noise, memory, worth)
        held.append(np.abs(off) < 1.645 * sd)
    # Three standard errors of a share of 0.9.
    assert np.mean(held, axis=0) == pytest.approx(0.9, abs=0.032)
