"""What an error is expected from, where nobody declares the noise: what the record shows is noise, the rest is the model's."""

from dataclasses import replace

import numpy as np
import pytest

import hsed_jax as hx
from hsed_jax.criticism.prediction import noise_sizes
from hsed_jax.measurements import Campaign
from hsed_jax.reporting.band_figures import band_parts, nested

NOISE = 200.0  # N
SAMPLES = 400


@pytest.fixture(scope="module")
def calibration():
    """An elastic model of a spring that yields, at rest for the first quarter of each record."""
    random, records = np.random.default_rng(0), {}
    for id, size in (("E01", 0.02), ("E02", 0.015)):
        time = np.linspace(0.0, 8.0, SAMPLES)
        elongation = size * np.where(time > 2, np.sin(2 * np.pi * (time - 2) / 2), 0.0)
        force = 2e4 * np.tanh(elongation / 5e-3) + NOISE * random.normal(size=SAMPLES)
        records[id] = {"time": time, "elongation": elongation, "force": force}
    campaign = Campaign.from_frames(
        [{"id": "E01"}, {"id": "E02", "split": "test"}],
        records=records,
        protocol="displacement",
        channels={"time": "s", "elongation": "m", "force": "N"},
    )
    study = hx.load_study(
        {"study": "expected", "model": {"spring": "elastic", "parameters": {"k": {"uniform": [1e5, 1e7]}}},
         "experiments": {"campaign": "."}, "observe": "histories", "error": {"inflate": True},
         "calibration": {"sampler": "laplace", "starts": 1}}
    )  # fmt: skip
    return hx.calibrate(study, campaign)


@pytest.mark.whole
def test_the_parts_of_an_error_are_noise_parameters_and_model_and_add_up_to_it(calibration):
    comparison = hx.compare(calibration)
    for split, experiment in ((comparison.train, "E01"), (comparison.test, "E02")):
        scale = np.std(calibration.campaign[experiment].record["force"])
        assert split.noise_floor == pytest.approx(NOISE / scale, rel=0.15)
        parts = {"noise": split.noise_floor, **split.parts}
        assert parts.keys() == {"noise", "parameters", "model"}
        assert parts["model"] > 10 * parts["noise"]
        assert np.sqrt(sum(part**2 for part in parts.values())) == pytest.approx(split.error, rel=0.35)
    said = comparison.train.attributed
    assert said and "model 0.000" not in said


@pytest.mark.whole
def test_before_the_motion_starts_the_band_is_the_models_and_not_noise(calibration):
    prediction = calibration.train
    still = slice(0, SAMPLES // 4)
    assert prediction.parts["noise"][0, still] == pytest.approx(NOISE, rel=0.15)
    np.testing.assert_allclose(sum(part**2 for part in prediction.parts.values()), prediction.sd**2, rtol=1e-6)
    bands = nested(prediction)
    assert [*bands] == ["parameters", "model", "noise"]
    assert bands["model"][0, still] == pytest.approx(bands["noise"][0, still], rel=0.05)
    texts = [
        text.get_text() for text in band_parts(hx.compare(calibration), calibration.campaign).figure.legends[0].texts
    ]
    assert {"parameters", "and model", "and noise"} <= {*texts}


@pytest.mark.whole
def test_of_a_record_too_coarse_to_tell_the_noise_no_more_is_noise_than_is_left(calibration):
    random = np.random.default_rng(1)
    coarse = replace(calibration.train, measured=1e5 * random.normal(size=calibration.train.measured.shape))
    assert (noise_sizes(coarse, "force", declared=False) <= coarse.sigma).all()
