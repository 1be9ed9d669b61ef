"""The catalogue of effects: metadata, neutrality, commutation, derivatives; each kind against independent solutions."""

from functools import cache
from itertools import permutations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.shares import by_default, has_default_driver
from observations import of_largest, relative
from scipy.integrate import solve_ivp

from hsed_jax.physics.effects import EFFECTS, AbstractSetupEffect, AbstractSpringEffect, called
from hsed_jax.physics.effects.base import ADDED, MULTIPLIED, Setup, SpringPoint, combine
from hsed_jax.physics.effects.forms import default_form, forms_of
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.integrate import integrate
from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.parameters import dimensionless, parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.sensors import shifted
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator, Timeline
from hsed_jax.physics.specimen import Specimen, unserved
from hsed_jax.physics.structures import ModalDamping, Spring, Structure
from hsed_jax.physics.systems import ShakenStructure

SCALES = Scales(force=1.2e5, elongation=0.25, rate=1.5, energy=2e4)
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")
# Effects that a Bouc–Wen specimen can have.
PRESENT = tuple(name for name in EFFECTS if not unserved(EFFECTS[name], BoucWen))
SPRING = tuple(name for name in PRESENT if issubclass(EFFECTS[name], AbstractSpringEffect))
SETUP = tuple(name for name, effect in EFFECTS.items() if issubclass(effect, AbstractSetupEffect))
# What a Bouc–Wen specimen can have of an effect: every shape with the default driver, the first one with the others.
FORMS = tuple(
    (name, label)
    for name in PRESENT
    for label, form in forms_of(EFFECTS[name]).items()
    if not unserved(EFFECTS[name], BoucWen, label)
    and (not form.driver or form.name == default_form(EFFECTS[name]).name)
)
SPRING_FORMS = tuple((name, label) for name, label in FORMS if name in SPRING)
MOST_PARAMETERS = max(len(form.parameters(effect)) for effect in EFFECTS.values() for form in forms_of(effect).values())
LAW = {"A": 5e5, "beta": 0.8, "gamma": 0.2, "n": 1.2}


def points(count: int = 200) -> SpringPoint:
    """Random states of the spring, rest and virgin state among them; leading axis `count`."""
    draw = np.random.default_rng(3)
    z, du, rate = draw.normal(size=(3, count)) * [[1e5], [0.3], [1.5]]
    energy = draw.exponential(2e4, count)
    travel = draw.exponential(2.0, count)
    z[:2] = du[:2] = energy[:2] = travel[:2] = rate[0] = 0.0
    memory = {
        "hysteretic": z,
        "energy": energy,
        "largest_elongation": np.abs(du) * draw.uniform(1.0, 5.0, count),
        "largest_tension": np.maximum(du, 0.0) * draw.uniform(1.0, 5.0, count),
        "largest_compression": np.maximum(-du, 0.0) * draw.uniform(1.0, 5.0, count),
        "travel": travel,
        "fatigue": np.abs(du) * travel,
        "reversals": np.floor(travel) + 0.37,  # between numbers: an onset at one has no derivative
    }
    bristled = ("coulomb_friction", "stribeck_friction", "kinematic_hardening")
    for state in ("relaxing", "plastic", *(f"{name}_{own}" for name in bristled for own in ("bristle", "foot"))):
        memory |= {state: draw.normal(scale=1e5 if state == "relaxing" else 0.5, size=count)}
    return SpringPoint(
        du, rate, z, memory, Scales(*(np.full(count, s) for s in SCALES)), np.full(count, 1e5), np.full(count, 5e5)
    )


def made(name: str, label: str | None = None, value=lambda known: jnp.asarray(known.neutral)):
    """An effect in a form, by default the default one; what that leaves free is a number from its metadata."""
    effect = EFFECTS[name]
    form = default_form(effect) if label is None else forms_of(effect)[label]
    return effect(**form.held, **{key: value(known) for key, known in form.parameters(effect).items()})


def off_neutral(known) -> float:
    """0.3 off the neutral value, on the side that the bounds allow; a life that ends at some of the points."""
    if known.name == "life":
        return 1.0
    within = [known.neutral + step for step in (0.3, -0.3) if known.lower <= known.neutral + step <= known.upper]
    return within[0] if within else (known.neutral + known.upper) / 2


