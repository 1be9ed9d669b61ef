"""Measured histories: component tests and shaken structures against closed forms and SciPy; windows, splits, errors."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.places import ROOT
from builders.springs import BETA, A, spring_study
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

import hsed_jax as hx
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import Quantities, assemble, conditions_of
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record, check_campaign, read_at2
from hsed_jax.measurements.characteristics import from_unloaded
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

NOISE = 2.0e3


def exact_force(elongation, A=A, beta=BETA):
    """Bouc–Wen with γ = 0, n = 1 on monotone steps: z relaxes to ±A/β over the way, whatever the rate."""
    force = np.zeros(elongation.size)
    for k, du in enumerate(np.diff(elongation)):
        limit = np.sign(du) * A / beta
        force[k + 1] = limit + (force[k] - limit) * np.exp(-beta * abs(du))
    return force


def path_force(time, elongation, A=A, beta=BETA, parts=40):
    """The same along the smooth path through the samples, which turns between them."""
    share = np.arange(parts) / parts
    dense = np.append((time[:-1, None] + np.diff(time)[:, None] * share).ravel(), time[-1])
    return exact_force(CubicSpline(time, elongation)(dense), A, beta)[::parts]


def along_the_path(built, campaign, row, A=A, beta=BETA):
    """The closed form along the path that the package lays through the samples of an experiment."""
    experiment = campaign.experiments[row]
    # In steps so small that no reversal falls between them.
    fine = replace(built.simulation.grid, change=built.simulation.grid.change / 40, steps=0)
    fine = replace(fine, steps=int(fine.divisions(experiment.record).sum()))
    recorded = conditions_of(experiment, campaign, fine, None).recorded
    path, ends = np.asarray(recorded.forcing.samples.elongation), np.asarray(recorded.ends)
    return exact_force(path, A, beta)[2 * ends][: len(experiment.record)]


def motion(seed, samples):
    """Uneven times and an irregular cyclic elongation."""
    random = np.random.default_rng(seed)
    time = 3.0 + np.cumsum(random.uniform(0.01, 0.05, samples))
    amplitude = np.linspace(0.003, 0.03, samples)
    return time, amplitude * np.sin(2 * np.pi * 0.5 * (time - time[0]) + 0.3 * np.sin(time - time[0]))


def component_campaign(has_time=True, noise=None, **changes) -> Campaign:
    """Three experiments of different lengths, the second with a window, the third for testing."""
    experiments = []
    for number, samples in enumerate((240, 400, 300)):
        time, elongation = motion(number, samples)
        time = time if has_time else np.arange(samples, dtype=float)
        force = path_force(time, elongation) + NOISE * np.random.default_rng(100 + number).standard_normal(samples)
        window = (float(time[50]), float(time[350])) if number == 1 else None
        split = "test" if number == 2 else "train"
        record = Record(time, {"elongation": elongation, "force": force})
        experiments.append(Experiment(f"E0{number + 1}", record=record, window=window, split=split))
    channels = {"elongation": Channel("elongation", "mm"), "force": Channel("force", "kN", noise=noise)}
    channels = {"time": Channel("time", "s"), **channels} if has_time else channels
    return Campaign("springs", "displacement", {}, channels, {}, tuple(experiments))


def study_of(**changes):
    calibration = {"starts": 1, "chains": 4, "warmup": 40, "draws": 120}
    return spring_study(**{"calibration": calibration, **changes})


# Of the predictor as an argument, so that equal ones share a program.
outputs_of = eqx.filter_jit(lambda predictor, theta, data: predictor(theta, data.conditions, data.count))
sigma_of = eqx.filter_jit(lambda posterior, *of: posterior.sigma(*of))


def predict(built, campaign, theta):
    """Predicted outputs of all experiments, [experiment][output] -> samples of its record."""
    data = built.inference.data(campaign, campaign.experiments)
    predicted, ok = outputs_of(built.inference.posterior.predict, jnp.asarray(theta), data)
    assert np.all(np.asarray(ok) == 1)
    tables = np.asarray(predicted).reshape(len(campaign), len(built.observed.outputs), -1)
    return [
        dict(zip(built.observed.outputs, table[:, : len(e.record)], strict=True))
        for table, e in zip(tables, campaign, strict=True)
    ]


# --- component tests -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def calibration():
    return hx.calibrate(study_of(), component_campaign())


@pytest.mark.whole
def test_calibration_of_a_component_test_recovers_parameters_and_noise(calibration):
    campaign = calibration.campaign
    # The inferred error is relative to the RMS of each record in its window: of two much alike.
    rms = [np.sqrt(np.mean(e.record["force"][e.in_window] ** 2)) for e in campaign.train]
    truth = {"A": A, "beta": BETA, "error.force": float(np.mean([NOISE / x for x in rms]))}
    summary = calibration.fit.summary()
    # Measured standard deviations: 0.26 %, 0.27 % and 2.8 % of the truth.
    for name, most in (("A", 0.004), ("beta", 0.004), ("error.force", 0.045)):
        assert summary[name]["sd"] < most * truth[name]
        assert (
            abs(calibration.map[name] - truth[name]) < 3.3 * summary[name]["sd"] + 0.03 * (name[0] == "e") * truth[name]
        )
        assert summary[name]["q05"] - summary[name]["sd"] < truth[name] < summary[name]["q95"] + summary[name]["sd"]
    assert calibration.fit.convergence.divergences == 0


@pytest.mark.whole
def test_gauss_newton_covariance_of_a_component_test_agrees_with_nuts(calibration):
    sd = np.sqrt(np.diag(np.asarray(calibration.fit.maximum.covariance)))
    drawn = [calibration.fit.summary()[name]["sd"] for name in calibration.fit.names]
    np.testing.assert_allclose(drawn, sd, rtol=0.2)  # 600 draws


@pytest.mark.whole
def test_white_noise_is_counted_in_full(calibration):
    weights = np.asarray(calibration.fit.data.weights)
    assert set(np.unique(weights)) == {0.0, 1.0}
    assert weights.sum() == 240 + 301


@pytest.mark.whole
def test_histories_of_a_component_test_are_the_closed_form(calibration):
    campaign = calibration.campaign
    for theta in ((A, BETA), (0.6 * A, 2 * BETA)):
        for row, found in enumerate(predict(calibration.built, campaign, theta)):
            exact = along_the_path(calibration.built, campaign, row, *theta)
            # Measured: at most 1.3e-3, where a reversal falls between the steps.
            assert np.abs(found["force"] - exact).max() < 3e-3 * np.abs(exact).max()


@pytest.mark.whole
def test_comparison_of_a_component_test_is_adequate_in_both_splits(calibration):
    comparison = hx.compare(calibration)
    assert comparison.adequate
    for split in (comparison.train, comparison.test):
        assert split.error == pytest.approx(split.noise_floor, rel=0.2)
        assert 0.85 < split.per_output["force"]["coverage_90"] < 0.95
    assert set(comparison.test.per_experiment) == {"E03"} and set(comparison.train.per_experiment) == {"E01", "E02"}
    assert comparison.notes == []


def test_closed_form_of_the_component_test_is_what_scipy_integrates():
    _, u = motion(0, 240)
    z = [0.0]
    for du in np.diff(u)[:60]:
        step = solve_ivp(lambda s, z, du=du: A * du - BETA * abs(du) * z, (0, 1), z[-1:], rtol=1e-10, atol=1e-6)
        z.append(step.y[0, -1])
    np.testing.assert_allclose(z, exact_force(u)[:61], atol=1e-7 * A / BETA)


def changed(campaign, id, **changes):
    return campaign.update(replace(campaign[id], **changes))


def test_values_outside_the_window_have_no_influence():
    campaign, built = component_campaign(), Built(study_of(), component_campaign())
    experiment = campaign["E02"]
    force = np.where(experiment.in_window, experiment.record["force"], 7e6)
    other = changed(
        campaign, "E02", record=Record(experiment.record.time, {**experiment.record.channels, "force": force})
    )
    one, two = (built.inference.data(c, c.train.experiments) for c in (campaign, other))
    jax.tree.map(np.testing.assert_array_equal, one, two)
    # But those inside have.
    force = np.where(experiment.in_window, 1.01, 1.0) * experiment.record["force"]
    other = changed(
        campaign, "E02", record=Record(experiment.record.time, {**experiment.record.channels, "force": force})
    )
    assert np.any(np.asarray(built.inference.data(other, other.train.experiments).values) != np.asarray(one.values))


def test_the_simulation_starts_with_the_record_and_not_with_the_window():
    campaign = component_campaign()
    built = Built(study_of(), campaign)
    found = predict(built, campaign, (A, BETA))[1]["force"]
    exact = along_the_path(built, campaign, 1)
    window = campaign["E02"].in_window
    np.testing.assert_allclose(found[window], exact[window], atol=1e-3 * np.abs(exact).max())


def cut(record: Record, first: int, elongation: float = 0.0) -> Record:
    """A record without its first samples, its elongation measured from somewhere else."""
    channels = {name: values[first:] for name, values in record.channels.items()}
    return Record(record.time[first:], {**channels, "elongation": channels["elongation"] + elongation})


def in_one_record(record: Record) -> Campaign:
    channels = {"elongation": Channel("elongation", "mm"), "force": Channel("force", "kN")}
    channels = {"time": Channel("time", "s"), **channels}
    return Campaign("spring", "displacement", {}, channels, {}, (Experiment("E01", record=record),))


def test_a_record_whose_first_rows_were_not_written_begins_loaded():
    time, elongation = motion(1, 400)
    whole = Record(time, {"elongation": elongation, "force": path_force(time, elongation)})
    # Still on the first loading, as loggers and recorders of programs begin.
    loaded = in_one_record(cut(whole, 4))
    assert abs(loaded["E01"].record["force"][0]) > 0.1 * np.abs(whole["force"]).max()
    found = predict(Built(study_of(), loaded), loaded, (A, BETA))[0]["force"]
    # A step later lies elsewhere at a reversal, where the force has a kink.
    largest = np.abs(whole["force"]).max()
    np.testing.assert_allclose(found, whole["force"][4:], atol=1e-2 * largest)
    np.testing.assert_allclose(found[:100], whole["force"][4:104], atol=2e-3 * largest)
    said = [finding for finding in check_campaign(loaded) if finding.kind == "offset"]
    assert len(said) == 1 and "loads a new specimen from zero" in said[0].message


def test_a_sensor_that_is_not_quite_at_zero_is_no_load():
    time, elongation = motion(1, 400)
    record = Record(time, {"elongation": elongation + 1e-5, "force": path_force(time, elongation) + 4e3})
    assert from_unloaded(record) is record
    assert not [finding for finding in check_campaign(in_one_record(record)) if finding.kind == "offset"]


@pytest.mark.filterwarnings("error")
def test_a_channel_without_a_number_is_no_load():
    time, elongation = motion(1, 400)
    record = Record(time, {"elongation": elongation, "force": np.full(len(time), np.nan)})
    assert from_unloaded(record) is record


def test_an_elongation_that_was_not_zeroed_is_no_load():
    time, elongation = motion(1, 400)
    # A small force of the same sign, such as noise.
    whole = Record(time, {"elongation": elongation, "force": path_force(time, elongation) + 3e3})
    campaigns = [in_one_record(cut(whole, 0, shift * np.abs(elongation).max())) for shift in (0.0, 0.3)]
    found = [predict(Built(study_of(), c), c, (A, BETA))[0]["force"] for c in campaigns]
    np.testing.assert_allclose(found[1], found[0], atol=1e-3)


@pytest.mark.whole
def test_test_experiments_are_never_fitted(calibration):
    assert int(calibration.fit.data.count) == 2
    assert [e.id for e in calibration.train.experiments] == ["E01", "E02"]


def test_the_row_number_stands_for_a_time_that_is_absent():
    with_time, without = component_campaign(), component_campaign(has_time=False)
    one, two = (predict(Built(study_of(), c), c, (A, BETA)) for c in (with_time, without))
    for a, b in zip(one, two, strict=True):
        # The law does not notice; the path between the samples does, a little.
        np.testing.assert_allclose(a["force"], b["force"], atol=2e-2 * A / BETA)


def test_declared_noise_is_used_and_not_inferred():
    absolute = Built(study_of(), component_campaign(noise=Noise(absolute=NOISE)))
    assert absolute.inference.posterior.names == ("A", "beta")
    np.testing.assert_allclose(np.asarray(absolute.inference.posterior.errors(jnp.ones(2))), NOISE)
    relative = Built(study_of(), component_campaign(noise=Noise(relative=0.03)))
    data = relative.inference.data(relative.experiments.measured, relative.experiments.measured.train.experiments)
    theta = jnp.asarray([A, BETA])
    predicted, ok = outputs_of(relative.inference.posterior.predict, theta, data)
    sigma = np.asarray(sigma_of(relative.inference.posterior, theta, predicted, ok, data))
    for row, e in enumerate(relative.experiments.measured.train):
        # Less what the noise itself adds to it.
        used = np.asarray(data.weights[row]) > 0
        rms = np.sqrt(np.mean(e.record["force"][e.in_window] ** 2) / (1 + 0.03**2))
        np.testing.assert_allclose(sigma[row, used], 0.03 * rms)


def test_quantities_are_taken_from_records():
    campaign = component_campaign()
    built = Built(
        study_of(observe="quantities", quantities=["peak_force", "dissipated_energy"], error={"relative": 0.05}),
        campaign,
    )
    record = campaign["E01"].record
    force, elongation = record["force"], record["elongation"]
    exact = [np.abs(force).max(), np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(elongation))]
    np.testing.assert_allclose(built.inference.observation.measured(campaign["E01"]), exact, rtol=1e-12)
    data = built.inference.data(campaign, campaign.experiments)
    predicted, _ = outputs_of(built.inference.posterior.predict, jnp.asarray([A, BETA]), data)
    # The specimen's own, without noise: the peak is exact at its turn; the trapezoid of the samples errs by 1e-3.
    for row, experiment in enumerate(campaign):
        u = experiment.record["elongation"]
        z = exact_force(u)
        assert predicted[row, 0] == pytest.approx(np.abs(z).max(), rel=1e-4)
        assert predicted[row, 1] == pytest.approx(np.trapezoid(z, u), rel=1e-2)


def test_a_relative_error_of_a_quantity_of_zero_is_refused():
    campaign = Campaign.from_frames(
        [{"id": "E01", "S": 1.0, "peak_force": 0.0}, {"id": "E02", "S": 2.0, "peak_force": 3.0}],
        protocol="ground_motion",
        inputs={"S": "1"},
        quantities={"peak_force": "kN"},
    )
    observed = Quantities(("peak_force",))
    with pytest.raises(UserError, match="'E01': peak_force is 0, for which a relative error is zero"):
        assemble(observed, campaign, campaign.experiments, np.asarray([True]))
    data = assemble(observed, campaign, campaign.experiments, np.asarray([False]))
    assert data.values.tolist() == [[0.0], [3e3]] and data.weights.tolist() == [[1.0], [1.0]]


# --- shaken structures -----------------------------------------------------------------------------------------------

MASSES, SPRINGS, SPECIMEN, DAMPING = np.asarray([8e3, 9e3]), (4e5, 1e6), 5e5, 0.05
STRUCTURE = {
    "masses": MASSES.tolist(),
    "springs": [
        {"between": ["ground", 1], "stiffness": SPRINGS[0]},
        {"between": [2, "ground"], "stiffness": SPRINGS[1]},
    ],
    "specimen": {"between": [1, 2]},
    "damping": {"modal": DAMPING, "specimen_stiffness": SPECIMEN},
}
MODEL = {"parameters": {"A": {"uniform": [2e5, 9e5]}, "beta": {"uniform": [0.5, 20.0]}, "gamma": 0.0, "n": 1.0}}
CHANNELS = {"elongation": "m", "force": "N", "displacement_1": "m", "acceleration_2_absolute": "m/s^2"}
THETA = (5e5, 10.0)


def two_masses(time, ground_of, A, beta):
    """The channels of the two-mass structure by SciPy (DOP853), C from the modes of the elastic structure."""
    across = np.asarray([-1.0, 1.0])
    frame = np.diag(SPRINGS)
    squares, modes = eigh(frame + SPECIMEN * np.outer(across, across), np.diag(MASSES))
    full = np.diag(MASSES) @ modes
    C = full @ np.diag(2 * DAMPING * np.sqrt(squares)) @ full.T

    def accelerations(u, v, z):
        return -(C @ v + frame @ u + across * z) / MASSES

    def rates(t, y):
        u, v, z = y[:2], y[2:4], y[4]
        rate = across @ v
        return [*v, *(accelerations(u, v, z) - ground_of(t)), A * rate - beta * abs(rate) * z]

    step = float(np.min(np.diff(time)))
    y = solve_ivp(rates, time[[0, -1]], np.zeros(5), "DOP853", time, rtol=1e-8, atol=1e-8, max_step=step).y
    absolute = np.asarray([accelerations(u, v, z) for u, v, z in zip(y[:2].T, y[2:4].T, y[4], strict=True)])
    return {
        "elongation": y[1] - y[0],
        "force": y[4],
        "displacement_1": y[0],
        "acceleration_2_absolute": absolute[:, 1],
    }


def agree(found, exact, share):
    for name, values in exact.items():
        assert np.abs(found[name] - values).max() < share * np.abs(values).max(), name


def shaking(seed):
    """A smooth ground motion at uneven times."""
    random = np.random.default_rng(seed)
    time = 1.0 + np.concatenate([[0.0], np.cumsum(random.uniform(0.005, 0.02, 500 - 60 * seed))])
    t = time - time[0]
    return time, 6.0 * np.sin(2 * np.pi * 1.1 * t + seed) * np.sin(0.4 * t) ** 2


@pytest.mark.whole
def test_histories_of_a_structure_under_measured_ground_acceleration_are_scipys():
    records = {}
    for seed in range(2):
        time, ground = shaking(seed)
        exact = two_masses(time, CubicSpline(time, ground), *THETA)
        records[f"E0{seed + 1}"] = {"time": time, "ground_acceleration": ground, **exact}
    channels = {"time": "s", "ground_acceleration": "m/s^2", **CHANNELS}
    campaign = Campaign.from_frames(records=records, protocol="ground_motion", channels=channels)
    built = Built(study_of(structure=STRUCTURE, model=MODEL), campaign)
    assert set(built.observed.outputs) == set(CHANNELS)
    for found, experiment in zip(predict(built, campaign, THETA), campaign, strict=True):
        agree(found, {name: experiment.record[name] for name in CHANNELS}, 2e-4)


def pulse_velocity(t, V_P, T_P, gamma=2.0, nu=0.10):
    """Dabaghi & Der Kiureghian's pulse, from its formula."""
    offset = V_P * (np.sin(nu + gamma * np.pi) - np.sin(nu - gamma * np.pi)) / (4 * np.pi * (1 - gamma**2) * gamma)
    s = (t - gamma * T_P / 2) / T_P
    v = (0.5 * V_P * np.cos(2 * np.pi * s + nu) - offset) * (1 + np.cos(2 * np.pi / gamma * s))
    return np.where((t >= 0) & (t <= gamma * T_P), v, 0.0)


