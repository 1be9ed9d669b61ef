"""Materials of OpenSees as models: the table against formulas, the processes that simulate, messages, export, recovery."""

import json
import os
import runpy
import signal
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from builders.places import ROOT
from builders.studies import SMALL
from laws_in_steps import MenegottoPinto
from observations import of_largest, relative

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study, parse_yaml
from hsed_jax.errors import UserError
from hsed_jax.exports.counterparts import Command
from hsed_jax.exports.materials import Test as Along
from hsed_jax.exports.materials import difference
from hsed_jax.exports.scripts import python_script
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.laboratories.opensees import interpreter
from hsed_jax.measurements import Campaign, Channel, Noise
from hsed_jax.models.opensees import MATERIALS, driver
from hsed_jax.models.opensees.base import Marks
from hsed_jax.models.opensees.envelope import four_points
from hsed_jax.models.opensees.simulated import Simulated, finely
from hsed_jax.models.opensees.workers import Workers
from hsed_jax.study.build import Built
from hsed_jax.study.first_material import material_lines

NEEDS_OPENSEES = pytest.mark.usefixtures("openseespy")
STIFFNESS, STRENGTH, REACH = 2.0e7, 1.0e5, 0.04
# A pinched branch that is stiffer than the asymptote, which the table excludes.
ENDLESS = (67.8, 53.6, 0.0146, 34900.0, 0.101, -0.0309, 1.18, 0.239, 0.308, 1.03)
# Of every material a set of parameters in which nothing degrades.
PARAMETERS = {
    "Pinching4": {
        "k": STIFFNESS, "F_m": STRENGTH, "u_p": 0.015, "u_c": 0.1, "c": 0.4, "y": 0.5, "q": 0.4, "r": 0.05,
        "rDisp": 0.3, "rForce": 0.3, "uForce": 0.0, "gK1": 0.0, "gK2": 0.0, "gD1": 0.0, "gD2": 0.0, "gF1": 0.0,
        "gF2": 0.0, "gE": 10.0, "limit": 0.9, "negative": 1.0,
    },
    "IMKPeakOriented": {
        "k": STIFFNESS, "F_y": 0.8 * STRENGTH, "u_p": 0.015, "u_c": 0.1, "h": 1.25, "r": 0.0,
        "d_S": 0.0, "d_C": 0.0, "d_A": 0.0, "d_K": 0.0, "negative": 1.0,
    },
    "IMKPinching": {
        "k": STIFFNESS, "F_y": 0.8 * STRENGTH, "u_p": 0.015, "u_c": 0.1, "h": 1.25, "r": 0.0,
        "d_S": 0.0, "d_C": 0.0, "d_A": 0.0, "d_K": 0.0, "kappaF": 0.4, "kappaD": 0.5, "negative": 1.0,
    },
    "IMKBilin": {
        "k": STIFFNESS, "F_y": 0.8 * STRENGTH, "u_p": 0.015, "u_c": 0.1, "h": 1.25, "r": 0.0,
        "d_S": 0.0, "d_C": 0.0, "d_K": 0.0, "negative": 1.0,
    },
    "HystereticSM": {
        "k": STIFFNESS, "F_m": STRENGTH, "u_p": 0.015, "u_c": 0.1, "y": 0.6, "r": 0.05,
        "pinchX": 0.6, "pinchY": 0.4, "damage1": 0.0, "damage2": 0.0, "beta": 0.2, "negative": 1.0,
    },
    "SelfCentering": {"k": STIFFNESS, "F_a": 0.7 * STRENGTH, "b": 0.05, "beta": 0.6},
    "Steel4": {
        "k": STIFFNESS, "F_y": 0.7 * STRENGTH, "b": 0.02, "R_0": 15.0, "r_1": 0.9, "r_2": 0.15,
        "b_i": 0.0, "rho_i": 0.5, "b_l": 0.0, "R_i": 20.0,
    },
    "SAWS": {
        "k": STIFFNESS, "F_0": 0.8 * STRENGTH, "f_I": 0.2, "u_u": 0.05, "R1": 0.03, "R2": 0.05, "R3": 1.1,
        "r_4": 0.3, "alpha": 0.7, "beta": 1.1,
    },
}  # fmt: skip
DEGRADING = {
    "Pinching4": ("gK2", "gD2", "gF2"),
    "IMKPeakOriented": ("d_S", "d_C", "d_A", "d_K"),
    "IMKPinching": ("d_S", "d_C", "d_A", "d_K"),
    "IMKBilin": ("d_S", "d_C", "d_K"),
    "HystereticSM": ("damage1", "damage2"),
}


