"""Studies: the ready ones load, what is written is read again, and every mistake has one clear message."""

import copy
import subprocess
import sys
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import yaml
from builders.studies import SMALL, content
from hypothesis import given, settings
from hypothesis import strategies as st

import hsed_jax as hx
from hsed_jax.command_line import main, run_main
from hsed_jax.config.load import load_study, parse_yaml
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign
from hsed_jax.physics.simulator import Simulator
from hsed_jax.plain import dump_yaml
from hsed_jax.reporting.asked import asked
from hsed_jax.study.build import Built

DELETE = object()


@pytest.fixture(autouse=True)
def memory(monkeypatch):
    """A machine of 16 GiB, whichever it is."""
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(total=2**34))


def changed(path: str, value) -> dict:
    """The small study with the key at a dotted path replaced, added or deleted."""
    tree = copy.deepcopy(content())
    *keys, last = path.split(".")
    node = tree
    for key in keys:
        node = node[int(key)] if isinstance(node, list) else node[key]
    last = int(last) if isinstance(node, list) else last
    if value is DELETE:
        del node[last]
    else:
        node[last] = value
    return tree


# --- what is right -----------------------------------------------------------------------------------------------


def ready_studies(root):
    return sorted(path for path in (root / "configs").glob("*.yaml") if not path.stem.startswith("sweep"))


def test_every_ready_study_is_valid(request, capsys):
    found = ready_studies(request.config.rootpath)
    assert found
    for path in found:
        status, said = run_main([str(path), "--check"]), capsys.readouterr()
        if path.stem == "opensees" and "install it with python -m pip install 'hsed_jax[opensees]'" in said.err:
            assert status == 2
            continue
        assert status == 0, path
        assert "the study is valid" in said.out


def test_every_ready_study_is_read_again_as_it_was_written(request, tmp_path):
    for path in ready_studies(request.config.rootpath):
        study = load_study(path)
        copy_of = tmp_path / path.name
        copy_of.write_text(yaml.safe_dump(study.written(), sort_keys=False), encoding="utf-8")
        again = load_study(copy_of)
        assert again.written() == study.written()


@pytest.mark.whole
@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    masses=st.lists(st.floats(1e-3, 1e9), min_size=2, max_size=2),
    low=st.floats(1e-3, 1e6),
    width=st.floats(1e-3, 1e6),
    iterations=st.integers(0, 100),
    error=st.sampled_from(
        [
            {"relative": 0.1},
            {"relative": 0.1, "of": "measured"},
            {"absolute": 3.0},
            {"unknown": True},
            {"peak_force": {"relative": 0.1}},
            None,
        ]
    ),
    name=st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,11}", fullmatch=True),
)
def test_written_and_read_again_any_study_is_the_same(seed, masses, low, width, iterations, error, name):
    tree = content()
    tree["study"], tree["seed"], tree["error"] = name, seed, error
    tree["structure"]["masses"] = masses
    tree["model"]["parameters"]["A"] = {"uniform": {"low": low, "high": low + width}}
    tree["design"]["iterations"] = iterations
    study = load_study(tree)
    again = load_study(parse_yaml(dump_yaml(study.written()), "again"))
    assert again == study


def test_written_has_every_default(request):
    written = load_study(content()).written()
    assert written["design"]["kriging"] == {"trend": "constant", "kernel": "matern52", "starts": 10}
    assert written["quantities"] == ["peak_force", "peak_elongation", "dissipated_energy"]
    assert written["excitation"]["near_fault_pulse"]["gamma"] == 2.0


def test_a_study_says_what_a_relative_error_is_of():
    measured = Campaign("m", "ground_motion")
    for of, word in (
        (None, "5 % of each predicted value (log-normal)"),
        ("measured", "5 % of each measured value (Gaussian)"),
    ):
        study = load_study({**content(), "error": {"relative": 0.05} | ({"of": of} if of else {})})
        assert Built(study).observed.errors[0].of_measured == (of == "measured")
        assert any(word in sentence for sentence in asked(study.written(), measured))


def test_numbers_are_read_as_engineers_write_them():
    numbers = parse_yaml("[1e5, 1.e-3, .5, 5., -2E+3, 2e5, 7, 0.10]", "numbers")
    assert numbers == [1e5, 1e-3, 0.5, 5.0, -2e3, 2e5, 7, 0.1]


