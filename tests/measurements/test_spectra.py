"""The response spectrum against closed forms and SciPy's simulation of the same oscillator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from observations import relative
from scipy.signal import lsim

from hsed_jax.physics.spectra import response_spectrum

PERIODS = np.array([0.05, 0.2, 0.5, 1.0, 2.0, 5.0])


def noise_motion(m=600, step=0.01, seed=0):
    """A motion with energy at all periods of interest, zero at both ends."""
    rng = np.random.default_rng(seed)
    time = step * np.arange(m)
    waves = sum(rng.normal() * np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in np.geomspace(0.2, 15, 25))
    return np.sin(np.pi * time / time[-1]) * waves


def peak_by_lsim(acceleration, step, period, damping, per_step):
    omega = 2 * np.pi / period
    time = step * np.arange(acceleration.size)
    fine = np.linspace(0, time[-1], per_step * (acceleration.size - 1) + 1)
    oscillator = ([[0, 1], [-(omega**2), -2 * damping * omega]], [[0], [-1]], [[omega**2, 0]], [[0]])
    _, y, _ = lsim(oscillator, np.interp(fine, time, acceleration), fine)
    return np.abs(y).max()


@pytest.mark.verification("dynamics")
@pytest.mark.parametrize("damping", [0.0, 0.05, 0.7])
def test_it_is_the_exact_solution_for_a_piecewise_linear_motion(damping, observed):
    motion, step = noise_motion(), 0.01
    expected = [peak_by_lsim(motion, step, period, damping, per_step=4) for period in PERIODS]
    found = response_spectrum(motion, step, PERIODS, damping)
    observed("response spectrum of a sampled motion", "SciPy lsim", relative(found, expected), 1e-9)


def test_peaks_between_the_samples_are_seen():
    motion, step = noise_motion(), 0.01
    expected = [peak_by_lsim(motion, step, period, 0.05, per_step=64) for period in PERIODS]
    np.testing.assert_allclose(response_spectrum(motion, step, PERIODS), expected, rtol=0.02)


@pytest.mark.verification("dynamics")
def test_a_suddenly_applied_constant_load(observed):
    """y = −a (1 − e^{−ζωt}(…)), whose first peak is a (1 + e^{−ζπ/√(1−ζ²)})."""
    damping, load = 0.1, 3.0
    step, periods = 1e-3, np.array([0.5, 1.0, 2.0])
    expected = load * (1 + np.exp(-damping * np.pi / np.sqrt(1 - damping**2)))
    spectrum = response_spectrum(np.full(4000, load), step, periods, damping)
    observed("response spectrum of a sudden load", "closed form of the peak", relative(spectrum, expected), 1e-5)


@pytest.mark.verification("dynamics")
@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_the_steady_state_of_a_harmonic_load(ratio, observed):
    """|y| = a / √((1−ρ²)² + (2ζρ)²), ρ = T/T_load; the amplitude grows in slowly, so that no transient exceeds it."""
    damping, load_period = 0.05, 1.0
    time = 0.005 * np.arange(24_000)
    motion = np.sin(np.pi / 2 * np.clip(time / 60, 0, 1)) ** 2 * np.sin(2 * np.pi * time / load_period)
    expected = 1 / np.hypot(1 - ratio**2, 2 * damping * ratio)
    spectrum = response_spectrum(motion, 0.005, np.array([ratio * load_period]), damping)
    observed("response spectrum of a harmonic load", "steady state", relative(spectrum, expected), 2e-3)


def test_a_rigid_oscillator_moves_with_the_ground():
    motion = noise_motion()
    peak = np.abs(motion).max()
    spectrum = response_spectrum(motion, 0.01, np.array([0.0, 1e-5, 1e-3]))
    np.testing.assert_allclose(spectrum, peak, rtol=1e-2)
    assert spectrum[0] == peak


@pytest.mark.verification("dynamics")
def test_a_very_soft_oscillator_stays_where_it_is(observed):
    """Its elongation is the ground's displacement."""
    motion, step, period = noise_motion(), 0.01, 1e4
    velocity = np.concatenate([[0], np.cumsum((motion[1:] + motion[:-1]) * step / 2)])
    displacement = np.concatenate([[0], np.cumsum(velocity[:-1] * step + step**2 * (2 * motion[:-1] + motion[1:]) / 6)])
    expected = (2 * np.pi / period) ** 2 * np.abs(displacement).max()
    found = response_spectrum(motion, step, np.array([period]), 0.05)
    observed("response spectrum at a long period", "displacement of the ground", relative(found, expected), 5e-3)


def test_a_batch_of_motions_is_the_motions_one_by_one():
    motions = np.stack([noise_motion(seed=seed) for seed in range(3)])
    batch = jax.vmap(response_spectrum, (0, None, None))(jnp.asarray(motions), 0.01, PERIODS)
    assert batch.shape == (3, PERIODS.size)
    for motion, spectrum in zip(motions, batch, strict=True):
        np.testing.assert_allclose(response_spectrum(motion, 0.01, PERIODS), spectrum, rtol=1e-12)


def test_it_scales_with_the_motion_and_is_differentiable():
    motion = jnp.asarray(noise_motion())
    spectrum = response_spectrum(motion, 0.01, PERIODS)
    slope = jax.jacfwd(lambda scale: response_spectrum(scale * motion, 0.01, PERIODS))(2.0)
    np.testing.assert_allclose(slope, spectrum, rtol=1e-10)
    np.testing.assert_allclose(response_spectrum(-2 * motion, 0.01, PERIODS), 2 * spectrum, rtol=1e-12)