def path(peaks, samples=120):
    """A path to these peaks, one after the other."""
    corners = np.concatenate([[0.0], peaks])
    return np.concatenate([np.linspace(a, b, samples, endpoint=False) for a, b in pairwise(corners)])


CYCLES = path([s * REACH * a for a in (0.25, 0.25, 0.5, 0.5, 1.0, 1.0) for s in (1, -1)])


def force(material, elongation, **other):
    return Simulated(material)({**PARAMETERS[material], **other}, {"elongation": np.asarray(elongation)})["force"]


def test_every_material_of_the_table_is_tried():
    assert set(PARAMETERS) == set(MATERIALS)
    for name, material in MATERIALS.items():
        assert list(PARAMETERS[name]) == list(material.parameters)


@pytest.mark.parametrize("name", MATERIALS)
def test_a_material_has_few_free_parameters_and_each_has_a_prior_from_the_record(name):
    marks = Marks(STIFFNESS, STRENGTH, REACH, 1.0)
    free = {key: known for key, known in MATERIALS[name].parameters.items() if known.value is None}
    assert 4 <= len(free) <= 12
    assert all(known.prior_of(marks) for known in free.values())
    # The middle of a prior moves with its mark alone.
    for known in free.values():
        more = known.prior_of(Marks(2 * STIFFNESS, 3 * STRENGTH, 5 * REACH, 7.0))
        ((kind, given),) = known.prior_of(marks).items()
        factor = {"N/m": 2.0, "N": 3.0, "m": 5.0, "1/m": 1 / 7.0, "1": 1.0}[known.unit]
        if kind == "lognormal":
            assert more[kind][0] - given[0] == pytest.approx(np.log(factor)) and more[kind][1] == given[1]
        elif kind == "half_normal":
            assert more[kind] == pytest.approx(given * factor)
        else:
            assert more[kind] == given and factor == 1


@NEEDS_OPENSEES
@pytest.mark.verification("laws")
@pytest.mark.parametrize("name", MATERIALS)
def test_a_material_is_as_stiff_as_its_parameter_says_and_symmetric(name, observed):
    small = np.linspace(0, 1e-3 * STRENGTH / STIFFNESS, 5)[1:]
    # The curves of Steel4 and SAWS bend from the beginning.
    observed(
        f"{name} of OpenSees: initial stiffness", "parameter k", relative(force(name, small), STIFFNESS * small), 2e-3
    )
    there, back = force(name, CYCLES[:120]), force(name, -CYCLES[:120])
    observed(f"{name} of OpenSees: force of the other sign", "force of the first sign", of_largest(-back, there), 1e-9)


@NEEDS_OPENSEES
@pytest.mark.parametrize("name", DEGRADING)
def test_zero_degrades_nothing_and_each_rate_degrades(name):
    repeated = path([0.6 * REACH, -0.6 * REACH] * 6)
    plain = force(name, repeated)
    # From the third cycle on a law without degradation repeats itself.
    assert plain[480:720] == pytest.approx(plain[720:960], abs=1e-6 * STRENGTH)
    for key in DEGRADING[name]:
        rate = 2.0 if MATERIALS[name].parameters[key].unit == "1/m" else 0.1
        assert np.max(np.abs(force(name, repeated, **{key: rate}) - plain)) > 0.005 * STRENGTH, key


@NEEDS_OPENSEES
@pytest.mark.verification("laws")
def test_pinching4_and_hysteretic_sm_follow_the_points_of_their_backbones(observed):
    for u, f in four_points(PARAMETERS["Pinching4"]):
        found = force("Pinching4", np.linspace(0, u, 50))[-1]
        observed("Pinching4 of OpenSees: monotone force", "points of its backbone", relative(found, f), 1e-6)
    p = PARAMETERS["HystereticSM"]
    top = p["F_m"] / p["k"] + p["u_p"]
    for u, f in ((top, p["F_m"]), (top + 0.5 * p["u_c"], 0.5 * p["F_m"])):
        found = force("HystereticSM", np.linspace(0, u, 50))[-1]
        observed("HystereticSM of OpenSees: monotone force", "points of its backbone", relative(found, f), 1e-6)


