"""The discrepancy of a model: against dense formulas, and in simulation, where what is best and what is wrong are known."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import block_diag

from hsed_jax.analysis.calibration import calibrate_built
from hsed_jax.config.load import load_study
from hsed_jax.criticism.compare import compare
from hsed_jax.criticism.prediction import Band, Prediction, learned_misfit, predict
from hsed_jax.errors import UserError
from hsed_jax.inference.discrepancy.inputs import Process, Support
from hsed_jax.inference.fit import fit
from hsed_jax.inference.likelihood import Error, data_of
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.observation import stacked
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Campaign, Channel, Experiment, Record
from hsed_jax.physics.simulator import Conditions
from hsed_jax.reporting.band_figures import band_parts, nested
from hsed_jax.study.build import Built

pytestmark = pytest.mark.whole

# --- the process, by dense matrices ----------------------------------------------------------------------------------


def matern(a, b, lengths):
    apart = np.sqrt(5) * np.sqrt((((a[:, None] - b[None]) / lengths) ** 2).sum(-1))
    return (1 + apart + apart**2 / 3) * np.exp(-apart)


@pytest.fixture(scope="module")
def process():
    random = np.random.default_rng(0)
    across = np.linalg.qr(random.standard_normal((9 * 2, 3)))[0].reshape(9, 2, 3)
    used = np.ones((6, 2))
    used[4, 1] = used[5] = 0.0
    arrays = (np.array([1.5, 0.4]), np.array([0.3, 0.8]), random.uniform(size=(9, 2)), across,
              random.uniform(size=(6, 2)), used)  # fmt: skip
    return Process(*map(jnp.asarray, arrays))


def covariance(process, *places):
    """Of δ at places and of its functionals Σ F δ at the measure, jointly, and conditioned on these being zero."""
    amplitudes, lengths, measure, across = (np.asarray(x) for x in (
        process.amplitudes, process.lengths, process.measure, process.across))  # fmt: skip
    points = np.concatenate([*places, measure])
    joint = np.kron(matern(points, points, lengths), np.diag(amplitudes**2))
    size = len(points) - len(measure)
    gather = block_diag(np.eye(2 * size), across.reshape(-1, across.shape[-1]).T)
    joint = gather @ joint @ gather.T
    own, functionals = slice(0, 2 * size), slice(2 * size, None)
    return joint[own, own] - joint[own, functionals] @ np.linalg.solve(
        joint[functionals, functionals], joint[functionals, own]
    )


def test_the_whitening_is_that_of_noise_and_a_process_that_has_no_part_in_the_sensitivities(process):
    used = np.asarray(process.used).ravel()
    wanted = np.eye(12) + used[:, None] * covariance(process, np.asarray(process.at)) * used
    found = process.whitening
    np.testing.assert_allclose(found.factor @ wanted @ found.factor.T, np.eye(12), atol=1e-7)
    assert float(found.log_determinant) == pytest.approx(np.linalg.slogdet(wanted)[1], abs=1e-7)


def test_at_the_measure_the_process_is_orthogonal_to_the_sensitivities(process):
    at_measure = covariance(process, np.asarray(process.measure))
    across = np.asarray(process.across).reshape(-1, 3)
    weights, variance = process.conditional(process.measure)
    # Whatever the residuals of the experiments are, the mean of δ has no part in them; nor has what is left open.
    np.testing.assert_allclose(across.T @ np.asarray(weights), 0.0, atol=1e-7)
    assert np.all(np.asarray(variance).ravel() <= np.diag(at_measure) + 1e-9)


def test_the_conditional_is_that_of_a_joint_gaussian(process):
    points = np.random.default_rng(1).uniform(size=(3, 2))
    joint = covariance(process, np.asarray(process.at), points)
    known = np.flatnonzero(np.asarray(process.used).ravel())
    noisy = joint[np.ix_(known, known)] + np.eye(known.size)
    between = joint[12:, :][:, known]
    weights, variance = process.conditional(jnp.asarray(points))
    # The residual is predicted less measured: the discrepancy has the other sign.
    np.testing.assert_allclose(np.asarray(weights)[:, known], -between @ np.linalg.inv(noisy), atol=1e-7)
    left = np.diag(joint[12:, 12:]) - np.einsum("ij,ji->i", between, np.linalg.solve(noisy, between.T))
    np.testing.assert_allclose(np.asarray(variance).ravel(), left, atol=1e-7)


# --- a line on what is no line ---------------------------------------------------------------------------------------

# Plumlee 2017: the model is θx, the specimen 4x + x sin 5x; in squares over the unit interval 3.5647 predicts best.
BEST = 4 + 3 * float(np.trapezoid(np.linspace(0, 1, 20001) ** 2 * np.sin(5 * np.linspace(0, 1, 20001)), dx=1 / 20000))
NOISE = 0.02


def bent(x):
    return 4 * x + x * np.sin(5 * x)


def straight(x):
    return 3.0 * x


def conditions_at(x):
    return stacked([Conditions({"x": jnp.asarray(v)}) for v in x])


def data_at(x, specimen, seed):
    values = specimen(x) + NOISE * np.random.default_rng(seed).standard_normal(x.size)
    return data_of(conditions_at(x), values[:, None], np.ones((x.size, 1), bool), np.full((x.size, 1), np.inf), x.size)


SPREAD = (np.arange(64) + 0.5) / 64
SUPPORT = Support(("x",), lambda inputs: np.asarray(inputs["x"])[:, None], conditions_at(SPREAD))


def line(theta, conditions):
    return (theta[0] * conditions.inputs["x"])[None], True


def calibrated(specimen, seed, watch=None, number=12):
    errors = [Error(NOISE, discrepancy=True)]
    posterior = Posterior(Predictor(line), {"theta": Prior("normal", [0.0, 10.0])}, errors, ["y"], np.arange(1))
    x = (np.arange(number) + np.random.default_rng(1000 + seed).uniform(size=number)) / number
    return fit(
        posterior,
        data_at(x, specimen, seed),
        starts=1,
        settings=Settings(2, 1, 100, sampler="laplace"),
        key=jax.random.key(seed),
        units={},
        errors=errors,
        support=SUPPORT,
        watch=watch,
    )


@pytest.fixture(scope="module")
def fits():
    return [calibrated(bent, seed) for seed in range(20)]


def ordinary(found):
    """Least squares on the same data, in closed form: estimate and sd."""
    x, y = np.asarray(found.data.conditions.inputs["x"]), np.asarray(found.data.values)[:, 0]
    return x @ y / (x @ x), NOISE / np.sqrt(x @ x)


def interval(found):
    middle, sd = float(found.maximum.theta[0]), float(np.sqrt(found.maximum.covariance[0, 0]))
    return middle - 1.645 * sd, middle + 1.645 * sd


def test_intervals_hold_the_parameter_that_predicts_best(fits):
    """18 of 20 are to be expected, 15 or fewer with a probability of 4 %."""
    assert pytest.approx(3.5647, abs=1e-3) == BEST
    held = sum(low < BEST < high for low, high in map(interval, fits))
    assert held >= 16
    alone = [ordinary(found) for found in fits]
    assert sum(abs(middle - BEST) < 1.645 * sd for middle, sd in alone) < 10


def test_bands_hold_new_experiments_and_are_the_sum_of_their_parts(fits):
    x = np.linspace(0.02, 0.98, 40)
    inside, without = [], []
    for seed, found in enumerate(fits):
        there = predict(found, data_at(x, bent, 500 + seed), ())
        inside.append(np.abs(there.mean - there.measured) < 1.645 * there.sd)
        without.append(np.abs(there.without.mean - there.measured) < 1.645 * there.without.sd)
        np.testing.assert_allclose(sum(part**2 for part in there.parts.values()), there.sd**2)
        np.testing.assert_allclose(there.parts["noise"], NOISE, rtol=1e-6)
    assert 0.85 < np.mean(inside) < 0.95
    assert np.mean(without) < 0.3


def test_a_model_that_is_right_has_no_discrepancy_and_the_ordinary_interval():
    shares = []
    for seed in range(8):
        found = calibrated(straight, seed)
        shares.append(float(found.discrepancy.amplitudes[0]))
        wide, (middle, plain) = np.sqrt(float(found.maximum.covariance[0, 0])), ordinary(found)
        if shares[-1] < 0.1:
            assert wide == pytest.approx(plain, rel=0.05)
            assert found.map["theta"] == pytest.approx(middle, abs=0.1 * plain)
    # In units of the noise; some noise looks like a curve.
    assert sum(share < 0.1 for share in shares) >= 5 and np.median(shares) < 0.01


def test_the_error_is_attributed_to_noise_and_model(fits):
    x = np.linspace(0.02, 0.98, 40)
    experiments = tuple(Experiment(f"T{i:02d}", {"x": float(v)}) for i, v in enumerate(x))
    there = predict(fits[0], data_at(x, bent, 7), experiments)
    found = compare(there, None, np.asarray([True]), 1, [])
    parts, error = found.train.parts, found.train.error
    assert np.sqrt(found.train.noise_floor**2 + sum(part**2 for part in parts.values())) == pytest.approx(
        error, rel=0.1
    )
    assert parts["model"] > 5 * found.train.noise_floor and parts["parameters"] < parts["model"]
    own = found.train.per_output["y"]
    assert own["coverage_90"] > 0.8 > own["coverage_90_without"]
    assert "is to be expected from noise" in found.summary()["notes"][0] and "model" in repr(found)


def test_the_misfit_is_located_in_what_was_learned_over_all_inputs(fits):
    fitted = predict(fits[0], fits[0].data, ())
    there = learned_misfit(fits[0], fitted)
    x = np.asarray([e.inputs["x"] for e in there.experiments])
    np.testing.assert_allclose(x, SPREAD)
    wrong = bent(x) - fits[0].map["theta"] * x
    np.testing.assert_allclose(-there.residual[:, 0], wrong, atol=3 * NOISE)
    assert learned_misfit(replace(fits[0], discrepancy=None), fitted) is fitted


def test_a_resumed_calibration_has_the_same_discrepancy():
    kept = {}
    watch = Watch()
    watch.keep, watch.recall = kept.__setitem__, kept.get
    first, again = (calibrated(bent, 0, watch=watch) for _ in range(2))
    assert any(name.startswith("maximum") for name in kept)
    for one, other in zip(jax.tree.leaves(first.discrepancy), jax.tree.leaves(again.discrepancy), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(first.chains.theta, again.chains.theta)
    assert first.map == again.map and first.discrepancy_summary() == again.discrepancy_summary()


# --- relative errors, and what a study says --------------------------------------------------------------------------


def test_a_relative_discrepancy_is_one_of_the_logarithm():
    errors = [Error(0.1, is_relative=True), Error(2.0)]
    model = Predictor(lambda theta, c: (jnp.stack([theta[0], theta[0]]), True))
    posterior = Posterior(model, {"theta": Prior("normal", [0.0, 10.0])}, errors, ["a", "b"], np.arange(2))
    data = data_of(conditions_at(np.ones(1)), np.ones((1, 2)), np.ones((1, 2), bool), np.full((1, 2), np.inf), 1)
    by = jnp.asarray([[3.0, 3.0]])
    moved, slope = posterior.displaced(jnp.asarray([5.0]), jnp.asarray([[5.0, 5.0]]), by, data)
    sd = float(np.log(moved[0, 0] / 5.0)) / 3.0
    assert sd == pytest.approx(0.1, rel=0.02)  # sd of log|1 + 0.1 ε|
    np.testing.assert_allclose(moved[0, 1], 11.0)
    np.testing.assert_allclose(slope[0], [sd * moved[0, 0], 2.0])


PAPER = "configs/paper.yaml"


def test_a_discrepancy_of_one_or_two_shaken_records_is_refused_with_the_reason():
    told = ["error={relative: 0.05, discrepancy: true}", "observe=histories", "steps=[calibrate]"]
    for number, many in ((1, "one experiment does"), (2, "two experiments do")):
        reason = f"{many} not show how much the error of the model differs.*at least 3 experiments.*inflate: true"
        with pytest.raises(UserError, match=reason):
            Built(load_study(PAPER, [*told, f"design.initial={number}"])).check()
    Built(load_study(PAPER, [*told, "design.initial=3"])).check()
    Built(load_study(PAPER, [told[0], "steps=[calibrate]", "design.initial=1"])).check()
    # The motion of a component test is imposed: the next one has its own.
    Built(load_study("configs/cyclic.yaml", [*told, "design.initial=1"])).check()


def test_a_calibration_on_one_shaken_record_is_refused_before_it_begins():
    told = ["error={relative: 0.05, discrepancy: true}", "observe=histories", "steps=[calibrate]", "design.initial=3"]
    study = load_study(PAPER, told)
    record = Record(np.linspace(0, 1, 5), {"ground_acceleration": np.zeros(5), "force": np.ones(5)})
    channels = {
        name: Channel(name, unit) for name, unit in (("time", "s"), ("ground_acceleration", "m/s^2"), ("force", "N"))
    }
    campaign = Campaign("one", "ground_motion", inputs={"V_P": "m/s", "T_P": "s"}, channels=channels)
    campaign = campaign.add(Experiment("E1", {"V_P": 2.0, "T_P": 1.0}, record=record))
    with pytest.raises(UserError, match="one experiment does not show"):
        calibrate_built(Built(study), campaign)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("{relative: 0.05, inflate: true, discrepancy: true}", "give inflate or discrepancy, not both"),
        ("{unknown: true, discrepancy: true}", "needs a declared error"),
    ],
)
def test_what_contradicts_itself_is_refused(error, words):
    with pytest.raises(UserError, match=words):
        load_study(PAPER, [f"error={error}"])


def test_a_discrepancy_that_cannot_be_learned_is_refused():
    with pytest.raises(UserError, match="no noise of peak_force is declared"):
        Built(load_study(PAPER, ["error={discrepancy: true}"])).check()


# --- the figure ------------------------------------------------------------------------------------------------------


def test_shades_hold_the_parts_inside_them():
    random = np.random.default_rng(0)
    parts = {name: np.full((4, 2), size) for name, size in (("noise", 3.0), ("parameters", 1.0), ("model", 2.0))}
    table = random.standard_normal((4, 2)) + 10
    sd = np.sqrt(sum(part**2 for part in parts.values()))
    without = Band(table, {name: parts[name] for name in ("noise", "parameters")})
    prediction = Prediction(
        ("peak_force", "peak_elongation"), np.arange(2), tuple(Experiment(f"E{i}") for i in range(4)), table,
        np.ones((4, 2), bool), table, table + 1, sd, parts["noise"], np.ones(4, bool), parts=parts, without=without,
    )  # fmt: skip
    widths = nested(prediction)
    assert list(widths) == ["parameters", "model", "noise"]
    np.testing.assert_allclose(widths["model"], 1.6448536 * np.sqrt(5.0))
    np.testing.assert_allclose(widths["noise"], 1.6448536 * sd)
    np.testing.assert_allclose(prediction.correction, 1.0)
    np.testing.assert_allclose(prediction.misfit["model"], np.hypot(1.0, 2.0))
    comparison = compare(prediction, None, np.ones(2, bool), 1, [])
    picture = band_parts(comparison, Campaign("by hand", "ground_motion"))
    assert "4 of 4 measurements inside" in picture.alt and len(picture.figure.axes) == 2


# --- the paper's case ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bands_of_a_model_without_degradation_hold_the_degrading_specimen():
    """`benchmarks/discrepancy.py` in small: of 8 campaigns of 20 experiments."""
    from discrepancy import Case, look

    found = [look(Case(20, "discrepancy"), seed) for seed in range(8)]
    assert 0.85 < np.mean([one["measured"] for one in found]) < 0.95
    assert 0.8 < np.mean([one["specimen"] for one in found]) < 0.97
    assert np.mean([list(one["holds"].values()) for one in found]) > 0.6
    alone = [look(Case(20, ""), seed) for seed in range(8)]
    assert np.mean([one["measured"] for one in alone]) < 0.75
