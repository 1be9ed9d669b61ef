"""Estimates on bounds of their priors that are no physical limits: said first, in a calibration and wherever a run is told of."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from builders.loops import loop

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.schema import Study
from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.diagnose import diagnose
from hsed_jax.inference.leaning import ANYTHING, Leaning, caution, leaning
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import Campaign, Channel, Noise, write_campaign
from hsed_jax.reporting.digest import verdict, warnings
from hsed_jax.runs.reading import read_run
from hsed_jax.study.build import Built

# Most of the time goes into simulations of the component test.
pytestmark = pytest.mark.optimised

POSITIVE = (0.0, math.inf)


@pytest.mark.parametrize(
    ("prior", "possible", "value", "sd", "side"),
    [
        (Prior("uniform", [0.5, 2.0]), POSITIVE, 2.0, 1e-4, "upper"),
        (Prior("uniform", [0.5, 2.0]), POSITIVE, 0.5, 1e-4, "lower"),
        (Prior("uniform", [0.5, 2.0]), POSITIVE, 0.51, 0.01, "lower"),
        (Prior("uniform", [0.5, 2.0]), POSITIVE, 0.51, 0.001, ""),  # near it, and ten standard deviations away
        (Prior("uniform", [0.5, 2.0]), POSITIVE, 0.6, 0.2, ""),
        (Prior("uniform", [0.0, 2.0]), POSITIVE, 0.0, 0.1, ""),
        (Prior("uniform", [0.0, 1.0]), (0.0, 1.0), 1.0, 0.1, ""),
        (Prior("uniform", [0.0, 1.0]), POSITIVE, 1.0, 0.1, "upper"),
        (Prior("half_normal", 0.3), POSITIVE, 0.0, 0.1, ""),
        (Prior("half_normal", 0.3), (-1.0, math.inf), 0.0, 0.1, "lower"),
        (Prior("lognormal", [0.0, 1.0]), POSITIVE, 1e-3, 1e-3, ""),
        (Prior("truncated_normal", {"loc": 0.0, "scale": 1.0, "low": -0.5, "high": 6.0}), (-0.5, math.inf), -0.5, 0.1, ""),
        (Prior("truncated_normal", {"loc": 0.0, "scale": 1.0, "low": -0.2, "high": 6.0}), (-0.5, math.inf), -0.2, 0.1, "lower"),
        (Prior("uniform", [1e-3, 1.0]), ANYTHING, 1e-3, 1e-6, "lower"),
        # Of a parameter of somebody's function nothing is known.
        (Prior("half_normal", 0.3), None, 0.0, 0.1, ""),
        (Prior("uniform", [0.0, 1.0]), None, 0.0, 0.1, "lower"),
    ],
)  # fmt: skip
def test_an_estimate_leans_on_a_bound_that_is_no_physical_limit(prior, possible, value, sd, side):
    limits = {} if possible is None else {"x": possible}
    found = leaning({"x": prior}, limits, {"x": value}, {"x": {"sd": sd}})
    assert [one.side for one in found] == ([side] if side else [])
    if side:
        assert found[0].bound == prior.bounds[0 if side == "lower" else 1]


def test_what_leans_is_said_with_its_unit_and_what_to_do():
    found = (Leaning("A", 2e5, 2e5, "lower", (2e5, 9e5)), Leaning("beta", 2.0, 2.0, "upper", (0.5, 2.0)))
    priors = {name: Prior("uniform", list(ends)) for name, ends in (("A", (2e5, 9e5)), ("beta", (0.5, 2.0)))}
    posterior = {"A": {"sd": 1e3, "q05": 2.01e5, "q95": 2.1e5}, "beta": {"sd": 0.1, "q05": 1.8, "q95": 1.99}}
    units = {"A": "N/m", "beta": "1/m"}
    said = caution(found, priors, {"A": 2e5, "beta": 2.0}, posterior, units)
    assert said == (
        "estimates are on bounds of their priors that are not physical limits: "
        "A = 2e+05 N/m on the lower bound of 2e+05 to 9e+05, beta = 2 1/m on the upper bound of 0.5 to 2; "
        "these priors exclude values that fit better: widen them and calibrate again "
        "before an effect is named"
    )
    assert json.dumps([one.summary() for one in found], allow_nan=False)


def test_an_estimate_outside_its_own_interval_is_said_but_not_one_at_a_limit():
    priors = {"beta": Prior("lognormal", [7.0, 0.7]), "delta": Prior("half_normal", 1.0)}
    posterior = {"beta": {"sd": 25.0, "q05": 1004.0, "q95": 1087.0}, "delta": {"sd": 0.02, "q05": 0.001, "q95": 0.05}}
    said = caution((), priors, {"beta": 1089.1, "delta": 0.0}, posterior, {"beta": "1/m"})
    assert said is not None
    assert said.startswith(
        "the most probable beta = 1089 1/m (1004 to 1087) lies outside the 90 % interval: the posterior is skewed"
    )
    assert "delta" not in said
    assert caution((), priors, {"beta": 1050.0, "delta": 0.0}, posterior, {}) is None


def test_many_estimates_outside_their_intervals_are_one_sentence():
    names = [f"p{k}" for k in range(6)]
    priors = {name: Prior("normal", [0.0, 1.0]) for name in names}
    posterior = {name: {"sd": 0.1, "q05": 0.2, "q95": 0.4} for name in names}
    said = caution((), priors, dict.fromkeys(names, 0.0), posterior, {})
    assert said is not None
    assert said.startswith(
        "the most probable p0 = 0 (0.2 to 0.4), p1 = 0 (0.2 to 0.4), p2 = 0 (0.2 to 0.4) and 3 more "
        "lie outside the 90 % interval"
    )


# --- a specimen that its priors exclude ----------------------------------------------------------------------------------

BOUNDED = {"A": {"uniform": [2e7, 9e7]}, "beta": {"uniform": [50.0, 200.0]}, "gamma": 0.0, "n": 1.0}


def nearly_linear() -> Campaign:
    """A component test of a spring that hardly yields: a tenth of the least β that the study's prior allows."""
    time = np.linspace(0, 10, 101)
    elongation = 0.002 * time * np.sin(np.pi * time)
    force = loop(time, elongation, A=5e7, beta=5.0) + 2e3 * np.random.default_rng(0).standard_normal(time.size)
    return Campaign.from_frames(
        records={"E01": {"time": time, "elongation": elongation, "force": force}},
        protocol="displacement",
        channels={"time": "s", "elongation": "m", "force": Channel("force", "N", noise=Noise(2e3))},
    )


