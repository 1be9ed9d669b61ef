"""Derivatives: forward against differences, reverse against forward at every saved time, finite at z = 0."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.inference.predict import Predictor
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.integrate import integrate
from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.simulator import Timeline
from hsed_jax.physics.specimen import Specimen

pytestmark = pytest.mark.optimised
NAMES = ("A", "beta", "gamma", "n", "stiffness_degradation.delta")
SCALES = np.array([5e5, 1.0, 1.0, 1.0, 2e-5])
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")
CHANNELS = ("force", "elongation", "energy")


def named(theta):
    """Parameters by name from multiples of SCALES."""
    return dict(zip(NAMES, theta * SCALES, strict=True))


@pytest.fixture(scope="session")
def model(paper_simulator):
    """All five parameters free."""
    return paper_simulator(effects=("stiffness_degradation",), constants=())


@pytest.fixture(scope="session")
def quantities(model, pulse_conditions):
    """θ (5,) to quantities (3,), and its forward Jacobian (3, 5), over rows of θ."""

    def one(theta):
        return model.quantities(named(theta), pulse_conditions(2.25, 1.0), QUANTITIES)[0]

    return jax.jit(jax.vmap(one)), jax.jit(jax.vmap(jax.jacfwd(one)))


POINTS = np.array([[1.0, 1.0, 0.1, 1.02, 1.0], [0.8, 0.7, -0.2, 0.97, 0.5], [1.3, 1.4, 0.4, 1.05, 2.0]])


@pytest.mark.whole
def test_forward_jacobian_equals_central_differences(quantities):
    value, jacobian = quantities
    step = 1e-6
    moved = POINTS[:, None, None] + step * np.stack([np.eye(5), -np.eye(5)], axis=1)
    values = np.asarray(value(moved.reshape(-1, 5))).reshape(3, 5, 2, 3)
    difference = np.moveaxis(values[:, :, 0] - values[:, :, 1], 1, 2) / (2 * step)
    exact = np.asarray(jacobian(POINTS))
    scale = np.abs(exact).max(axis=2, keepdims=True)
    error = np.abs(difference - exact) / scale
    assert error.max() < 5e-9  # of the largest derivative of the quantity; measured 8e-10


@pytest.mark.whole
def test_neutral_effect_has_a_derivative_from_either_side(quantities):
    # A score test needs ∂/∂δ at δ = 0, where the effect is switched off.
    value, jacobian = quantities
    theta = np.array([[1.0, 1.0, 0.0, 1.0, 0.0]])
    step = np.array([0, 0, 0, 0, 1e-6])
    slope = np.asarray(jacobian(theta))[0, :, 4]
    for moved in (step, -step):
        one_sided = (np.asarray(value(theta + moved)) - np.asarray(value(theta)))[0] / moved[4]
        np.testing.assert_allclose(one_sided, slope, rtol=1e-4)


@pytest.fixture(scope="session")
def history(model):
    """θ to histories (641, 3)."""

    def of(theta):
        forcing = NearFaultPulse(2.25, 1.0).forcing(1 / 64, 640)
        response = integrate(model.system(named(theta)), forcing, 1 / 64, 640, channels=CHANNELS)
        return jnp.stack([response.channels[name] for name in CHANNELS], axis=1)

    return of


@pytest.mark.whole
def test_reverse_equals_forward_at_every_saved_time(history):
    theta = jnp.asarray(POINTS[0])
    forward = np.asarray(jax.jit(jax.jacfwd(history))(theta))

    @jax.jit
    def reverse(cotangents):
        _, pull = jax.vjp(history, theta)
        return jax.lax.map(lambda c: pull(c)[0], cotangents, batch_size=128)

    cotangents = jnp.eye(641 * 3).reshape(-1, 641, 3)
    backward = np.asarray(reverse(cotangents)).reshape(641, 3, 5)
    error = np.abs(backward - forward).max(axis=0) / np.abs(forward).max(axis=0)
    assert error.max() < 1e-12  # measured 7e-15
    assert (np.abs(backward[1:]).max(axis=(1, 2)) > 0).all()


@pytest.mark.parametrize("n", [1, 1.0, 1.5, 2, 2.0])
@pytest.mark.parametrize("is_traced", [False, True])
def test_derivative_of_the_law_is_finite_at_zero_force(n, is_traced):
    def flow(A, beta, gamma, n, z, rate):
        return Specimen(BoucWen(A, beta, gamma, n)).rates(0.01, rate, {"hysteretic": z, "energy": 0.0})["hysteretic"]

    arguments = (5e5, 0.7, 0.3, n, 0.0, 0.5)
    which = tuple(i for i in range(6) if is_traced or i != 3)
    program = jax.jit(jax.value_and_grad(flow, which), static_argnums=() if is_traced else 3)
    value, slopes = program(*(float(a) if i in which else a for i, a in enumerate(arguments)))
    assert value == pytest.approx(5e5 * 0.5, rel=1e-15)
    assert np.isfinite(slopes).all()
    expected = dict.fromkeys(which, 0.0) | {0: 0.5, 5: 5e5}  # ż = A Δu̇ at z = 0
    if n == 1:
        del expected[4]  # |z| has no derivative at zero: any of its two, or what lies between, will do
        assert -0.5 * (0.7 + 0.3) <= slopes[which.index(4)] <= 0.5 * (0.7 + 0.3)
    for i, slope in expected.items():
        assert slopes[which.index(i)] == pytest.approx(slope, abs=1e-6)


@pytest.mark.parametrize("n", [1, 1.5, 2])
def test_a_traced_exponent_gives_the_law_of_a_constant_one(n):
    z = np.linspace(-1e5, 1e5, 41)
    for rate in (0.7, -0.7):
        constant, traced = (
            jax.jit(
                jax.vmap(
                    lambda z, n=n, rate=rate: Specimen(BoucWen(5e5, 0.7, 0.3, n)).rates(
                        0.01, jnp.asarray(rate), {"hysteretic": z, "energy": 0.0}
                    )["hysteretic"]
                )
            )(z)
            for n in (n, jnp.asarray(float(n)))
        )
        np.testing.assert_allclose(traced, constant, rtol=1e-13, atol=1e-6)


@pytest.mark.whole
def test_derivatives_of_a_whole_response_are_finite_for_each_exponent(quantities):
    _, jacobian = quantities
    # β, γ in N^(1−n)/m: about the same ultimate force for each n
    theta = np.array([[1.0, 0.5, 0.2, 1.0, 1.0], [1.0, 2e-3, 1e-3, 1.5, 1.0], [1.0, 8e-6, 4e-6, 2.0, 1.0]])
    found = np.asarray(jacobian(theta))
    assert np.isfinite(found).all()
    assert (np.abs(found[..., 0]) > 0).all()


# --- the predictor -----------------------------------------------------------------------------------------------

SIZE = 70  # more than one tile of 64


@pytest.fixture(scope="session")
def prediction(paper_simulator, pulse_conditions):
    """(predict, plain): the predictor, and the same by plain vmap; θ = (A/A_ref, β), 70 short experiments."""
    simulator = paper_simulator(timeline=Timeline(1 / 32, 96))
    conditions = pulse_conditions(np.linspace(1.5, 3.0, SIZE), np.linspace(0.5, 1.5, SIZE))

    def respond(theta, conditions):
        return simulator.quantities({"A": theta[0] * 5e5, "beta": theta[1]}, conditions, QUANTITIES)

    predict = Predictor(respond)
    plain = jax.vmap(lambda theta, c: respond(theta, c)[0], in_axes=(None, 0))
    return lambda theta, count: predict(theta, conditions, count), lambda theta: plain(theta, conditions)


THETA = np.array([[0.9, 0.8], [1.0, 1.0], [1.2, 1.3]])
WEIGHTS = np.random.default_rng(0).normal(size=(SIZE, 3)) / [1e5, 0.3, 1e4]


def cost(outputs):
    return jnp.sum((outputs * WEIGHTS) ** 2)


@pytest.fixture(scope="session")
def plain_truth(prediction):
    """Values (3, n, J) and Jacobians (3, n, J, 2) of plain code at THETA."""
    _, plain = prediction
    both = jax.jit(jax.jacfwd(lambda theta: (plain(theta),) * 2, has_aux=True))
    jacobians, values = zip(*(both(theta) for theta in THETA), strict=True)
    return np.stack(values), np.stack(jacobians)


@pytest.mark.whole
def test_predictor_value_and_jvp_equal_plain_vmap(prediction, plain_truth):
    predict, _ = prediction
    values, jacobians = plain_truth
    direction = np.array([0.3, -1.7])
    (outputs, ok), (moved, still) = jax.jit(
        lambda theta, d: jax.jvp(lambda t: predict(t, jnp.asarray(SIZE)), (theta,), (d,))
    )(THETA[0], direction)
    np.testing.assert_allclose(outputs, values[0], rtol=1e-12)
    np.testing.assert_allclose(moved, jacobians[0] @ direction, rtol=0, atol=1e-11 * np.abs(jacobians[0]).max())
    np.testing.assert_array_equal(ok, 1.0)
    np.testing.assert_array_equal(still, 0.0)
    plain_value = jax.jit(lambda theta: predict(theta, jnp.asarray(SIZE))[0])(THETA[0])
    np.testing.assert_allclose(plain_value, values[0], rtol=1e-12)


@pytest.mark.whole
def test_predictor_nested_vmap_and_gradient_equal_a_loop(prediction, plain_truth):
    predict, _ = prediction
    values, jacobians = plain_truth

    def scored(theta, count):
        outputs, ok = predict(theta, count)
        return cost(outputs), (outputs, ok)

    def check(slopes, outputs, ok, which):
        np.testing.assert_allclose(outputs, values[which], rtol=1e-12)
        np.testing.assert_array_equal(ok, 1.0)
        expected = np.einsum("cnj,cnjp->cp", 2 * values[which] * WEIGHTS**2, jacobians[which])
        np.testing.assert_allclose(slopes, expected, rtol=1e-10)

    count = jnp.asarray(SIZE)
    graded = jax.grad(scored, has_aux=True)
    slopes, (outputs, ok) = jax.jit(jax.vmap(graded, in_axes=(0, None)))(THETA, count)
    check(slopes, outputs, ok, slice(None))
    nested = jax.jit(jax.vmap(jax.vmap(graded, in_axes=(0, None)), in_axes=(0, None)))
    slopes, (outputs, ok) = nested(THETA[:2, None].repeat(2, axis=1), count)
    for i in range(2):
        check(slopes[:, i], outputs[:, i], ok[:, i], slice(0, 2))


@pytest.mark.whole
@pytest.mark.parametrize("count", [0, 1, 40, 65])
def test_predictor_is_zero_beyond_the_count(prediction, plain_truth, count):
    predict, _ = prediction
    values, jacobians = plain_truth
    outputs, ok, jacobian = _counted(predict)(THETA, jnp.asarray(count))
    for c in range(3):
        np.testing.assert_allclose(outputs[c, :count], values[c, :count], rtol=1e-12)
        np.testing.assert_allclose(
            jacobian[c, :count], jacobians[c, :count], rtol=0, atol=1e-11 * np.abs(jacobians).max()
        )
    np.testing.assert_array_equal(ok, np.tile(np.arange(SIZE) < count, (3, 1)))
    np.testing.assert_array_equal(outputs[:, count:], 0.0)
    np.testing.assert_array_equal(jacobian[:, count:], 0.0)


_COUNTED: dict = {}


def _counted(predict):
    """Values, flags and Jacobian of three parameter vectors, compiled once."""
    if "program" not in _COUNTED:

        def one(theta, count):
            (outputs, ok), push = jax.linearize(lambda t: predict(t, count), theta)
            return outputs, ok, jnp.stack([push(e)[0] for e in jnp.eye(2)], axis=-1)

        _COUNTED["program"] = jax.jit(jax.vmap(one, in_axes=(0, None)))
    return _COUNTED["program"]


def test_predictor_gives_a_diverged_experiment_zero_value_and_derivative():
    def respond(theta, x):
        y = theta[0] * x
        return jnp.stack([jnp.where(x > 2, jnp.nan, y), jnp.sqrt(x - 1) * theta[1]]), x < 3

    predict = Predictor(respond)
    x = jnp.array([1.5, 2.5, 3.5, 0.5])
    along = jax.jit(lambda theta, d: jax.jvp(lambda t: predict(t, x, jnp.asarray(4)), (theta,), (d,)))
    (outputs, ok), (moved, _) = along(jnp.array([2.0, 3.0]), jnp.array([1.0, 1.0]))
    np.testing.assert_array_equal(ok, [1, 0, 0, 0])
    np.testing.assert_array_equal(outputs[1:], 0)
    np.testing.assert_array_equal(moved[1:], 0)
    np.testing.assert_allclose(outputs[0], [3.0, 3 * np.sqrt(0.5)], rtol=1e-14)
    np.testing.assert_allclose(moved[0], [1.5, np.sqrt(0.5)], rtol=1e-14)
