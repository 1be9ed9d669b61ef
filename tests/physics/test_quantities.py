"""Quantities against closed forms, against the recorded history of the same simulation, and as users name and observe them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import hsed_jax as hx
from hsed_jax.measurements import Campaign, Channel, Experiment, Record, check_campaign, parse_unit
from hsed_jax.measurements.units import quantity_dimension
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.outputs import EQ_18, QUANTITIES, Quantity, _largest, is_quantity, output, quantity
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator, Timeline
from hsed_jax.physics.structures import ModalDamping, Structure
from hsed_jax.study.build import Built

NEW = ("residual_elongation", "peak_absolute_acceleration", "peak_energy", "energy_at_1100ms")
NAMES = (*EQ_18, *NEW, "energy_at_5s", "energy_at_60s")
PAPER = "configs/paper.yaml"


# --- the table ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*QUANTITIES, "energy_at_5s"])
def test_an_entry_says_what_there_is_to_know(name):
    known = quantity(name)
    assert output(name) == known
    assert known.symbol and known.meaning
    assert parse_unit(known.unit).factor == 1
    assert quantity_dimension(name).si == known.unit
    time = np.linspace(0, 6, 7)
    record = Record(time, {channel: np.sin(time) for channel in known.channels(2)})
    assert np.isfinite(Experiment("E1", record=record).quantity(name, masses=2))


@pytest.mark.parametrize(("name", "time"), [("energy_at_5s", 5.0), ("energy_at_2500ms", 2.5)])
def test_the_time_of_an_energy_is_in_its_name(name, time):
    assert quantity(name).until == time


@pytest.mark.parametrize(
    "name", ["energy_at_5", "energy_at_0s", "energy_at_2.5s", "energy_at_-1s", "energy_at_s", "energy", "ductility"]
)
def test_what_is_no_quantity_is_none(name):
    assert not is_quantity(name)
    with pytest.raises(KeyError):
        quantity(name)
    with pytest.raises(hx.UserError, match=f"unknown quantity '{name}'; allowed: .*energy_at_5s"):
        quantity_dimension(name)


# --- closed forms ------------------------------------------------------------------------------------------------

MASS, STIFFNESS, PUSH = 2e3, 8e4, 3.0
OMEGA = np.sqrt(STIFFNESS / MASS)
ELASTIC = {"A": STIFFNESS, "beta": 0.0, "gamma": 0.0, "n": 1.0}


def pushed(step, steps, padding=0):
    """An undamped elastic oscillator under a constant acceleration of the ground: u = −(a/ω²)(1 − cos ωt)."""
    structure = Structure((MASS,), (), ((None, 0),), ModalDamping(0.0, STIFFNESS))
    lengths = np.concatenate([np.full(steps, step), np.zeros(padding)])
    motion = Tabulated(jnp.full(2 * lengths.size + 1, PUSH))
    simulator = Simulator(structure, None, Timeline(None, lengths.size))
    response = simulator.respond(ELASTIC, Conditions({}, Recorded(motion, jnp.asarray(lengths))), quantities=NEW)
    assert response.ok
    return {name: float(value) for name, value in response.quantities.items()}


@pytest.mark.verification("dynamics")
def test_quantities_of_an_elastic_oscillator_are_the_closed_ones(observed):
    # Neither the peak nor 1.1 s falls on the end of a step of 0.018 s.
    step, steps = 0.018, 97
    found = pushed(step, steps)

    def elongation(t):
        return -PUSH / OMEGA**2 * (1 - np.cos(OMEGA * t))

    exact = {
        "residual_elongation": (elongation(step * steps), 1e-4),
        "peak_absolute_acceleration": (2 * PUSH, 5e-6),
        "energy_at_1100ms": (0.5 * STIFFNESS * elongation(1.1) ** 2, 1e-4),
        # All of the work is given back: what it was at most is twice the push to the left.
        "peak_energy": (0.5 * STIFFNESS * (2 * PUSH / OMEGA**2) ** 2, 1e-4),
    }
    for name, (value, within) in exact.items():
        observed(f"elastic oscillator under a sudden push: {name}", "closed form", found[name] / value - 1, within)
    at_ends = PUSH * (1 - np.cos(OMEGA * step * np.arange(steps + 1)))
    assert abs(at_ends.max() / (2 * PUSH) - 1) > 1e-4  # a peak of the samples alone would not pass


def test_padded_steps_change_no_quantity():
    assert pushed(0.018, 111, padding=40) == pytest.approx(pushed(0.018, 111), rel=1e-12)


def test_energy_at_a_time_beyond_the_end_is_that_at_the_end():
    found = pushed(0.018, 50)
    assert found["energy_at_1100ms"] == pytest.approx(found["dissipated_energy"], rel=1e-12)


def test_quantities_of_an_imposed_elongation():
    step, steps = 0.02, 80
    time = 0.5 * step * np.arange(2 * steps + 1)
    path = Imposed(jnp.asarray(0.03 * np.sin(2 * time)), jnp.asarray(0.06 * np.cos(2 * time)))
    conditions = Conditions({}, Recorded(Tabulated(path), jnp.full(steps, step)))
    names = ("residual_elongation", "energy_at_1100ms", "peak_energy")
    found = Simulator(None, None, Timeline(None, steps)).respond(ELASTIC, conditions, quantities=names).quantities
    assert found["residual_elongation"] == pytest.approx(0.03 * np.sin(3.2), rel=1e-12)
    assert found["energy_at_1100ms"] == pytest.approx(0.5 * STIFFNESS * (0.03 * np.sin(2.2)) ** 2, rel=1e-6)
    assert found["peak_energy"] == pytest.approx(0.5 * STIFFNESS * 0.03**2, rel=1e-6)  # at π/4 s, within a step


# --- the history of the same simulation -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulated(paper_simulator, pulse_conditions):
    """Quantities at the usual step, and an experiment with the history of the same simulation at 1/1600 s."""
    parameters, conditions = {"A": 5e5, "beta": 1.0}, pulse_conditions(2.25, 1.0)
    channels = ("elongation", "force", "acceleration_1_absolute", "acceleration_2_absolute")
    usual = paper_simulator().respond(parameters, conditions, quantities=NAMES[3:])
    fine = paper_simulator(timeline=Timeline(1 / 1600, 16000)).respond(parameters, conditions, channels)
    record = Record(np.arange(16001) / 1600, {name: np.asarray(fine.channels[name]) for name in channels})
    return usual.quantities, Experiment("E1", record=record)


@pytest.mark.parametrize("name", NAMES[:-1])
def test_a_quantity_is_that_of_the_history(simulated, name):
    quantities, experiment = simulated
    # Measured: 8e-5 at most, and of the residual 2 µm in 0.25 m.
    floor = 5e-6 if name == "residual_elongation" else 0.0
    assert float(quantities[name]) == pytest.approx(experiment.quantity(name, masses=2), rel=2e-4, abs=floor)


def test_a_record_that_ends_before_does_not_tell_the_energy(simulated):
    _, experiment = simulated
    assert np.isnan(experiment.quantity("energy_at_60s"))


def test_peak_acceleration_needs_every_mass(simulated):
    _, experiment = simulated
    assert np.isnan(experiment.quantity("peak_absolute_acceleration", masses=3))
    assert np.isnan(experiment.quantity("peak_absolute_acceleration"))
    alone = experiment.quantity("peak_absolute_acceleration", masses=1)
    assert alone == np.abs(experiment.record["acceleration_1_absolute"]).max()


def test_the_time_of_an_energy_counts_from_the_start_of_the_record():
    u = np.asarray([0.0, 1.0, 2.0, 3.0])
    experiment = Experiment("E1", record=Record(np.asarray([7.0, 8.0, 10.0, 11.0]), {"force": 2 * u, "elongation": u}))
    assert experiment.quantity("energy_at_3s") == 4.0  # u² at u = 2
    assert experiment.quantity("energy_at_2s") == 2.5  # halfway between 1 and 4


def test_a_given_quantity_comes_before_the_record(simulated):
    _, experiment = simulated
    given = Experiment("E1", record=experiment.record, quantities={"residual_elongation": -0.5})
    assert given.quantity("residual_elongation") == -0.5


def test_a_response_has_the_quantities_of_the_paper_and_those_asked_for(paper_simulator, pulse_conditions):
    conditions = pulse_conditions(2.25, 1.0)
    plain = jax.eval_shape(lambda: paper_simulator().respond({"A": 5e5, "beta": 1.0}, conditions))
    more = jax.eval_shape(lambda: paper_simulator().respond({"A": 5e5, "beta": 1.0}, conditions, (), NEW))
    assert set(plain.quantities) == set(EQ_18)
    assert set(more.quantities) == {*EQ_18, *NEW}


def test_gains_of_the_rig_act_on_what_they_measure(paper_simulator, pulse_conditions):
    names, conditions, law = (*NEW, "energy_at_5s"), pulse_conditions(2.25, 1.0), {"A": 5e5, "beta": 1.0}
    gains = {"force_gain.delta": 0.1, "elongation_gain.delta": -0.2}
    exact = paper_simulator().respond(law, conditions, quantities=names).quantities
    told = (
        paper_simulator(("force_gain", "elongation_gain")).respond(law | gains, conditions, quantities=names).quantities
    )
    factors = {name: float(told[name] / exact[name]) for name in exact}
    expected = {
        "peak_force": 1.1,
        "peak_elongation": 0.8,
        "residual_elongation": 0.8,
        "peak_absolute_acceleration": 1.0,
    }
    expected |= dict.fromkeys(("dissipated_energy", "peak_energy", "energy_at_1100ms", "energy_at_5s"), 0.88)
    assert factors == pytest.approx(expected, rel=1e-9)


# --- a quantity of one's own is one entry ---------------------------------------------------------------------------


def test_a_further_quantity_is_one_entry(monkeypatch, tmp_path):
    entry = Quantity(
        r"\max|\Delta\dot u|",
        "m/s",
        "largest rate of the elongation",
        channels=lambda masses: ("elongation_rate",),
        measured=lambda time, channels: float(np.max(np.abs(channels["elongation_rate"]))),
        kept=_largest(lambda step: step.system.kinematics(*step.end)[step.specimen][1]),
    )
    monkeypatch.setitem(QUANTITIES, "peak_rate", entry)
    study = hx.load_study(PAPER, ["quantities=[peak_rate]", "steps=[calibrate]"])
    inputs = {"V_P": 2.25, "T_P": 1.0}
    response = hx.simulate(study, inputs, channels=("elongation_rate",))
    largest = float(np.abs(response.channels["elongation_rate"]).max())
    assert float(response.quantities["peak_rate"]) == pytest.approx(largest, rel=1e-12)
    assert "peak_rate" in str(response)
    campaign = Campaign("mine", "ground_motion", quantities={"peak_rate": Channel("peak_rate", "mm/s")})
    campaign = campaign.add(Experiment("E1", quantities={"peak_rate": largest}))
    hx.write_campaign(campaign, tmp_path / "mine")
    assert hx.read_campaign(tmp_path / "mine")["E1"].quantity("peak_rate") == pytest.approx(largest, rel=1e-15)


# --- campaigns and studies ------------------------------------------------------------------------------------------


def test_a_campaign_with_new_quantities_is_read_as_it_was_written(tmp_path):
    units = {"residual_elongation": "mm", "peak_absolute_acceleration": "g", "energy_at_2s": "kJ"}
    campaign = Campaign("new", "ground_motion", quantities={name: Channel(name, unit) for name, unit in units.items()})
    numbers = {"residual_elongation": -0.0, "peak_absolute_acceleration": 9.80665, "energy_at_2s": 1.5e4}
    campaign = campaign.add(Experiment("E1", quantities=numbers))
    hx.write_campaign(campaign, tmp_path / "c")
    text = (tmp_path / "c" / "experiments.csv").read_text(encoding="utf-8")
    assert ",1.0,15.0" in text
    again = hx.read_campaign(tmp_path / "c")
    assert again["E1"].quantities == numbers
    assert check_campaign(again) == []  # no residual is no reason to doubt the unit


def test_a_campaign_with_a_quantity_in_a_wrong_unit_is_refused():
    with pytest.raises(hx.UserError, match="does not measure acceleration"):
        Campaign(
            "c", "ground_motion", quantities={"peak_absolute_acceleration": Channel("peak_absolute_acceleration", "mm")}
        )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("quantities=[energy_at_5]", "quantities: there is no quantity 'energy_at_5'; allowed are .*energy_at_500ms"),
        (
            "quantities=[energy_at_15s]",
            "quantities: energy_at_15s lies beyond the end of the experiments, which last 10 s",
        ),
        (
            "quantities=[residual_elongation]",
            r"error.residual_elongation: .* may be negative or zero, .* \[m\], such as error: {residual_elongation: {abs",
        ),
        (
            "experiments={command: {run: '{python} x.py', channels: {time: {unit: s}, elongation: {unit: m}, "
            "acceleration_1_absolute: {unit: g}}}}",
            r"peak_absolute_acceleration is observed and not measured; .*\(acceleration_1_absolute, acceleration_2_absolute\)",
        ),
        (
            "design.limits={stroke: 0.1, weight: 3}",
            "allowed here are force, stroke, energy, acceleration, velocity, prob",
        ),
        ("design.limits={probability: 0.1}", "at least one of force, stroke, energy, acceleration, velocity"),
    ],
)
def test_a_mistake_gets_one_message(override, message):
    quantities = "quantities=[peak_elongation, peak_absolute_acceleration]"
    with pytest.raises(hx.UserError, match=message):
        built = Built(hx.load_study(PAPER, [quantities, override]))
        built.check()
        _ = built.design.limits


@pytest.mark.whole
def test_a_component_test_has_no_acceleration_of_a_mass(tmp_path):
    time = np.linspace(0, 1, 50)
    record = Record(time, {"elongation": 0.01 * np.sin(6 * time), "force": 1e3 * np.sin(6 * time)})
    channels = {"time": "s", "elongation": "m", "force": "N"}
    campaign = Campaign("c", "displacement", channels={name: Channel(name, unit) for name, unit in channels.items()})
    campaign = campaign.add(Experiment("E1", record=record))
    hx.write_campaign(campaign, tmp_path / "c")
    hx.initial_study(hx.read_campaign(tmp_path / "c"), tmp_path / "study.yaml")
    observed = ["observe=quantities", "quantities=[peak_absolute_acceleration]", "error={relative: 0.05}"]
    with pytest.raises(hx.UserError, match="quantities: peak_absolute_acceleration needs masses, but a component test"):
        Built(hx.load_study(tmp_path / "study.yaml", observed)).check()


def overrides(*more):
    noise = "{peak_absolute_acceleration: {relative: 0.01}, energy_at_2s: {relative: 0.01}, " + (
        "residual_elongation: {absolute: 1.0e-4}}"
    )
    return [
        "quantities=[peak_absolute_acceleration, energy_at_2s, residual_elongation]",
        "error=null",
        "experiments.virtual.effects={}",
        f"experiments.virtual.noise={noise}",
        "calibration.sampler=laplace",
        *more,
    ]


@pytest.mark.whole
def test_a_study_in_yaml_calibrates_on_new_quantities():
    study = hx.load_study(PAPER, overrides("design.initial=6", "steps=[calibrate]"))
    fit = hx.calibrate(study)
    assert fit.map["A"] == pytest.approx(5e5, rel=0.02)
    assert fit.map["beta"] == pytest.approx(1.0, rel=0.04)
    comparison = hx.compare(fit)
    assert set(comparison.train.per_output) == set(study.quantities)


@pytest.mark.whole
def test_a_design_asks_for_what_is_within_a_limit_of_a_new_quantity(tmp_path):
    design = "design={initial: 3, iterations: 1, candidates: 64, limits: {acceleration: 40.0, probability: 0.3}}"
    run = hx.run(hx.load_study(PAPER, overrides(design, "steps=[design]")), output=tmp_path / "run", figures=False)
    asked = run.campaign["E04"]
    # The first three are the initial design, which knows no model yet; one of them is beyond the limit.
    assert max(e.quantities["peak_absolute_acceleration"] for e in run.campaign) > 45
    assert asked.quantities["peak_absolute_acceleration"] < 42
    written = yaml.safe_load((tmp_path / "run" / "study.yaml").read_text(encoding="utf-8"))
    assert written["design"]["limits"]["acceleration"] == 40.0
    again = hx.read_campaign(tmp_path / "run" / "campaign")
    assert [e.quantities for e in again] == [e.quantities for e in run.campaign]
