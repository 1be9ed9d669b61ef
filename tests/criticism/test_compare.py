"""The figures of a comparison by hand on small arrays, and its p-value on noise that is what it is declared to be."""

import json

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from hsed_jax.criticism.compare import compare, discrepancy_p_value
from hsed_jax.criticism.prediction import Prediction, error_cell
from hsed_jax.errors import UserError
from hsed_jax.measurements import Experiment, Record
from hsed_jax.measurements.noise import record_noise

DECLARED = np.asarray([True])


def prediction_of(measured, predicted, sigma=1.0, outputs=("force",), experiments=None, **changes) -> Prediction:
    """A prediction made by hand; columns are shared evenly among the outputs."""
    measured, predicted = (np.atleast_2d(np.asarray(x, float)) for x in (measured, predicted))
    rows, columns = measured.shape
    sigma = np.broadcast_to(np.asarray(sigma, float), measured.shape)
    fields = {
        "outputs": tuple(outputs),
        "groups": np.repeat(np.arange(len(outputs)), columns // len(outputs)),
        "experiments": tuple(experiments or (Experiment(f"E{i + 1:02d}") for i in range(rows))),
        "measured": measured,
        "used": np.isfinite(measured),
        "predicted": predicted,
        "mean": predicted,
        "sd": sigma,
        "sigma": sigma,
        "converged": np.ones(rows, dtype=bool),
    }
    return Prediction(**{**fields, **changes})


def recorded(id, time, **channels) -> Experiment:
    return Experiment(
        id, record=Record(np.asarray(time, float), {k: np.asarray(v, float) for k, v in channels.items()})
    )


# --- by hand ---------------------------------------------------------------------------------------------------------

MEASURED = [0.0, 2.0, 4.0, 2.0]  # mean 2, RMS about it √2
PREDICTED = [1.0, 2.0, 3.0, 4.0]  # residual 1, 0, -1, 2: RMS √1.5, mean ½


@pytest.fixture(scope="module")
def by_hand():
    return compare(prediction_of(MEASURED, PREDICTED, 0.5), None, DECLARED, 0, [])


def test_error_is_the_rms_residual_over_the_rms_about_the_mean(by_hand):
    assert by_hand.train.error == pytest.approx(np.sqrt(1.5 / 2))
    assert by_hand.train.per_output["force"]["nrmse"] == pytest.approx(np.sqrt(0.75))


def test_noise_floor_is_the_same_figure_of_the_declared_noise(by_hand):
    assert by_hand.train.noise_floor == pytest.approx(0.5 / np.sqrt(2))


def test_bias_r2_peak_and_coverage_by_hand(by_hand):
    found = by_hand.train.per_output["force"]
    assert found["bias"] == pytest.approx(0.5 / np.sqrt(2))
    assert found["r2"] == pytest.approx(1 - 0.75)
    assert found["peak_error"] == pytest.approx(0.0)
    # |residual| ≤ 1.645 × 0.5 holds for one of four.
    assert found["coverage_90"] == pytest.approx(0.25)


def test_peak_error_is_relative_to_the_largest_magnitude_measured():
    found = compare(prediction_of([1.0, -4.0, 2.0], [1.0, -3.0, 2.0]), None, DECLARED, 0, []).train
    assert found.per_output["force"]["peak_error"] == pytest.approx(-0.25)


def test_outputs_are_averaged_in_the_square():
    # The first output is off by half its RMS about the mean everywhere, the second is exact.
    measured, predicted = [[-1.0, 1.0, 5.0, 7.0]], [[-0.5, 1.5, 5.0, 7.0]]
    found = compare(prediction_of(measured, predicted, outputs=("force", "elongation")), None, np.ones(2, bool), 0, [])
    assert found.train.per_output["force"]["nrmse"] == pytest.approx(0.5)
    assert found.train.per_output["elongation"]["nrmse"] == 0.0
    assert found.train.error == pytest.approx(0.5 / np.sqrt(2))


def test_what_was_not_measured_does_not_count():
    nothing = np.nan
    found = compare(prediction_of([*MEASURED, nothing], [*PREDICTED, 1e9], 0.5), None, DECLARED, 0, []).train
    assert found.error == pytest.approx(np.sqrt(0.75))
    assert found.per_output["force"]["coverage_90"] == pytest.approx(0.25)


def test_an_output_that_was_nowhere_measured_has_no_figures():
    measured = [[0.0, 2.0, np.nan, np.nan]]
    found = compare(
        prediction_of(measured, np.ones((1, 4)), outputs=("force", "elongation")), None, np.ones(2, bool), 0, []
    )
    assert set(found.train.per_output) == {"force"}
    with pytest.raises(UserError, match="nothing to compare"):
        compare(prediction_of([np.nan, np.nan], [1.0, 1.0]), None, DECLARED, 0, [])


def test_a_constant_output_is_compared_with_its_own_size():
    found = compare(prediction_of([2.0, 2.0], [2.5, 1.5]), None, DECLARED, 0, []).train
    assert found.error == pytest.approx(0.25)


def test_coverage_counts_what_lies_within_the_90_percent_band_of_the_predictive_mean():
    measured = stats.norm.ppf((np.arange(1000) + 0.5) / 1000)
    prediction = prediction_of(measured, measured + 5, mean=np.zeros((1, 1000)), sd=np.ones((1, 1000)))
    found = compare(prediction, None, DECLARED, 0, []).train.per_output["force"]
    assert found["coverage_90"] == pytest.approx(0.9)


def test_train_and_test_are_separate_and_the_worst_of_both_come_first():
    train = prediction_of([MEASURED, MEASURED], [MEASURED, PREDICTED])
    test = prediction_of([MEASURED], [np.asarray(MEASURED) + 10.0], experiments=[Experiment("T01", split="test")])
    found = compare(train, test, DECLARED, 0, [])
    assert found.train.error == pytest.approx(np.sqrt(0.75 / 2))
    assert found.test.error == pytest.approx(10 / np.sqrt(2))
    assert [entry["experiment"] for entry in found.worst] == ["T01", "E02", "E01"]
    assert found.worst[1]["error"] == pytest.approx(np.sqrt(0.75))
    alone = compare(train, None, DECLARED, 0, [])
    assert alone.p_value == found.p_value and alone.test is None and "test" not in alone.summary()


def test_a_test_split_in_which_nothing_was_measured_is_no_split():
    nothing = prediction_of([[np.nan] * 4], [PREDICTED])
    assert compare(prediction_of(MEASURED, PREDICTED), nothing, DECLARED, 0, []).test is None


def test_a_quantity_of_one_experiment_is_judged_by_the_spread_over_all():
    # Two experiments: 1 and 3, hence the spread 1; the second is off by ½.
    found = compare(prediction_of([[1.0], [3.0]], [[1.0], [3.5]], outputs=("peak_force",)), None, DECLARED, 0, []).train
    assert found.per_experiment["E02"]["peak_force"]["nrmse"] == pytest.approx(0.5)


def test_a_diverged_simulation_is_named():
    prediction = prediction_of([MEASURED, MEASURED], [PREDICTED, np.zeros(4)], converged=np.asarray([True, False]))
    found = compare(prediction, None, DECLARED, 0, ["kept"])
    assert found.notes == ["kept"] and "E02 diverged" in found.warnings[0] and "E02 diverged" in repr(found)
    assert found.train.diverged == ["E02"] and found.summary()["train"]["diverged"] == ["E02"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.inf, np.nan, 1e271, 401.0])
