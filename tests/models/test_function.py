"""Models that are functions: posteriors known in closed form, differences, programs, designs, clear messages."""

import logging
from pathlib import Path

import jax
import numpy as np
import pytest
import yaml
from builders.shares import by_default

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record, write_campaign
from hsed_jax.models.differences import Differenced, Free
from hsed_jax.models.function import FunctionModel
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

FUNCTIONS = '''
import math

import numpy as np

CALLS = []


def line(parameters, inputs):
    """A straight line."""
    return {"peak_force": parameters["a"] * inputs["x"] + parameters["b"]}


def plain(parameters, inputs):
    """The same, and nothing that JAX could look into."""
    CALLS.append(parameters)
    return {"peak_force": math.fsum([parameters["a"] * math.fabs(inputs["x"]), parameters["b"]])}


def spring(parameters, told):
    """A linear spring under an imposed elongation, plain: it must not see the padding of a short record."""
    assert (np.diff(told["time"]) > 0).all()
    return {"force": parameters["k"] * np.asarray(told["elongation"], dtype=float)}
'''
PROGRAM = """
import csv, json
request = json.load(open("request.json"))
p, x = request["parameters"], request["inputs"]["x"]
if p["b"] > 1e3:
    raise SystemExit("the program gave up")
assert request["quantities"] == ["peak_force"] and request["channels"] == []
json.dump({"peak_force": p["a"] * x + p["b"]}, open("quantities.json", "w"))
"""
X = np.linspace(1.0, 5.0, 12)
SIGMA, PRIOR = 0.3, 10.0
Y = 3.0 * X + 2.0 + SIGMA * np.random.default_rng(1).standard_normal(X.size)
STUDY = {
    "study": "line",
    "inputs": {"x": {"uniform": [1.0, 5.0]}},
    "model": {
        "function": "mine.py:line",
        "parameters": {"a": {"normal": [0.0, PRIOR], "unit": "N"}, "b": {"normal": [0.0, PRIOR], "unit": "N"}},
    },
    "experiments": {"campaign": "campaign"},
    "quantities": ["peak_force"],
    "calibration": {"sampler": "importance", "draws": 500},
    "steps": ["calibrate", "compare"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign on a straight line, and functions."""
    path = tmp_path_factory.mktemp("functions")
    (path / "mine.py").write_text(FUNCTIONS, encoding="utf-8")
    (path / "sim.py").write_text(PROGRAM, encoding="utf-8")
    (path / "campaign").mkdir()
    (path / "campaign" / "campaign.yaml").write_text(
        f"name: line\nprotocol: ground_motion\ninputs: {{x: '1'}}\n"
        f"quantities: {{peak_force: {{column: F, unit: N, noise: {SIGMA}}}}}\n"
    )
    rows = [f"E{i:02d},{float(x)!r},{float(y)!r}" for i, (x, y) in enumerate(zip(X, Y, strict=True))]
    (path / "campaign" / "experiments.csv").write_text("\n".join(["id,x,F", *rows]) + "\n")
    return path


def study_of(folder: Path, changes=(), **more):
    """The study, in the folder."""
    (folder / "study.yaml").write_text(yaml.safe_dump({**STUDY, **more}), encoding="utf-8")
    return load_study(folder / "study.yaml", list(changes))


def exact() -> tuple[np.ndarray, np.ndarray]:
    """Mean and sd of the posterior of a straight line with Gaussian noise and priors."""
    design = np.stack([X, np.ones_like(X)], axis=1)
    precision = design.T @ design / SIGMA**2 + np.eye(2) / PRIOR**2
    return np.linalg.solve(precision, design.T @ Y / SIGMA**2), np.sqrt(np.diag(np.linalg.inv(precision)))


@pytest.mark.parametrize("function", by_default(["line", "plain"], lambda function: function == "plain"))
def test_a_straight_line_has_the_posterior_of_the_textbook(folder, function):
    study = study_of(folder, [f"model.function=mine.py:{function}"])
    model = Built(study).simulation.simulator
    assert isinstance(model, FunctionModel)
    assert isinstance(model.function, Differenced) == (function == "plain")
    fit = hx.calibrate(study)
    mean, sd = exact()
    maximum = fit.fit.maximum
    np.testing.assert_allclose(maximum.theta, mean, rtol=1e-5)
    np.testing.assert_allclose(np.sqrt(np.diag(maximum.covariance)), sd, rtol=1e-4)
    found = fit.fit.summary()
    np.testing.assert_allclose((np.asarray([found[name]["mean"] for name in "ab"]) - mean) / sd, 0.0, atol=0.15)
    np.testing.assert_allclose([found[name]["sd"] for name in "ab"], sd, rtol=0.1)
    assert "a [N]" in str(fit)
    assert hx.compare(fit).train.error < 0.1
    assert hx.locate(fit).sentences
    with pytest.raises(UserError, match=r"model\.function: .*diagnose, improve.*must be a spring law"):
        hx.diagnose(fit)
    with pytest.raises(UserError, match=r"must be a spring law"):
        hx.improve(fit, effects=["slip"])


def test_both_kinds_of_functions_are_simulated_alike(folder):
    inputs, parameters = {"x": [1.0, 2.0]}, {"a": 3.0, "b": np.asarray([0.5, 1.5])}
    found = [
        hx.simulate(study_of(folder, [f"model.function=mine.py:{name}"]), inputs, parameters)
        for name in ("line", "plain")
    ]
    for response in found:
        np.testing.assert_allclose(response.quantities["peak_force"], [3.5, 7.5], rtol=1e-15)
    with pytest.raises(UserError, match="the model does not give energy"):
        hx.simulate(study_of(folder), {"x": 1.0}, channels=("energy",))


def test_derivatives_are_asked_for_once_a_lane_and_the_function_not_twice_for_the_same():
    calls = []

    def function(parameters, inputs):
        calls.append(parameters["a"])
        return {"peak_force": parameters["a"] ** 3 * inputs["x"] + parameters["c"]}

    made = Differenced(function, "f", ("peak_force",), (Free("a", 1.0, 0.0, 10.0),))

    def value(a, x):
        return made({"a": a, "c": 1.0}, {"x": x})["peak_force"]

    x = np.asarray([1.0, 2.0, 2.0])
    directions = np.asarray([1.0, 2.0, -1.0, 0.5])
    slopes = jax.jit(
        jax.vmap(lambda d: jax.vmap(lambda x: jax.jvp(lambda a: value(a, x), (2.0,), (d,))[1])(x)),
    )(directions)
    np.testing.assert_allclose(slopes, 12.0 * directions[:, None] * x, rtol=1e-5)
    # The value and one on either side, of two different simulations; whatever the number of directions.
    assert len(calls) == 6
    # On the bound the difference is one-sided, and within it.
    np.testing.assert_allclose(jax.jacfwd(lambda a: value(a, 1.0))(0.0), 0.0, atol=1e-6)
    assert min(calls) == 0.0


def test_a_failing_call_is_a_simulation_that_diverged_and_is_told_once(caplog):
    def function(parameters, inputs):
        if parameters["a"] > 1:
            raise ValueError("beyond one")
        return {"peak_force": parameters["a"]}

    made = Differenced(function, "mine.py:f", ("peak_force",), (Free("a", 1.0, -5.0, 5.0),))
    model = FunctionModel(function=made, given=("peak_force",), excitation=None, timeline=None)
    with caplog.at_level(logging.WARNING):
        ok = [bool(model.quantities({"a": a}, Conditions({}), ("peak_force",))[1]) for a in (0.5, 1.5, 2.5)]
    assert ok == [True, False, False]
    (message,) = caplog.messages
    assert "mine.py:f failed" in message and "ValueError: beyond one" in message


@pytest.mark.whole
def test_histories_of_short_and_long_records_calibrate_a_plain_function(folder):
    rng, noise = np.random.default_rng(0), Noise(absolute=5.0)
    channels = {
        "time": Channel("time", "s"),
        "elongation": Channel("elongation", "m"),
        "force": Channel("force", "N", noise=noise),
    }
    campaign = Campaign("springs", "displacement", channels=channels)
    estimates = []
    for number, samples in enumerate((40, 60)):
        time = 0.1 * np.arange(samples)
        elongation = 0.01 * np.sin(time)
        force = 4.0e4 * elongation + 5.0 * rng.standard_normal(samples)
        campaign = campaign.add(
            Experiment(f"E{number}", record=Record(time, {"elongation": elongation, "force": force}))
        )
        estimates.append((elongation, force))
    write_campaign(campaign, folder / "springs")
    model = {"function": "mine.py:spring", "parameters": {"k": {"uniform": [1e4, 9e4], "unit": "N/m"}}}
    study = study_of(
        folder,
        ["experiments.campaign=springs", "inputs={}", "observe=histories", "calibration.sampler=laplace"],
        model=model,
    )
    fit = hx.calibrate(study)
    u, f = (np.concatenate(parts) for parts in zip(*estimates, strict=True))
    assert fit.map["k"] == pytest.approx(u @ f / (u @ u), rel=1e-5)
    assert fit.fit.summary()["k"]["sd"] == pytest.approx(5.0 / np.sqrt(u @ u), rel=0.1)


def test_a_program_is_a_model(folder):
    model = {"command": "{python} sim.py", "parameters": STUDY["model"]["parameters"]}
    study = study_of(folder, model=model)
    assert load_study(study.written()).written() == study.written()
    built = Built(study)
    response = built.simulation.simulator.respond({"a": 2.0, "b": 1.0}, Conditions({"x": 3.0}))
    assert float(response.quantities["peak_force"]) == 7.0 and bool(response.ok)
    assert not bool(built.simulation.simulator.respond({"a": 2.0, "b": 2e3}, Conditions({"x": 3.0})).ok)
    assert "sim.py" in study.code[0]
    with pytest.raises(UserError, match=r"model\.command\.run: it contains \{y\}"):
        Built(study_of(folder, ["model.command.run='prog {y}'"], model=model)).check()
    with pytest.raises(UserError, match=r"model\.command\.run: there is no program no_such"):
        Built(study_of(folder, ["model.command.run=no_such"], model=model)).check()


# A specimen with a ground motion: the package's own simulator, wrapped; a design; a look at what was left.

LAW = {
    "study": "law",
    "structure": {
        "masses": [8.0e3, 9.0e3],
        "springs": [{"between": ["ground", 1], "stiffness": 4.0e5}, {"between": [2, "ground"], "stiffness": 1.0e6}],
        "specimen": {"between": [1, 2]},
        "damping": {"modal": 0.05, "specimen_stiffness": 5.0e5},
    },
    "excitation": {"near_fault_pulse": {"V_P": "V_P", "T_P": "T_P"}, "duration": 6.0},
    "inputs": {"V_P": {"uniform": [1.5, 3.0], "unit": "m/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}},
    "model": {
        "spring": "bouc_wen",
        "parameters": {"A": {"uniform": [2.0e5, 9.0e5]}, "beta": {"uniform": [0.5, 2.0]}, "gamma": 0.0, "n": 1.0},
    },
    "experiments": {
        "virtual": {
            "spring": "bouc_wen",
            "parameters": {"A": 5.0e5, "beta": 1.0, "gamma": 0.0, "n": 1.0},
            "noise": {"relative": 0.02},
            "test": 2,
        }
    },
    "error": {"relative": 0.02},
    "design": {"initial": 3, "iterations": 2, "candidates": 64},
    "calibration": {"sampler": "laplace", "starts": 2},
    "steps": ["design", "calibrate", "compare"],
}
WRAPPED = """
import numpy as np

from hsed_jax.study.build import Built
from hsed_jax.config.load import load_study
from hsed_jax.physics.simulator import Conditions

NAMES = ("peak_force", "peak_elongation", "dissipated_energy")
SIMULATOR = Built(load_study({law!r})).simulation.simulator


def respond(parameters, inputs):
    # Plain Python to the one who calls it: no tracer gets through `float`.
    conditions = Conditions({{name: np.asarray(float(inputs[name])) for name in ("V_P", "T_P")}})
    values, ok = SIMULATOR.quantities({{name: np.asarray(float(parameters[name])) for name in ("A", "beta")}}, conditions, NAMES)
    assert ok and inputs["time"].shape == inputs["ground_acceleration"].shape
    return dict(zip(NAMES, np.asarray(values).tolist()))
"""


@pytest.fixture(scope="module")
def wrapped(folder):
    """The study of the law, and the same study with its model a plain function around the simulator."""
    (folder / "law.yaml").write_text(yaml.safe_dump(LAW), encoding="utf-8")
    (folder / "wrapped.py").write_text(WRAPPED.format(law=str(folder / "law.yaml")), encoding="utf-8")
    parameters = {name: LAW["model"]["parameters"][name] for name in ("A", "beta")}
    model = {"function": "wrapped.py:respond", "parameters": parameters}
    (folder / "wrapped.yaml").write_text(yaml.safe_dump({**LAW, "model": model, "study": "wrapped"}), encoding="utf-8")
    return load_study(folder / "law.yaml"), load_study(folder / "wrapped.yaml")


@pytest.mark.slow
def test_the_simulator_in_a_plain_function_is_designed_with_and_calibrated_as_the_law(wrapped, tmp_path, capsys):
    ours, theirs = (hx.run(study, tmp_path / study.study, progress=False, figures=False) for study in wrapped)
    for name in ("A", "beta"):
        assert theirs.calibration.map[name] == pytest.approx(ours.calibration.map[name], rel=1e-3)
    np.testing.assert_allclose(
        theirs.calibration.fit.maximum.covariance, ours.calibration.fit.maximum.covariance, rtol=0.02
    )
    assert len(theirs.steps) == 2
    np.testing.assert_allclose(
        [step["max_expected_improvement"] for step in theirs.steps],
        [step["max_expected_improvement"] for step in ours.steps],
        rtol=0.05,
    )
    assert theirs.comparison.train.error == pytest.approx(ours.comparison.train.error, rel=1e-2)
    assert theirs.location is not None


CYCLES = {
    "study": "cycles",
    "excitation": {"imposed": {"amplitudes": ["a", 0.03], "rate": 0.05, "cycles": 1}},
    "inputs": {"a": {"uniform": [5.0, 40.0], "unit": "mm"}},
    "model": {"function": "mine.py:spring", "parameters": {"k": {"uniform": [1.0e4, 9.0e4], "unit": "N/m"}}},
    "experiments": {"virtual": {"spring": "elastic", "parameters": {"k": 4.0e4}, "noise": {"absolute": 10.0}}},
    "observe": "histories",
    "channels": ["force"],
    "error": {"absolute": 10.0},
    "design": {"initial": 2},
    "calibration": {"sampler": "laplace", "starts": 1},
    "steps": ["calibrate"],
}


@pytest.mark.whole
def test_a_function_is_told_the_cycles_of_a_designed_test_and_calibrated_by_it(folder):
    study = study_of(folder, **CYCLES)
    built = Built(study)
    built.check()
    told = {name: np.asarray(value) for name, value in built.simulation.simulator.told(Conditions({"a": 0.02})).items()}
    # Two sines of the same peak rate, one after the other.
    first, second = (2 * np.pi * a / 0.05 for a in (0.02, 0.03))
    is_first, begun = told["time"] < first, np.minimum(told["time"], first)
    amplitude, phase = np.where(is_first, 0.02, 0.03), np.where(is_first, told["time"], told["time"] - begun)
    np.testing.assert_allclose(told["time"][-1], first + second, rtol=1e-12)
    np.testing.assert_allclose(told["elongation"], amplitude * np.sin(0.05 * phase / amplitude), atol=1e-12)
    np.testing.assert_allclose(told["elongation_rate"], 0.05 * np.cos(0.05 * phase / amplitude), atol=1e-12)
    fit = hx.calibrate(study)
    assert fit.fit.summary()["k"]["sd"] < 100.0
    assert abs(fit.map["k"] - 4.0e4) < 4 * fit.fit.summary()["k"]["sd"]
    alone = {"command": "true"}
    without = Built(study_of(folder, **{**CYCLES, "experiments": alone}))
    assert (
        without.simulation.planned.step is None
        and without.simulation.planned.every == 1
        and 500 < without.simulation.planned.steps < 2000
    )


def test_a_function_is_told_the_force_that_is_applied(folder):
    time, force = 0.01 * np.arange(101), 1.0e3 * np.sin(np.arange(101) / 9)
    rows = "".join(f"{t!r},{p!r}\n" for t, p in zip(time.tolist(), force.tolist(), strict=True))
    (folder / "force.csv").write_text(f"t [s],p [N]\n{rows}", encoding="utf-8")
    study = study_of(folder, excitation={"applied_force": {"file": "force.csv", "mass": 2, "scale": "x"}})
    told = Built(study).simulation.simulator.told(Conditions({"x": 3.0}))
    assert set(told) == {"x", "time", "applied_force_2"}
    np.testing.assert_allclose(told["time"], time, atol=1e-12)
    np.testing.assert_allclose(told["applied_force_2"], 3.0 * force, atol=1e-6)
    with pytest.raises(UserError, match=r"inputs\.applied_force_1: a function gets a history of this name"):
        Built(study_of(folder, ["inputs={applied_force_1: {uniform: [1.0, 5.0]}}"])).check()


def test_specimens_have_no_model_of_their_own_beside_a_function(folder):
    own = {"between": [1, 2], "model": {"spring": "elastic", "parameters": {"k": {"uniform": [1.0, 2.0]}}}}
    structure = {name: value for name, value in LAW["structure"].items() if name != "specimen"}
    study = study_of(folder, structure={**structure, "specimens": {"wall": own}})
    with pytest.raises(UserError, match=r"structure\.specimens\.wall\.model: the model is a function"):
        Built(study).check()


@pytest.mark.whole
def test_a_report_executes_nothing(folder, tmp_path):
    study = study_of(folder, ["calibration.sampler=laplace", "model.function=mine.py:plain"])
    run = hx.run(study, tmp_path / "run", progress=False, figures=False)
    written = load_study(tmp_path / "run" / "study.yaml")
    assert written.code == [str((folder / "mine.py").resolve())]
    assert run.calibration.map["a"] == pytest.approx(exact()[0][0], rel=1e-4)
    mark = tmp_path / "executed"
    kept = (folder / "mine.py").read_text(encoding="utf-8")
    try:
        (folder / "mine.py").write_text(f"open({str(mark)!r}, 'w').close()\n{kept}", encoding="utf-8")
        assert main(["report", str(tmp_path / "run")]) == 0
        assert "the function mine.py:plain" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
        assert not mark.exists()
        assert main(["check", str(folder / "study.yaml")]) == 2
        assert not mark.exists()
        assert main(["check", str(folder / "study.yaml"), "--trust"]) == 0
        assert mark.exists()
    finally:
        (folder / "mine.py").write_text(kept, encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is no such file"),
        ("x = 1", "it has no function 'f'"),
        ("f = 3", "it has no function 'f'"),
        ("x = 1 / 0", "ZeroDivisionError"),
        ("def f(p, x): return 1.0", "a mapping of names to numbers or arrays is wanted"),
        ("def f(p, x): return {'peak_forse': 1.0}", "no peak_force; .* it returned peak_forse"),
        (
            "def f(p, x): return {'peak_force': [1.0, 2.0]}",
            r"its peak_force has the shape \(2,\); a quantity is one number",
        ),
        ("def f(p, x): return {'peak_force': 'strong'}", "its peak_force is 'strong'; numbers are wanted"),
        ("def f(p, x): return {'peak_force': float('nan')}", "its peak_force is no finite number"),
        ("def f(p, x): return {'peak_force': p['a'], 'force': [1.0]}", "the channel force, but no excitation"),
        ("def f(p, x): return {'peak_force': p['c']}", "KeyError: 'c'"),
        ("def f(p, x): raise SystemExit(3)", "SystemExit: 3"),
        ("def f(p): return {}", "TypeError: f"),
    ],
)
def test_a_function_that_cannot_be_used_is_one_clear_message(folder, tmp_path, text, words):
    if text is not None:
        (tmp_path / "own.py").write_text(text, encoding="utf-8")
    study = study_of(folder, [f"model.function={tmp_path / 'own.py'}:f"])
    with pytest.raises(UserError, match=rf"(?s)model\.function: .*own\.py.*{words}") as caught:
        Built(study).check()
    assert str(folder / "study.yaml") in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["model.function=mine.py"], r"model\.function: this is FILE:NAME"),
        (["model.spring=takeda"], r"model\.spring: there is no such key; allowed here are levels, function, command"),
        (["model.effects={}"], r"model\.effects: there is no such key"),
        (["model.command=prog"], r"model: give either function or command"),
        (["model.parameters.a.unit=kN"], r"model\.parameters\.a\.unit: parameters of a model are in SI"),
        (["model.parameters.a.unit=metre_of_beer"], r"model\.parameters\.a\.unit: unknown unit"),
        (["model.parameters={a: 1.0, b: 2.0}"], r"model\.parameters: at least one parameter needs a prior"),
        (["model.parameters.a={uniform: [2.0, 1.0]}"], r"model\.parameters\.a: uniform"),
        (["steps=[calibrate, compare, diagnose]"], r"model\.function: .*must be a spring law"),
        (["steps=[calibrate, compare, improve]", "improve.add=[slip]"], r"model\.function: .*must be a spring law"),
        (["design.acquisition=discriminate"], r"design\.acquisition: this needs a diagnosis"),
        (["design.stop.verdict=true"], r"design\.stop\.verdict: this needs a diagnosis"),
        (["design.limits={stroke: 0.1}"], r"design\.limits: the model does not give peak_elongation"),
        (["quantities=[peak_force, peak_elongation]"], r"it returned no peak_elongation"),
        (["model.derivatives=jax", "model.function=mine.py:plain"], r"JAX cannot trace it .*differences"),
        (["experiments={virtual: {parameters: {A: 1.0}}}"], r"structure: this key is required"),
    ],
)
def test_a_study_of_a_function_that_makes_no_sense_is_one_clear_message(folder, changes, words):
    with pytest.raises(UserError, match=words):
        Built(study_of(folder, changes)).check()


def test_a_history_has_a_name_that_no_input_may_have(folder):
    study = study_of(folder, ["inputs={time: {uniform: [1.0, 5.0]}}"])
    with pytest.raises(UserError, match=r"inputs\.time: a function gets a history of this name"):
        Built(study).check()