def test_overrides_replace_keys_by_their_path():
    study = load_study(
        content(), ["design.iterations=7", "model.parameters.gamma={uniform: [0, 1]}", "structure.masses.1=1e4"]
    )
    assert study.design.iterations == 7 and study.design.initial == 3
    assert study.model.parameters["gamma"] == {"uniform": [0, 1]}
    assert study.structure.masses == [8e3, 1e4]


def test_a_relative_path_starts_at_the_study_and_is_absolute_once_it_is_written_elsewhere(tmp_path):
    tree = changed("experiments", {"campaign": "data/mine"})
    tree["excitation"] = {"recorded": {"file": "motions/one.AT2"}}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(tree))
    study = load_study(tmp_path / "study.yaml")
    assert study.folder == tmp_path
    assert study.written()["experiments"] == {"campaign": str(tmp_path / "data/mine")}
    assert study.written()["excitation"]["recorded"]["file"] == str(tmp_path / "motions/one.AT2")
    assert load_study(study.written()).written() == study.written()


@pytest.mark.parametrize("name", ["hsed run", "python -m"])
@pytest.mark.parametrize("order", ["key first", "key last"])
def test_overrides_may_stand_before_or_after_the_options(tmp_path, capsys, name, order):
    path = tmp_path / "study.yaml"
    path.write_text(SMALL)
    words = ["design.iterations=-1", "--check"] if order == "key first" else ["--check", "design.iterations=-1"]
    status = main(["run", str(path), *words]) if name == "hsed run" else run_main([str(path), *words])
    assert status == 2 and "design.iterations" in capsys.readouterr().err


def test_inputs_in_other_units_reach_the_simulator_in_si():
    tree = changed("inputs.V_P", {"uniform": [150.0, 300.0], "unit": "cm/s"})
    one, other = Built(load_study(content())), Built(load_study(tree))
    cube = one.experiments.space.initial_design(3)
    for name, values in one.experiments.space.si(one.experiments.space.declared(cube)).items():
        assert other.experiments.space.si(other.experiments.space.declared(cube))[name] == pytest.approx(
            values, rel=1e-12
        )


def test_a_study_of_another_stiffness_is_built_without_compiling_again(caplog):
    def built(stiffness):
        tree = changed("structure.springs.0.stiffness", stiffness)
        del tree["experiments"]["virtual"]["effects"]
        return Built(load_study(tree)).simulation.planned_simulator

    built(3.9e5)
    with jax.log_compiles():
        built(4.1e5)
    assert "ompil" not in caplog.text


# --- what is wrong -----------------------------------------------------------------------------------------------

