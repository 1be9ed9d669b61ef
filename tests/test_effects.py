"""The catalogue of effects: its metadata, neutrality, commutation, and degradation against independent integrations."""

from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hsed_jax.physics.bouc_wen import BoucWen
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.base import ADDED, MULTIPLIED, SpringPoint, combine, register
from hsed_jax.physics.parameters import dimensionless, parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Timeline

SCALES = Scales(force=1.2e5, elongation=0.25, rate=1.5, energy=2e4)
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")
LAW = {"A": 5e5, "beta": 0.8, "gamma": 0.2, "n": 1.2}


def points(count: int = 200) -> SpringPoint:
    """Random states of the spring, rest and virgin state among them; leading axis `count`."""
    draw = np.random.default_rng(3)
    z, du, rate = draw.normal(size=(3, count)) * [[1e5], [0.3], [1.5]]
    energy = draw.exponential(2e4, count)
    travel = draw.exponential(2.0, count)
    z[:2] = du[:2] = energy[:2] = travel[:2] = rate[0] = 0.0
    memory = {"hysteretic": z, "energy": energy, "largest_elongation": 1.5 * np.abs(du), "travel": travel}
    return SpringPoint(du, rate, z, memory, Scales(*(np.full(count, s) for s in SCALES)), np.full(count, 1e5))


def at_neutral(name: str):
    return EFFECTS[name](**{key: jnp.asarray(p.neutral) for key, p in parameters_of(EFFECTS[name]).items()})


def active(name: str):
    """The effect with every parameter 0.3 off its neutral value, on the side that its bounds allow."""
    values = {}
    for key, known in parameters_of(EFFECTS[name]).items():
        above = known.neutral + 0.3
        values[key] = above if above <= known.upper else known.neutral - 0.3
    return EFFECTS[name](**values)


def rates(effects) -> dict:
    """Rates and force of the law with these effects at all points."""

    def one(point):
        law = BoucWen(**LAW, effects=tuple(effects), scales=SCALES)
        found = law.rates(point.elongation, point.rate, point.memory)
        return found | {"force": law.force(point.elongation, point.rate, point.memory)}

    return jax.vmap(one)(points())


# --- metadata ----------------------------------------------------------------------------------------------------


def test_catalogue_is_not_empty():
    assert {"stiffness_degradation", "strength_degradation"} <= set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_says_what_it_is(name):
    effect = EFFECTS[name]
    assert effect.name == name
    assert effect.family.strip()
    assert effect.reference.strip()
    assert effect.__doc__
    assert not effect.__doc__.startswith(f"{effect.__name__}(")  # what a dataclass writes where nobody else did
    assert getattr(effect, "__final__", False)
    known = parameters_of(effect)
    assert known
    for key, parameter in known.items():
        assert parameter.name == key
        assert parameter.symbol.strip()
        assert parameter.unit.strip()
        assert parameter.meaning.strip()
        assert parameter.neutral is not None
        assert parameter.lower <= parameter.neutral <= parameter.upper
        assert parameter.prior is not None
        assert len(parameter.prior) == 1
        assert parameter.physical is None or parameter.physical.unit.strip()


@pytest.mark.parametrize("name", EFFECTS)
def test_either_form_of_a_parameter_sets_the_same_effect(name):
    for key, known in parameters_of(EFFECTS[name]).items():
        assert dimensionless(EFFECTS[name], key, 0.3, SCALES) == {key: 0.3}
        if known.physical is not None:
            physical = 0.3 * known.physical.factor(SCALES)
            found = dimensionless(EFFECTS[name], known.physical.name, physical, SCALES)
            assert found == {key: pytest.approx(0.3, rel=1e-15)}
    with pytest.raises(KeyError):
        dimensionless(EFFECTS[name], "no such parameter", 0.3, SCALES)


def test_two_effects_of_one_name_are_refused():
    with pytest.raises(ValueError, match="in the catalogue already"):
        register(EFFECTS["stiffness_degradation"])


