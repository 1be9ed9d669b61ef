"""Excitations against their formulas in NumPy, and their forcings against direct evaluation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from observations import of_largest
from scipy.integrate import quad

from hsed_jax.measurements import read_at2
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.excitations.recorded import RecordedMotion

PULSES = [
    dict(V_P=2.25, T_P=1.0),
    dict(V_P=3.0, T_P=0.5),
    dict(V_P=1.5, T_P=1.5, gamma=1.4, nu=0.7),
    dict(V_P=2.0, T_P=0.8, gamma=3.3, nu=-1.9),
]


def velocity(t, V_P, T_P, gamma=2.0, nu=0.1):
    """Eqs. 16 and 17, written down once more."""
    tau = (t - gamma * T_P / 2) / T_P
    D_r = V_P * T_P * (np.sin(nu + gamma * np.pi) - np.sin(nu - gamma * np.pi)) / (4 * np.pi * (1 - gamma**2))
    v = (V_P / 2 * np.cos(2 * np.pi * tau + nu) - D_r / (gamma * T_P)) * (1 + np.cos(2 * np.pi * tau / gamma))
    return np.where(np.abs(tau) <= gamma / 2, v, 0.0)


def along(function, times):
    """A function of time at many."""
    return np.asarray(jax.jit(jax.vmap(function))(times))


def sampled(forcing, steps):
    """All samples of a forcing, as the integrator asks for them."""
    carry, first = forcing.start()
    _, rest = jax.lax.scan(lambda c, i: forcing.advance(c, i), carry, np.arange(1, 2 * steps + 1))
    return np.concatenate([np.atleast_1d(first), np.asarray(rest)])


@pytest.mark.verification("dynamics")
@pytest.mark.parametrize("inputs", PULSES)
def test_pulse_velocity_is_equation_16(inputs, observed):
    t = np.linspace(-0.5, 6, 1301)
    error = of_largest(along(NearFaultPulse(**inputs).velocity, t), velocity(t, **inputs))
    observed("near-fault pulse: velocity", "Eqs. 16 and 17 in NumPy", error, 1e-13)


@pytest.mark.verification("dynamics")
@pytest.mark.parametrize("inputs", PULSES)
def test_pulse_acceleration_is_the_derivative_of_velocity(inputs, observed):
    pulse = NearFaultPulse(**inputs)
    t = np.linspace(0.001, 0.999, 500) * pulse.duration
    acceleration = along(pulse.sample, t)
    scale = np.abs(acceleration).max()
    # Measured 3e-16 of the peak.
    np.testing.assert_allclose(acceleration, along(jax.grad(pulse.velocity), t), rtol=0, atol=5e-15 * scale)
    d = 1e-5  # the difference quotient is good to d²ω² and 1e-16/d
    slope = (velocity(t + d, **inputs) - velocity(t - d, **inputs)) / (2 * d)
    error = of_largest(acceleration, slope)
    observed("near-fault pulse: acceleration", "differences of the velocity in NumPy", error, 1e-8)


@pytest.mark.parametrize("inputs", PULSES)
def test_pulse_starts_and_ends_smoothly_and_is_zero_outside(inputs):
    pulse = NearFaultPulse(**inputs)
    for function in (pulse.velocity, pulse.sample):
        for time in (0.0, float(pulse.duration)):
            assert abs(function(time)) < 1e-12
        for time in (-1e-9, -3.0, float(pulse.duration) + 1e-9, 100.0):
            assert function(time) == 0.0


@pytest.mark.parametrize("inputs", PULSES)
def test_pulse_leaves_no_permanent_displacement(inputs):
    pulse = NearFaultPulse(**inputs)
    t = np.linspace(0, pulse.duration, 4097)
    displacement = np.trapezoid(along(pulse.velocity, t), t)  # spectrally accurate: zero slope at both ends
    travelled, _ = quad(lambda s: abs(float(velocity(s, **inputs))), 0, float(pulse.duration), limit=200)
    assert abs(displacement) < 1e-7 * travelled


@pytest.mark.parametrize("inputs", PULSES)
@pytest.mark.parametrize("step", [1 / 64, 0.005])
def test_rotating_phasors_equal_direct_evaluation(inputs, step):
    steps = round(10 / step)
    pulse = NearFaultPulse(**inputs)
    direct = along(pulse.sample, 0.5 * step * np.arange(2 * steps + 1))
    np.testing.assert_allclose(sampled(pulse.forcing(step, steps), steps), direct, rtol=0, atol=1e-10)


def test_pulse_is_differentiable_in_its_inputs():
    def samples(x):
        forcing = NearFaultPulse(V_P=x[0], T_P=x[1]).forcing(1 / 64, 128)
        carry, _ = forcing.start()
        return jax.lax.scan(lambda c, i: forcing.advance(c, i), carry, jnp.arange(1, 257))[1]

    x, d = np.array([2.25, 1.003]), 1e-6
    jacobian, program = jax.jit(jax.jacfwd(samples))(x), jax.jit(samples)
    for i, e in enumerate(d * np.eye(2)):
        difference = (program(x + e) - program(x - e)) / (2 * d)
        np.testing.assert_allclose(jacobian[:, i], difference, rtol=0, atol=1e-7 * np.abs(jacobian[:, i]).max())


def test_record_is_linear_between_uneven_samples_and_zero_outside():
    time, values = np.array([0.1, 0.2, 0.5, 0.6]), np.array([1.0, -2.0, 4.0, 0.5])
    motion = RecordedMotion(time, values)
    t = np.array([0.0, 0.0999, 0.1, 0.15, 0.35, 0.5, 0.6, 0.6001, 9.0])
    expected = [0, 0, 1, -0.5, 1, 4, 0.5, 0, 0]
    np.testing.assert_allclose(along(motion.sample, t), expected, rtol=0, atol=1e-14)
    steps = 40
    grid = 0.5 * 0.025 * np.arange(2 * steps + 1)
    expected = np.interp(grid, time, values, left=0, right=0)
    np.testing.assert_allclose(sampled(motion.forcing(0.025, steps), steps), expected, rtol=0, atol=1e-14)


def test_forcing_of_a_recorded_motion_passes_through_its_samples(shared):
    dt, acceleration = read_at2(shared / "data" / "ground_motions" / "elCentro.AT2")
    motion = RecordedMotion(np.arange(acceleration.size) * dt, acceleration)
    steps = acceleration.size - 1
    samples = sampled(motion.forcing(dt, steps), steps)
    np.testing.assert_allclose(samples[::2], acceleration, rtol=0, atol=1e-13)
    np.testing.assert_allclose(samples[1::2], (acceleration[1:] + acceleration[:-1]) / 2, rtol=0, atol=1e-13)
    assert np.abs(samples).max() == pytest.approx(np.abs(acceleration).max(), rel=1e-14)