def test_a_simulation_that_ran_away_is_no_prediction(value):
    # The largest value measured is 4: a hundred times that is the limit.
    prediction = prediction_of([MEASURED, MEASURED], [PREDICTED, [1.0, value, 3.0, 4.0]])
    assert prediction.diverged.tolist() == [False, True]
    assert np.isnan(prediction.shown[1]).all() and prediction.shown[0].tolist() == PREDICTED
    assert not prediction.residual[1].any()
    found = compare(prediction, None, DECLARED, 0, [])
    assert not found.adequate and found.p_value == 0.0
    assert np.isinf(found.train.error) and "diverged" in repr(found)
    assert found.train.per_experiment["E01"]["force"]["nrmse"] == pytest.approx(np.sqrt(0.75))
    assert found.worst[0]["experiment"] == "E02"


def test_a_prediction_that_is_only_bad_is_one():
    prediction = prediction_of([MEASURED, MEASURED], [PREDICTED, [1.0, 399.0, 3.0, 4.0]])
    assert not prediction.diverged.any() and np.isfinite(compare(prediction, None, DECLARED, 0, []).train.error)


def test_draws_that_diverged_are_said():
    lost = np.asarray([0.0, 0.25])
    found = compare(prediction_of([MEASURED, MEASURED], [PREDICTED, PREDICTED], draws_lost=lost), None, DECLARED, 0, [])
    assert found.warnings == [
        "the simulation of E02 diverged in up to 25 % of the posterior's draws: the predictive band leaves these draws out"
    ]