def test_an_unknown_slot_is_refused():
    with pytest.raises(ValueError, match="There is no slot 'mu'"):
        combine([{"mu": 1.0}])


def test_contributions_to_one_slot_multiply_and_forces_add():
    slot = combine([{"eta": 2.0, "force": 1.0}, {"eta": 3.0, "force": 5.0}])
    assert (slot("eta"), slot("force"), slot("nu"), slot("a"), slot("h")) == (6.0, 6.0, 1.0, 1.0, 1.0)


# --- neutrality and commutation ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_contributes_nothing_at_its_neutral_value(name):
    contributions = jax.vmap(at_neutral(name).contribute)(points())
    for slot, values in contributions.items():
        assert slot in (*MULTIPLIED, *ADDED)
        np.testing.assert_array_equal(values, 1.0 if slot in MULTIPLIED else 0.0)
    plain, neutral = rates([]), rates([at_neutral(name)])
    for state, expected in plain.items():
        np.testing.assert_array_equal(neutral[state], expected)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_changes_the_law_off_its_neutral_value(name):
    plain, changed = rates([]), rates([active(name)])
    assert any(np.abs(changed[s] - plain[s]).max() > 1e-3 * np.abs(plain[s]).max() for s in plain)


def orders(limit: int = 6) -> list[tuple[str, ...]]:
    """All orders of the catalogue while they are few; else the first, its reverse and random ones."""
    names = tuple(EFFECTS)
    if len(names) <= 3:
        return list(permutations(names))
    draw = np.random.default_rng(0)
    return [names, names[::-1], *(tuple(draw.permutation(names)) for _ in range(limit - 2))]


def test_effects_commute_in_the_law():
    first, *others = (rates([active(name) for name in order]) for order in orders())
    for other in others:
        for state, expected in first.items():
            np.testing.assert_allclose(other[state], expected, rtol=1e-14)


def quantities_with(paper_simulator, pulse_conditions, names, values):
    """Quantities (3,) of the paper's experiment with these effects; `values` are inputs of the program."""
    simulator = paper_simulator(effects=names, scales=SCALES)
    program = jax.jit(lambda values, c: simulator.quantities({"A": 5e5, "beta": 1.0, **values}, c, QUANTITIES))
    quantities, ok = program(values, pulse_conditions(2.25, 1.0))
    assert ok
    return np.asarray(quantities)


def parameters(names, value) -> dict:
    """The named effects' parameters by full name; `value` from metadata to number."""
    return {f"{n}.{key}": jnp.asarray(value(p)) for n in names for key, p in parameters_of(EFFECTS[n]).items()}


def test_all_effects_at_their_neutral_values_are_the_plain_model(paper_simulator, pulse_conditions):
    plain = quantities_with(paper_simulator, pulse_conditions, (), {})
    neutral = parameters(EFFECTS, lambda p: p.neutral)
    nested = quantities_with(paper_simulator, pulse_conditions, tuple(EFFECTS), neutral)
    np.testing.assert_allclose(nested, plain, rtol=1e-12)


def test_effects_commute_in_the_response(paper_simulator, pulse_conditions):
    names = ("stiffness_degradation", "strength_degradation")
    values = parameters(names, lambda p: p.neutral + 0.3)
    forward, backward = (
        quantities_with(paper_simulator, pulse_conditions, order, values) for order in (names, names[::-1])
    )
    np.testing.assert_allclose(forward, backward, rtol=1e-12)


# --- degradation against SciPy -----------------------------------------------------------------------------------