@NEEDS_OPENSEES
@pytest.mark.verification("laws")
@pytest.mark.parametrize("name", ["IMKBilin", "IMKPeakOriented", "IMKPinching"])
def test_imk_follows_its_backbone_and_a_weaker_side(name, observed):
    p = PARAMETERS[name]
    top = p["F_y"] / p["k"] + p["u_p"]
    for u, f in (
        (p["F_y"] / p["k"], p["F_y"]),
        (p["F_y"] / p["k"] + 0.5 * p["u_p"], p["F_y"] * (1 + 0.5 * (p["h"] - 1))),
        (top + 0.5 * p["u_c"], 0.5 * p["h"] * p["F_y"]),
    ):
        found = force(name, np.linspace(0, u, 400))[-1]
        observed(f"{name} of OpenSees: monotone force", "points of its backbone", relative(found, f), 1e-6)
    yielded = p["F_y"] / p["k"] + 0.1 * p["u_p"]
    weak = force(name, -np.linspace(0, yielded, 400), negative=0.5)[-1]
    assert weak == pytest.approx(0.5 * force(name, -np.linspace(0, yielded, 400))[-1], rel=0.15)


@NEEDS_OPENSEES
@pytest.mark.verification("laws")
def test_self_centering_is_the_flag_of_its_formulas(observed):
    p = PARAMETERS["SelfCentering"]
    u_a, k2 = p["F_a"] / p["k"], p["b"] * p["k"]
    u = np.concatenate([np.linspace(0, 4 * u_a, 2000), np.linspace(4 * u_a, 0, 2000)])
    found = force("SelfCentering", u)
    loading = np.where(u[:2000] < u_a, p["k"] * u[:2000], p["F_a"] + k2 * (u[:2000] - u_a))
    apart = np.abs(found[:2000] - loading) / p["F_a"]
    observed("SelfCentering of OpenSees: force of a flag, over F_a", "its formulas", apart, 1e-3)
    # The way back is parallel to the way there, and ends on the elastic branch at the force (1 - beta) F_a.
    middle = np.searchsorted(-u[2000:], -2 * u_a) + 2000
    lower = p["F_a"] * (1 - p["beta"]) + k2 * (u[middle] - u_a * (1 - p["beta"]))
    apart = np.abs([found[middle] - lower, found[-1]]) / p["F_a"]
    observed("SelfCentering of OpenSees: force of a flag, over F_a", "its formulas", apart, 1e-3)


@NEEDS_OPENSEES
@pytest.mark.verification("laws")
def test_steel4_follows_the_curve_of_menegotto_and_pinto(observed):
    p = PARAMETERS["Steel4"]
    law = MenegottoPinto(p["k"], p["F_y"], p["b"], p["R_0"], p["r_1"], p["r_2"])
    u = np.linspace(0, REACH, 400)[1:]
    expected = [law.move(x) for x in u]
    observed("Steel4 of OpenSees: monotone force", "law in steps", of_largest(force("Steel4", u), expected), 1e-6)


@NEEDS_OPENSEES
@pytest.mark.verification("laws")
def test_saws_follows_the_exponential_backbone(observed):
    p = PARAMETERS["SAWS"]
    u = np.linspace(0, 0.9 * p["u_u"], 300)
    formula = (p["F_0"] + p["R1"] * p["k"] * u) * (1 - np.exp(-p["k"] * u / p["F_0"]))
    observed("SAWS of OpenSees: monotone force", "exponential", of_largest(force("SAWS", u), formula), 1e-6)


def test_the_path_has_the_samples_and_short_steps():
    samples = np.array([0.01, 0.04, -0.04, 0.0])
    fine, at = finely(samples)
    assert fine[at].tolist() == samples.tolist()
    assert np.max(np.abs(np.diff(np.concatenate([[0.0], fine])))) <= 0.04 / 100 * (1 + 1e-6)
    assert finely(np.zeros(3))[0].tolist() == [0.0, 0.0, 0.0]


@pytest.fixture
def own_workers():
    made = Workers(interpreter(), timeout=1.0)
    yield made
    made.close()


ARGUMENTS = MATERIALS["SelfCentering"].arguments(PARAMETERS["SelfCentering"])