@pytest.mark.parametrize(("error", "said"), [(0.1234, "0.123"), (None, "–"), (1.3e8, "diverged"), (np.inf, "diverged")])
def test_an_absurd_error_is_said_to_have_diverged(error, said):
    assert error_cell(error) == said


# --- the energy of cycles ---------------------------------------------------------------------------------------------


def test_a_cycle_that_returns_more_energy_than_it_was_given_is_a_note():
    cycle = np.arange(401) / 100
    u = 0.01 * np.where(cycle < 2, 1, 2) * np.sin(2 * np.pi * cycle)
    force = 6e3 * np.sign(np.gradient(u))
    turned = np.where(cycle.astype(int) == 1, -force, force)
    experiment = recorded("E01", np.arange(u.size), elongation=u, force=turned)
    for measured, said in ((turned, ["E01: the measured force does negative work over cycle 2"]), (force, [])):
        notes = compare(prediction_of(measured, measured, experiments=[experiment]), None, DECLARED, 0, []).notes
        assert [note.partition(";")[0] for note in notes] == said


def test_the_energy_of_a_prediction_that_ran_away_is_no_number():
    t = np.linspace(0, 3, 301)
    experiment = recorded("E01", t, elongation=np.sin(2 * np.pi * t), force=np.cos(2 * np.pi * t))
    predicted = np.where(t > 2, np.nan, np.cos(2 * np.pi * t))
    found = compare(
        prediction_of(np.cos(2 * np.pi * t), predicted, experiments=[experiment]), None, DECLARED, 0, []
    ).train
    assert found.per_experiment["E01"]["force"]["energy_error"] == np.inf


def test_energy_error_is_the_rms_error_of_the_energy_per_cycle_over_its_rms():
    t = np.linspace(0, 3, 301)
    u, force = np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)
    experiment = recorded("E01", t, elongation=u, force=force)
    found = compare(prediction_of(force, 1.2 * force, experiments=[experiment]), None, DECLARED, 0, []).train
    assert found.per_experiment["E01"]["force"]["energy_error"] == pytest.approx(0.2)


# --- the p-value -----------------------------------------------------------------------------------------------------


def histories(random, outputs=("force", "elongation"), rows=3, samples=150):
    """Predictions whose residual is white and as large as declared."""
    measured = np.cumsum(random.standard_normal((rows, len(outputs) * samples)), axis=1)
    sigma = random.uniform(0.5, 2.0, measured.shape)
    noise = sigma * random.standard_normal(measured.shape)
    return prediction_of(measured + noise, measured, sigma, outputs)


def test_p_value_of_histories_with_white_noise_as_declared_is_uniform():
    random = np.random.default_rng(11)
    values = [discrepancy_p_value(histories(random), np.ones(2, bool), 0) for _ in range(400)]
    assert stats.kstest(values, "uniform").pvalue > 0.01