def paper_by_scipy(V_P, T_P, eta=0.0, nu=0.0, A=5e5, beta=1.0, end=10.0):
    """Quantities of the paper's structure with Eq. 15 (and ν = 1 + nu·e on β), by DOP853 from reversal to reversal."""
    m1, m2, k1, k3, gamma, phase = 8e3, 9e3, 4e5, 1e6, 2.0, 0.10
    K = np.array([[k1 + A, -A], [-A, k3 + A]])
    root = np.sqrt([m1, m2])
    eigenvalues, modes = np.linalg.eigh(K / np.outer(root, root))
    C = np.outer(root, root) * (modes @ np.diag(2 * 0.05 * np.sqrt(eigenvalues)) @ modes.T)
    offset = (
        V_P * (np.sin(phase + gamma * np.pi) - np.sin(phase - gamma * np.pi)) / (4 * np.pi * (1 - gamma**2)) / gamma
    )

    def ground(t):
        tau = t / T_P - gamma / 2
        c, e = 2 * np.pi * tau + phase, 2 * np.pi * tau / gamma
        slope = -V_P / 2 * np.sin(c) * (1 + np.cos(e)) - (V_P / 2 * np.cos(c) - offset) * np.sin(e) / gamma
        return 2 * np.pi / T_P * slope if tau <= gamma / 2 else 0.0

    def flow(t, y, sign):
        u1, u2, v1, v2, r, e = y
        rate = v2 - v1
        speed = abs(rate) if sign == 0 else sign * rate
        return [
            v1,
            v2,
            -(C[0, 0] * v1 + C[0, 1] * v2 + k1 * u1 - r) / m1 - ground(t),
            -(C[1, 0] * v1 + C[1, 1] * v2 + k3 * u2 + r) / m2 - ground(t),
            (A * rate - (1 + nu * e) * beta * speed * r) / (1 + eta * e),
            r * rate,
        ]

    def reversal(t, y, sign):
        return y[3] - y[2]

    reversal.terminal = True
    t, y, sign, peaks = 0.0, np.zeros(6), 0, np.zeros(2)
    while t < end:
        until = 1e-3 if sign == 0 else gamma * T_P if t < gamma * T_P else end
        reversal.direction = -sign
        found = solve_ivp(
            flow,
            (t, until),
            y,
            "DOP853",
            rtol=1e-11,
            atol=[1e-11] * 4 + [1e-5] * 2,
            args=(sign,),
            events=reversal if sign else None,
            dense_output=True,
        )
        path = found.sol(np.linspace(t, found.t[-1], 400))
        t, y = found.t[-1], found.y[:, -1]
        # While strength degrades, |r| can peak before the reversal.
        peaks = np.maximum(peaks, [np.abs(path[4]).max(), np.abs(path[1] - path[0]).max()])
        sign = -sign if found.status == 1 else sign or (1 if y[3] > y[2] else -1)
    return np.array([*peaks, y[5]])


@pytest.mark.parametrize(
    ("effect", "physical", "amount", "tolerance"),
    [("stiffness_degradation", "eta", 2e-5, 2e-7), ("strength_degradation", "nu", 5e-5, 3e-6)],
)
def test_degradation_equals_its_equation_integrated_by_scipy(
    paper_simulator, pulse_conditions, effect, physical, amount, tolerance
):
    simulator = paper_simulator(effects=(effect,), scales=SCALES, timeline=Timeline(0.0025, 4000))

    @jax.jit
    def program(name_value, conditions):
        return simulator.quantities({"A": 5e5, "beta": 1.0, **name_value}, conditions, QUANTITIES)[0]

    for V_P, T_P in [(2.25, 1.0), (2.8, 0.7)]:
        conditions = pulse_conditions(V_P, T_P)
        truth = paper_by_scipy(V_P, T_P, **{physical: amount})
        found = program({f"{effect}.{physical}": jnp.asarray(amount)}, conditions)
        # Measured at 2.5 ms: 7e-8; a force that peaks before the reversal (strength degradation) 1.8e-6.
        np.testing.assert_allclose(found, truth, rtol=tolerance)
    same = program({f"{effect}.delta": jnp.asarray(amount * SCALES.energy)}, conditions)
    np.testing.assert_allclose(same, found, rtol=1e-12)
    assert np.abs(paper_by_scipy(V_P, T_P) / truth - 1).max() > 0.02  # the effect is far above the tolerance


def test_effects_of_the_same_energy_state_share_it():
    law = BoucWen(**LAW, effects=tuple(active(name) for name in ("stiffness_degradation", "strength_degradation")))
    assert list(law.start()) == ["hysteretic", "energy"]