@pytest.mark.whole
def test_pulse_drives_records_without_a_ground_acceleration():
    V_P, T_P = 2.0, 0.9
    time = np.linspace(0, 5, 501)

    def ground(t):
        return (pulse_velocity(t + 1e-6, V_P, T_P) - pulse_velocity(t - 1e-6, V_P, T_P)) / 2e-6

    exact = two_masses(time, ground, *THETA)
    campaign = Campaign.from_frames(
        [{"id": "E01", "V_P": 100 * V_P, "T_P": T_P}],
        {"E01": {"time": time, **exact}},
        protocol="ground_motion",
        inputs={"V_P": "cm/s", "T_P": "s"},
        channels={"time": "s", **CHANNELS},
    )
    study = study_of(
        structure=STRUCTURE,
        model=MODEL,
        excitation={"near_fault_pulse": {"V_P": "V_P", "T_P": "T_P"}, "duration": 5.0},
        inputs={"V_P": {"uniform": [150, 300], "unit": "cm/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}},
    )
    agree(predict(Built(study, campaign), campaign, THETA)[0], exact, 2e-4)


@pytest.mark.whole
def test_recorded_ground_motions_drive_the_structure(shared):
    folder = shared / "data" / "ground_motions"
    if not folder.is_dir():
        pytest.skip(f"there is no folder {folder}")
    path = folder / "Rinaldi228.AT2"
    step, ground = read_at2(path)
    time = step * np.arange(len(ground))
    study = study_of(
        structure=STRUCTURE,
        model=MODEL,
        excitation={"recorded": {"file": str(path), "scale": "S"}},
        inputs={"S": {"uniform": [0.5, 1.5], "unit": "1"}},
        experiments={"virtual": {"parameters": {"A": THETA[0], "beta": THETA[1]}}},
        observe="quantities",
        steps=["calibrate"],
    )
    scales = np.asarray([0.5, 1.2])
    simulator, theta = Built(study).simulation.simulator, dict(zip(("A", "beta"), THETA, strict=True))
    found = jax.jit(jax.vmap(lambda S: simulator.respond(theta, Conditions({"S": S}))))(jnp.asarray(scales))
    for row, scale in enumerate(scales):
        exact = two_masses(time, lambda t, scale=scale: scale * np.interp(t, time, ground), *THETA)
        for name in ("force", "elongation"):
            peak = np.abs(exact[name]).max()
            assert float(found.quantities[f"peak_{name}"][row]) == pytest.approx(peak, rel=5e-3), name
        energy = np.trapezoid(exact["force"], exact["elongation"])
        assert float(found.quantities["dissipated_energy"][row]) == pytest.approx(energy, rel=5e-3)


# --- errors ----------------------------------------------------------------------------------------------------------


def shaken_campaign(**channels) -> Campaign:
    time, ground = shaking(0)
    columns = {"time": time, **{name: ground for name in channels}}
    return Campaign.from_frames(records={"E01": columns}, protocol="ground_motion", channels={"time": "s", **channels})


def test_a_campaign_with_nothing_to_fit_is_refused():
    campaign = component_campaign()
    for id in ("E01", "E02"):
        campaign = changed(campaign, id, status="failed")
    with pytest.raises(UserError, match="no completed experiment"):
        hx.calibrate(study_of(), campaign)


def test_a_campaign_in_which_nothing_is_completed_is_refused():
    campaign = component_campaign()
    for experiment in campaign:
        campaign = changed(campaign, experiment.id, status="failed")
    with pytest.raises(UserError, match="no completed experiment"):
        hx.calibrate(study_of(), campaign)


def test_records_without_any_excitation_are_refused():
    with pytest.raises(UserError, match="no ground_acceleration and the study no excitation"):
        hx.calibrate(study_of(structure=STRUCTURE, model=MODEL), shaken_campaign(force="N"))


def test_a_channel_that_was_not_measured_is_refused():
    with pytest.raises(UserError, match="displacement_1 was not measured; measured are force"):
        hx.calibrate(study_of(channels=["displacement_1"]), component_campaign())


def test_what_was_imposed_is_nothing_to_compare_with():
    campaign = component_campaign()
    with pytest.raises(UserError, match="elongation was not measured"):
        hx.calibrate(study_of(channels=["elongation"]), campaign)


def test_a_displacement_campaign_without_elongation_is_refused():
    with pytest.raises(UserError, match="'elongation' is missing"):
        Campaign.from_frames(
            records={"E01": {"force": np.arange(5.0)}}, protocol="displacement", channels={"force": "N"}
        )


def test_an_imposed_elongation_that_is_no_number_is_refused():
    campaign = component_campaign()
    record = campaign["E01"].record
    broken = np.where(np.arange(len(record)) == 7, np.nan, record["elongation"])
    campaign = changed(campaign, "E01", record=Record(record.time, {**record.channels, "elongation": broken}))
    with pytest.raises(UserError, match=r"'E01'.*finite numbers"):
        Built(study_of(), component_campaign()).inference.data(campaign, campaign.train.experiments)


def test_quantities_that_nobody_measured_are_refused():
    campaign = component_campaign()
    without = replace(campaign, experiments=tuple(replace(e, record=None, window=None) for e in campaign))
    built = Built(study_of(observe="quantities", quantities=["peak_force"], error={"relative": 0.05}), campaign)
    with pytest.raises(UserError, match="'E01' has no record"):
        built.inference.data(without, without.train.experiments)
    with pytest.raises(UserError, match="none of peak_force was measured in E01, E02"):
        assemble(Quantities(("peak_force",)), without, without.train.experiments, np.asarray([True]))


@pytest.mark.whole
def test_a_record_longer_than_the_model_was_built_for_is_refused(calibration):
    time, elongation = motion(0, 600)
    longer = Record(time, {"elongation": elongation, "force": exact_force(elongation)})
    campaign = replace(calibration.campaign, experiments=(Experiment("L01", record=longer),))
    with pytest.raises(UserError, match="'L01': its record has 600 samples, more than the 512"):
        calibration.predict(campaign)


# --- a design that observes histories ----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_design_that_observes_histories_calibrates_as_a_calibration_alone(tmp_path):
    told = [
        "observe=histories",
        "excitation.duration=4",
        "experiments.virtual.effects={}",
        "calibration.sampler=laplace",
    ]
    sizes = ["design.initial=3", "design.iterations=1", "design.candidates=64", "calibration.draws=100"]
    noise = ["experiments.virtual.noise={relative: 0.05}", "steps=[design, calibrate]"]
    study = hx.load_study(ROOT / "configs" / "paper.yaml", [*told, *sizes, *noise])
    run = hx.run(study, tmp_path / "run", figures=False, progress=False)
    alone = hx.calibrate(study, run.campaign)
    for name, truth in (("A", 5e5), ("beta", 1.0)):
        found, again = run.calibration.fit.summary()[name], alone.fit.summary()[name]
        assert abs(found["mean"] - truth) < 4 * found["sd"]
        assert found["sd"] == pytest.approx(again["sd"], rel=0.3)
        assert run.calibration.map[name] == pytest.approx(alone.map[name], abs=0.1 * found["sd"])