def content(**parameters) -> dict:
    return {"study": "stiff", "model": {"parameters": {**BOUNDED, **parameters}}, "observe": "histories",
            "experiments": {"campaign": "."}, "steps": ["calibrate", "compare"],
            "calibration": {"sampler": "laplace", "starts": 2}}  # fmt: skip


@pytest.fixture(scope="module")
def campaign():
    return nearly_linear()


@pytest.fixture(scope="module")
def calibration(campaign):
    return hx.calibrate(Study.model_validate(content()), campaign)


@pytest.mark.whole
def test_a_calibration_says_first_which_estimates_lean(campaign, calibration):
    found = {one.parameter: one.side for one in calibration.fit.leaning}
    assert found["beta"] == "lower"
    first = repr(calibration).splitlines()[0]
    assert first.startswith(("an estimate is on a bound", "estimates are on bounds")) and "beta = 50 1/m" in first
    # With the bound open nothing leans, and the data are explained.
    opened = hx.calibrate(Study.model_validate(content(beta={"uniform": [0.0, 200.0]})), campaign)
    assert opened.fit.leaning == () and opened.fit.doubt is None
    assert repr(calibration).splitlines()[1].startswith("calibrated on 1 experiment")
    assert repr(opened).startswith("calibrated on 1 experiment") and opened.map["beta"] == pytest.approx(5.0, rel=0.2)


def check_what_is_written(folder) -> None:
    """Summary and headline of a run of the nearly linear specimen."""
    told = json.loads((folder / "summary.json").read_text())["calibration"]
    (beta,) = (one for one in told["at_bounds"] if one["parameter"] == "beta")
    assert beta == {"parameter": "beta", "value": beta["value"], "bound": 50.0, "side": "lower", "prior": [50.0, 200.0]}
    headline = verdict(read_run(folder))
    assert headline.startswith(f"{told['caution'][0].upper()}{told['caution'][1:]}. The noise does not explain")


def check_headline_after_an_improvement(run) -> None:
    """An effect may free an estimate from its bound: the first model's warning is no headline then."""
    steps = [{"effects": [], "error_train": 0.2}, {"effects": ["slip"], "error_train": 0.02}]
    improvement = {"steps": steps, "noise_floor": 0.02, "comparison": {"train": {}, "adequate": True, "p_value": 0.5}}
    summary = run.summary | {"calibration": {"caution": "an estimate leans"}, "improvement": improvement}
    improved = replace(run, summary=summary)
    assert verdict(improved).startswith("With slip the error")
    assert "Of the model as it was: an estimate leans." in list(warnings(improved))
    improvement["caution"] = "another one leans"
    assert verdict(improved).startswith("Of the improved model, another one leans. With slip")