def active(name: str, label: str | None = None):
    """The effect with every free parameter of its form 0.3 off its neutral value."""
    return made(name, label, off_neutral)


@cache
def plain() -> dict:
    """What `rates` is without effects."""
    return rates([])


def rates(effects, at: SpringPoint | None = None, *, own: bool = False) -> dict:
    """Rates and force of the law with these effects at all points; also of states that are there for the effects, or not."""
    left_out = set() if own else {n for e in effects for n in (*e.states, *(state.name for state in e.needs))}

    def one(point):
        specimen = Specimen(BoucWen(**LAW), tuple(effects), SCALES)
        found = specimen.rates(point.elongation, point.rate, point.memory)
        found |= {"force": specimen.force(point.elongation, point.rate, point.memory)}
        return {state: value for state, value in found.items() if state not in left_out}

    return jax.vmap(one)(points() if at is None else at)


def contributions(effect) -> dict:
    """What an effect writes to its slots: at all points, or to a structure of three masses and two supports."""
    if isinstance(effect, AbstractSpringEffect):
        return jax.vmap(effect.contribute)(points())
    return effect.contribute(Setup(SCALES, 3, 2))


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
    # The amplitude comes first, and what only tells forms apart comes last.
    assert not next(iter(known.values())).shapes
    assert [p.shapes for p in known.values()] == sorted(p.shapes for p in known.values())
    assert effect.place in ("spring", "structure", "test rig")
    assert effect.place != "spring" or issubclass(effect, AbstractSpringEffect)
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
def test_every_form_says_what_it_is(name):
    effect, forms = EFFECTS[name], forms_of(EFFECTS[name])
    known = parameters_of(effect)
    # Every shape with every driver, but powers of a driver that has its own.
    twice = sum("power" in shape.free for shape in effect.forms) * ("path_and_elongation" in effect.drivers)
    assert len(forms) == max(len(effect.forms), 1) * max(len(effect.drivers), 1) - twice
    assert [form.is_default for form in forms.values()] == [True] + [False] * (len(forms) - 1)
    assert not default_form(effect).held
    assert not default_form(effect).free
    ways = [(sorted(form.held.items()), sorted(form.free)) for form in forms.values()]
    assert all(ways.count(way) == 1 for way in ways)
    for label, form in forms.items():
        assert label == form.label
        # The default one may be described by the effect, and nothing else but what is free in several respects.
        assert form.equation or form.name == next(iter(effect.forms), form).name
        assert (not form.driver) or form.driver in effect.drivers[1:]
        assert not set(form.free) & set(form.held)
        assert all(known[key].shapes for key in form.free)
        for key, value in form.held.items():
            assert known[key].lower <= value <= known[key].upper
            assert not (known[key].shapes and value == known[key].neutral)
        free = form.parameters(effect)
        assert next(iter(free)) == next(iter(known))
        assert set(form.free) <= set(free)
        assert not set(form.held) & set(free)
    # What tells forms apart is told apart by some form, but for the choice of drivers, which effects share.
    told = {key for form in forms.values() for key in (*form.free, *form.held)}
    assert {key for key, p in known.items() if p.shapes and not key.startswith("driver")} <= told
    symbols = [p.symbol for key, p in known.items() if key in told or not p.shapes]
    assert len(symbols) == len(set(symbols))


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
    with pytest.raises(ValueError, match="two effects are named 'stiffness_degradation'"):
        EFFECTS.joined([EFFECTS["stiffness_degradation"]])


def test_an_unknown_slot_is_refused():
    with pytest.raises(ValueError, match="There is no slot 'mu'"):
        combine([{"mu": 1.0}])


def test_contributions_to_one_slot_multiply_and_forces_add():
    slot = combine([{"eta": 2.0, "force": 1.0}, {"eta": 3.0, "force": 5.0}])
    assert (slot("eta"), slot("force"), slot("nu"), slot("a"), slot("h")) == (6.0, 6.0, 1.0, 1.0, 1.0)


