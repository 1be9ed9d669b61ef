"""A run of a component test whose model leaves more than noise: the remainder is learned, kept, and shown."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from builders.records import loop

import hsed_jax as hx
from hsed_jax.analysis.remainder import has_remainder
from hsed_jax.measurements import Campaign

SAMPLES = 60
pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def campaign():
    """A specimen that yields, in growing cycles, three of each amplitude; every third cycle is held out."""
    record = loop(cycles=(4, 4, 4, 8, 8, 8, 12, 12, 12), samples=SAMPLES, noise=1.0)
    return Campaign.from_frames(
        [
            {"id": f"C{k + 1}", "split": "test" if k % 3 == 2 else "train", "from": SAMPLES * k, "to": SAMPLES * (k + 1) - 1}
            for k in range(9)
        ],
        records={f"C{k + 1}": record for k in range(9)},
        protocol="displacement",
        channels={"elongation": "m", "force": "N"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def study():
    """An elastic model, and an effect that it needs least."""
    return hx.load_study(
        {"study": "rest", "model": {"spring": "elastic", "parameters": {"k": {"uniform": [1e5, 1e8]}}},
         "experiments": {"campaign": "."}, "observe": "histories", "channels": ["force"],
         "error": {"relative": 0.01, "inflate": True}, "calibration": {"sampler": "laplace", "starts": 1},
         "steps": ["calibrate", "compare", "improve"], "improve": {"add": ["cubic_stiffness"]}}
    )  # fmt: skip


def test_a_run_keeps_and_shows_the_remainder(campaign, study, tmp_path):
    hx.write_campaign(campaign, tmp_path / "campaign")
    of_files = study.model_copy(
        update={"experiments": study.experiments.model_copy(update={"campaign": str(tmp_path / "campaign")})}
    )
    done = hx.run(of_files, tmp_path / "run", progress=False)
    content = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    found = content["improvement"]["remainder"]
    plain, corrected = content["improvement"]["comparison"]["test"]["error"], found["comparison"]["test"]["error"]
    # An elastic model of a specimen that yields; its rest is the same function of the path in the third cycle of an amplitude.
    assert plain > 0.2 and corrected < 0.2 * plain and found["helps"]
    assert f"goes from {plain:.3f} to {corrected:.3f}" in found["sentence"]
    assert 0.85 < found["comparison"]["test"]["per_output"]["force"]["coverage_90"] <= 1.0
    with xr.open_datatree(tmp_path / "run" / "results.nc", engine="h5netcdf") as tree:
        test = tree["predictions_with_remainder/test/C3"]
        error = test["force_predicted"].values - test["force_measured"].values
        assert np.sqrt(np.nanmean(error**2)) < 0.3 * np.nanstd(test["force_measured"].values)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert (
        '<th scope="row">with the remainder</th>' in page
        and "What the model leaves, learned from the fitted rows" in page
    )
    assert str(done.remainder).startswith(found["sentence"])


def test_a_remainder_predicts_in_python_and_is_refused_where_there_is_none(campaign, study):
    fit = hx.calibrate(study, campaign)
    learned = hx.learn_remainder(fit)
    assert learned.helps and learned.predict(campaign.test).mean.shape == fit.test.mean.shape
    np.testing.assert_allclose(learned.predict(campaign.test).mean, learned.remainder.corrected(fit.test).mean)
    alone = hx.learn_remainder(hx.calibrate(study, campaign.train))
    assert not alone.helps and "no experiment was held out to judge it" in str(alone)
    quantities = hx.load_study({**study.written(), "observe": "quantities", "quantities": ["peak_force"]})
    with pytest.raises(hx.UserError, match="the history of a force"):
        hx.learn_remainder(hx.calibrate(quantities, campaign))
    few = replace(campaign, experiments=tuple(replace(e, window=(0.0, 9.0)) for e in campaign.train.experiments[:1]))
    assert not has_remainder(hx.calibrate(study, few))  # a run of so few samples learns none, and goes on