def test_p_value_of_quantities_with_noise_as_declared_is_uniform():
    random = np.random.default_rng(12)
    values = []
    for _ in range(400):
        exact = random.uniform(1, 2, (12, 2))
        measured = exact * (1 + 0.05 * random.standard_normal(exact.shape))
        prediction = prediction_of(measured, exact, 0.05 * exact, ("peak_force", "peak_elongation"))
        values.append(discrepancy_p_value(prediction, np.ones(2, bool), 0))
    assert stats.kstest(values, "uniform").pvalue > 0.01


def test_p_value_allows_for_the_parameters_that_were_fitted():
    # Fitting two parameters takes two degrees of freedom away: a straight line through ten noisy points.
    random, x = np.random.default_rng(13), np.linspace(-1, 1, 10)
    values = []
    for _ in range(400):
        measured = 3 + x + 0.1 * random.standard_normal(10)
        fitted = np.polyval(np.polyfit(x, measured, 1), x)
        prediction = prediction_of(measured, fitted, 0.1)
        values.append(discrepancy_p_value(prediction, DECLARED, 2))
    assert stats.kstest(values, "uniform").pvalue > 0.01


def test_p_value_of_a_misfit_is_tiny():
    random, t = np.random.default_rng(14), np.linspace(0, 10, 500)
    measured = np.sin(t) + 0.1 * random.standard_normal(500)
    found = compare(prediction_of(measured, 1.2 * np.sin(t), 0.1), None, DECLARED, 2, [])
    assert found.p_value < 1e-10 and not found.adequate
    # And so is it where the noise is inferred: the residual is as large as inferred, but not white.
    inferred = compare(prediction_of(measured, 1.2 * np.sin(t), 0.17), None, ~DECLARED, 2, [])
    assert inferred.p_value < 1e-6 and not inferred.adequate


def test_what_is_many_times_the_noise_of_its_record_is_no_noise_however_short_it_is():
    # The same difference, of a memory of 0.9, is noise where the record shows it, and a misfit where the record is smooth.
    random, t = np.random.default_rng(16), np.linspace(0, 10, 80)
    smooth, noise, difference = np.sin(t), 0.005 * random.standard_normal(80), np.zeros(80)
    for k in range(1, 80):
        difference[k] = 0.9 * difference[k - 1] + 0.06 * random.standard_normal()
    for measured, predicted, is_noise in (
        (smooth + difference, smooth, True),
        (smooth + noise, smooth + noise - difference, False),
    ):
        experiments = [recorded("E01", t, force=measured)]
        found = compare(prediction_of(measured, predicted, 0.1, experiments=experiments), None, ~DECLARED, 2, [])
        assert found.adequate == is_noise and (found.p_value > 0.05 if is_noise else found.p_value == 0)


def test_a_misfit_of_twice_the_noise_is_no_noise_if_the_noise_is_white():
    # A difference with a memory passes the test of whiteness: its autoregression is removed.
    random, t = np.random.default_rng(18), np.linspace(0, 10, 700)
    noise = 0.05 * random.standard_normal(700)
    difference = lfilter([1.0], [1.0, -0.95], 0.03 * random.standard_normal(700))
    measured = np.sin(t) + noise
    rows = np.arange(0, 700, 5)
    thin = Record(t[rows], {"force": measured[rows]}, {"force": record_noise(t, measured)})
    for predicted, is_noise in ((np.sin(t), True), (np.sin(t) + difference, False)):
        kept = prediction_of(thin["force"], predicted[rows], 0.1, experiments=[Experiment("E01", record=thin)])
        assert 1.5 < np.sqrt(np.mean(kept.residual**2)) / 0.05 < 3 or is_noise
        found = compare(kept, None, ~DECLARED, 2, [])
        assert found.adequate == is_noise