# Dotted path, what is put there, words that the message must have (its key, and what is allowed).
MISTAKES = {
    "unknown key": ("desgin", {}, "desgin", "did you mean design?", "excitation"),
    "unknown key like a branch": ("[(", 1, "[(", "there is no such key", "excitation"),
    "unknown key below": ("design.iteration", 3, "design.iteration", "did you mean iterations?", "candidates"),
    "unknown key deep": ("design.kriging", {"kernal": "x"}, "design.kriging.kernal", "did you mean kernel?"),
    "unknown key in a list": ("structure.springs.0.stifness", 1, "structure.springs.0.stifness", "stiffness?"),
    "unknown key of a union": ("structure.damping.modl", 1, "structure.damping.modl", "did you mean modal?"),
    "unknown key of the pulse": ("excitation.near_fault_pulse.VP", 1, "near_fault_pulse.VP", "V_P, T_P, gamma, nu"),
    "missing key": ("experiments", DELETE, "experiments", "required"),
    "missing key below": ("structure.springs.0.stiffness", DELETE, "structure.springs.0.stiffness", "required"),
    "missing parameter": ("model.parameters.A", DELETE, "model.parameters.A", "required", "initial stiffness"),
    "missing true parameter": ("experiments.virtual.parameters.beta", DELETE, "virtual.parameters.beta", "required"),
    "missing duration": ("excitation.duration", DELETE, "excitation", "duration"),
    "missing period": ("excitation.near_fault_pulse.T_P", DELETE, "excitation.near_fault_pulse.T_P", "required"),
    "text for a whole number": ("design.iterations", "many", "design.iterations", "whole number", "'many'"),
    "fraction for a whole number": ("design.iterations", 2.5, "design.iterations", "whole number", "2.5"),
    "number for a list": ("structure.masses", 8e3, "structure.masses", "list"),
    "text for a mass": ("structure.masses", ["a", 1.0], "structure.masses.0", "number", "'a'"),
    "text for a parameter": ("model.parameters.A", "big", "model.parameters.A", "number or a prior", "'big'"),
    "list for a parameter": ("model.parameters.A", [2e5, 9e5], "model.parameters.A", "number or a prior"),
    "number for an error": ("error", 0.05, "error", "mapping"),
    "what an absolute error is of": ("error", {"absolute": 0.05, "of": "measured"}, "error", "relative: 0.05, of: mea"),
    "an error of anything else": ("error", {"relative": 0.05, "of": "both"}, "error.of", "'both'", "measured"),
    "number for an input": ("inputs.V_P", 2.0, "inputs.V_P", "mapping"),
    "unknown unit": ("inputs.V_P.unit", "wobble", "inputs.V_P.unit", "wobble"),
    "unit of another dimension": ("inputs.V_P.unit", "kN", "inputs.V_P.unit", "kN", "velocity", "m/s"),
    "frequency for a period": ("inputs.T_P.unit", "Hz", "inputs.T_P.unit", "time"),
    "unit forgotten": ("inputs.V_P", {"uniform": [1.5, 3.0]}, "inputs.V_P.unit", "velocity"),
    "unit misspelt": ("inputs.V_P", {"uniform": [1.5, 3.0], "units": "m/s"}, "inputs.V_P", "unit: m/s", "units"),
    "reversed bounds of an input": ("inputs.V_P.uniform", [3.0, 1.5], "inputs.V_P", "lower bound 3", "upper bound 1.5"),
    "reversed bounds of a prior": ("model.parameters.A", {"uniform": [9e5, 2e5]}, "model.parameters.A", "must lie below"),
    "unbounded bounds": ("inputs.V_P.uniform", [1.5, float("inf")], "inputs.V_P", "finite"),
    "unknown prior": ("model.parameters.A", {"unifrom": [1, 2]}, "model.parameters.A", "unifrom", "uniform, normal"),
    "unknown distribution of an input": ("inputs.T_P", {"gauss": [1, 2], "unit": "s"}, "inputs.T_P", "uniform, normal"),
    "too few arguments": ("model.parameters.A", {"uniform": [2e5]}, "model.parameters.A", "low, high"),
    "unknown argument": ("model.parameters.A", {"uniform": {"lo": 1, "high": 2}}, "model.parameters.A", "low, high"),
    "text for an argument": ("model.parameters.A", {"uniform": ["a", 2]}, "model.parameters.A", "low, high"),
    "negative spread": ("model.parameters.A", {"normal": [5e5, -1e5]}, "model.parameters.A", "scale"),
    "two distributions": ("model.parameters.A", {"uniform": [1, 2], "normal": [1, 2]}, "A", "one distribution"),
    "prior of impossible values": ("model.parameters.A", {"uniform": [-1e5, 1e5]}, "model.parameters.A", "at least 0"),
    "impossible value": ("experiments.virtual.parameters.A", -5.0, "experiments.virtual.parameters.A", "at least 0"),
    "nothing to calibrate": ("model.parameters", {"A": 5e5, "beta": 1.0}, "model.parameters", "needs a prior"),
    "two sources": ("experiments.campaign", "x", "experiments", "virtual", "campaign"),
    "no source": ("experiments", {}, "experiments", "virtual", "campaign"),
    "unknown effect": ("model.effects", {"stifness_degradation": {}}, "model.effects.stifness_degradation",
        "did you mean stiffness_degradation?", "catalogue"),
    "unknown true effect": ("experiments.virtual.effects", {"rust": {"a": 1.0}}, "virtual.effects.rust", "catalogue"),
    "unknown effect parameter": (
        "model.effects", {"stiffness_degradation": {"etta": 1.0}}, "stiffness_degradation.etta", "delta, eta"
    ),
    "both forms of a parameter": (
        "model.effects", {"stiffness_degradation": {"eta": {"half_normal": 1}, "delta": 0.5}}, "delta", "eta",
        "two forms",
    ),
    "unknown parameter": ("model.parameters.alpha", 1.0, "model.parameters.alpha", "A, beta, gamma, n"),
    "unknown true parameter": ("experiments.virtual.parameters.alpha", 1.0, "parameters.alpha", "A, beta, gamma, n"),
    "unknown quantity": ("quantities", ["peak_forse"], "quantities", "peak_forse", "peak_force"),
    "quantity twice": ("quantities", ["peak_force", "peak_force"], "quantities", "twice"),
    "no quantity": ("quantities", [], "quantities", "empty"),
    "error of what is not observed": ("error", {"peak_jerk": {"relative": 0.1}}, "error.peak_jerk", "peak_force"),
    "two kinds of error": ("error", {"relative": 0.1, "absolute": 3.0}, "error", "exactly one", "relative"),
    "error of zero": ("error", {"relative": 0}, "error.relative", "greater than 0"),
    "noise that is unknown": ("experiments.virtual.noise", {"unknown": True}, "experiments.virtual.noise", "number"),
    "end that does not exist": ("structure.springs.0.between", ["ground", 5], "structure", "spring", "mass 5", "2 masses"),
    "mass zero": ("structure.springs.0.between", ["ground", 0], "structure", "mass 0"),
    "ends that are the same": ("structure.specimen.between", [1, 1], "structure", "must differ"),
    "end misspelt": ("structure.specimen.between", ["gnd", 1], "structure.specimen.between.0", "'ground'"),
    "three ends": ("structure.specimen.between", [1, 2, 3], "structure.specimen.between", "too many"),
    "negative mass": ("structure.masses.0", -8e3, "structure.masses.0", "greater than 0", "-8000"),
    "negative damping": ("structure.damping.modal", -0.05, "structure.damping.modal", "greater than or equal to 0"),
    "damping of three modes": ("structure.damping.modal", [0.1] * 3, "structure.damping.modal", "3 ratios for 2 modes"),
    "two kinds of damping": ("structure.damping.rayleigh", {"alpha": 1.0, "beta": 1.0}, "structure.damping", "either"),
    "no structure": ("structure", DELETE, "structure", "required"),
    "no excitation": ("excitation", DELETE, "excitation", "near_fault_pulse"),
    "two excitations": ("excitation.recorded", {"file": "x.AT2"}, "excitation", "either"),
    "record that is not there": ("excitation", {"recorded": {"file": "no.AT2"}}, "no.AT2"),
    "period that names no input": ("excitation.near_fault_pulse.T_P", "T", "near_fault_pulse.T_P", "'T'", "V_P, T_P"),
    "period of zero": ("excitation.near_fault_pulse.T_P", 0.0, "excitation.near_fault_pulse.T_P", "positive"),
    "period that may be negative": ("inputs.T_P", {"normal": [1.0, 0.3], "unit": "s"}, "inputs.T_P", "positive"),
    "period that is next to nothing": ("inputs.T_P", {"lognormal": [0.0, 2.0], "unit": "s"}, "excitation", "steps"),
    "pulse without envelope": ("excitation.near_fault_pulse.gamma", 1.0, "near_fault_pulse.gamma", "not 1"),
    "step longer than the motion": ("excitation.step", 20.0, "excitation.step", "longer than the duration"),
    "linear trend of too few": ("design.kriging", {"trend": "linear"}, "design.initial", "at least 4", "it is 3"),
    "one initial experiment": ("design.initial", 1, "design.initial", "at least 2", "it is 1"),
    "too few candidates": ("design.candidates", 4, "design.candidates", "too few"),
    "cost of no input": ("design.cost", {"per": {"cycles": 1.0}}, "design.cost.per", "'cycles'", "V_P, T_P"),
    "cost of nothing": ("design.cost", {"fixed": 0, "per": {"V_P": -1.0}}, "design.cost", "smallest", "-3"),
    "cost without inputs": ("design.cost", {"fixed": 2.0}, "design.cost.per", "required"),
    "unknown acquisition": ("design.acquisition", "ei", "design.acquisition", "expected_improvement", "sobol"),
    "unknown kernel": ("design.kriging", {"kernel": "rbf"}, "design.kriging.kernel", "'matern52'"),
    "unknown step": ("steps", ["design", "calibrat"], "steps.1", "'calibrate'"),
    "steps in the wrong order": ("steps", ["calibrate", "design"], "steps", "calibrate stands before design"),
    "no steps": ("steps", [], "steps", "empty"),
    "no inputs": ("inputs", {}, "inputs", "V_P"),
    "negative seed": ("seed", -1, "seed", "greater than or equal to 0"),
    "no chains": ("calibration.chains", 0, "calibration.chains", "greater than or equal to 1"),
    "name that is a path": ("study", "a/b", "study", "'a/b'", "no slash"),
    "name of a folder above": ("study", "..", "study", "'..'", "not . or .."),
    "name of this folder": ("study", ".", "study", "'.'", "not . or .."),
    "name with NUL": ("study", "a\0b", "study", r"'a\x00b'", "one line of text"),
    "name of 300 characters": ("study", "x" * 300, "study", "too long", "200"),
    "mass next to nothing": ("structure.masses.0", 1e-320, "structure.masses.0", "out of range", "1e-100"),
    "mass of 400 digits": ("structure.masses.0", 10**400, "structure.masses.0", "number"),
    "step next to nothing": ("excitation.step", 1e-320, "excitation.step", "out of range"),
    "step of 400 digits": ("excitation.step", 10**400, "excitation.step", "number"),
    "prior next to nothing": ("model.parameters.A", {"uniform": [1e-320, 1.0]}, "model.parameters.A", "sensible size"),
    "prior of 400 digits": ("model.parameters.A", {"uniform": [1.0, 10**400]}, "model.parameters.A", "low, high"),
    "true for a mass": ("structure.masses.0", True, "structure.masses.0", "number", "True"),
    "true for a parameter": ("model.parameters.A", True, "model.parameters.A", "number or a prior", "True"),
    "true for a true parameter": ("experiments.virtual.parameters.A", True, "virtual.parameters.A", "number", "True"),
    "true for an input": ("excitation.near_fault_pulse.T_P", True, "near_fault_pulse.T_P", "number or a text", "True"),
    "true for a whole number": ("seed", True, "seed", "whole number", "True"),
    "true for an end": ("structure.specimen.between", [True, 2], "structure.specimen.between.0", "whole number", "True"),
    "1e10 candidates": ("design.candidates", 10**10, "design.candidates: 10000000000 would take 447 GiB of memory"),
    "1e9 initial experiments": ("design.initial", 10**9, "design.initial: 1000000000 would take 6.94 EiB of memory"),
    "1e12 draws": ("calibration.draws", 1e12, "calibration.draws: 1000000000000 would take 43.7 TiB", "enough for"),
    "1e12 draws of adaptation": ("calibration.warmup", 10**12, "calibration.warmup: 1000000000000 would take"),
    "1e9 chains": ("calibration.chains", 10**9, "calibration.chains: 1000000000 would take 894 GiB of memory"),
    "campaign with NUL": ("experiments", {"campaign": "a\0b"}, "no such folder"),
    "campaign of 300 characters": ("experiments", {"campaign": "a" * 300}, "no such folder"),
    "record with NUL": ("excitation", {"recorded": {"file": "a\0b"}}, "cannot be read"),
    "record of 300 characters": ("excitation", {"recorded": {"file": "a" * 300}}, "cannot be read"),
    "program with NUL": ("experiments", {"python": "a\0.py:f"}, "experiments.python", "no such file"),
    "no channels": ("channels", [], "channels", "empty"),
    "channel twice": ("channels", ["force", "force"], "channels", "'force' appears twice"),
    "unit without end": ("inputs.V_P.unit", "9**9**9**9", "inputs.V_P.unit", "unknown unit"),
}  # fmt: skip