@NEEDS_OPENSEES
def test_a_killed_process_is_a_failed_simulation_and_the_next_one_works(own_workers):
    first = own_workers.forces("SelfCentering", ARGUMENTS, CYCLES)
    os.kill(own_workers._idle[0]._process.pid, signal.SIGKILL)
    with pytest.raises(ExperimentFailed, match="ended while it simulated SelfCentering"):
        own_workers.forces("SelfCentering", ARGUMENTS, CYCLES)
    assert own_workers.forces("SelfCentering", ARGUMENTS, CYCLES).tolist() == first.tolist()


@NEEDS_OPENSEES
def test_a_simulation_that_never_ends_is_stopped(own_workers):
    p = PARAMETERS["SAWS"]
    with pytest.raises(ExperimentFailed, match="longer than 1 s"):
        own_workers.forces("SAWS", ENDLESS, CYCLES)
    found = own_workers.forces("SAWS", MATERIALS["SAWS"].arguments(p), CYCLES)
    assert np.isfinite(found).all()


@NEEDS_OPENSEES
def test_a_simulation_that_never_ends_does_not_outlive_whoever_asked():
    """A killed program ends no process of its own."""
    request = {"material": "SAWS", "arguments": list(ENDLESS), "points": len(CYCLES)}
    with subprocess.Popen([sys.executable, driver.__file__, "1"], stdin=-1, stdout=subprocess.DEVNULL) as process:
        assert process.stdin is not None
        process.stdin.write(json.dumps(request).encode() + b"\n" + CYCLES.tobytes())
        process.stdin.flush()
        assert process.wait(timeout=60) == -signal.SIGALRM


@NEEDS_OPENSEES
def test_refused_arguments_are_told_and_the_process_goes_on(own_workers):
    with pytest.raises(ExperimentFailed, match="OpenSees refused SelfCentering"):
        own_workers.forces("SelfCentering", (1.0,), CYCLES)
    assert np.isfinite(own_workers.forces("SelfCentering", ARGUMENTS, CYCLES)).all()
    assert own_workers.version().count(".") == 2


def test_without_openseespy_one_message_says_what_to_install():
    with pytest.raises(UserError, match=r"model\.opensees: openseespy cannot be imported by .*hsed_jax\[opensees\]"):
        Workers("/bin/false").version()


def campaign(material="SelfCentering", elongation=CYCLES, noise=500.0, seed=0, test=None, **other):
    """A test that OpenSees made, with noise; the rows from `test` on are held out."""
    clean = force(material, elongation, **other)
    noisy = clean + noise * np.random.default_rng(seed).standard_normal(clean.size)
    records = {"E01": {"elongation": elongation, "force": noisy}}
    if test is not None:
        held = force(material, test, **other)
        held = held + noise * np.random.default_rng(seed + 1000).standard_normal(held.size)
        records["E02"] = {"elongation": test, "force": held}
    return Campaign.from_frames(
        records=records,
        name="made by OpenSees",
        protocol="displacement",
        channels={"elongation": "m", "force": Channel("force", "N", noise=Noise(absolute=noise))},
        **({} if test is None else {"experiments": {"id": ["E01", "E02"], "split": ["train", "test"]}}),
    )


STUDY = """
study: material
model: {opensees: SelfCentering}
experiments: {campaign: measured}
observe: histories
steps: [calibrate, compare]
"""


@NEEDS_OPENSEES
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("model={opensees: Pinching5}", "there is no material.*did you mean Pinching4.*allowed are Pinching4, IMKPeak"),
        ("model={opensees: SelfCentering, spring: bouc_wen}", "model.spring: there is no such key"),
        (
            "model.parameters={sigAct: 3.0}",
            "model.parameters.sigAct: there is no such parameter; allowed here are k, F_a",
        ),
        ("model.parameters={b: 2.0}", "model.parameters.b: 2 is outside the allowed range, at least 0 and at most 1"),
        ("model.parameters={k: 2.0e7, F_a: 7.0e4, b: 0.05, beta: 0.6}", "at least one parameter needs a prior"),
        (
            "steps=[calibrate, compare, diagnose]",
            "model.opensees: .*a spring law.*the material SelfCentering of OpenSees",
        ),
        ("model.search=-1", "model.search: this must be greater than or equal to 0"),
    ],
)
def test_a_mistake_in_a_study_is_one_message(change, message):
    with pytest.raises(UserError, match=message):
        Built(load_study(parse_yaml(STUDY, "study"), [change]), campaign()).check()