def test_nothing_can_be_said_of_quantities_with_unknown_noise():
    found = compare(prediction_of([[1.0], [2.0]], [[1.1], [1.9]], outputs=("peak_force",)), None, ~DECLARED, 1, [])
    assert found.p_value is None and not found.adequate
    assert "no noise is declared" in found.verdict and "p_value" not in found.summary()


def test_noise_is_estimated_where_none_is_declared():
    random, t = np.random.default_rng(15), np.linspace(0, 10, 2000)
    force = np.sin(t)
    measured = force + 0.05 * random.standard_normal(t.size)
    prediction = prediction_of(measured, 1.5 * force, 0.36, experiments=[recorded("E01", t, force=measured)])
    scale = np.std(measured)
    # Third differences of 2000 samples: the median estimates the spread within about 3 %.
    assert compare(prediction, None, ~DECLARED, 0, []).train.noise_floor == pytest.approx(0.05 / scale, rel=0.08)
    assert compare(prediction, None, DECLARED, 0, []).train.noise_floor == pytest.approx(0.36 / scale)


def test_a_history_of_few_samples_has_the_noise_of_the_others():
    random, t = np.random.default_rng(17), np.linspace(0, 10, 400)
    measured = np.full((2, 400), np.nan)
    measured[0] = np.sin(t) + 0.05 * random.standard_normal(400)
    measured[1, :6] = np.sin(t[:6])
    experiments = [recorded(f"E0{row}", t[:size], force=measured[row, :size]) for row, size in enumerate((400, 6))]
    # The inferred error is an upper bound: without an estimate, the noise would be as large.
    prediction = prediction_of(measured, np.nan_to_num(measured), 1e6, experiments=experiments)
    found = compare(prediction, None, ~DECLARED, 0, []).train
    assert found.noise_floor == pytest.approx(0.05 / np.nanstd(measured), rel=0.2)


def test_noise_of_several_outputs_with_records_of_different_lengths_is_estimated_for_each():
    random = np.random.default_rng(16)
    samples, sizes, noises = 400, (400, 250), {"force": 0.05, "elongation": 0.2}
    measured, experiments = np.full((2, 2 * samples), np.nan), []
    for row, size in enumerate(sizes):
        t = np.linspace(0, 10, size)
        channels = {o: np.sin(t) + s * random.standard_normal(size) for o, s in noises.items()}
        experiments.append(recorded(f"E0{row + 1}", t, **channels))
        for place, values in enumerate(channels.values()):
            measured[row, place * samples : place * samples + size] = values
    prediction = prediction_of(measured, np.zeros_like(measured), 1.0, tuple(noises), experiments)
    found = compare(prediction, None, np.zeros(2, bool), 0, []).train.per_output
    for output, noise in noises.items():
        assert found[output]["noise_floor"] * found[output]["scale"] == pytest.approx(noise, rel=0.15)


def test_summary_is_json_without_nan_and_has_the_keys_of_the_contract():
    random = np.random.default_rng(17)
    test = prediction_of(random.standard_normal((1, 80)), np.zeros((1, 80)), outputs=("force", "elongation"))
    found = compare(histories(random), test, np.ones(2, bool), 2, ["a note"]).summary()
    text = json.dumps(found, allow_nan=False)
    again = json.loads(text)
    for split in ("train", "test"):
        assert {"error", "noise_floor", "per_output"} <= again[split].keys()
        assert {"nrmse", "bias", "coverage_90"} <= again[split]["per_output"]["force"].keys()
    assert isinstance(again["adequate"], bool) and 0 <= again["p_value"] <= 1
    assert again["worst"] and set(again["worst"][0]) == {"experiment", "output", "error"}
    assert again["notes"] == ["a note"]


def test_numbers_and_verdict_are_shown():
    random = np.random.default_rng(18)
    found = compare(histories(random), None, np.ones(2, bool), 0, [])
    assert "train" in repr(found) and found.verdict in repr(found)
    assert found.verdict in found._repr_html_() and "<td" in found._repr_html_()