def message_of(arguments, capsys) -> str:
    """The one line that a mistake gives; fails on anything else."""
    status = run_main(arguments)
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert line.startswith("error: ")
    return line


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_gives_one_line_with_file_key_and_what_is_allowed(mistake, tmp_path, capsys):
    path, value, *words = MISTAKES[mistake]
    file = tmp_path / "mistaken.yaml"
    file.write_text(yaml.safe_dump(changed(path, value), sort_keys=False), encoding="utf-8")
    line = message_of([str(file), "--check", "--trust"], capsys)
    for word in ("mistaken.yaml", *words):
        assert word in line
    # Words of the validator, of Python or of a library are no words of a user.
    for word in ("pydantic", "Entry", "dictionary", "NoneType", "Traceback", "__init__", "unable to parse", "numpyro."):
        assert word not in line


def test_a_check_simulates_nothing(monkeypatch):
    class Simulated(Exception):
        pass

    def respond(*_):
        raise Simulated

    monkeypatch.setattr(Simulator, "respond", respond)
    built = Built(load_study(content()))
    built.check()
    with pytest.raises(Simulated):  # the specimen's effect has no scales but those of the plain model
        _ = built.site.laboratory


def test_a_mistake_is_refused_before_anything_is_written(tmp_path, capsys):
    file = tmp_path / "mistaken.yaml"
    file.write_text(yaml.safe_dump(changed("design.kriging", {"trend": "linear"})))
    line = message_of([str(file), "--output", str(tmp_path / "run")], capsys)
    assert "design.initial" in line and not (tmp_path / "run").exists()