@NEEDS_OPENSEES
def test_left_out_parameters_have_the_priors_of_the_table_and_given_ones_are_fixed():
    study = load_study(
        parse_yaml(STUDY, "study"), ["model={opensees: IMKBilin, parameters: {d_S: 0.0, negative: {}, h: 1.2}}"]
    )
    mechanics = Built(study, campaign("IMKBilin")).mechanics
    free, fixed = mechanics.parameters
    assert list(free) == ["k", "F_y", "u_p", "u_c", "d_C", "d_K", "negative"]
    assert fixed == {"h": 1.2, "r": 0.0, "d_S": 0.0}
    assert free["k"].quantile(0.5) == pytest.approx(STIFFNESS, rel=0.1)
    assert mechanics.units["d_C"] == "1/m" and mechanics.units["k"] == "N/m"


def test_a_shaken_specimen_is_refused():
    shaken = {key: value for key, value in parse_yaml(SMALL, "study").items() if key != "model"}
    study = load_study({**shaken, "model": {"opensees": "Steel4"}})
    with pytest.raises(UserError, match=r"model\.opensees: .*protocol: displacement.*model\.spring"):
        Built(study).check()


@NEEDS_OPENSEES
@pytest.mark.parametrize("name", MATERIALS)
def test_init_writes_a_study_that_has_the_priors_of_the_table(name):
    made = campaign()
    text = "\n".join(material_lines(f"opensees:{name}", made))
    written = parse_yaml(STUDY, "study") | parse_yaml(text, "model")
    free, fixed = Built(load_study(written), made).mechanics.parameters
    bare = parse_yaml(STUDY, "study") | {"model": {"opensees": name}}
    expected, values = Built(load_study(bare), made).mechanics.parameters
    assert fixed == values and list(free) == list(expected)
    for key, prior in free.items():
        assert prior.name == expected[key].name
        assert np.ravel(prior.arguments) == pytest.approx(np.ravel(expected[key].arguments), rel=2e-3, abs=2e-3)


@NEEDS_OPENSEES
@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("opensees:Pinchign4", "--model: there is no material 'Pinchign4' (did you mean Pinching4?)"),
        ("takeda", "write opensees: and a material"),
    ],
)
def test_init_refuses_an_unknown_model(tmp_path, model, message, capsys):
    file = tmp_path / "test.csv"
    np.savetxt(
        file,
        np.column_stack([CYCLES, force("SelfCentering", CYCLES)]),
        delimiter=",",
        header="u [m],F [N]",
        comments="",
    )
    assert main(["init", str(file), "--model", model]) == 2
    assert message in capsys.readouterr().err


@NEEDS_OPENSEES
@pytest.mark.verification("opensees")
@pytest.mark.parametrize("name", MATERIALS)
def test_the_exported_script_has_the_forces_of_the_simulation(name, observed):
    rates = {key: (2.0 if name.startswith("IMK") else 0.05) for key in DEGRADING.get(name, ())}
    fine = np.concatenate([[0.0], finely(CYCLES)[0]])
    # Without degradation its parameters are exactly zero.
    for parameters in ({**PARAMETERS[name], **rates}, PARAMETERS[name]):
        simulated = Along(fine, Simulated(name)(parameters, {"elongation": fine})["force"])
        command = Command("uniaxialMaterial", (name, 1, *MATERIALS[name].arguments(parameters)))
        error = difference(python_script("A test.", [], [command], REACH), simulated)
        observed(
            f"{name} as the model: error of the force along growing cycles", "exported script in OpenSees", error, 1e-6
        )
        # Another stiffness is another force: the measure sees it.
        other = MATERIALS[name].arguments({**parameters, "k": 0.8 * STIFFNESS})
        wrong = python_script("A test.", [], [Command("uniaxialMaterial", (name, 1, *other))], REACH)
        assert difference(wrong, simulated) > 0.01


