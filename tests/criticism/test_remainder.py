"""The remainder of a model: features of a path by hand, and a known residual, learned on some cycles, that holds on others."""

import numpy as np
import pytest
from builders.records import loop
from numpy.testing import assert_allclose

from hsed_jax.criticism.prediction import Prediction
from hsed_jax.criticism.remainder import can_be_learned, path_features, remainder_of
from hsed_jax.errors import UserError
from hsed_jax.measurements import Experiment, Record

SAMPLES, NOISE = 60, 100.0
CYCLES = (2, 2, 2, 4, 4, 4, 8, 8, 8, 12, 12, 12)


def prediction_of(residual, elongation, used, noise=NOISE) -> Prediction:
    """A model that leaves a residual of a force, in one test."""
    row = np.zeros((1, elongation.size))
    record = Record(np.arange(elongation.size, dtype=float), {"elongation": elongation, "force": residual})
    return Prediction(
        outputs=("force",),
        groups=np.zeros(elongation.size, dtype=int),
        experiments=(Experiment("E01", record=record),),
        measured=residual[None],
        used=used[None],
        predicted=row,
        mean=row,
        sd=np.full_like(row, 5e3),
        sigma=np.full_like(row, noise),
        converged=np.asarray([True]),
        parts={"noise": np.full_like(row, noise), "parameters": row, "model": np.full_like(row, 5e3)},
    )


@pytest.fixture(scope="module")
def cycles():
    """A pinched residual that grows with the largest elongation so far, in growing cycles, three of each amplitude."""
    data = loop(cycles=CYCLES, samples=SAMPLES)
    u, largest = data["elongation"], np.maximum.accumulate(np.abs(data["elongation"]))
    away = np.sign(np.gradient(u))
    residual = -2e3 * away * np.exp(-((u / np.maximum(0.3 * largest, 1e-9)) ** 2)) * largest / 12e-3
    return u, residual, np.arange(u.size) // SAMPLES


def test_features_of_a_path_by_hand():
    u = np.asarray([0.0, 1.0, 2.0, 1.0, -1.0, -2.0, 0.0, 3.0])
    found = path_features(u)
    assert_allclose(found[:, 0], u)
    assert_allclose(found[:, 1], [1, 1, 1, -1, -1, -1, 1, 1])
    assert_allclose(found[:, 2], [0, 0, 0, 2, 2, 2, -2, -2])
    assert_allclose(found[:, 3], [0, 0, 0, 0, 0, 0, 2, 2])
    assert_allclose(found[:, 4], [0, 1, 2, 2, 2, 2, 2, 3])
    assert_allclose(found[:, 5], [0, 0, 0, 0, -1, -2, -2, -2])
    assert_allclose(found[:, 6], [0, 1, 2, 3, 5, 6, 8, 11])


@pytest.mark.parametrize("seed", range(3))
def test_cycles_that_were_left_out_are_predicted_within_the_band(cycles, seed):
    u, residual, number = cycles
    measured = residual + NOISE * np.random.default_rng(seed).normal(size=u.size)
    left_out = number % 3 == 2
    remainder = remainder_of(prediction_of(measured, u, ~left_out), True)
    found = remainder.corrected(prediction_of(measured, u, left_out))
    wrong = (found.mean[0] - residual)[left_out]
    # A residual of a hundred times the variance of the noise; what is left is about the noise.
    assert np.sqrt(np.mean(wrong**2)) < 0.2 * np.sqrt(np.mean(residual[left_out] ** 2))
    inside = np.abs(found.mean[0] - measured)[left_out] < 1.645 * found.sd[0, left_out]
    assert 0.85 < inside.mean() <= 1.0
    assert_allclose(found.predicted, found.mean)
    assert_allclose(sum(part**2 for part in found.parts.values()), found.sd**2)
    assert_allclose(found.without.mean, 0.0)
    assert_allclose(found.without.sd, np.hypot(5e3, NOISE))