TEXTS = {
    "key twice": ("study: a\nstudy: b\n", "line 2", "study", "twice"),
    "bracket left open": ("study: [a\n", "line", "expected"),
    "tab": ("study:\n\ta: 1\n", "line 2", "cannot start"),
    "braces of a template": ("study: {{ name }}\n", "line 1", "key"),
    "unknown anchor": ("study: *x\n", "line 1", "x"),
    "nothing": ("", "mapping of keys"),
    "a list": ("- a\n", "mapping of keys"),
    "a number for a key": ("1: 2\n", "study", "required"),
    "3000 lists": ("study: " + "[" * 3000, "line 1, column 57", "more than 50 deep"),
    "3000 mappings": ("{study: " * 3000, "line 1", "more than 50 deep"),
    "a list of itself": ("study: &a [*a]\n", "more than 50 deep"),
    "a list of lists of lists": (
        "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else '1'] * 10)}]\n" for i in range(9)),
        "1000000 values",
    ),
    "no whole number": ("seed: !!int abc\n", "line 1, column 7", "'abc' is not a whole number"),
    "no number": ("seed: !!float abc\n", "'abc' is not a number"),
    "neither true nor false": ("seed: !!bool abc\n", "'abc' is not true or false"),
    "no time": ("seed: !!timestamp x\n", "'x' is not a date"),
    "an impossible date": ("study: a\nseed: 2024-13-45\n", "seed", "whole number", "2024-13-45"),
    "a seed of 5000 digits": (f"seed: {'9' * 5000}\n", "line 1, column 7", "is not a whole number that can be read"),
    "another encoding": ("study: \xe9\n".encode("latin-1"), "UTF-8"),
}


