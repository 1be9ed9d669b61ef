"""What no effect of the catalogue is, end to end: campaigns of another program, with a term that is unlisted and with none."""

import json
from unittest.mock import Mock

import numpy as np
import pytest
import xarray as xr
from hidden import campaigns, cases, unlisted

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.diagnosis.findings import Diagnosis

pytestmark = pytest.mark.slow
STEPS = "steps=[calibrate, compare, diagnose, discover, improve]"


@pytest.fixture(scope="module")
def wedge(tmp_path_factory):
    """The run of a campaign whose specimen rubs the more the further it is pulled."""
    place = tmp_path_factory.mktemp("wedge")
    unlisted.make(unlisted.Case("friction_of_position", 902), place / "campaign", place / "truth.json")
    words = ["run", str(place / "campaign/study.yaml"), STEPS, "calibration.sampler=laplace"]
    assert main([*words, "--output", str(place / "run")]) == 0
    return place / "run"


@pytest.fixture(scope="module")
def found(wedge):
    return json.loads((wedge / "summary.json").read_text())


def test_friction_that_depends_on_the_position_is_found_where_it_is(found):
    learned = found["discovery"]
    assert learned["found"], learned["reason"]
    place = unlisted.Place(learned["place"]["slot"], frozenset(learned["place"]["of"]))
    assert place in unlisted.TERMS["friction_of_position"].right
    assert learned["ranking"][0]["place"] == learned["place"]
    assert learned["probability"] == pytest.approx(learned["ranking"][0]["probability"])


def test_what_was_not_used_is_predicted_almost_to_the_noise(found):
    floor = found["comparison"]["test"]["noise_floor"]
    assert found["comparison"]["test"]["error"] > 2 * floor
    assert found["discovery"]["error_test"] < 1.5 * floor
    # Calibrated again it does what was promised.
    last = found["improvement"]["steps"][-1]
    assert last["error_test"] < 1.5 * floor
    assert last["effects"][-1] == "learned_effect"


def test_the_learned_friction_is_the_true_one(wedge):
    lines = xr.open_datatree(wedge / "results.nc")["discovery"].to_dataset()
    true = unlisted.TERMS["friction_of_position"].value
    # Half of what lies between the directions: what the law or a spring beside it could not do.
    rubbed = 0.5 * (lines["mean"].values[1] - lines["mean"].values[0])
    expected = true(lines["x"].values[0], 1.0)
    # Of a constant friction the law can take some.
    apart = (rubbed - rubbed.mean()) - (expected - expected.mean())
    assert np.sqrt(np.mean(apart**2)) < 0.1 * np.ptp(expected)


def test_the_effect_that_was_learned_is_a_study_to_go_on_with(wedge, capsys):
    assert (wedge / "learned_effect.py").is_file()
    assert main(["check", str(wedge / "improved.yaml"), "--trust"]) == 0, capsys.readouterr().err
    study = hx.load_study(wedge / "improved.yaml")
    assert list(study.model.effects) == ["learned_effect"]
    assert [(wedge / name).resolve() for name in study.model.own_effects] == [(wedge / "learned_effect.py").resolve()]


@pytest.mark.parametrize("is_forced", [False, True], ids=["by its diagnosis", "by the search itself"])
def test_where_nothing_is_missing_nothing_is_learned(tmp_path, is_forced):
    case = cases.Case("component", (), 0.0, unlisted.NOISE, 6, 4, 3)
    campaigns.make(case, tmp_path / "campaign", tmp_path / "truth.json")
    study = hx.load_study(tmp_path / "campaign/study.yaml", ["calibration.sampler=laplace"])
    fit = hx.calibrate(study, hx.read_campaign(tmp_path / "campaign"))
    # As if the catalogue had had its turn in vain.
    diagnosis = Mock(Diagnosis, verdict="unexplained", effects=[], forms={}) if is_forced else None
    learned = hx.discover(fit, diagnosis=diagnosis)
    assert not learned.found
    assert learned.reason == "the noise explains the residual" or is_forced
    # The search was made where it was asked for, and said no by itself.
    assert bool(learned.ranking) == is_forced
    assert not learned.source and learned.place is None