def test_an_error_that_nobody_declared_is_no_noise_of_the_remainder(cycles):
    u, residual, number = cycles
    measured = residual + NOISE * np.random.default_rng(0).normal(size=u.size)
    left_out = number % 3 == 2
    inferred = 1.1e3  # from the residual itself
    remainder = remainder_of(prediction_of(measured, u, ~left_out, inferred), False)
    found = remainder.corrected(prediction_of(measured, u, left_out, inferred))
    assert np.median(found.parts["noise"][0, left_out]) == pytest.approx(NOISE, rel=0.5)
    assert np.median(found.sd[0, left_out]) < 0.3 * inferred
    assert (np.abs(found.mean[0] - measured)[left_out] < 1.645 * found.sd[0, left_out]).mean() > 0.85


def test_a_friction_that_changes_its_sign_at_every_turn_is_learned_up_to_the_turns():
    amplitudes = np.repeat([20, 30, 40, 25, 35], 100) * 1e-3  # two cycles of each, whose peaks are between two samples
    u = amplitudes * np.sin(np.pi * 0.04 * np.arange(amplitudes.size))
    friction = 1.5e4 * (u / 0.04) ** 2 * np.sign(np.cos(np.pi * 0.04 * np.arange(u.size)))
    held = np.arange(u.size) >= 300
    found = remainder_of(prediction_of(friction, u, ~held), True).corrected(prediction_of(friction, u, held))
    wrong = (found.mean[0] - friction)[held]
    assert np.sqrt(np.mean(wrong**2)) < 0.15 * np.sqrt(np.mean(friction[held] ** 2))


def test_far_from_the_fitted_paths_the_band_holds_the_residual(cycles):
    u, residual, number = cycles
    measured = residual + NOISE * np.random.default_rng(0).normal(size=u.size)
    is_larger = number >= 9
    found = remainder_of(prediction_of(measured, u, ~is_larger), True).corrected(prediction_of(measured, u, is_larger))
    before, after = (np.sqrt(np.mean(x[is_larger] ** 2)) for x in (residual, found.mean[0] - residual))
    assert after < 1.1 * before
    assert np.median(found.sd[0, is_larger]) > 2 * np.median(found.sd[0, ~is_larger])
    assert (np.abs(found.mean[0] - measured)[is_larger] < 1.645 * found.sd[0, is_larger]).mean() > 0.7


def test_of_noise_nothing_is_learned(cycles):
    u, _, number = cycles
    noise = NOISE * np.random.default_rng(1).normal(size=u.size)
    left_out = number % 3 == 2
    found = remainder_of(prediction_of(noise, u, ~left_out), True).corrected(prediction_of(noise, u, left_out))
    assert np.sqrt(np.mean(found.mean[0, left_out] ** 2)) < 0.35 * NOISE


def test_the_same_cycles_with_a_noisy_elongation(cycles):
    u, residual, number = cycles
    random = np.random.default_rng(2)
    measured, noisy = residual + NOISE * random.normal(size=u.size), u + 1e-5 * random.normal(size=u.size)
    left_out = number % 3 == 2
    found = remainder_of(prediction_of(measured, noisy, ~left_out), True).corrected(
        prediction_of(measured, noisy, left_out)
    )
    wrong = (found.mean[0] - residual)[left_out]
    assert np.sqrt(np.mean(wrong**2)) < 0.25 * np.sqrt(np.mean(residual[left_out] ** 2))


def test_without_an_elongation_or_with_few_samples_it_is_refused(cycles):
    u, residual, _ = cycles
    with pytest.raises(UserError, match="at least 20 fitted samples of one force whose elongation was recorded"):
        remainder_of(prediction_of(residual, u, np.arange(u.size) < 10), True)
    unknown = prediction_of(residual, u, np.ones(u.size, dtype=bool))
    record = Record(np.arange(u.size, dtype=float), {"force": residual})
    unknown = Prediction(**{**vars(unknown), "experiments": (Experiment("E01", record=record),)})
    assert not can_be_learned(unknown)
    with pytest.raises(UserError, match="whose elongation was recorded without gaps"):
        remainder_of(unknown, True)