@pytest.mark.parametrize("case", TEXTS)
def test_a_file_that_is_no_study_is_refused_with_the_place(case, tmp_path, capsys):
    text, *words = TEXTS[case]
    file = tmp_path / "mistaken.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    line = message_of([str(file), "--check", "--trust"], capsys)
    for word in ("mistaken.yaml", *words):
        assert word in line


@pytest.mark.parametrize(
    ("channels", "word"), [(["time"], "'time'"), (["displacement_3"], "'displacement_3'"), (["velocity_1_absolute"], "velocity")]
)  # fmt: skip
def test_a_channel_that_the_model_does_not_give_is_refused(channels, word):
    tree = content() | {"observe": "histories", "channels": channels}
    with pytest.raises(
        UserError, match=rf"channels: there is no channel .*{word}.*it gives .*displacement_2"
    ) as refused:
        Built(load_study(tree)).check()
    assert "displacement_3," not in str(refused.value)


@pytest.mark.parametrize("name", ["a+b", "größe (2)", "50 % & more", "2024-11-22", "-x", "a'b"])
def test_a_study_may_bear_any_name_that_a_folder_may(name, tmp_path, capsys):
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump(content() | {"study": name}, allow_unicode=True), encoding="utf-8")
    assert load_study(file).study == name
    assert run_main([str(file), "--check"]) == 0


def test_a_file_named_like_no_file_is_not_there(capsys):
    for name in ("a\0b", "a" * 300):
        assert "there is no such file" in message_of([name, "--check"], capsys)