@NEEDS_OPENSEES
def test_a_record_that_begins_loaded_is_followed_from_zero_as_it_is():
    begun = CYCLES[70:]
    built = Built(load_study(parse_yaml(STUDY, "study")), campaign(elongation=begun))
    told = np.asarray(built.simulation.simulator.told(built.simulation.first)["elongation"])
    assert told == pytest.approx(begun)
    # The first sample has the force of a path from zero to it.
    assert force("SelfCentering", told)[0] == pytest.approx(
        force("SelfCentering", np.linspace(0, begun[0], 500))[-1], rel=1e-3
    )


@NEEDS_OPENSEES
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--materials", "SAWS,Stel4"], "--materials: there is no material 'Stel4' (did you mean Steel4?)"),
        ([], "has laws already; say --resume to go on with them, --force to replace them, or choose --output"),
    ],
)
def test_laws_refuses_a_mistake_before_it_calibrates(tmp_path, capsys, words, message):
    (tmp_path / "study.yaml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "laws.json").touch()
    assert main(["laws", str(tmp_path / "study.yaml"), "--output", str(tmp_path / "laws"), *words]) == 2
    assert message in capsys.readouterr().err


def test_a_wrong_material_is_told_to_a_caller_in_python_without_the_words_of_the_command():
    study = load_study(parse_yaml(STUDY, "study"))
    with pytest.raises(UserError, match=r"^materials: there is no material 'Stel4' \(did you mean Steel4\?\)"):
        hx.laws(study, ["Stel4"])


def test_the_page_is_what_the_table_says():
    docs = ROOT / "docs"
    page = runpy.run_path(str(docs / "opensees_laws.py"))["page"]()
    assert (docs / "opensees_laws.md").read_text(encoding="utf-8") == page


@NEEDS_OPENSEES
@pytest.mark.slow
def test_intervals_hold_the_parameters_of_records_that_opensees_made():
    inside = []
    for seed in range(6):
        fit = hx.calibrate(
            load_study(parse_yaml(STUDY, "study"), ["model.search=300", "calibration.starts=2"]), campaign(seed=seed)
        )
        told = fit.fit.summary()
        inside += [told[n]["q05"] <= value <= told[n]["q95"] for n, value in PARAMETERS["SelfCentering"].items()]
    # 24 intervals of 90 %: fewer than 18 have a probability of 2 %.
    assert 18 <= sum(inside) <= 24


@NEEDS_OPENSEES
@pytest.mark.slow
def test_laws_are_ranked_by_what_they_predict(tmp_path, capsys):
    from hsed_jax.measurements import write_campaign

    larger = path([s * REACH * 1.2 for s in (1, -1, 1)])
    write_campaign(campaign(test=larger), tmp_path / "measured")
    (tmp_path / "study.yaml").write_text(
        STUDY.replace("SelfCentering}", "SelfCentering, search: 300}"), encoding="utf-8"
    )
    words = ["calibration.starts=2", "calibration.sampler=laplace", "--output", str(tmp_path / "laws")]
    assert main(["laws", str(tmp_path / "study.yaml"), *words, "--materials", "SelfCentering,IMKBilin"]) == 0
    told = json.loads((tmp_path / "laws" / "laws.json").read_text(encoding="utf-8"))
    assert [law["name"] for law in told["laws"]] == ["opensees:SelfCentering", "opensees:IMKBilin"]
    assert told["laws"][0]["error_test"] < 0.05 < told["laws"][1]["error_test"]
    # In Python the same: the runs are there, and are read.
    again = hx.laws(
        load_study(tmp_path / "study.yaml", words[:2]), ["SelfCentering", "IMKBilin"], tmp_path / "laws", resume=True
    )
    assert again.best is not None and again.best.name == "opensees:SelfCentering"
    assert [law.error_test for law in again.laws] == [law["error_test"] for law in told["laws"]]
    assert "opensees:SelfCentering predicts the held-out data best" in capsys.readouterr().out
    # The run of a law is exported as any run is, and the script agrees.
    assert main(["export", str(tmp_path / "laws" / "opensees_SelfCentering"), "--opensees", "--table"]) == 0
    made = tmp_path / "laws" / "opensees_SelfCentering" / "export"
    assert json.loads((made / "check.json").read_text(encoding="utf-8"))["difference"] < 0.01
    report = (made.parent / "report.html").read_text(encoding="utf-8")
    assert 'id="export-check"' in report and "semantics of OpenSees" in (made / "specimen.py").read_text(
        encoding="utf-8"
    )
    assert r"F_a" in (made / "parameters.md").read_text(encoding="utf-8")