def test_hardening_with_a_negative_amplitude_is_called_softening():
    assert called("hardening", {"delta": -0.25}) == "hardening (softening, as by P-Delta)"
    assert called("hardening", {"k": -1e5}) == called("hardening", {"hardening.delta": -0.25, "A": 1.0})
    assert called("storey2.hardening", {"storey2.hardening.delta": -0.1}).endswith("(softening, as by P-Delta)")
    assert called("hardening", {"delta": 0.25}) == called("hardening", {"storey2.hardening.delta": -0.1}) == "hardening"
    assert called("cubic_stiffness", {"delta": -1.0}) == "cubic_stiffness (a spring that softens)"
    assert called("viscous_damping", {"delta": -1.0}) == "viscous_damping" and called("own", {"delta": -1.0}) == "own"


# --- neutrality and commutation ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_contributes_nothing_at_its_neutral_value(name):
    for label in forms_of(EFFECTS[name]):
        for slot, values in contributions(made(name, label)).items():
            assert slot in (*MULTIPLIED, *ADDED)
            if slot == "settling_rate":
                continue  # of an offset that is none
            np.testing.assert_array_equal(values, 1.0 if slot in MULTIPLIED else 0.0)


@pytest.mark.parametrize("name", SPRING)
def test_an_effect_in_the_spring_contributes_nothing_without_its_amplitude(name):
    amplitude = next(iter(parameters_of(EFFECTS[name])))
    for label in forms_of(EFFECTS[name]):
        idle = made(name, label, lambda p: jnp.asarray(p.neutral) if p.name == amplitude else off_neutral(p))
        for slot, values in contributions(idle).items():
            np.testing.assert_array_equal(values, 1.0 if slot in MULTIPLIED else 0.0)


@pytest.mark.parametrize("name", SPRING)
def test_a_neutral_effect_leaves_the_law_as_it_is(name):
    for state, values in rates([made(name)]).items():
        np.testing.assert_array_equal(values, plain()[state])


@pytest.mark.parametrize(("name", "label"), by_default(SPRING_FORMS, has_default_driver))
def test_an_effect_changes_the_law_off_its_neutral_value(name, label):
    changed = rates([active(name, label)])
    assert any(np.abs(changed[s] - plain()[s]).max() > 1e-3 * np.abs(plain()[s]).max() for s in changed)


@pytest.mark.parametrize(("name", "label"), by_default(SPRING_FORMS, has_default_driver))
def test_an_effect_that_needs_no_time_follows_the_path_alone(name, label):
    # At twice the speed such a law has the same force and runs twice as fast; friction is past its turning at these rates.
    at = points()
    at = at._replace(rate=np.sign(at.rate + 0.5) * np.linspace(0.5, 2, at.rate.size) * SCALES.rate)
    effect = made(name, label, lambda p: p.neutral if p.name == "sticking" else off_neutral(p))
    slow, fast = rates([effect], at, own=True), rates([effect], at._replace(rate=2 * at.rate), own=True)
    follows = all(np.allclose(fast[s], slow[s] if s == "force" else 2 * slow[s], rtol=1e-12, atol=1e-9) for s in slow)
    assert EFFECTS[name].needs_time is not follows


@pytest.mark.parametrize(
    ("name", "label"), by_default([(n, label) for n in EFFECTS for label in forms_of(EFFECTS[n])], has_default_driver)
)
def test_contributions_have_the_derivatives_of_central_differences(name, label):
    effect, form = EFFECTS[name], forms_of(EFFECTS[name])[label]
    values = {key: off_neutral(known) for key, known in form.parameters(effect).items()}

    def of(theta):
        return contributions(effect(**form.held, **dict(zip(values, theta, strict=False))))

    # As many numbers for every effect, so that each operation is compiled for one shape; nothing depends on the last of them.
    theta, step = np.pad(list(values.values()), (0, MOST_PARAMETERS - len(values))), 1e-6
    exact = jax.jacfwd(of)(jnp.asarray(theta))
    directions = step * np.eye(MOST_PARAMETERS)
    above, below = (jax.vmap(of)(theta + moved) for moved in (directions, -directions))
    for slot, slopes in exact.items():
        found = np.moveaxis((np.asarray(above[slot]) - np.asarray(below[slot])) / (2 * step), 0, -1)
        sizes = np.abs(np.asarray(slopes)).max()
        np.testing.assert_allclose(found, slopes, rtol=1e-6, atol=1e-7 * sizes)


