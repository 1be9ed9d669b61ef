"""Applied forces and planned cyclic tests: against formulas, SciPy and NumPy; from the study to the laboratory and back."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from observations import of_largest
from scipy.integrate import solve_ivp

import hsed_jax as hx
from hsed_jax.analysis.calibration import campaign_of
from hsed_jax.config.excitation_entry import ExcitationEntry
from hsed_jax.diagnosis.candidates import applicable
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, write_campaign
from hsed_jax.physics.declared import DECLARED
from hsed_jax.physics.excitations import EXCITATIONS, Applied, Imposed
from hsed_jax.physics.excitations.imposed import CyclicElongation
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.study.build import Built

FRAME = """
study: pushed
structure:
  masses: [8.0e3, 9.0e3]
  springs: [{between: [ground, 1], stiffness: 4.0e5}, {between: [2, ground], stiffness: 1.0e6}]
  specimen: {between: [1, 2]}
  damping: {rayleigh: {alpha: 0.3, beta: 1.0e-3}, specimen_stiffness: 5.0e5}
excitation:
  applied_force: {mass: 1, file: force.csv, scale: s}
  duration: 4.0
inputs: {s: {uniform: [0.5, 2.0]}}
model: {spring: elastic, parameters: {k: {uniform: [2.0e5, 9.0e5]}}}
experiments: {virtual: {parameters: {k: 5.0e5}, noise: {relative: 1.0e-3}}}
error: {relative: 1.0e-3}
steps: [calibrate]
calibration: {sampler: laplace, starts: 1}
"""
CYCLES = """
study: cycles
excitation:
  imposed: {amplitudes: [a, 0.03], cycles: 2, rate: v}
