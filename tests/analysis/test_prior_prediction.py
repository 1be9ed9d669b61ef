"""Prior prediction: data that no draw of the priors explains are named, with where, and data within them are not."""

import numpy as np
import pytest
from builders.springs import BETA, NOISE, A, spring_campaign, spring_study

from hsed_jax.analysis.prior_prediction import DRAWS, prior_reach, prior_sentences
from hsed_jax.command_line import main
from hsed_jax.measurements import write_campaign
from hsed_jax.plain import dump_yaml
from hsed_jax.study.build import Built

WEAK = {"A": {"uniform": [0.05 * A, 0.15 * A]}, "beta": BETA, "gamma": 0.0, "n": 1.0}


def reached(model=None):
    campaign = spring_campaign(0.0)
    study = spring_study(**({} if model is None else {"model": {"parameters": model}}))
    built = Built(study, campaign)
    return built, campaign, *prior_reach(built.inference, campaign)


@pytest.fixture(scope="module")
def weak():
    return reached(WEAK)


@pytest.mark.whole
def test_data_of_the_model_itself_are_within_its_priors():
    built, campaign, found, converged = reached()
    assert converged == DRAWS
    assert [(reach.experiment, reach.output) for reach in found] == [(f"E0{n}", "force") for n in range(1, 5)]
    assert not any(reach.is_outside for reach in found)
    assert prior_sentences(built.inference, campaign) == [
        "E01, E02, E03, E04: the measured force is within the predictions of the priors"
    ]


@pytest.mark.whole
def test_a_specimen_that_is_too_strong_for_the_priors_is_said_to_be(weak):
    _, campaign, found, _ = weak
    # The strength of a Bouc–Wen spring is A/β at most, however it is driven.
    strength = 0.15 * A / BETA
    for reach, experiment in zip(found, campaign, strict=True):
        force = experiment.record["force"]
        beyond = np.maximum(np.abs(force) - strength - 3 * NOISE, 0.0)
        least = np.sqrt(np.mean(beyond**2)) / np.std(force)
        assert least > 0.3  # the case is one
        assert least <= reach.error < 1.2
        assert reach.is_outside and -strength <= reach.low <= reach.high <= strength
        worst = np.argmin(np.abs(experiment.record.time - reach.time))
        assert reach.measured == pytest.approx(force[worst])
        assert abs(force[worst]) > 0.9 * np.max(np.abs(force))


@pytest.mark.whole
def test_no_simulation_within_the_priors_is_closer_than_is_said(weak):
    _, campaign, found, _ = weak
    for reach, experiment in zip(found, campaign, strict=True):
        force, time = experiment.record["force"], experiment.record.time
        dense = np.linspace(time[0], time[-1], 50 * (time.size - 1) + 1)
        moved = np.diff(np.interp(dense, time, experiment.record["elongation"]))
        for a in np.linspace(0.05 * A, 0.15 * A, 5):
            z = np.zeros(dense.size)
            for k, du in enumerate(moved):
                limit = np.sign(du) * a / BETA
                z[k + 1] = limit + (z[k] - limit) * np.exp(-BETA * abs(du))
            assert np.sqrt(np.mean((z[::50] - force) ** 2)) / np.std(force) > reach.error


@pytest.mark.whole
def test_check_says_it_in_one_sentence_each(tmp_path, capsys):
    write_campaign(spring_campaign(0.0), tmp_path / "springs")
    content = spring_study().written() | {"experiments": {"campaign": "springs"}}
    content["model"] = {"spring": "bouc_wen", "parameters": WEAK}
    (tmp_path / "study.yaml").write_text(dump_yaml(content), encoding="utf-8")
    assert main(["check", str(tmp_path / "study.yaml")]) == 0
    assert "prior prediction" not in capsys.readouterr().out
    assert main(["check", str(tmp_path / "study.yaml"), "--predict"]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("prior prediction: ")]
    assert len(said) == 4
    assert "E01: the model cannot produce the measured force with these priors" in said[0]
    assert " kN, predicted " in said[0] and "% of its samples, most at " in said[0]


def test_a_planned_study_has_nothing_to_compare_with(tmp_path, capsys):
    assert main(["check", "configs/paper.yaml", "--predict"]) == 2
    assert "experiments.campaign" in capsys.readouterr().err