def test_code_of_the_user_that_leaves_by_an_exit_is_no_success(tmp_path, capsys, monkeypatch):
    file = tmp_path / "study.yaml"
    file.write_text(SMALL)
    monkeypatch.setattr("hsed_jax.runs.workflow.run", lambda *_, **__: sys.exit(0))
    assert "sys.exit(0)" in message_of([str(file), "--output", str(tmp_path / "run")], capsys)


def test_a_folder_is_no_study_and_the_one_in_it_is_named(tmp_path, capsys):
    assert f"such as {tmp_path / 'study.yaml'}" in message_of([str(tmp_path), "--check"], capsys)


def test_a_missing_file_is_named(tmp_path, capsys):
    line = message_of([str(tmp_path / "no.yaml"), "--check"], capsys)
    assert "no.yaml" in line and "no such file" in line


OVERRIDES = {
    "no value": ("design.iterations", "design.iterations", "KEY=VALUE"),
    "no key": ("=4", "KEY=VALUE"),
    "unknown key": ("design.iteratons=4", "design.iteratons", "did you mean iterations?"),
    "no such place in a list": ("structure.masses.7=4", "structure.masses.7", "list of 2"),
    "word for a place in a list": ("structure.masses.x=4", "structure.masses.x", "list of 2"),
    "no YAML": ("seed=[1", "seed=[1", "YAML"),
    "below a number": ("seed.x=1", "seed", "whole number"),
}


@pytest.mark.parametrize("case", OVERRIDES)
def test_a_bad_override_is_refused(case, tmp_path, capsys):
    override, *words = OVERRIDES[case]
    file = tmp_path / "study.yaml"
    file.write_text(SMALL)
    line = message_of([str(file), "--check", override], capsys)
    for word in words:
        assert word in line


def test_the_process_itself_exits_with_2_and_one_line(tmp_path):
    file = tmp_path / "mistaken.yaml"
    file.write_text(yaml.safe_dump(changed("structure.masses.0", -1.0)))
    done = subprocess.run(
        [sys.executable, "-m", "hsed_jax.run", str(file)], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 2 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("error: ")
    assert list(tmp_path.iterdir()) == [file]


def test_from_python_a_mistake_is_an_exception_with_the_same_words():
    with pytest.raises(
        UserError,
        match=r"structure\.masses\.0: this must be greater than 0 or a prior, such as \{.*\}, but it is -1\.0",
    ):
        load_study(changed("structure.masses.0", -1.0))


def test_a_law_that_hardens_is_one_like_others():
    changes = ["model.parameters.gamma={uniform: [-3, 3]}", "experiments.virtual.parameters.gamma=-2"]
    study = load_study(content(), changes)
    Built(study).check()
    gamma = np.array([-2, -1, 0.5])
    found = hx.simulate(study, {"V_P": 2.25, "T_P": 1.0}, {"A": 5e5, "beta": 1.0, "gamma": gamma}, ())
    assert found.ok.all() and (np.diff(found.quantities["peak_force"]) < 0).all()


def test_files_of_a_specimens_own_law_are_code_and_are_written_by_their_whole_path(tmp_path):
    own = {"spring": {"file": "mine.py", "class": "Mine"}, "parameters": {"k": 1.0}}
    given = content()
    place = given["structure"].pop("specimen")["between"]
    given["structure"]["specimens"] = {"lower": {"between": place, "model": own}, "upper": {"between": place}}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(given), encoding="utf-8")
    study = load_study(tmp_path / "study.yaml")
    assert study.code == ["mine.py"] and list(study.models) == ["model", "structure.specimens.lower.model"]
    written = study.written()
    assert written["structure"]["specimens"]["lower"]["model"]["spring"] == {
        "file": str(tmp_path / "mine.py"),
        "class": "Mine",
    }
    assert load_study(written).written() == written


def test_the_name_of_a_file_in_place_of_a_study_is_told(tmp_path):
    """In a process without the checks of types that tests have."""
    said = subprocess.run(
        [sys.executable, "-c", "import hsed_jax as hx; hx.calibrate('study.yaml')"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert "UserError: study: 'study.yaml' is not a study; hx.load_study" in said.stderr
