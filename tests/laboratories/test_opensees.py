"""OpenSees as the laboratory: against our own simulator, its materials and a user's, and what is said where it is missing."""

import json

import numpy as np
import pytest
from builders.places import ROOT
from observations import relative

from hsed_jax.command_line import run_main
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.laboratories import opensees
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.measurements import Experiment
from hsed_jax.physics.structures import ModalDamping, Spring, Structure
from hsed_jax.study.build import Built

CONFIG = ROOT / "configs" / "opensees.yaml"
PAPER = {"ko": 5e5, "beta": 1.0}
INPUTS = {"V_P": 2.25, "T_P": 1.0}
OURS = {"A": 5e5, "beta": 1.0, "gamma": 0.0, "n": 1.0}


def built(experiments, **changes):
    """The ready study with other experiments, and in short."""
    content = load_study(CONFIG).model_dump(mode="json", exclude_none=True)
    inputs = {"V_P": {"uniform": [1.5, 3.0], "unit": "m/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}}
    return Built(load_study(content | {"inputs": inputs, "experiments": experiments} | changes))


def specimen(material, parameters=PAPER, **more):
    return {"opensees": {"material": material, "parameters": parameters, **more}}


def short(experiments, **changes):
    """Experiments of 4 s, in steps ten times as long."""
    excitation = {"near_fault_pulse": {"V_P": "V_P", "T_P": "T_P"}, "duration": 4.0}
    if "opensees" in experiments:
        experiments = {"opensees": {"step": 3e-3} | experiments["opensees"]}
    return built(experiments, excitation=excitation, **changes)


# --- the model ---------------------------------------------------------------------------------------------------


def test_links_between_points_are_the_stiffness_and_damping_of_the_structure():
    masses, between, stiffness = np.array([3e3, 5e3, 2e3]), [(None, 0), (2, 0), (1, 2)], [4e5, 2e5, 7e5]
    springs = tuple(Spring(ends, k) for ends, k in zip(between, stiffness, strict=True))
    structure = Structure(tuple(masses), springs, ((1, None),), ModalDamping(np.array([0.02, 0.05, 0.08]), 3e5))
    made = opensees.model(structure, {}, 1e-3)
    assert made["masses"] == masses.tolist() and made["specimen"] == [2, 0]

    def assembled(links):
        whole = np.zeros((4, 4))  # the ground is the first point
        for i, j, value in links:
            whole[[i, j], [i, j]] += value
            whole[[i, j], [j, i]] -= value
        return whole[1:, 1:]

    elastic = [(0, 1, 4e5), (3, 1, 2e5), (2, 3, 7e5)]
    np.testing.assert_allclose(assembled([(i, j, k) for i, j, k, _ in made["links"]]), assembled(elastic))
    # Each mode has its damping ratio, where the specimen counts with 3e5 N/m.
    square, modes = np.linalg.eig(assembled([*elastic, (2, 0, 3e5)]) / masses[:, None])
    damping = np.linalg.solve(modes, assembled([(i, j, c) for i, j, _, c in made["links"]]) / masses[:, None] @ modes)
    order = np.argsort(square)
    found = damping[np.ix_(order, order)] / (2 * np.sqrt(square[order]))
    np.testing.assert_allclose(found, np.diag([0.02, 0.05, 0.08]), atol=1e-12)


def compared(observed, problem, material, found, expected, tolerance):
    """A row for each quantity."""
    for name, value in expected.items():
        observed(f"{problem}: {name}", f"OpenSees {material}", relative(found[name], value), tolerance)


@pytest.mark.whole
@pytest.mark.verification("laws")
def test_bouc_wen_without_degradation_is_our_own_specimen(openseespy, observed):
    ours, theirs = built({"virtual": {"parameters": OURS}}).site.laboratory, built(specimen("BoucWen")).site.laboratory
    for V_P, T_P in ((2.25, 1.0), (1.5, 0.5), (3.0, 1.5), (2.9, 0.6)):
        inputs = {"V_P": V_P, "T_P": T_P}
        # The tolerance that the laboratory states.
        pair = ours.perform(0, inputs).quantities, theirs.perform(0, inputs).quantities
        compared(observed, "bouc_wen in the paper's frame", "BoucWen", *pair, 5e-4)


@pytest.mark.verification("effects")
def test_degradation_of_the_material_is_our_effect(openseespy, observed):
    effects = {"stiffness_degradation": {"eta": 2e-5}}
    ours = built({"virtual": {"parameters": OURS, "effects": effects}}).site.laboratory.perform(0, INPUTS).quantities
    theirs = built(specimen("BoucWen", PAPER | {"deltaEta": 2e-5})).site.laboratory.perform(0, INPUTS).quantities
    compared(observed, "stiffness_degradation in the paper's frame", "BoucWen", ours, theirs, 3e-3)


@pytest.mark.verification("dynamics")
def test_histories_of_any_structure_are_those_of_our_simulator(openseespy, observed):
    springs = [(["ground", 1], 4e5), ([2, 1], 6e5), ([2, 3], 8e5)]
    structure = {
        "masses": [8e3, 9e3, 5e3],
        "springs": [{"between": between, "stiffness": k} for between, k in springs],
        "specimen": {"between": [3, "ground"]},
        "damping": {"modal": [0.02, 0.05, 0.08], "specimen_stiffness": 5e5},
    }
    responses = ["elongation", "elongation_rate", "force"]
    channels = [*responses, "displacement_1", "velocity_2", "acceleration_3", "acceleration_2_absolute"]
    changes = {"structure": structure, "observe": "histories", "channels": channels}
    ours = short({"virtual": {"parameters": OURS}}, **changes).site.laboratory.perform(0, INPUTS).record
    theirs = short(specimen("BoucWen", step=1e-3), **changes).site.laboratory.perform(0, INPUTS).record
    np.testing.assert_allclose(theirs.time, ours.time, atol=1e-12)
    for name in ["ground_acceleration", *channels]:
        error = np.sqrt(np.mean((theirs[name] - ours[name]) ** 2)) / np.std(ours[name])
        observed(f"three masses with bouc_wen, {name}: error of the history", "OpenSees", error, 0.01)


# --- materials ---------------------------------------------------------------------------------------------------


def peaks(material, parameters=PAPER):
    return short(specimen(material, parameters)).site.laboratory.perform(0, INPUTS).quantities


def test_further_quantities_are_those_of_its_record(openseespy):
    names = ["peak_force", "residual_elongation", "peak_absolute_acceleration", "energy_at_2s"]
    ours = built({"virtual": {"parameters": OURS}}, quantities=names).site.laboratory.exact(INPUTS)
    theirs = built(specimen("BoucWen"), quantities=names)
    assert list(theirs.observed.sensors.quantities) == ["peak_force"]
    quantities, record = theirs.site.laboratory.perform(0, INPUTS)
    measured = Experiment("E01", INPUTS, record=record, quantities=quantities)
    # Measured: 1.6 µm, 0.07 % (a peak between samples) and 0.18 % (the work between samples).
    assert measured.quantity("residual_elongation") == pytest.approx(ours["residual_elongation"], abs=1e-5)
    for name in ("peak_absolute_acceleration", "energy_at_2s"):
        assert measured.quantity(name, masses=2) == pytest.approx(ours[name], rel=4e-3)


@pytest.mark.verification("effects")
def test_bwbn_pinches_as_our_effect(openseespy, observed):
    assert peaks("BWBN") == pytest.approx(peaks("BoucWen"), rel=2e-3)
    pinched = {"zetas": 0.6, "p": 1e-4, "Shi": 0.2, "lambda": 0.5}
    effects = {"pinching": {"zeta": 0.6, "p": 1e-4, "psi": 0.2, "ratio": 0.5, "q": 0.0, "spread": 0.0}}
    # With a characteristic energy of 1 J, and a strength at z = 1 m, both have the same units.
    scales = {"force": 5e5, "elongation": 1.0, "rate": 1.0, "energy": 1.0}
    ours = short({"virtual": {"parameters": OURS, "effects": effects}}, scales=scales).site.laboratory.perform(
        0, INPUTS
    )
    # A third of the step has a third of the error: that of OpenSees.
    theirs = short(specimen("BWBN", PAPER | pinched, step=3e-4)).site.laboratory.perform(0, INPUTS)
    compared(observed, "pinching in the paper's frame", "BWBN", ours.quantities, theirs.quantities, 5e-3)


def test_steel02_is_elastic_below_its_strength_and_stops_at_it(openseespy):
    elastic = peaks("Steel02", {"Fy": 1e12, "E0": 5e5})
    linear = short({"virtual": {"parameters": OURS | {"beta": 1e-9}}}).site.laboratory.perform(0, INPUTS).quantities
    for name in ("peak_force", "peak_elongation"):
        assert elastic[name] == pytest.approx(linear[name], rel=2e-3)
    yielding = peaks("Steel02", {"Fy": 6e4, "E0": 5e5})
    assert elastic["peak_force"] > 1.2e5 and yielding["peak_force"] == pytest.approx(6e4, rel=0.01)


PYTHON = """
def specimen(ops, tag, ko, beta):
    ops.uniaxialMaterial("BoucWen", tag, 0.0, ko, 1.0, 0.0, beta, 1.0, 0.0, 0.0, 0.0)
"""
# Two of half the stiffness, side by side.
TCL = """
foreach part {2 3} {
    uniaxialMaterial BoucWen $part 0 [expr {$ko / 2}] 1 0 $beta 1.0 0.0 0.0 0.0
}
uniaxialMaterial Parallel $tag 2 3
"""


@pytest.mark.parametrize(("name", "text"), [("mine.py", PYTHON), ("mine.tcl", TCL)])
def test_a_material_of_a_users_own_is_the_specimen(openseespy, tmp_path, name, text):
    if name.endswith("tcl"):
        pytest.importorskip("tkinter", reason="this Python has no Tcl")
    (tmp_path / name).write_text(text)
    assert peaks({"file": str(tmp_path / name)}) == pytest.approx(peaks("BoucWen"), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("mine.py", "def specimen(ops, tag, **_):\n    raise ValueError('no such steel')", "ValueError: no such steel"),
        ("mine.py", "steel = 3", "KeyError: 'specimen'"),
        ("mine.tcl", "uniaxialMaterial BoucWen $tag $stiffness", 'can\'t read "stiffness": no such variable'),
        ("mine.tcl", "uniaxialSteel $tag", 'invalid command name "uniaxialSteel"'),
    ],
)
def test_a_material_that_fails_fails_the_experiment_and_says_how(openseespy, tmp_path, name, text, reason):
    if name.endswith("tcl"):
        pytest.importorskip("tkinter", reason="this Python has no Tcl")
    (tmp_path / name).write_text(text)
    with pytest.raises(ExperimentFailed, match=reason):
        peaks({"file": str(tmp_path / name)})


def test_noise_has_its_size_and_depends_on_the_experiment_alone(openseespy):
    def elongation(number, **noise):
        record = short(specimen("BoucWen", **noise), observe="histories").site.laboratory.perform(number, INPUTS).record
        return record["elongation"]

    exact, noise = elongation(3), {"noise": {"relative": 0.02}}
    noisy = elongation(3, **noise)
    np.testing.assert_array_equal(elongation(3, **noise), noisy)
    other = elongation(4, **noise)
    for measured in (noisy, other):
        size = np.sqrt(np.mean((measured - exact) ** 2) / np.mean(exact**2))
        assert size == pytest.approx(0.02, rel=0.2)
    assert abs(np.corrcoef(noisy - exact, other - exact)[0, 1]) < 0.3


# --- what cannot be ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("experiments", "said"),
    [
        (specimen("Concrete01"), r"experiments\.opensees\.material: this must be 'BoucWen', 'BWBN' or 'Steel02'"),
        (specimen("BoucWen", {"A": 5e5}), r"experiments\.opensees: parameters\.A: BoucWen has no such parameter; it has alpha"),
        (specimen("Steel02", {"Fy": 6e4}), r"experiments\.opensees: parameters\.E0: Steel02 needs this key"),
        (specimen({"file": "none.py"}), r"experiments\.opensees: material\.file: there is no file .*none\.py"),
        (specimen({"file": str(CONFIG)}), r"opensees\.yaml must be a Python file \(\.py\) or a Tcl file \(\.tcl\)"),
        (specimen("BoucWen", noise={"unknown": True}), r"experiments\.opensees\.noise: the noise of .* must be a number"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(experiments, said):
    with pytest.raises(UserError, match=said):
        built(experiments).check()


def test_damping_that_follows_the_model_is_no_laboratory():
    structure = load_study(CONFIG).structure.model_dump(mode="json", exclude_none=True)
    structure["damping"]["specimen_stiffness"] = "model"
    with pytest.raises(
        UserError, match=r"structure\.damping\.specimen_stiffness: the laboratory opensees needs a number"
    ):
        built(specimen("BoucWen"), structure=structure).check()


def test_without_openseespy_one_line_says_how_to_get_it(tmp_path, monkeypatch, capsys):
    (tmp_path / "bare").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "bare").chmod(0o755)
    for python in ("bare", "none"):
        monkeypatch.setenv("OPENSEES_PYTHON", str(tmp_path / python))
        assert run_main([str(CONFIG), "--output", str(tmp_path / "run")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: ") and "openseespy cannot be imported" in line
        assert "pip install 'hsed_jax[opensees]'" in line
    assert not (tmp_path / "run").exists()


# --- the ready study ---------------------------------------------------------------------------------------------


def test_the_ready_study_is_valid(openseespy, capsys):
    assert run_main([str(CONFIG), "--check"]) == 0
    assert "the study is valid" in capsys.readouterr().out


@pytest.mark.slow
def test_the_ready_study_finds_what_the_material_does(openseespy, tmp_path):
    assert run_main([str(CONFIG), "--output", str(tmp_path / "run")]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (tmp_path / "run" / "report.html").is_file()
    assert summary["diagnosis"]["verdict"] == "missing_effects"
    assert summary["diagnosis"]["effects"] == ["stiffness_degradation"]
    improvement = summary["improvement"]
    first, last = improvement["steps"]
    assert first["error_train"] > 5 * improvement["noise_floor"] > last["error_train"]
    for name, true in (("A", 5e5), ("beta", 1.0)):
        found = improvement["posterior"][name]
        # Biased before, right after.
        assert abs(summary["calibration"]["map"][name] - true) > 0.1 * true
        assert abs(found["mean"] - true) < 3 * found["sd"]
