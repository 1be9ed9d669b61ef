"""Several specimens in one structure, of one law or of several, and linear springs that yield."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.places import ROOT
from scipy.integrate import solve_ivp

import hsed_jax as hx
from hsed_jax.diagnosis.candidates import applicable, with_effects
from hsed_jax.errors import UserError
from hsed_jax.measurements import overview, write_campaign
from hsed_jax.physics.effects import EFFECTS, Catalogue
from hsed_jax.physics.effects.yielding import Yielding
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.laws import BoucWen, Elastic
from hsed_jax.physics.outputs import is_quantity, loops, output
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Parametrised, Simulator, Timeline
from hsed_jax.physics.structures import ModalDamping, Spring, Structure
from hsed_jax.study.build import Built

MASSES = (2.0e4, 1.5e4)
RATIO = 0.03
FIRST, SECOND = {"A": 6e6, "beta": 60.0}, {"A": 4e6, "beta": 50.0}
BETWEEN = ((None, 0), (0, 1))
EXCITATION = Parametrised(NearFaultPulse, (("V_P", "V_P"), ("T_P", 0.7)))
CONDITIONS = Conditions({"V_P": jnp.asarray(0.6)})
TIMELINE = Timeline(0.002, 2000, 20)
SCALES = Scales(1e5, 0.02, 0.5, 5e3)
TWO = (Element("storey1"), Element("storey2"))

STUDY = """
study: two_storeys
structure:
  masses: [2.0e4, 1.5e4]
  specimens:
    storey1: {between: [ground, 1]}
    storey2:
      between: [1, 2]
      model:
        spring: bilinear
        parameters: {k: {uniform: [1.0e6, 6.0e6]}, F_y: 4.0e4, b: 0.05}
  damping: {modal: 0.03, specimen_stiffness: {storey1: 6.0e6, storey2: 3.0e6}}
excitation: {near_fault_pulse: {V_P: V_P, T_P: 0.7}, duration: 3.0}
inputs: {V_P: {uniform: [0.3, 0.9], unit: m/s}}
model: {parameters: {A: {uniform: [3.0e6, 9.0e6]}, beta: 60.0}}
experiments:
  virtual:
    parameters: {A: 6.0e6, beta: 60.0, storey2.k: 3.0e6, storey2.F_y: 4.0e4, storey2.b: 0.05}
    effects: {storey2.strength_degradation: {delta: 1.0}}
    noise: {relative: 0.02}
    test: 1