def test_no_two_effects_own_one_state():
    owned = {(name, state) for name, label in SPRING_FORMS for state in active(name, label).states}
    shared = {state.name for name, label in SPRING_FORMS for state in active(name, label).needs}
    names = [state for _, state in owned]
    assert len(names) == len(set(names))
    assert not shared & set(names)
    assert shared == {
        "largest_elongation",
        "largest_tension",
        "largest_compression",
        "travel",
        "reversals",
        "fatigue",
    }


def orders(names: tuple[str, ...] = SPRING, limit: int = 6) -> list[tuple[str, ...]]:
    """All orders while they are few; else the first, its reverse and random ones."""
    if len(names) <= 3:
        return list(permutations(names))
    draw = np.random.default_rng(0)
    return [names, names[::-1], *(tuple(map(str, draw.permutation(names))) for _ in range(limit - 2))]


@pytest.mark.whole
def test_effects_commute_in_the_law():
    # In its last form, too, which is another one wherever there are several.
    for last in (False, True):
        labels = {name: [label for other, label in SPRING_FORMS if other == name][-1 if last else 0] for name in SPRING}
        first, *others = (rates([active(name, labels[name]) for name in order]) for order in orders())
        for other in others:
            for state, expected in first.items():
                np.testing.assert_allclose(other[state], expected, rtol=2e-13, atol=5e-14 * np.abs(expected).max())


def quantities_with(paper_simulator, pulse_conditions, names, values):
    """Quantities (3,) of the paper's experiment with these effects; `values` are inputs of the program."""
    simulator = paper_simulator(effects=names, scales=SCALES)
    program = jax.jit(lambda values, c: simulator.quantities({"A": 5e5, "beta": 1.0, **values}, c, QUANTITIES))
    quantities, ok = program(values, pulse_conditions(2.25, 1.0))
    assert ok
    return np.asarray(quantities)


def parameters(names, value) -> dict:
    """The named effects' parameters in their default forms by full name; `value` from metadata to number."""
    return {
        f"{n}.{key}": jnp.asarray(value(known))
        for n in names
        for key, known in default_form(EFFECTS[n]).parameters(EFFECTS[n]).items()
    }


@pytest.mark.whole
def test_all_effects_at_their_neutral_values_are_the_plain_model(paper_simulator, pulse_conditions):
    plain = quantities_with(paper_simulator, pulse_conditions, (), {})
    neutral = parameters(PRESENT, lambda p: p.neutral)
    nested = quantities_with(paper_simulator, pulse_conditions, PRESENT, neutral)
    np.testing.assert_allclose(nested, plain, rtol=1e-12)


@pytest.mark.whole
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


@pytest.mark.verification("effects")
@pytest.mark.parametrize(
    ("effect", "physical", "amount", "tolerance"),
    [("stiffness_degradation", "eta", 2e-5, 2e-7), ("strength_degradation", "nu", 5e-5, 3e-6)],
)
def test_degradation_equals_its_equation_integrated_by_scipy(
    paper_simulator, pulse_conditions, effect, physical, amount, tolerance, observed
):
    simulator = paper_simulator(effects=(effect,), scales=SCALES, timeline=Timeline(0.0025, 4000))

    @jax.jit
    def program(name_value, conditions):
        return simulator.quantities({"A": 5e5, "beta": 1.0, **name_value}, conditions, QUANTITIES)[0]

    for V_P, T_P in [(2.25, 1.0), (2.8, 0.7)]:
        conditions = pulse_conditions(V_P, T_P)
        truth = paper_by_scipy(V_P, T_P, **{physical: amount})
        found = program({f"{effect}.{physical}": jnp.asarray(amount)}, conditions)
        # A force that peaks before the reversal, as while strength degrades, is not found as closely.
        error = relative(found, truth)
        observed(
            f"{effect}: quantities of the paper's frame", "SciPy DOP853, from reversal to reversal", error, tolerance
        )
    same = program({f"{effect}.delta": jnp.asarray(amount * SCALES.energy)}, conditions)
    np.testing.assert_allclose(same, found, rtol=1e-12)
    assert np.abs(paper_by_scipy(V_P, T_P) / truth - 1).max() > 0.02  # the effect is far above the tolerance


def test_effects_of_the_same_energy_state_share_it():
    effects = tuple(active(name) for name in ("stiffness_degradation", "strength_degradation"))
    assert list(Specimen(BoucWen(**LAW), effects).start()) == ["hysteretic", "energy"]


