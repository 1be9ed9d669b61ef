"""The package as a notebook uses it: from a file to a fit, its draws, a run that is read back, the catalogue."""

from typing import ClassVar

import arviz as az
import numpy as np
import pandas as pd
import pytest

import hsed_jax as hx
from hsed_jax.physics.effects import EFFECTS, AbstractSpringEffect

STIFFNESS, NOISE = 2.0e6, 400.0


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A cyclic test of a linear spring, as a laboratory leaves it."""
    time = np.arange(0.0, 40.0, 0.1)
    elongation = 1e-3 * (1 + time / 10) * np.sin(time)
    force = STIFFNESS * elongation + np.random.default_rng(0).normal(0, NOISE, time.size)
    path = tmp_path_factory.mktemp("laboratory") / "spring.csv"
    pd.DataFrame({"t (s)": time, "elongation (mm)": 1e3 * elongation, "force (kN)": force / 1e3}).to_csv(
        path, index=False
    )
    return path


@pytest.fixture(scope="module")
def campaign(file):
    return hx.read_files(file)


@pytest.fixture(scope="module")
def study(campaign):
    model = {"spring": "elastic", "parameters": {"k": {"lognormal": [14.0, 1.0]}}}
    keys = {"study": "spring", "model": model, "experiments": {"campaign": "."}, "observe": "histories"}
    return hx.Study(**keys, calibration={"sampler": "laplace", "starts": 2}, steps=["calibrate"])


@pytest.fixture(scope="module")
def fit(study, campaign):
    return hx.calibrate(study, campaign)


def test_a_file_is_a_campaign_of_a_fitted_and_a_held_out_part(campaign, file):
    table = pd.read_csv(file)
    assert (len(campaign.train), len(campaign.test)) == (1, 1)
    np.testing.assert_allclose(campaign.experiments[0].record["force"], 1e3 * table["force (kN)"], rtol=1e-12)
    with pytest.raises(hx.UserError, match="column"):
        hx.read_files(file, elongation="drift")


def test_a_fit_has_the_map_of_least_squares(fit, campaign):
    (experiment,) = campaign.train
    begin, end = experiment.window
    part = (experiment.record.time >= begin) & (experiment.record.time <= end)
    u, f = experiment.record["elongation"][part], experiment.record["force"][part]
    # The prior is a thousandth of the information of the data.
    assert fit.map["k"] == pytest.approx(u @ f / (u @ u), rel=1e-3)


def test_the_posterior_is_a_tree_that_arviz_reads(fit):
    assert list(fit.posterior.children) == ["posterior", "sample_stats"]
    draws = fit.posterior["posterior"]["k"]
    assert draws.dims == ("chain", "draw") and draws.attrs["units"] == "N/m"
    summary = az.summary(fit.posterior, var_names=["k"])
    assert float(summary.loc["k", "mean"]) == pytest.approx(fit.map["k"], rel=5e-3)


def test_a_fit_predicts_its_own_campaign_or_another(fit, campaign):
    whole = fit.predict()
    assert [e.id for e in whole.experiments] == [e.id for e in campaign.completed]
    np.testing.assert_array_equal(fit.predict(campaign.test).predicted, fit.test.predicted)
    u = campaign.experiments[0].record["elongation"]
    np.testing.assert_allclose(whole.histories(0, "force")[1], fit.map["k"] * u, atol=1e-6 * STIFFNESS)


def test_a_first_study_is_a_study_and_its_file_says_the_same(campaign, tmp_path):
    study = hx.initial_study(campaign, tmp_path / "study.yaml")
    assert isinstance(study, hx.Study) and study.file == str(tmp_path / "study.yaml")
    assert "# initial stiffness" in (tmp_path / "study.yaml").read_text()
    in_memory = hx.initial_study(campaign)
    assert in_memory.model == study.model and in_memory.steps == study.steps
    (prior,) = study.model.parameters["A"].values()
    # The median of the prior is the stiffness that the record shows.
    assert np.exp(prior[0]) == pytest.approx(STIFFNESS, rel=0.1)


def test_a_run_is_read_back(study, campaign, fit, tmp_path):
    folder = tmp_path / "spring"
    hx.write_campaign(campaign, folder)
    keys = study.model_dump(exclude_none=True, by_alias=True) | {"experiments": {"campaign": str(folder)}}
    hx.run(hx.Study(**keys), tmp_path / "run", progress=False, figures=False)
    run = hx.read_run(tmp_path / "run")
    assert run.summary["calibration"]["map"] == pytest.approx(fit.map, rel=1e-9)
    np.testing.assert_allclose(run.results["posterior"]["k"], fit.posterior["posterior"]["k"], rtol=1e-9)
    assert repr(run).startswith(f"run spring in {tmp_path / 'run'}: complete")
    with pytest.raises(hx.UserError, match="not a run folder"):
        hx.read_run(tmp_path / "spring")


def test_the_catalogue_is_a_table():
    table = hx.effects()
    assert list(table.index) == sorted(EFFECTS)
    assert table.loc["slip", "family"] == "pinching" and table.notna().all().all()


def test_an_effect_of_your_own_stands_in_the_table_of_its_study(study):
    @hx.register
    class Mine(AbstractSpringEffect):
        """A force of my own."""

        name: ClassVar[str] = "mine"
        family: ClassVar[str] = "elastic"
        reference: ClassVar[str] = "nobody"

    assert set(hx.effects(study.with_own_effects(Mine)).index) == {*EFFECTS, "mine"}
    assert "mine" not in hx.effects().index
