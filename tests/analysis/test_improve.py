"""Adding effects to a calibrated model: the fall of the error, the improved study, and the same from the command line."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from builders.springs import BETA, NOISE, A, C, spring_campaign, spring_study

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.experiments import ExperimentsEntry
from hsed_jax.diagnosis.candidates import problem_of, with_effects
from hsed_jax.diagnosis.diagnose import diagnose
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Experiment, Record, write_campaign
from hsed_jax.study.build import Built

pytestmark = pytest.mark.whole

HARDENING = 8.0e5  # N/m: 24 kN at the largest elongation
SMALL = {"starts": 1, "chains": 2, "warmup": 10, "draws": 20}


def stiffened(campaign: Campaign) -> Campaign:
    """The same springs, each with a linear one beside it."""
    return loaded(campaign, lambda experiment: HARDENING * experiment.record["elongation"])


def loaded(campaign: Campaign, force) -> Campaign:
    """The same springs, each with a force beside it, which is a function of the experiment."""
    experiments = []
    for e in campaign.experiments:
        channels = dict(e.record.channels)
        channels["force"] = channels["force"] + force(e)
        experiments.append(Experiment(e.id, record=Record(e.record.time, channels), split=e.split))
    return Campaign("springs", "displacement", {}, campaign.channels, {}, tuple(experiments))


def small_study(**changes):
    return spring_study(calibration=SMALL, **changes)


@pytest.fixture(scope="module")
def campaign():
    return stiffened(spring_campaign(C))


@pytest.fixture(scope="module")
def calibration(campaign):
    return hx.calibrate(small_study(), campaign)


@pytest.fixture(scope="module")
def diagnosis(calibration, campaign):
    effects = ["viscous_damping", "hardening"]
    return diagnose(problem_of(calibration.built, campaign, effects).calibrated(calibration.map))


@pytest.fixture(scope="module")
def better(calibration, diagnosis):
    return hx.improve(calibration, effects=["viscous_damping", "hardening"], start=diagnosis.optimum)


def floor(experiments):
    return NOISE / np.std(np.concatenate([e.record["force"] for e in experiments]))


def test_the_trail_goes_from_the_model_as_it_was_to_the_one_with_all_effects(better, calibration):
    steps = better.trail.steps
    assert [s.effects for s in steps] == [[], ["viscous_damping"], ["viscous_damping", "hardening"]]
    errors = [s.error_train for s in steps]
    assert errors[0] > errors[1] > errors[2]
    assert errors[0] == better.before.train.error == hx.compare(calibration).train.error
    assert errors[2] == better.after.train.error
    assert [s.error_test for s in steps][::2] == [better.before.test.error, better.after.test.error]
    assert steps[0].parameters == calibration.map and steps[2].parameters == better.calibration.map
    assert set(steps[1].parameters) == {"A", "beta", "viscous_damping.delta"}


def test_the_error_falls_to_the_noise(better, campaign):
    last = better.trail.steps[-1]
    assert last.error_train == pytest.approx(floor(campaign.train), rel=0.15)
    assert last.error_test == pytest.approx(floor(campaign.test), rel=0.2)
    assert better.trail.noise_floor == pytest.approx(floor(campaign.train), rel=1e-6)
    assert better.trail.steps[0].error_train > 3 * last.error_train
    assert not better.before.adequate and better.after.adequate


def test_what_the_diagnosis_promises_the_improvement_delivers(better, diagnosis):
    assert set(diagnosis.effects) == {"viscous_damping", "hardening"} and not diagnosis.notes
    # The forms may be others than the default ones, with parameters of their own.
    owners = [{name.partition(".")[0] for name in one} for one in (diagnosis.optimum, better.calibration.map)]
    assert owners[0] == owners[1]
    last = better.trail.steps[-1]
    assert (last.error_train, last.error_test) == pytest.approx(diagnosis.error_after, rel=0.02)
    first = better.trail.steps[0]
    assert (first.error_train, first.error_test) == pytest.approx(diagnosis.error, rel=0.02)


@pytest.mark.parametrize(("adequate", "verdict"), [(True, "adequate"), (False, "unexplained")])
def test_bounds_that_exclude_nothing_make_no_model_wrong(calibration, diagnosis, monkeypatch, adequate, verdict):
    """An estimate is on a bound, and the noise explains the residual of the calibrated model or not."""

    def fake(problem, *_):
        assert problem.opened == ("A",)
        return replace(diagnosis, verdict="unexplained" if problem.excludes else "adequate", effects=[])

    monkeypatch.setattr("hsed_jax.inference.fit.Fit.leaning", [SimpleNamespace(parameter="A")])
    monkeypatch.setattr("hsed_jax.analysis.remedy.compare", lambda *_: SimpleNamespace(adequate=adequate))
    monkeypatch.setattr("hsed_jax.analysis.remedy.diagnosing.diagnose", fake)
    assert hx.diagnose(calibration).verdict == verdict


def test_a_diagnosis_says_all_that_an_improvement_needs(calibration, diagnosis):
    better = hx.improve(calibration, diagnosis)
    assert better.trail.steps[-1].effects == diagnosis.effects
    assert set(better.calibration.map) == set(diagnosis.optimum)
    last = better.trail.steps[-1]
    assert (last.error_train, last.error_test) == pytest.approx(diagnosis.error_after, rel=0.02)


@pytest.mark.slow
def test_a_model_that_was_not_at_its_best_fit_is_calibrated_again(calibration):
    # As if the search had stopped half-way.
    there = calibration.fit.maximum
    short = replace(calibration.fit, maximum=there._replace(theta=there.theta * jnp.asarray([0.8, 1.0])))
    found = hx.improve(replace(calibration, fit=short), effects=["coulomb_friction"])
    assert not hx.improve(calibration, effects=["coulomb_friction"]).trail.notes
    assert "was repeated" in found.trail.notes[0] and "was repeated" in repr(found)
    errors = [step.error_train for step in found.trail.steps]
    assert errors[0] == pytest.approx(hx.compare(calibration).train.error, rel=1e-3)
    assert errors[1] < errors[0] * 1.001


def test_parameters_of_law_and_effects_are_the_true_ones(better):
    scales = better.calibration.built.simulation.scales
    truth = {
        "A": A,
        "beta": BETA,
        "viscous_damping.delta": C * scales.rate / scales.force,
        "hardening.delta": HARDENING * scales.elongation / scales.force,
    }
    assert set(better.calibration.map) == set(truth)
    for name, value in truth.items():
        summary = better.calibration.fit.summary()[name]
        # Between 24 samples per cycle the model's rate is that of an interpolant: 3 % of the damping.
        assert abs(better.calibration.map[name] - value) < 4 * summary["sd"] + 0.03 * value, name


def test_an_effect_that_predicts_worse_is_not_added(diagnosis):
    """An offset of the force in the fitted tests alone: the model with it is right there, and wrong in the held-out test."""
    campaign = loaded(spring_campaign(C), lambda experiment: 20e3 if experiment.split == "train" else 0.0)
    calibration = hx.calibrate(small_study(), campaign)
    effects = ["viscous_damping", "force_offset"]
    found = hx.improve(calibration, replace(diagnosis, effects=effects, forms={}))
    first, last = found.trail.steps
    assert last.effects == ["viscous_damping"] == list(found.study.model.effects)
    assert last.error_test == found.after.test.error and last.parameters == found.calibration.map
    (note,) = found.trail.notes
    assert note.startswith("force_offset is not added: the error on experiments that were not fitted is ")
    with_it, without = (float(word) for word in note.split() if word.startswith("0."))
    assert with_it > without and first.error_test > 0
    assert without == pytest.approx(last.error_test, abs=1e-3)
    # A user's own choice is added as it is.
    assert hx.improve(calibration, effects=effects).trail.steps[-1].effects == effects


def test_the_trail_shows_itself(better):
    text = repr(better)
    lines = text.splitlines()
    assert [line.split("  ")[0].strip() for line in lines[2:6]] == [
        "model as it was",
        "+ viscous_damping",
        "+ hardening",
        "noise",
    ]
    assert "explained by the noise" in text and "nan" not in text and "<table>" in better._repr_html_()
    summary = json.loads(json.dumps(better.trail.summary(), allow_nan=False))
    assert summary.keys() == {"steps", "noise_floor", "notes"} and summary["notes"] == []
    assert all(step.keys() >= {"effects", "error_train", "error_test"} for step in summary["steps"])


def test_the_improved_study_is_read_back_as_it_is(better, tmp_path, campaign):
    path = tmp_path / "improved.yaml"
    better.write(path)
    again = hx.load_study(path)
    assert again.written() == better.study.written()
    assert list(again.model.effects) == ["viscous_damping", "hardening"]
    assert again.study == "springs_improved"
    # Amplitudes mean what they meant, on whatever data it is run.
    assert Built(again, spring_campaign(0.0)).simulation.scales == better.calibration.built.simulation.scales
    assert tuple(Built(again, campaign).mechanics.parameters[0]) == tuple(better.calibration.map)


def test_the_improved_study_finds_the_campaign_from_where_it_lies_and_says_what_it_is(better, tmp_path):
    located = better.study.model_copy(update={"experiments": ExperimentsEntry(campaign=str(tmp_path / "data/springs"))})
    (tmp_path / "runs/it").mkdir(parents=True)
    replace(better, study=located).write(tmp_path / "runs/it/improved.yaml")
    text = (tmp_path / "runs/it/improved.yaml").read_text()
    assert "campaign: ../../data/springs" in text and str(tmp_path) not in text
    assert text.startswith("# The study 'springs' with viscous_damping and hardening added to its model: the error on")
    for key in ("study", "model", "experiments", "scales"):
        assert text[: text.index(f"\n{key}:")].splitlines()[-1].startswith("# ")


def test_training_and_held_out_experiments_are_told_apart_where_the_misfit_is(calibration, campaign):
    default, given = (hx.locate(calibration, *of) for of in ((), (campaign,)))
    assert given.sentences == default.sentences and default.sentences
    held_out = hx.locate(calibration, campaign, split="test")
    assert held_out.samples.share.size < default.samples.share.size and held_out.sentences != default.sentences
    with pytest.raises(UserError, match="no experiments that were held out"):
        hx.locate(calibration, Campaign("some", "displacement", {}, campaign.channels, {}, campaign.train.experiments),
                  split="test")  # fmt: skip


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([], "no effect to add"),
        (["viscous_dampin"], "no effect 'viscous_dampin'.*viscous_damping"),
        (["hardening", "hardening"], "hardening is to be added twice"),
    ],
)
def test_what_cannot_be_added_is_said(calibration, effects, message):
    with pytest.raises(UserError, match=message):
        hx.improve(calibration, effects=effects)


def test_what_is_there_already_is_not_added_again(better):
    with pytest.raises(UserError, match="has hardening already"):
        hx.improve(better.calibration, effects=["hardening"])


def test_an_improved_model_lacks_nothing(better, monkeypatch):
    monkeypatch.setattr("hsed_jax.study.own_parts.EFFECTS", few())
    built = Built(better.study, better.calibration.built.campaign)
    found = hx.diagnose(replace(better.calibration, built=built))
    assert found.verdict == "adequate" and {c.effect for c in found.ranking} == {"coulomb_friction"}


# --- the command line ------------------------------------------------------------------------------------------------


def few():
    from hsed_jax.physics.effects import EFFECTS

    return EFFECTS.only(["viscous_damping", "hardening", "coulomb_friction"])


@pytest.fixture
def folder(tmp_path):
    """A campaign folder with a study in it."""
    write_campaign(spring_campaign(C), tmp_path / "springs")
    path = tmp_path / "springs" / "study.yaml"
    content = small_study(experiments={"campaign": "."}).written()
    content["experiments"]["campaign"] = "."
    path.write_text(json.dumps(content))
    return path


def refuse(word):
    raise AssertionError(word)


def summary_of(folder):
    return json.loads((folder / "summary.json").read_text(), parse_constant=refuse)


def test_diagnose_and_improve_from_the_command_line(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("hsed_jax.study.own_parts.EFFECTS", few())
    assert main(["diagnose", str(folder), "--output", str(tmp_path / "run")]) == 0, capsys.readouterr().err
    summary = summary_of(tmp_path / "run")
    assert summary["status"] == "complete" and summary.keys() >= {"calibration", "comparison", "diagnosis"}
    assert summary["diagnosis"]["verdict"] == "missing_effects"
    assert summary["diagnosis"]["effects"] == ["viscous_damping"]
    assert "improvement" not in summary and not (tmp_path / "run" / "improved.yaml").exists()
    assert "missing is viscous_damping" in capsys.readouterr().out


@pytest.mark.slow
def test_a_chosen_effect_is_added_from_the_command_line(folder, tmp_path, capsys):
    words = ["improve", str(folder), "--add", "viscous_damping", "--output", str(tmp_path / "run")]
    assert main(words) == 0, capsys.readouterr().err
    summary = summary_of(tmp_path / "run")
    steps = summary["improvement"]["steps"]
    assert [step["effects"] for step in steps] == [[], ["viscous_damping"]]
    assert steps[1]["error_train"] == pytest.approx(summary["improvement"]["noise_floor"], rel=0.15)
    assert steps[0]["error_train"] > 2 * steps[1]["error_train"]
    improved = tmp_path / "run" / "improved.yaml"
    assert str(improved) in capsys.readouterr().out
    study = hx.load_study(improved)
    assert list(study.model.effects) == ["viscous_damping"] and study.improve.add is None


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ("diagnose", "put calibrate, compare before"),
        ("improve", "put calibrate, compare before"),
        ("calibrate, diagnose", "put calibrate, compare before"),
        ("calibrate, compare, improve", "improve needs diagnose before it, or improve.add"),
        ("calibrate, diagnose, compare", "the order is"),
    ],
)
def test_steps_that_lack_what_they_need_are_the_users_to_mend(folder, tmp_path, capsys, steps, words):
    assert main(["run", str(folder), f"steps=[{steps}]", "--output", str(tmp_path / "run")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and str(folder) in line and words in line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("effect", "words"),
    [("viscos_damping", "there is no effect 'viscos_damping'"), ("hardening", "has hardening already")],
)
def test_an_effect_that_cannot_be_added_is_refused_before_anything_is_computed(
    folder, tmp_path, capsys, monkeypatch, effect, words
):
    monkeypatch.setattr("hsed_jax.runs.workflow.calibrate_built", lambda *_, **__: pytest.fail("calibrated"))
    more = ["model.effects={hardening: {}}"]
    assert main(["improve", str(folder), *more, "--add", effect, "--output", str(tmp_path / "run")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and words in line
    assert not (tmp_path / "run").exists()


def test_what_becomes_of_a_study_with_a_chosen_effect_is_a_valid_study(campaign):
    steps = ["calibrate", "compare", "improve"]
    chosen = Built(small_study(steps=steps, improve={"add": ["hardening"]}), campaign)
    chosen.check()
    Built(with_effects(chosen, ["hardening"]), campaign).check()


@pytest.mark.slow
def test_the_whole_sentence_on_the_command_line(folder, tmp_path, capsys):
    assert main(["improve", str(folder), "--output", str(tmp_path / "run")]) == 0, capsys.readouterr().err
    summary = summary_of(tmp_path / "run")
    # A fluid damper whose exponent is nearly one is a dashpot, too, and takes up what the interpolated rate lacks.
    (name,) = summary["diagnosis"]["effects"]
    assert name in ("viscous_damping", "power_damping")
    last = summary["improvement"]["steps"][-1]
    assert last["effects"] == [name]
    assert last["error_train"] == pytest.approx(summary["improvement"]["noise_floor"], rel=0.15)
    improved = tmp_path / "run" / "improved.yaml"
    assert main(["diagnose", str(improved), "--output", str(tmp_path / "again")]) == 0, capsys.readouterr().err
    assert summary_of(tmp_path / "again")["diagnosis"]["effects"] == []
