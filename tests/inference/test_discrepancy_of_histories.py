"""The discrepancy of histories: against dense formulas, and in simulation, where what is best and what is wrong are known."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.config.load import load_study
from hsed_jax.criticism.compare import compare
from hsed_jax.criticism.prediction import learned_misfit, predict
from hsed_jax.errors import UserError
from hsed_jax.inference.discrepancy.cycles import OverCycles, Products
from hsed_jax.inference.discrepancy.learning import cycle_history
from hsed_jax.inference.fit import fit
from hsed_jax.inference.likelihood import Error, data_of
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.observation import stacked
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Experiment, Record
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

pytestmark = pytest.mark.whole

# --- the process, by dense matrices ----------------------------------------------------------------------------------

N, G, M, P = 3, 2, 7, 2


@pytest.fixture(scope="module")
def process():
    random = np.random.default_rng(0)
    used = np.ones((N, G, M))
    used[2, :, 5:] = used[1, 1] = 0.0
    memory = np.where(np.arange(M) > 0, 0.4, 0.0) * np.array([[1.0], [0.0]]) * used
    arrays = (
        np.array([1.5, 0.7]), np.array(1.2), np.array(3.0), np.array([0.3, 0.8]), np.ones(G), np.ones((N, G)),
        random.uniform(0.3, 2, (N, G, M)), np.cumsum(random.uniform(0.05, 0.3, (N, G, M)), axis=-1),
        random.standard_normal((N, G, M, P)), used, memory, np.ones((N, G, M)),
    )  # fmt: skip
    return OverCycles(*map(jnp.asarray, arrays))


def oscillator(apart, swings, quality):
    """Covariance of a damped oscillator driven by white noise (Foreman-Mackey et al. 2017, Eq. 33)."""
    way, beat = np.pi * swings * np.abs(apart) / quality, np.sqrt(4 * quality**2 - 1)
    return np.exp(-way) * (np.cos(beat * way) + np.sin(beat * way) / beat)


def dense(process):
    """K at all samples, C₀ of those that were measured, and J there."""
    tables = (process.size, process.cycles, process.used, process.memory, process.along)
    size, cycles, used, memory, along = map(np.asarray, tables)
    every, noise = np.zeros((N * G * M,) * 2), np.eye(N * G * M)
    for e in range(N):
        for g in range(G):
            own = slice((e * G + g) * M, (e * G + g + 1) * M)
            s, x = float(process.amplitudes[g]) * size[e, g], cycles[e, g]
            every[own, own] = s[:, None] * s * oscillator(x[:, None] - x, float(process.swings), float(process.quality))
            for i in range(M):
                for j in range(i):
                    shared = np.prod(memory[e, g, j + 1 : i + 1])
                    noise[own.start + i, own.start + j] = noise[own.start + j, own.start + i] = shared
        own = slice(e * G * M, (e + 1) * G * M)
        moved = along[e].reshape(-1, P) * np.asarray(process.spread)
        every[own, own] += moved @ moved.T
    mask = used.ravel()
    return every, noise + mask[:, None] * every * mask, mask[:, None] * along.reshape(-1, P)


def residuals(process):
    return np.asarray(process.used).ravel() * np.random.default_rng(1).standard_normal(N * G * M)


def test_the_marginal_likelihood_is_that_of_the_dense_covariance(process):
    _, covariance, along = dense(process)
    basis = np.linalg.qr(along)[0]
    on, across = basis @ basis.T, np.eye(len(basis)) - basis @ basis.T
    split = on @ covariance @ on + across @ covariance @ across
    columns = np.column_stack([residuals(process), along])
    found = Products(process, jnp.asarray(columns).reshape(N, G, M, -1))
    np.testing.assert_allclose(found.products, columns.T @ np.linalg.solve(split, columns), rtol=1e-8, atol=1e-8)
    assert float(found.log_determinant) == pytest.approx(np.linalg.slogdet(split)[1], abs=1e-8)
    # So least squares is the best that can be done, and its covariance is that of correlated errors.
    weigh = np.linalg.inv(along.T @ along)
    wanted = weigh @ along.T @ covariance @ along @ weigh
    np.testing.assert_allclose(np.linalg.inv(np.asarray(found.products)[1:, 1:]), wanted, rtol=1e-7)


def test_parameters_are_told_along_their_sensitivities_and_the_rest_is_tempered(process):
    _, covariance, along = dense(process)
    basis = np.linalg.qr(along)[0]
    inner = basis.T @ covariance @ basis
    across = np.eye(len(basis)) - basis @ basis.T
    wanted = basis @ np.linalg.inv(inner) @ basis.T + across / np.linalg.eigvalsh(inner).max()
    found = process.whitening
    factor = np.stack([np.asarray(found(jnp.asarray(x).reshape(N, -1))) for x in np.eye(len(basis))], axis=1)
    np.testing.assert_allclose(factor.T @ factor, wanted, atol=1e-9)
    known = np.flatnonzero(np.asarray(process.used).ravel())
    size = np.linalg.slogdet(wanted[np.ix_(known, known)])[1]
    assert float(found.log_determinant) == pytest.approx(-size, abs=1e-8)


def test_what_is_known_of_an_experiment_is_universal_kriging(process):
    every, covariance, along = dense(process)
    z, mask = residuals(process), np.asarray(process.used).ravel()
    everywhere, between = np.asarray(process.along).reshape(-1, P), every * mask
    inverse = np.linalg.inv(covariance)
    told = along.T @ inverse @ along
    move = np.linalg.solve(told, along.T @ inverse @ z)
    rest = everywhere - between @ inverse @ along
    mean, variance = process.conditional(jnp.asarray(z).reshape(N, -1))
    # The residual is predicted less measured: the predictions fall short by the other sign.
    np.testing.assert_allclose(np.ravel(mean), -(everywhere @ move + between @ inverse @ (z - along @ move)), atol=1e-8)
    left = np.diag(every) - np.einsum("ij,jk,ik->i", between, inverse, between)
    left += np.einsum("ip,pq,iq->i", rest, np.linalg.inv(told), rest)
    np.testing.assert_allclose(np.ravel(variance), left, atol=1e-8)


def test_a_course_counts_cycles_and_has_their_amplitude():
    time = np.linspace(0, 6, 601)
    # Cycles that grow, at a rate that falls: neither counts by itself.
    phase = 2 * np.pi * 4 * np.sqrt(time / 6)
    found = cycle_history(((1 + time) * np.sin(phase))[None])
    np.testing.assert_allclose(found.cycles[0, -1], 4.25, atol=0.3)
    assert np.all(np.diff(found.cycles[0]) >= 0)
    middle = slice(150, 450)
    np.testing.assert_allclose(found.amplitude[0, middle], (1 + time)[middle], rtol=0.2)


# --- an oscillation whose damping grows ------------------------------------------------------------------------------

TIMES, NOISE = np.linspace(0, 6, 121), 0.05


def oscillation(theta, x, fading=0.0, np=jnp):
    """A free vibration of frequency θ from an amplitude x; of the specimen it falls with amplitude and time."""
    cycles = theta * TIMES * (1 - fading * x * TIMES / 12)
    return x * np.exp(-0.15 * TIMES) * np.sin(2 * np.pi * cycles)


def respond(theta, conditions):
    return oscillation(theta[0], conditions.inputs["x"]), True


def experiments(count, seed, fading):
    random = np.random.default_rng(seed)
    inputs = random.uniform(0.5, 1.5, count)
    exact = np.stack([oscillation(1.0, x, fading, np) for x in inputs])
    sizes = NOISE * np.sqrt(np.mean(exact**2, axis=1, keepdims=True))
    values = exact + sizes * random.standard_normal(exact.shape)
    gaps = np.full(values.shape, TIMES[1])
    gaps[:, 0] = np.inf
    rows = stacked([Conditions({"x": jnp.asarray(x)}) for x in inputs])
    records = [Record(TIMES, {"force": row}) for row in values]
    named = tuple(
        Experiment(f"E{i}", {"x": float(x)}, record=r) for i, (x, r) in enumerate(zip(inputs, records, strict=True))
    )
    return data_of(rows, values, np.ones(values.shape, bool), gaps, count), exact, named


def calibrated(fading, seed, discrepancy=True, watch=None, count=6):
    errors = [Error(NOISE, is_relative=True, discrepancy=discrepancy)]
    priors, groups = {"theta": Prior("normal", [1.0, 0.2])}, np.zeros(TIMES.size, int)
    posterior = Posterior(Predictor(respond), priors, errors, ["force"], groups)
    data, _, _ = experiments(count, seed, fading)
    settings = Settings(2, 1, 100, sampler="laplace")
    return fit(
        posterior, data, starts=3, settings=settings, key=jax.random.key(seed), units={}, errors=errors, watch=watch
    )


def interval(found):
    s = found.summary()["theta"]
    return s["q05"], s["q95"]


FADING = 0.15


@pytest.fixture(scope="module")
def best():
    """The frequency that predicts best over all amplitudes."""
    return calibrated(FADING, 10_000, discrepancy=False, count=400).map["theta"]


@pytest.fixture(scope="module")
def fits():
    return [calibrated(FADING, seed) for seed in range(20)]


def test_intervals_hold_the_parameter_that_predicts_best(fits, best):
    """18 of 20 are to be expected, 15 or fewer with a probability of 4 %."""
    assert sum(low < best < high for low, high in map(interval, fits)) >= 16
    alone = [calibrated(FADING, seed, discrepancy=False) for seed in range(8)]
    assert sum(low < best < high for low, high in map(interval, alone)) < 6


def test_bands_hold_new_experiments_and_are_the_sum_of_their_parts(fits):
    inside, without = [], []
    for seed, found in enumerate(fits):
        data, _, named = experiments(4, 500 + seed, FADING)
        there = predict(found, data, named)
        inside.append(np.abs(there.mean - there.measured) < 1.645 * there.sd)
        without.append(np.abs(there.without.mean - there.measured) < 1.645 * there.without.sd)
        np.testing.assert_allclose(sum(part**2 for part in there.parts.values()), there.sd**2)
        np.testing.assert_allclose(there.correction, 0.0, atol=1e-12)
    assert 0.84 < np.mean(inside) < 0.97
    assert np.mean(without) < np.mean(inside) - 0.1


def test_an_experiment_that_was_fitted_is_known_and_goes_on(fits):
    found = fits[0]
    _, exact, named = experiments(6, 0, FADING)
    there = predict(found, found.data, named)
    assert np.sqrt(np.mean((there.mean - exact) ** 2)) < 0.5 * np.sqrt(np.mean((there.predicted - exact) ** 2))
    assert np.mean(np.abs(there.mean - there.measured) < 1.645 * there.sd) > 0.85
    learned = learned_misfit(found, there)
    np.testing.assert_allclose(learned.residual, there.predicted - there.mean)
    assert learned_misfit(replace(found, discrepancy=None), there) is there
    parts = compare(there, None, np.asarray([True]), 1, []).train
    assert parts.per_output["force"]["coverage_90"] > parts.per_output["force"]["coverage_90_without"]


def test_a_model_that_is_right_has_no_discrepancy_and_the_ordinary_interval():
    for seed in range(4):
        found, plain = calibrated(0.0, seed), calibrated(0.0, seed, discrepancy=False)
        wide, narrow = (float(np.sqrt(each.maximum.covariance[0, 0])) for each in (found, plain))
        assert found.map["theta"] == pytest.approx(plain.map["theta"], abs=0.2 * narrow)
        assert 0.95 * narrow < wide < 1.6 * narrow
        assert float(found.discrepancy.amplitudes[0]) < 0.5


def test_a_resumed_calibration_has_the_same_discrepancy():
    kept, watch = {}, Watch()
    watch.keep, watch.recall = kept.__setitem__, kept.get
    first, again = (calibrated(FADING, 0, watch=watch) for _ in range(2))
    for one, other in zip(jax.tree.leaves(first.discrepancy), jax.tree.leaves(again.discrepancy), strict=True):
        np.testing.assert_array_equal(one, other)
    assert first.map == again.map and first.discrepancy_summary() == again.discrepancy_summary()
    assert set(first.discrepancy_summary()["cycles"]) == {"swing", "memory"}


def test_a_discrepancy_of_histories_beside_levels_is_refused():
    told = ["error={relative: 0.05, discrepancy: true}", "observe=histories", "steps=[calibrate]",
            "model.levels={specimen: [A]}"]  # fmt: skip
    with pytest.raises(UserError, match="scatter between specimens"):
        Built(load_study("configs/paper.yaml", told)).check()


# --- the paper's case ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bands_of_a_model_without_degradation_hold_the_histories_of_the_degrading_specimen():
    """`benchmarks/discrepancy.py` in small: of 8 campaigns of 6 experiments."""
    from discrepancy import Case, look

    found = [look(Case(6, "discrepancy", observe="histories"), seed) for seed in range(8)]
    assert 0.8 < np.mean([one["measured"] for one in found]) < 0.97
    assert np.mean([list(one["holds"].values()) for one in found]) > 0.7
    alone = [look(Case(6, "", observe="histories"), seed) for seed in range(8)]
    assert np.mean([one["measured"] for one in alone]) < 0.6