inputs: {a: {uniform: [5.0, 40.0], unit: mm}, v: {uniform: [20.0, 60.0], unit: mm/s}}
model: {spring: bilinear, parameters: {k: {uniform: [2.0e6, 9.0e6]}, F_y: {uniform: [2.0e4, 6.0e4]}}}
experiments: {virtual: {parameters: {k: 5.0e6, F_y: 4.0e4}, noise: {relative: 1.0e-3}}}
error: {relative: 1.0e-3}
steps: [calibrate]
calibration: {sampler: laplace, starts: 1}
"""
K, DELAYED = 5.0e5, 0.25  # N/m, s


def force(t):
    """A half sine of 1 s and 30 kN, sampled: linear between the samples of the file."""
    time = DELAYED + np.linspace(0.0, 1.0, 41)
    return np.interp(t, time, 3.0e4 * np.sin(np.pi * (time - DELAYED)), left=0.0, right=0.0)


@pytest.fixture
def pushed(tmp_path):
    """A factory: the study of the frame, its file of the force beside it, keys overridden."""

    def make(*overrides, text=FRAME):
        time = DELAYED + np.linspace(0.0, 1.0, 41)
        rows = "".join(f"{t:.17g};{p:.17g}\n" for t, p in zip(time, force(time), strict=True))
        (tmp_path / "force.csv").write_text(f"t [s];F [N]\n{rows}")
        (tmp_path / "study.yaml").write_text(text)
        return hx.load_study(tmp_path / "study.yaml", overrides)

    return make


def cycles(*overrides, **changes):
    content = {**yaml.safe_load(CYCLES), **changes}
    return hx.load_study(content, overrides)


def scipys(scale, step, ground=lambda t: 0.0, mass=0):
    """Displacements, velocities and accelerations of the elastic frame, relative to the ground, by DOP853."""
    M = np.diag([8e3, 9e3])
    b = np.array([-1.0, 1.0])
    stiffness = np.diag([4e5, 1e6]) + K * np.outer(b, b)
    damping = 0.3 * M + 1e-3 * (np.diag([4e5, 1e6]) + 5e5 * np.outer(b, b))

    def acceleration(t, u, v):
        push = np.zeros(2)
        push[mass] = scale * force(t)
        return np.linalg.solve(M, push - damping @ v - stiffness @ u) - ground(t)

    def rates(t, y):
        return np.concatenate([y[2:], acceleration(t, y[:2], y[2:])])

    time = step * np.arange(round(4.0 / step) + 1)
    found = solve_ivp(rates, (0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-10, atol=1e-12, max_step=0.02)
    u, v = found.y[:2], found.y[2:]
    return time, u, v, np.stack([acceleration(t, *pair) for t, *pair in zip(time, u.T, v.T, strict=True)], axis=1)


# --- a force on a mass ---------------------------------------------------------------------------------------------


@pytest.mark.verification("dynamics")
def test_an_applied_force_moves_the_frame_as_scipy_says(pushed, observed):
    study = pushed("excitation.step=0.005")
    names = ("displacement_1", "displacement_2", "velocity_1", "acceleration_2", "acceleration_2_absolute",
             "applied_force_1", "ground_acceleration")  # fmt: skip
    found = hx.simulate(study, {"s": 1.5}, {"k": K}, names).channels
    step = Built(study).simulation.planned.step
    time, u, v, a = scipys(1.5, step)
    assert found["displacement_1"].shape == time.shape
    for name, exact in zip(names, (*u, v[0], a[1]), strict=False):
        error = of_largest(found[name], exact)
        observed(f"elastic frame under a force on a mass: {name}", "SciPy", error, 1e-5)
    np.testing.assert_array_equal(found["acceleration_2"], found["acceleration_2_absolute"])
    np.testing.assert_allclose(found["applied_force_1"], 1.5 * force(time), rtol=0, atol=1e-9)
    assert not np.any(found["ground_acceleration"])


def test_steps_are_no_longer_than_the_samples_of_a_force(pushed, tmp_path):
    study = pushed()
    (tmp_path / "force.csv").write_text("0 0\n1 0\n1.001 1e6\n1.002 0\n4 0\n")  # a hammer
    built = Built(study)
    assert built.simulation.planned.step <= 1e-3
    velocity = hx.simulate(study, {"s": 1.0}, {"k": K}, ("velocity_1",)).channels["velocity_1"]
    after = float(np.interp(1.0022, built.simulation.planned.step * np.arange(velocity.size), velocity))
    assert after == pytest.approx(1e6 * 1e-3 / 8e3, rel=0.03)  # the impulse over the mass


def test_a_force_that_stays_bends_the_frame_statically(pushed, tmp_path):
    study = pushed("excitation.applied_force.mass=2", "excitation.duration=60.0")
    (tmp_path / "force.csv").write_text("force,time\n0,0\n1e4,20\n1e4,60\n")  # the columns are told by their names
    found = hx.simulate(study, {"s": 1.0}, {"k": K}, ("displacement_1", "displacement_2")).channels
    exact = np.linalg.solve([[4e5 + K, -K], [-K, 1e6 + K]], [0.0, 1e4])
    np.testing.assert_allclose([x[-1] for x in found.values()], exact, rtol=1e-3)


@pytest.mark.whole
def test_a_measured_force_drives_the_model_and_tells_its_stiffness(pushed, tmp_path):
    """The records have a force and a ground motion at once, from SciPy."""
    records, rows = {}, []
    for name, scale in (("E01", 1.0), ("E02", 0.6)):
        time, u, _, a = scipys(scale, 0.01, ground=lambda t: 0.5 * np.sin(3 * t), mass=1)
        ground = 0.5 * np.sin(3 * time)
        records[name] = {"time": time, "applied_force_2": scale * force(time) / 1e3, "ground_acceleration": ground,
                         "elongation": u[1] - u[0], "acceleration_1_absolute": a[0] + ground}  # fmt: skip
        rows.append({"id": name, "s": scale})
    channels = {"time": "s", "applied_force_2": "kN", "ground_acceleration": "m/s^2", "elongation": "m"}
    channels["acceleration_1_absolute"] = "m/s^2"
    campaign = Campaign.from_frames(rows, records, protocol="ground_motion", inputs={"s": "1"}, channels=channels)
    write_campaign(campaign, tmp_path / "measured")
    campaign = hx.read_campaign(tmp_path / "measured")
    calibration = hx.calibrate(pushed("observe=histories"), campaign)
    assert calibration.map["k"] == pytest.approx(K, rel=1e-3)
    train = calibration.train
    predicted = np.asarray(train.predicted)[train.used]
    np.testing.assert_allclose(predicted, train.measured[train.used], rtol=0, atol=0.01 * np.abs(predicted).max())


def test_a_force_on_a_mass_that_is_not_there_is_refused(pushed):
    with pytest.raises(UserError, match=r"applied_force\.mass: there is no mass 3; the structure has 2"):
        Built(pushed("excitation.applied_force.mass=3")).check()
    record = {"time": np.arange(9.0), "applied_force_3": np.sin(np.arange(9.0)), "force": np.arange(9.0)}
    units = {"time": "s", "applied_force_3": "N", "force": "N"}
    campaign = Campaign.from_frames(records={"E01": record}, protocol="ground_motion", channels=units)
    with pytest.raises(UserError, match=r"channels\.applied_force_3: there is no mass 3"):
        _ = Built(pushed("inputs={}", "excitation={}", "observe=histories"), campaign).simulation.grid


@pytest.mark.parametrize(
    ("content", "said"),
    [("t,F\n0,1\n0,2\n", "increasing times"), ("t,F\n0,1\n1,nan\n", "finite"), ("F\n1\n2\n", "one column"), ("", "empty")],
)  # fmt: skip
def test_a_file_that_is_no_history_is_refused(pushed, tmp_path, content, said):
    study = pushed()
    (tmp_path / "force.csv").write_text(content)
    with pytest.raises(UserError, match=said):
        Built(study).check()


def test_a_gain_of_the_ground_motion_leaves_a_force_alone(pushed):
    built = Built(pushed())
    campaign = built.site.empty_campaign()
    names = applicable(built, campaign)
    assert "mass_error" in names and "ground_motion_gain" not in names
    shaken = Built(pushed("excitation={near_fault_pulse: {V_P: 1.0, T_P: 1.0}, duration: 4.0}", "inputs={}"))
    assert "ground_motion_gain" in applicable(shaken, campaign)


# --- an imposed elongation ------------------------------------------------------------------------------------------

PROTOCOL = CyclicElongation((0.01, 0.025, 0.004), 0.05, 3)


def formula(t, amplitudes=(0.01, 0.025, 0.004), rate=0.05, cycles=3):
    """Elongation and rate, written down once more."""
    for a in amplitudes:
        period = 2 * np.pi * a / rate
        if t <= cycles * period:
            return a * np.sin(2 * np.pi * t / period), rate * np.cos(2 * np.pi * t / period)
        t -= cycles * period
    raise ValueError


@pytest.mark.whole
def test_cycles_are_sines_whose_reversals_are_ends_of_steps():
    n = 6
    line = Timeline(None, n * PROTOCOL.branches)
    lengths = PROTOCOL.step_length(line)
    time = np.asarray(times(lengths, 1, line.samples))
    assert time[-1] == pytest.approx(float(PROTOCOL.duration), rel=1e-12)
    samples = PROTOCOL.forcing(lengths, line.steps).samples
    half = np.concatenate([[0.0], np.cumsum(np.repeat(lengths / 2, 2))])
    exact = np.array([formula(t - 1e-12) for t in half])  # at a change of amplitude both sides agree
    np.testing.assert_allclose(samples.elongation, exact[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(samples.rate, exact[:, 1], rtol=0, atol=1e-11)
    elongation, rate = np.asarray(samples.elongation)[::2], np.asarray(samples.rate)[::2]
    assert np.all(rate[n :: 2 * n] == 0)
    np.testing.assert_array_equal(np.abs(elongation[n :: 2 * n]), np.repeat([0.01, 0.025, 0.004], 6))
    direct = jax.vmap(PROTOCOL.sample)(jnp.asarray(half))
    np.testing.assert_allclose(direct.elongation, samples.elongation, rtol=0, atol=1e-13)
    np.testing.assert_allclose(direct.rate[1:-1], samples.rate[1:-1], rtol=0, atol=1e-11)
    assert PROTOCOL.sample(-0.1) == Imposed(0.0, 0.0) and PROTOCOL.sample(half[-1] + 0.1) == Imposed(0.0, 0.0)


@pytest.mark.verification("laws")
def test_an_elastic_spring_takes_no_energy_and_an_elastoplastic_one_the_area_of_its_loops(observed):
    model = {"spring": "elastic", "parameters": {"k": {"uniform": [2e6, 9e6]}}}
    virtual = {"virtual": {"parameters": {"k": 5e6}}}
    inputs = {"a": 20.0, "v": 50.0}
    quantities = hx.simulate(cycles(model=model, experiments=virtual), inputs, {"k": 5e6}, ()).quantities
    assert abs(quantities["dissipated_energy"]) < 1e-6 * 0.5 * 5e6 * 0.03**2
    assert quantities["peak_force"] == pytest.approx(5e6 * 0.03)
    single = cycles("excitation.imposed.amplitudes=[a]", "excitation.imposed.cycles=3")
    names = ("elongation", "elongation_rate", "force", "energy")
    found = hx.simulate(single, inputs, {"k": 5e6, "F_y": 4e4}, names)
    a, k, F, n = 0.02, 5e6, 4e4, 3
    y = F / k
    # Loading to a; three descents of 2a and two ascents, each elastic over 2y; the last ascent ends at zero.
    exact = F * (a - y / 2) + (2 * n - 1) * F * 2 * (a - y) + F * (a - 2 * y)
    error = float(found.quantities["dissipated_energy"]) / exact - 1
    observed("bilinear without hardening: dissipated energy of three cycles", "area of the loops", error, 2e-4)
    assert found.quantities["peak_force"] == pytest.approx(F, rel=1e-9)
    assert found.quantities["peak_elongation"] == a
    h = {name: np.asarray(values) for name, values in found.channels.items()}
    assert np.abs(h["force"]).max() == pytest.approx(float(found.quantities["peak_force"]))
    assert np.trapezoid(h["force"], h["elongation"]) == pytest.approx(exact, rel=2e-3)
    assert np.abs(h["elongation_rate"]).max() == pytest.approx(0.05)


def test_several_experiments_at_once_are_each_by_itself():
    study = cycles()
    batch = hx.simulate(study, {"a": np.array([10.0, 35.0]), "v": np.array([20.0, 50.0])}, None, ())
    alone = hx.simulate(study, {"a": 35.0, "v": 50.0}, None, ())
    for name, values in batch.quantities.items():
        np.testing.assert_allclose(values[1], alone.quantities[name], rtol=1e-12)


@pytest.mark.whole
def test_what_is_measured_at_imposed_cycles_tells_the_law():
    """Of quantities, and of histories through a campaign with its own times, as a later calibration would read it."""
    truth = {"k": 5.0e6, "F_y": 4.0e4}
    for observe in ("quantities", "histories"):
        study = cycles(f"observe={observe}")
        campaign = campaign_of(study)
        assert campaign.protocol == "displacement"
        calibration = hx.calibrate(study, campaign)
        for name, value in truth.items():
            assert calibration.map[name] == pytest.approx(value, rel=5e-3), observe
    assert set(campaign.channels) == {"time", "elongation", "force"}
    records = [e.record for e in campaign]
    assert len({len(record) for record in records}) == 1 and len({record.time[-1] for record in records}) == 3
    for experiment in campaign:
        a, v = experiment.inputs["a"], experiment.inputs["v"]
        exact = [formula(t, (a, 0.03), v, 2)[0] for t in experiment.record.time[:-1]]
        np.testing.assert_allclose(experiment.record["elongation"][:-1], exact, rtol=0, atol=1e-12)


@pytest.mark.whole
def test_a_request_tells_what_to_impose_and_the_answer_has_the_force(tmp_path):
    """A bench that follows the file it is given; its springs are elastic, k = 3 MN/m."""
    seen = []

    def bench(request):
        seen.append(request)
        request.write(tmp_path, {}, {})
        path = np.loadtxt(tmp_path / "imposed_elongation.csv", delimiter=",", skiprows=1)
        return {"time": path[:, 0], "force": 3.0e6 * path[:, 1]}

    model = {"spring": "elastic", "parameters": {"k": {"uniform": [2e6, 9e6]}}}
    study = cycles("observe=histories", model=model, experiments={"python": {}})
    built = Built(study, function=bench)
    campaign = built.site.perform()
    assert (tmp_path / "imposed_elongation.csv").read_text().startswith("t [s],du [m]\n")
    assert not (tmp_path / "ground_motion.AT2").exists()
    told = json.loads((tmp_path / "request.json").read_text())
    assert told["imposed_elongation"]["samples"] == len(seen[-1].time) == len(told["imposed_elongation"]["times"])
    assert told["record"]["times"][-1] == pytest.approx(seen[-1].time[-1])
    assert hx.calibrate(study, campaign).map["k"] == pytest.approx(3.0e6, rel=1e-4)


IMPOSSIBLE = {
    "a structure": (dict(structure=yaml.safe_load(FRAME)["structure"]), [], "leave the structure out"),
    "a duration": ({}, ["excitation.duration=10"], "leave out duration"),
    "another dimension": ({}, ["inputs.a.unit=s"], r"inputs\.a\.unit.*length"),
    "a name that is no input": ({}, ["excitation.imposed.amplitudes=[b]"], r"amplitudes\.0: it refers to 'b'"),
    "an amplitude of zero": ({}, ["excitation.imposed.amplitudes=[0.0]"], r"amplitudes\.0: an amplitude is positive"),
    "an amplitude that may be negative": ({}, ["inputs.a.uniform=[-1, 2]"], r"inputs\.a: an amplitude is positive"),
    "no amplitude": ({}, ["excitation.imposed.amplitudes=[]"], "must not be empty"),
    "half a cycle": ({}, ["excitation.imposed.cycles=0.5"], "whole number"),
    "two excitations": ({}, ["excitation.near_fault_pulse={V_P: 1, T_P: 1}"], "give either"),
    "what was imposed observed": ({}, ["observe=histories", "channels=[elongation]"], "no channel 'elongation'"),
    "amplitudes beyond all steps": ({}, ["inputs.a.unit=km"], "too many"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_a_plan_that_cannot_be_is_refused(case):
    changes, overrides, said = IMPOSSIBLE[case]
    with pytest.raises(UserError, match=said):
        Built(cycles(*overrides, **changes)).check()


# --- every excitation ----------------------------------------------------------------------------------------------


def test_every_excitation_has_a_place_in_a_study_and_a_sentence():
    given = {
        "near_fault_pulse": {"V_P": "V", "T_P": 1.0},
        "recorded": {"file": "here/a.AT2"},
        "applied_force": {"file": "p.csv", "mass": 2},
        "imposed": {"amplitudes": ["a", 0.02], "rate": 0.01},
    }
    assert given.keys() == DECLARED.keys() == set(EXCITATIONS)
    for name, settings in given.items():
        entry = ExcitationEntry.model_validate({name: settings, **({"duration": 3.0} if "V_P" in settings else {})})
        assert entry.excitation is DECLARED[name] is EXCITATIONS[name].declared
        fields = {field.name: field.default for field in dataclasses.fields(EXCITATIONS[name])}
        assert fields.keys() == {*entry.excitation.settings, *entry.excitation.of_file}
        assert all(entry.excitation.default(one) in (None, fields[one]) for one in entry.excitation.settings)
        sentence = entry.excitation.sentence(entry.settings, entry.duration)
        assert sentence[0].isalnum() and not sentence.endswith(".")
    assert entry.channel == "elongation"
    assert "2 cycles of elongation imposed at each amplitude a, 0.02 m" in sentence


def test_a_figure_shows_what_drives_the_experiments(pushed):
    for study, unit in ((cycles(), "mm"), (pushed(), "kN")):
        (panel,) = hx.plot.ground_motions(study)
        assert f"[{unit}]" in panel.get_ylabel()
        assert len(panel.collections[0].get_segments()) == 200
    assert isinstance(Built(pushed()).experiments.excitation({"s": 1.0}).sample(0.5), Applied)


# --- a run from its first request to its report ---------------------------------------------------------------------

LOOP = {
    "seed": 1,
    "observe": "histories",
    "steps": ["design", "calibrate", "compare", "diagnose", "improve"],
    "design": {"initial": 2, "iterations": 1, "candidates": 64, "kriging": {"starts": 2}},
    "calibration": {"sampler": "laplace", "starts": 2},
}


@pytest.mark.slow
def test_a_designed_cyclic_test_finds_the_hidden_degradation(tmp_path):
    law = {"A": 5.0e6, "beta": 100.0, "gamma": 0.0, "n": 1.0}
    hidden = {"virtual": {"parameters": law, "effects": {"stiffness_degradation": {"delta": 0.1}},
                          "noise": {"relative": 0.01}}}  # fmt: skip
    free = {**law, "A": {"uniform": [2e6, 9e6]}, "beta": {"uniform": [50.0, 200.0]}}
    study = cycles(**LOOP, model={"parameters": free}, experiments=hidden, error={"relative": 0.01})
    run = hx.run(study, output=tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["diagnosis"]["effects"] == ["stiffness_degradation"], summary["diagnosis"]["sentence"]
    steps, floor = summary["improvement"]["steps"], summary["improvement"]["noise_floor"]
    assert steps[0]["error_train"] > 1.15 * floor and steps[-1]["error_train"] < 1.05 * floor
    assert steps[-1]["parameters"]["stiffness_degradation.delta"] == pytest.approx(0.1, rel=0.2)
    assert run.campaign.protocol == "displacement"
    page = (tmp_path / "run" / "report.html").read_text()
    assert "2 cycles of elongation imposed at each amplitude" in page
    assert (tmp_path / "run" / "figures" / "fig3_excitation.svg").is_file()


@pytest.mark.slow
def test_a_run_with_an_applied_force_reaches_its_report(pushed, tmp_path):
    # Peaks alone: the energy of a linear spring is what it holds at the end of the record, a comb of local maxima over k, of
    # which two starts find any.
    told = {"observe": "quantities", "quantities": ["peak_force", "peak_elongation"], "error": {"relative": 1e-3}}
    loop = yaml.safe_dump({**yaml.safe_load(FRAME), **LOOP, **told})
    study = pushed("steps=[design, calibrate, compare, diagnose]", text=loop)
    run = hx.run(study, output=tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["diagnosis"]["verdict"] == "adequate", summary["diagnosis"]["sentence"]
    assert summary["calibration"]["map"]["k"] == pytest.approx(K, rel=5e-3)
    assert len(run.campaign.train) == 3
    assert "Driven by the force force.csv on mass 1" in (tmp_path / "run" / "report.html").read_text()
    assert (tmp_path / "run" / "figures" / "fig3_excitation.svg").is_file()
    # What was run can be run again from its folder.
    again = hx.load_study(tmp_path / "run" / "study.yaml")
    assert Built(again).simulation.planned == Built(study).simulation.planned