# --- whole responses: structure and test rig ---------------------------------------------------------------------


CHANNELS = ("force", "elongation", "elongation_rate", "energy")
STEP, STEPS = 1 / 64, 192
CHARACTERISTIC = SCALES.elongation / SCALES.rate  # u_c/v_c [s]
THREE = {
    "masses": (8e3, 9e3, 5e3),
    "springs": (Spring((None, 0), 4e5), Spring((0, 1), 1e6), Spring((2, None), 3e5)),
    "specimens": ((2, 1),),
}


def imposed(amplitude: float = 0.2) -> Conditions:
    """A component test: two cycles of a sine of 1.5 s."""
    t, omega = np.arange(2 * STEPS + 1) * STEP / 2, 2 * np.pi / 1.5
    path = Imposed(jnp.asarray(amplitude * np.sin(omega * t)), jnp.asarray(amplitude * omega * np.cos(omega * t)))
    return Conditions({}, Recorded(Tabulated(path), jnp.full(STEPS, STEP)))


@pytest.fixture(scope="session", params=["shaken", "driven"])
def experiment(request, paper_simulator, pulse_conditions):
    """(kind, respond): respond(effects, their values) for a short experiment; `values` are inputs of the program."""
    base = {"scales": SCALES, "timeline": Timeline(STEP, STEPS)}
    is_shaken = request.param == "shaken"
    base |= {"structure": Structure(**THREE, damping=ModalDamping(0.05, 5e5))} if is_shaken else {"structure": None}
    conditions = pulse_conditions(2.25, 1.0) if is_shaken else imposed()
    programs = {}

    def respond(effects, values):
        if effects not in programs:
            simulator = paper_simulator(effects=effects, **base)
            programs[effects] = jax.jit(
                lambda values, c: simulator.respond({"A": 5e5, "beta": 1.0, **values}, c, CHANNELS)
            )
        response = programs[effects](values, conditions)
        assert response.ok
        return response

    return request.param, respond


def both(response) -> dict:
    """Quantities and channels by name."""
    return {name: np.asarray(value) for name, value in (response.quantities | response.channels).items()}


def some(name: str) -> dict:
    """Parameters of an effect, 0.1 off neutral."""
    return parameters((name,), lambda p: p.neutral + 0.1)


@pytest.mark.parametrize("name", SETUP)
def test_an_effect_outside_the_spring_changes_what_it_says(experiment, name):
    kind, respond = experiment
    effect = EFFECTS[name]
    # One program has them all: those that are neutral do nothing.
    idle = parameters(SETUP, lambda p: p.neutral)
    plain, neutral = both(respond((), {})), both(respond(SETUP, idle))
    # Every operation is exact (above, and below), but two programs may contract a·b + c differently.
    for key, expected in plain.items():
        np.testing.assert_allclose(neutral[key], expected, rtol=0, atol=1e-14 * np.abs(expected).max())
    changed = both(respond(SETUP, idle | some(name)))
    differs = {key for key in plain if np.abs(changed[key] - plain[key]).max() > 1e-3 * np.abs(plain[key]).max()}
    quantities = differs & set(QUANTITIES)
    if effect.shaken_only and kind == "driven":
        assert not differs
    elif effect.histories_only and kind == "shaken":
        assert differs and not quantities
    elif effect.histories_only:
        # Imposed is what was measured: a delay changes what the specimen feels, and so its whole response.
        assert "force" in differs
        assert "peak_elongation" not in differs
    else:
        assert quantities