scales: {force: 1.0e5, elongation: 0.05, rate: 0.5, energy: 5.0e3}
observe: histories
design: {initial: 2}
steps: [calibrate]
calibration: {sampler: laplace}
"""


def study(tmp_path, *changes):
    (tmp_path / "study.yaml").write_text(STUDY)
    return hx.load_study(tmp_path / "study.yaml", changes)


def frame(springs=(), specimens=BETWEEN, stiffness=(FIRST["A"], SECOND["A"])):
    return Structure(MASSES, springs, specimens, ModalDamping(RATIO, stiffness))


def histories(structure, parameters, channels, **changes):
    simulator = Simulator(structure=structure, excitation=EXCITATION, timeline=TIMELINE, scales=SCALES, **changes)
    response = simulator.respond({name: jnp.asarray(float(v)) for name, v in parameters.items()}, CONDITIONS, channels)
    assert response.ok
    return response


def named(**of_specimens):
    return {f"{owner}.{name}": value for owner, own in of_specimens.items() for name, value in own.items()}


def bouc_wen_frame(slips):
    """Both storeys by SciPy: displacements, velocities, forces (or plastic elongations) as rates of the law say."""
    masses = np.asarray(MASSES)
    K = np.array([[FIRST["A"] + SECOND["A"], -SECOND["A"]], [-SECOND["A"], SECOND["A"]]])
    root = np.sqrt(masses)
    values, modes = np.linalg.eigh(K / np.outer(root, root))
    C = np.outer(root, root) * ((modes * (2 * RATIO * np.sqrt(values))) @ modes.T)
    pulse = NearFaultPulse(0.6, 0.7)
    fine = np.linspace(0.0, 4.0, 40001)
    ground = np.asarray(jax.vmap(pulse.sample)(jnp.asarray(fine)))

    def rates(t, y):
        v, z = y[2:4], y[4:]
        du = np.array([v[0], v[1] - v[0]])
        force = np.array([z[0] - z[1], z[1]])
        return [*v, *(-(C @ v + force) / masses - np.interp(t, fine, ground)), *slips(du, z)]

    times = np.linspace(0.0, 4.0, 2001)
    return solve_ivp(rates, (0.0, 4.0), np.zeros(6), t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.005).y


@pytest.mark.whole
def test_two_specimens_are_those_of_another_integrator():
    stiffness, bounds = np.array([6e6, 4e6]), np.array([60.0, 50.0])
    y = bouc_wen_frame(lambda du, z: stiffness * du - bounds * np.abs(du) * z)
    names = ("storey1.elongation", "storey1.force", "storey2.elongation", "storey2.force", "displacement_2")
    given = named(storey1=FIRST, storey2=SECOND) | {"gamma": 0.0, "n": 1.0}
    response = histories(frame(), given, names, elements=TWO)
    expected = (y[0], y[4], y[1] - y[0], y[5], y[1])
    for name, truth in zip(names, expected, strict=True):
        np.testing.assert_allclose(response.channels[name], truth[::20], rtol=0, atol=2e-4 * np.abs(truth).max())
    for i, owner in enumerate(("storey1", "storey2")):
        force, elongation = expected[2 * i + 1], expected[2 * i]
        assert response.quantities[f"{owner}.peak_force"] == pytest.approx(np.abs(force).max(), rel=1e-3)
        assert response.quantities[f"{owner}.peak_elongation"] == pytest.approx(np.abs(elongation).max(), rel=1e-3)


@pytest.mark.whole
def test_a_specimen_that_is_elastic_is_a_linear_spring():
    spring = histories(
        frame((Spring((0, 1), SECOND["A"]),), BETWEEN[:1], FIRST["A"]), FIRST | {"gamma": 0.0, "n": 1.0}, ("force",)
    )
    elements = (Element("storey1"), Element("storey2", Elastic, is_apart=True))
    given = named(storey1=FIRST, storey2={"k": SECOND["A"]}) | {"gamma": 0.0, "n": 1.0}
    both = histories(frame(), given, ("storey1.force",), elements=elements)
    force = spring.channels["force"]
    np.testing.assert_allclose(both.channels["storey1.force"], force, rtol=0, atol=1e-10 * np.abs(force).max())


@pytest.mark.whole
def test_a_linear_spring_that_yields_is_a_bouc_wen_specimen():
    structure = frame((Spring((0, 1), SECOND["A"]),), BETWEEN[:1], FIRST["A"])
    law = FIRST | {"gamma": 0.0, "n": 1.0}
    names = ("force", "displacement_1", "displacement_2")
    linear = histories(structure, law, names)
    catalogue = Catalogue((("spring_1.yielding", Yielding),))

    def with_delta(delta):
        return histories(structure, law | {"spring_1.yielding.delta": delta}, names, effects=catalogue).channels

    for name, values in with_delta(0.0).items():
        np.testing.assert_allclose(values, linear.channels[name], rtol=0, atol=1e-11 * np.abs(values).max())
    # It yields at u_c/delta: the bound of the force is k u_c/delta, and beta = gamma = half of its stiffness over that.
    bound = SECOND["A"] * SCALES.elongation / 1.5
    half = 0.5 * SECOND["A"] / bound
    elements = (Element("storey1"), Element("storey2", BoucWen, is_apart=True))
    given = named(storey1=law, storey2={"A": SECOND["A"], "beta": half, "gamma": half, "n": 1.0})
    yields = histories(frame(), given, ("storey1.force", *names[1:]), elements=elements).channels
    for found, expected in zip(with_delta(1.5).values(), yields.values(), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3 * np.abs(expected).max())


@pytest.mark.whole
def test_a_linear_spring_that_yields_freely_is_a_bouc_wen_specimen_beside_a_spring():
    stiffness, kept, delta, turned, sharpness = SECOND["A"], 0.4, 1.2, 1.375, 1.3
    law = FIRST | {"gamma": 0.0, "n": 1.0}
    form = dict(Yielding.forms[2].held) | {"delta": delta, "elastic": kept, "turned": turned, "sharpness": sharpness}
    found = histories(
        frame((Spring((0, 1), stiffness),), BETWEEN[:1], FIRST["A"]),
        law | {f"spring_1.yielding.{name}": value for name, value in form.items()},
        ("displacement_1", "displacement_2"),
        effects=Catalogue((("spring_1.yielding", Yielding),)),
    ).channels
    # beta + gamma < 0: the loop hardens.
    a = (1 - kept) * stiffness
    beta = a * delta / (a * SCALES.elongation) ** sharpness
    beside = {"A": a, "beta": beta, "gamma": -turned * beta, "n": sharpness}
    expected = histories(
        frame((Spring((0, 1), kept * stiffness),), stiffness=(FIRST["A"], a)),
        named(storey1=law, storey2=beside),
        ("displacement_1", "displacement_2"),
        elements=(Element("storey1"), Element("storey2", BoucWen, is_apart=True)),
    ).channels
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=2e-3 * np.abs(values).max())


@pytest.mark.whole
def test_parameters_are_shared_unless_a_specimen_has_its_own():
    law = {"A": 5e6, "beta": 50.0, "gamma": 0.0, "n": 1.0}
    names = ("storey1.force", "storey2.force")
    shared = histories(frame(), law, names, elements=TWO).channels
    each = histories(frame(), named(storey1=law, storey2=law), names, elements=TWO).channels
    other = histories(frame(), law | {"storey2.A": 4e6}, names, elements=TWO).channels
    for name in names:
        np.testing.assert_array_equal(shared[name], each[name])
        assert np.abs(shared[name] - other[name]).max() > 0.01 * np.abs(shared[name]).max()


@pytest.mark.whole
def test_effects_and_sensors_are_of_one_specimen():
    law = {"A": 5e6, "beta": 50.0, "gamma": 0.0, "n": 1.0}
    names = ("storey1.force", "storey2.force")
    plain = histories(frame(), law, names, elements=TWO).channels

    def changed(effect):
        catalogue = Catalogue(((f"storey2.{effect}", EFFECTS[effect]),))
        given = law | {f"storey2.{effect}.delta": 0.1}
        return histories(frame(), given, names, elements=TWO, effects=catalogue).channels

    gained = changed("force_gain")
    np.testing.assert_array_equal(gained["storey1.force"], plain["storey1.force"])
    np.testing.assert_allclose(gained["storey2.force"], 1.1 * plain["storey2.force"], rtol=1e-12)
    degraded = changed("strength_degradation")
    assert np.abs(degraded["storey2.force"]).max() < np.abs(plain["storey2.force"]).max()


def test_names_of_outputs():
    assert output("storey2.force").unit == "N"
    assert "storey2" in output("storey2.peak_force").meaning
    assert is_quantity("storey2.energy_at_5s")
    assert loops(["a.force", "b.force", "b.elongation", "time"]) == ("b",)
    for name in ("storey2.time", "storey2.displacement_1", "storey2.peak_absolute_acceleration", ".force", "a.b.force"):
        with pytest.raises(KeyError):
            output(name)


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    return hx.calibrate(study(tmp_path_factory.mktemp("frame"), "experiments.virtual.effects={}"))


@pytest.mark.whole
def test_a_study_calibrates_both_and_says_of_which_each_figure_is(calibration):
    truth = {"A": 6e6, "storey2.k": 3e6}
    found = calibration.fit.summary()
    assert list(found) == list(truth)
    for name, value in truth.items():
        assert abs(found[name]["mean"] - value) < 4 * found[name]["sd"]
        assert found[name]["sd"] < 0.01 * value
    assert calibration.fit.units == {"A": "N/m", "storey2.k": "N/m"}
    outputs = hx.compare(calibration).summary()["test"]["per_output"]
    assert list(outputs) == [
        f"storey{i}.{name}" for i in (1, 2) for name in ("elongation", "force")
    ]  # of each, in the order of the structure
    assert all(errors["nrmse"] < 0.03 for errors in outputs.values())


@pytest.mark.whole
def test_a_campaign_on_disk_has_channels_of_each(calibration, tmp_path):
    write_campaign(calibration.campaign, tmp_path / "campaign")
    again = hx.read_campaign(tmp_path / "campaign")
    assert {"storey1.force", "storey2.force"} <= again.channels.keys()
    assert "initial stiffness of storey2" in str(overview(again))
    for before, after in zip(calibration.campaign, again, strict=True):
        assert before.record is not None and after.record is not None
        np.testing.assert_allclose(before.record["storey2.force"], after.record["storey2.force"], rtol=1e-9)


def test_candidates_are_those_of_each_specimen(tmp_path):
    built = Built(study(tmp_path))
    found = applicable(built, built.site.empty_campaign())
    assert {"storey1.stiffness_degradation", "storey2.strength_degradation", "mass_error"} <= set(found)
    assert "storey2.stiffness_degradation" not in found  # no slot of the bilinear law
    assert not {"slip", "force_gain", "storey1.mass_error", "yielding"} & set(found)
    larger = with_effects(built, ["storey2.strength_degradation"])
    assert "storey2.strength_degradation.delta" in Built(larger).mechanics.parameters[0]
    with pytest.raises(UserError, match=r"the model has storey2\.strength_degradation already"):
        with_effects(Built(larger), ["storey2.strength_degradation"])


def test_an_effect_of_all_needs_one_that_shares_the_model(tmp_path):
    model = "{parameters: {A: {uniform: [1e6, 2e6]}, beta: 60.0}}"
    apart = f"structure.specimens={{left: {{between: [ground, 1], model: {model}}}}}"
    changes = [
        apart,
        "structure.damping.specimen_stiffness=1e6",
        "experiments.virtual.parameters={left.A: 1e6, left.beta: 60.0}",
    ]
    changes += ["experiments.virtual.effects={}", "model={}"]
    built = Built(study(tmp_path, *changes))
    built.check()
    assert "left.slip" in built.mechanics.naming.candidates and "slip" not in built.mechanics.naming.candidates
    assert "storey2.yielding" not in built.mechanics.naming.candidates
    with pytest.raises(
        UserError, match=r"slip: no specimen shares the model of the study; name the specimen, left\.slip"
    ):
        Built(study(tmp_path, *changes, "model={effects: {slip: {}}}")).check()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("model.parameters.storey3.A=1.0", "there is no such parameter"),
        ("experiments.virtual.parameters={A: 6e6, beta: 60.0}", "storey2.k: this key is required"),
        ("quantities=[peak_force]", "storey1.peak_force, storey2.peak_force"),
        ("channels=[force]", "storey1.force"),
        ("structure.specimens={slip: {between: [ground, 1]}}", "slip is the name of an effect"),
        ("structure.specimens={spring_1: {between: [ground, 1]}}", "can be no specimen's name"),
        ("structure.specimen={between: [1, 2]}", "give either specimen, or specimens"),
        ("structure.damping.specimen_stiffness={storey1: 6e6}", "one for each of several specimens: storey1, storey2"),
        ("improve.add=[storey2.slip]", "which the law bilinear does not have"),
        ("model.effects={storey9.slip: {}}", "there is no such effect"),
        ("model.parameters={beta: 60.0}", "model.parameters.A: this key is required"),
    ],
)
def test_a_mistake_gets_one_message(tmp_path, change, message):
    changes = [change, "steps=[calibrate, compare, improve]"] if "improve" in change else [change]
    changes += ["observe=quantities"] if "quantities" in change else []
    with pytest.raises(UserError, match=message.replace(".", r"\.")):
        Built(study(tmp_path, *changes)).check()


@pytest.mark.whole
def test_the_ready_frame_has_a_takeda_storey():
    ready = hx.load_study(ROOT / "configs" / "two_storeys.yaml")
    truth = {"storey1.k": 6e6, "storey1.F_y": 6e4, "A": 4e6, "beta": 50.0, "structure.mass_2": 1.5e4}
    response = hx.simulate(ready, {"V_P": 0.8, "T_P": 0.8}, truth)
    elongation, force = (np.asarray(response.channels[f"storey1.{name}"]) for name in ("elongation", "force"))
    # Elastic until it yields, then on the hardening branch, whose slope is b k = 0.05 k.
    before = np.cumsum(np.abs(elongation) > 6e4 / 6e6) == 0
    np.testing.assert_allclose(force[before], 6e6 * elongation[before], rtol=1e-9)
    first = int(np.argmax(np.abs(elongation)))
    assert abs(force[first]) <= (6e4 + 0.05 * 6e6 * (np.abs(elongation[first]) - 0.01)) * (1 + 1e-6)
    assert abs(force[first]) > 6e4