@pytest.mark.whole
def test_summary_and_headline_begin_with_it(campaign, tmp_path):
    write_campaign(campaign, tmp_path / "data")
    study = content(beta={"uniform": [50.0, 200.0]}) | {"experiments": {"campaign": str(tmp_path / "data")}}
    hx.run(Study.model_validate(study), tmp_path / "run", progress=False, figures=False)
    check_what_is_written(tmp_path / "run")
    check_headline_after_an_improvement(read_run(tmp_path / "run"))


@pytest.mark.whole
def test_terminal_and_report_begin_with_it(campaign, tmp_path, capsys):
    write_campaign(campaign, tmp_path / "data")
    path = tmp_path / "data" / "study.yaml"
    path.write_text(yaml.safe_dump(content()))
    assert main(["run", str(path), "--output", str(tmp_path / "run")]) == 0, capsys.readouterr().err
    shown = capsys.readouterr().out
    assert shown.index("on a bound") < shown.index("calibrated on 1 experiment")
    check_what_is_written(tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text()
    assert page.partition('id="sentence">')[2].startswith(("Estimates are on bounds", "An estimate is on a bound"))


# --- what is physically possible -----------------------------------------------------------------------------------------


@pytest.mark.whole
def test_no_effect_is_named_to_get_round_a_bound(campaign, calibration):
    built = Built(Study.model_validate(content()), campaign)
    leaning = [one.parameter for one in calibration.fit.leaning]
    assert leaning == ["beta"]
    effects = ["hardening", "support_flexibility"]
    within = diagnose(problem_of(built, campaign, effects).calibrated(calibration.map))
    assert within.effects  # what gets round it
    open_ = diagnose(problem_of(built, campaign, effects).calibrated(calibration.map, opened=leaning))
    assert (open_.verdict, open_.effects) == ("unexplained", [])
    assert open_.opened["beta"] == pytest.approx(5.0, rel=0.1)
    assert open_.sentence.startswith("the priors exclude this specimen") and "widen" in open_.sentence
    assert open_.summary()["opened"] == open_.opened
    # If the noise explained the residual with the bound, too, the bound would exclude nothing.
    allowed = problem_of(built, campaign, effects).calibrated(calibration.map, opened=leaning, excludes=False)
    allowed = diagnose(allowed)
    assert (allowed.verdict, allowed.effects) == ("adequate", [])
    assert {one.verdict for one in allowed.prior_widths} == {"adequate"}


def test_physical_limits_are_those_of_the_catalogue_in_either_form(campaign):
    study = content(beta=100.0)
    added = {"hardening": {"k": {"normal": [0.0, 1e6]}}, "slip": {}, "gap": {"width": {"half_normal": 1e-3}}}
    study["model"] |= {"effects": added}
    study |= {"scales": {"force": 1e6, "elongation": 0.02, "rate": 0.06, "energy": 1e4}}
    possible = Built(Study.model_validate(study), campaign).inference.possible
    assert possible["A"] == (0.0, math.inf)
    assert possible["slip.delta"] == (0.0, 1.0)
    assert possible["hardening.k"] == pytest.approx((-1e6 / 0.02, math.inf))
    assert possible["gap.width"] == pytest.approx((0.0, 0.02))


def test_numbers_of_a_structure_and_of_a_function_have_the_limits_that_are_known():
    structure = {"masses": [{"uniform": [1e3, 2e3]}], "specimen": {"between": ["ground", 1]},
                 "damping": {"modal": {"uniform": [0.01, 0.1]}, "specimen_stiffness": 4e6}}  # fmt: skip
    study = {"study": "frame", "structure": structure, "model": {"parameters": BOUNDED},
             "excitation": {"near_fault_pulse": {"V_P": 0.5, "T_P": 0.5}, "duration": 2.0},
             "experiments": {"virtual": {"parameters": {"A": 5e7, "beta": 100.0}, "structure": {"mass_1": 1.5e3, "ratio": 0.05}}},
             "error": {"relative": 0.01}}  # fmt: skip
    possible = Built(Study.model_validate(study)).inference.possible
    assert possible["structure.mass_1"] == (0.0, math.inf)
    assert possible["structure.ratio"] == (0.0, 1.0)