@pytest.mark.whole
def test_the_order_of_effects_outside_the_spring_does_not_matter(experiment):
    _, respond = experiment
    values = {key: value for name in SETUP for key, value in some(name).items()}
    first, *others = (both(respond(order, values)) for order in orders(SETUP, 4))
    for other in others:
        for key, expected in first.items():
            np.testing.assert_allclose(other[key], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.verification("effects")
def test_gains_act_on_histories_quantities_and_energy(experiment, observed):
    kind, respond = experiment
    plain = both(respond((), {}))
    force = both(respond(("force_gain",), {"force_gain.delta": jnp.asarray(0.1)}))
    expected = {"force": 1.1, "energy": 1.1, "peak_force": 1.1, "dissipated_energy": 1.1}
    for key, value in plain.items():
        error = of_largest(force[key], expected.get(key, 1.0) * value)
        observed(f"force_gain: response of a {kind} specimen", "response times the gain", error, 1e-13)
    stretched = both(respond(("elongation_gain",), {"elongation_gain.delta": jnp.asarray(0.25)}))
    if kind == "shaken":
        untouched = {"force", "peak_force"}
        for key, value in plain.items():
            gained = (1.0 if key in untouched else 1.25) * value
            error = of_largest(stretched[key], gained)
            observed("elongation_gain: response of a shaken specimen", "response times the gain", error, 1e-13)
        return
    # The specimen saw a fifth less than was measured.
    simulator = Simulator(None, None, Timeline(STEP, STEPS), constants=(("gamma", 0.0), ("n", 1.0)))
    truth = both(jax.jit(lambda c: simulator.respond({"A": 5e5, "beta": 1.0}, c, CHANNELS))(imposed(0.2 / 1.25)))
    for key in ("elongation", "elongation_rate", "peak_elongation"):
        np.testing.assert_allclose(stretched[key], plain[key], rtol=1e-12, atol=1e-12)
    for key, gained in (("force", 1.0), ("peak_force", 1.0), ("energy", 1.25), ("dissipated_energy", 1.25)):
        error = of_largest(stretched[key], gained * truth[key])
        observed("elongation_gain: response of a driven specimen", "smaller imposed elongation", error, 1e-10)


@pytest.mark.verification("effects")
def test_zero_shift_and_drift_are_in_newtons_and_newtons_per_second(experiment, observed):
    kind, respond = experiment
    plain = both(respond((), {}))
    values = {"force_offset.offset": jnp.asarray(2e3), "force_drift.drift": jnp.asarray(-500.0)}
    found = both(respond(("force_offset", "force_drift"), values))
    expected = plain["force"] + 2e3 - 500.0 * STEP * np.arange(STEPS + 1)
    error = of_largest(found["force"], expected)
    observed(f"force_offset and force_drift: force of a {kind} specimen", "force plus a straight line", error, 1e-12)
    at_end = both(respond(("force_drift",), {"force_drift.delta": jnp.asarray(0.1)}))["force"] - plain["force"]
    assert at_end[-1] == pytest.approx(0.1 * SCALES.force * STEPS * STEP / (100 * CHARACTERISTIC), rel=1e-9)


@pytest.mark.verification("effects")
@pytest.mark.parametrize(("name", "samples"), [("actuator_delay", 3), ("time_offset", 3), ("time_offset", -2)])
def test_a_delay_of_whole_samples_moves_histories_by_them(experiment, name, samples, observed):
    kind, respond = experiment
    plain = both(respond((), {}))
    found = both(respond((name,), {f"{name}.tau": jnp.asarray(samples * STEP)}))
    if kind == "driven":
        late = samples if name == "time_offset" else -samples
        if late > 0:
            # Until the path begins, the specimen waits.
            np.testing.assert_allclose(found["force"][:late], 0.0, atol=1e-9 * plain["peak_force"])
            moved, shown = plain["force"][:-late], found["force"][late:]
            # This sine begins at full rate, which a step integrates as half of one.
            error = np.abs(shown - moved).max() / plain["peak_force"]
            observed(f"{name}: force of a driven specimen", "record moved by three samples", error, 1.5e-2)
        np.testing.assert_allclose(found["elongation"][9:-9], plain["elongation"][9:-9], atol=1e-12)
        return
    late = {"force": samples} if name == "time_offset" else {"elongation": samples, "elongation_rate": samples}
    for key, value in plain.items():
        count = late.get(key, 0)
        # Beyond the ends a history is constant.
        moved = value if key in QUANTITIES else value[np.clip(np.arange(value.size) - count, 0, value.size - 1)]
        observed(
            f"{name}: response of a shaken specimen", "records moved by samples", of_largest(found[key], moved), 1e-11
        )


@pytest.mark.verification("effects")
@pytest.mark.parametrize("delay", [0.037, -0.0213])
def test_a_shifted_signal_is_the_signal_at_another_time(delay, observed):
    draw = np.random.default_rng(0)
    time = np.concatenate([[0.0], np.cumsum(draw.uniform(0.5, 1.5, 400) * 0.005)])
    padded = np.pad(time, (0, 30), mode="edge")
    padded = jnp.asarray(padded)
    values = jnp.sin(7 * padded + 0.3)
    found = np.asarray(jax.jit(shifted)(values, padded, delay))
    expected = np.sin(7 * np.clip(padded - delay, 0, time[-1]) + 0.3)
    assert np.abs(found - expected).max() < 1e-4  # the last interval, whose slope is one-sided
    inside = (padded - delay > time[3]) & (padded - delay < time[-4])
    error = np.abs(found - expected)[inside]  # 0.15 h³ |y'''|/6 at most
    observed("time_offset: a sampled sine at other times", "sine", error, 4e-6)
    slope = np.asarray(jax.jit(jax.jacfwd(lambda d: shifted(values, padded, d)))(delay))
    assert np.isfinite(slope).all()
    np.testing.assert_allclose(slope[inside], -7 * np.cos(7 * (padded - delay) + 0.3)[inside], atol=5e-3)


def test_no_delay_changes_no_bit():
    draw = np.random.default_rng(1)
    time = np.pad(np.concatenate([[0.0], np.cumsum(draw.uniform(0.001, 0.1, 300))]), (0, 20), mode="edge")
    values = np.pad(draw.normal(size=301), (0, 20), mode="edge")
    for call in (shifted, jax.jit(shifted)):
        np.testing.assert_array_equal(call(jnp.asarray(values), jnp.asarray(time), jnp.asarray(0.0)), values)


# --- whole responses: an altered structure, and relaxation -------------------------------------------------------


ALTERED = {
    "damping_error": ({"delta": 0.4}, {}, 1.4),
    "mass_error": ({"delta": 0.1, "tilt": 0.2}, {"masses": (8e3 * 0.9, 9e3 * 1.1, 5e3 * 1.3)}, 1.0),
    "support_stiffness_error": (
        {"delta": -0.1, "tilt": 0.3},
        {"springs": (Spring((None, 0), 4e5 * 0.6), Spring((0, 1), 1e6), Spring((2, None), 3e5 * 1.2))},
        1.0,
    ),
}


@pytest.mark.verification("effects")
@pytest.mark.parametrize("name", ALTERED)
def test_an_error_of_the_structure_is_another_structure_with_the_damping_it_had(
    paper_simulator, pulse_conditions, name, observed
):
    values, changes, factor = ALTERED[name]
    nominal = Structure(**THREE, damping=ModalDamping(0.05, 5e5))
    simulator = paper_simulator(structure=nominal, effects=(name,), scales=SCALES, timeline=Timeline(STEP, STEPS))
    given = {f"{name}.{key}": value for key, value in values.items()}
    found = jax.jit(lambda c: simulator.respond({"A": 5e5, "beta": 1.0, **given}, c, CHANNELS))(
        pulse_conditions(2.25, 1.0)
    )

    @jax.jit
    def truth():
        other = Structure(**{**THREE, **changes}, damping=ModalDamping(0.07, 5e5))
        system = ShakenStructure(
            other, [Specimen(BoucWen(5e5, 1.0, 0.0, 1.0))], damping=factor * nominal.damping_matrix()
        )
        return integrate(system, NearFaultPulse(2.25, 1.0).forcing(STEP, STEPS), STEP, STEPS, channels=CHANNELS)

    expected = both(truth())
    for key, value in both(found).items():
        observed(
            f"{name}: response of three masses", "structure changed by hand", of_largest(value, expected[key]), 1e-11
        )
    if name == "damping_error":
        np.testing.assert_allclose(
            factor * np.asarray(nominal.damping_matrix()),
            Structure(**THREE, damping=ModalDamping(0.07, 5e5)).damping_matrix(),
            rtol=1e-12,
        )


@pytest.mark.verification("effects")
def test_a_gain_of_the_ground_motion_is_a_stronger_pulse(paper_simulator, pulse_conditions, observed):
    names = ("ground_motion_gain",)
    stronger = quantities_with(paper_simulator, pulse_conditions, names, {f"{names[0]}.delta": jnp.asarray(0.2)})
    simulator = paper_simulator()
    program = jax.jit(lambda c: simulator.quantities({"A": 5e5, "beta": 1.0}, c, QUANTITIES)[0])
    error = relative(stronger, program(pulse_conditions(2.25 * 1.2, 1.0)))
    observed("ground_motion_gain: quantities of the paper's frame", "stronger pulse", error, 1e-11)


@pytest.mark.verification("effects")
def test_relaxation_is_the_maxwell_element(observed):
    # u = a sin ωt from rest: q = k a ω τ/(1 + ω²τ²) (cos ωt + ωτ sin ωt − exp(−t/τ)).
    simulator = Simulator(
        None,
        None,
        Timeline(STEP, STEPS),
        EFFECTS.only(["relaxation"]),
        SCALES,
        (("gamma", 0.0), ("n", 1.0), ("beta", 0.0)),
    )
    k, tau, amplitude, omega = 3e5, 0.2, 0.2, 2 * np.pi / 1.5
    values = {"A": 1e5, "relaxation.k": k, "relaxation.tau": tau}
    response = both(jax.jit(lambda c: simulator.respond(values, c, CHANNELS))(imposed(amplitude)))
    t = np.arange(STEPS + 1) * STEP
    sine, cosine = np.sin(omega * t), np.cos(omega * t)
    size = k * amplitude * omega * tau / (1 + (omega * tau) ** 2)
    q = size * (cosine + omega * tau * sine - np.exp(-t / tau))
    force = 1e5 * amplitude * sine + q
    observed("relaxation: force along two cycles", "Maxwell element", of_largest(response["force"], force), 1e-6)
    work = np.concatenate(
        [[0.0], np.cumsum(np.diff(t) * 0.5 * ((f := force * amplitude * omega * cosine)[1:] + f[:-1]))]
    )
    np.testing.assert_allclose(response["energy"], work, rtol=0, atol=1e-3 * work.max())


# --- all effects at once -----------------------------------------------------------------------------------------


@pytest.mark.whole
def test_a_traced_simulator_with_the_whole_catalogue_gives_the_same(experiment, paper_simulator, pulse_conditions):
    kind, respond = experiment
    values = {key: value for name in PRESENT for key, value in some(name).items()}
    expected = both(respond(PRESENT, values))
    structure = Structure(**THREE, damping=ModalDamping(0.05, 5e5)) if kind == "shaken" else None
    simulator = paper_simulator(structure=structure, effects=PRESENT, scales=SCALES, timeline=Timeline(STEP, STEPS))
    conditions = pulse_conditions(2.25, 1.0) if kind == "shaken" else imposed()

    @jax.jit
    def program(simulator, values, conditions):
        return simulator.respond({"A": 5e5, "beta": 1.0, **values}, conditions, CHANNELS)

    found = both(program(simulator, values, conditions))
    for key, value in expected.items():
        np.testing.assert_allclose(found[key], value, rtol=0, atol=1e-10 * np.abs(value).max())
    other = simulator.__class__(**{**simulator.__dict__, "scales": Scales(*(2 * s for s in SCALES))})
    assert np.abs(both(program(other, values, conditions))["force"] - found["force"]).max() > 1e3


@pytest.mark.whole
def test_responses_have_the_derivatives_of_central_differences(paper_simulator, pulse_conditions):
    names = (*SETUP, "relaxation", "hardening", "cubic_stiffness", "viscous_damping", "isotropic_hardening")
    values = {key: float(value) for name in names for key, value in some(name).items()}
    structure = Structure(**THREE, damping=ModalDamping(0.05, 5e5))
    simulator = paper_simulator(structure=structure, effects=names, scales=SCALES, timeline=Timeline(STEP, STEPS))

    def of(theta):
        given = dict(zip(values, theta, strict=True))
        return both_traced(simulator.respond({"A": 5e5, "beta": 1.0, **given}, pulse_conditions(2.25, 1.0), CHANNELS))

    def both_traced(response):
        return response.quantities | response.channels

    theta, step = np.array(list(values.values())), 1e-6
    moved = jax.jit(jax.vmap(of))(theta + step * np.concatenate([np.eye(theta.size), -np.eye(theta.size)]))
    exact = jax.jit(jax.jacfwd(of))(jnp.asarray(theta))
    for key, slopes in exact.items():
        above, below = np.split(np.asarray(moved[key]), 2)
        found = np.moveaxis((above - below) / (2 * step), 0, -1)
        error = np.abs(found - np.asarray(slopes)).max() / np.abs(np.asarray(slopes)).max()
        assert error < 1e-6, key
