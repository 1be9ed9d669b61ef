"""The formulas that learned functions are: shapes against NumPy, curves of known formulas, files of effects, findings in SI."""

import math
from dataclasses import replace

import jax
import numpy as np
import pytest
from builders.instants import RANDOM, SCALES, point, states
from numpy.polynomial import chebyshev

from hsed_jax.discovery.effect_file import source_of, source_of_curve
from hsed_jax.discovery.findings import Curve, Discovery, Tried
from hsed_jax.discovery.formulas import Formula, Term, formulas, in_text
from hsed_jax.discovery.grammar import OF_DIRECTION, SHAPES
from hsed_jax.discovery.places import Place
from hsed_jax.physics.effects import registered
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import COUNTS
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.python_files import executed

F, U, V, E = SCALES
BY_CODE = {shape.code: shape for shape in SHAPES}

# --- formulas ----------------------------------------------------------------------------------------------------

NUMPY = {
    "1.0": lambda x: np.ones_like(x),
    "{x} ** 2": lambda x: x * x,
    "{x} * jnp.abs({x})": lambda x: np.sign(x) * x**2,
    "jnp.sign({x}) * jnp.maximum(jnp.abs({x}), 1e-6) ** {p}": lambda x, p: np.where(x > 0, np.abs(x) ** p, -(np.abs(x) ** p)),
    "jnp.tanh({x} / {b})": lambda x, b: 1 - 2 / (np.exp(2 * x / b) + 1),
    "jnp.exp(-jnp.abs({x}) / {b})": lambda x, b: np.minimum(np.exp(x / b), np.exp(-x / b)),
    "jnp.log(1.0 + jnp.abs({x}) / {b})": lambda x, b: np.log((b + np.hypot(x, 0)) / b),
    "jnp.sin({k} * {x})": lambda x, k: np.imag(np.exp(1j * k * x)),
    "jnp.cos({k} * {x})": lambda x, k: np.real(np.exp(1j * k * x)),
    "jnp.maximum({m} - {x}, 0.0)": lambda x, m: np.where(x < m, m - x, 0),
    "jnp.maximum(jnp.abs({x}) - {m}, 0.0)": lambda x, m: np.where(x > m, x - m, np.where(x < -m, -m - x, 0)),
    "jnp.maximum({x} - {m}, 0.0) ** 2": lambda x, m: np.where(x > m, x**2 - 2 * m * x + m**2, 0),
    "0.5 * (1.0 + jnp.tanh(({x} - {m}) / {b}))": lambda x, m, b: 1 / (1 + np.exp(-2 * (x - m) / b)),
    "0.5 * (1.0 + jnp.tanh((jnp.abs({x}) - {m}) / {b}))": lambda x, m, b: 1 / (1 + np.exp(-2 * (np.abs(x) - m) / b)),
    "jnp.exp(-((({x} - {m}) / {b}) ** 2))": lambda x, m, b: np.exp(-(x * x - 2 * m * x + m * m) / b**2),
}  # fmt: skip


def drawn(shape, low=-1.2, high=0.9):
    """Numbers of a shape among those that are tried."""
    tried = shape.tried(low, high)
    return tried[int(RANDOM.integers(len(tried)))]


@pytest.mark.parametrize("code", NUMPY)
def test_a_shape_is_its_equation(code):
    shape, x = BY_CODE[code], RANDOM.uniform(-1.2, 0.9, 60)
    for _ in range(5):
        numbers = drawn(shape)
        np.testing.assert_allclose(shape.at(x, numbers), NUMPY[code](x, *numbers), rtol=1e-9, atol=1e-12)
        text = shape.text.format(x="x", **{n.symbol: repr(v) for n, v in zip(shape.numbers, numbers, strict=True)})
        assert "{" not in text and "{" not in shape.code.format(x="x", **dict.fromkeys("bkmp", "1"))


def stiff(count, seed):
    """What holds coefficients, well conditioned and otherwise random; a deviation of each that it allows."""
    draw = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(draw.normal(size=(count, count)))
    strength = (turned * np.geomspace(3e4, 3e5, count)) @ turned.T
    return strength, draw.multivariate_normal(np.zeros(count), np.linalg.inv(strength))


def coefficients_of(place, reaches, f):
    """Of the polynomials, by the orthogonality of cosines."""
    theta = np.pi * (np.arange(240) + 0.5) / 240
    x = [0.5 * (low + high) + 0.5 * (high - low) * np.cos(theta) for low, high in reaches]
    waves = np.cos(np.outer(np.arange(COUNTS[0]), theta)) * (2 / 240)
    waves[0] /= 2
    degrees = np.asarray(place.degrees)
    if len(x) == 1:
        return (waves @ f(x[0]))[degrees[:, 0]]
    return (waves @ f(*np.meshgrid(*x, indexing="ij")) @ waves.T)[degrees[:, 0], degrees[:, 1]]


STEP_IN_RATE, DECAY = "0.5 * (1.0 + jnp.tanh((jnp.abs({x}) - {m}) / {b}))", "jnp.exp(-jnp.abs({x}) / {b})"
# Place, reaches, logarithm of the factor or force over F_c; and the codes, numbers, form and size that it is.
TRUTHS = {
    "a power, by direction": (
        Place("force", ("energy", "direction")), [(0.0, 2.0), (-1.0, 1.0)],
        lambda x, d: 0.3 * x**1.5 * d, ("jnp.maximum(jnp.abs({x}), 1e-6) ** {p}", "{x}"), [1.5], "force", 0.3,
    ),
    "a sine": (
        Place("force", ("elongation",)), [(-1.1, 0.9)],
        lambda x: 0.2 * np.sin(5.1 * x), ("jnp.sin({k} * {x})",), [5.1], "force", 0.2,
    ),
    "a step in rate": (
        Place("nu", ("rate",)), [(-1.5, 1.5)],
        lambda x: 0.8 / (1 + np.exp(-2 * (np.abs(x) - 0.75) / 0.18)), (STEP_IN_RATE,), [0.75, 0.18], "exponential", 0.8,
    ),
    "a linear decay": (
        Place("a", ("energy",)), [(0.0, 1.6)], lambda x: np.log(1 + 2 * np.exp(-x / 0.4)), (DECAY,), [0.4], "linear", 2.0,
    ),
    "an exponential decay": (
        Place("a", ("energy",)), [(0.0, 1.6)], lambda x: -0.7 * np.exp(-x / 0.4), (DECAY,), [0.4], "exponential", -0.7,
    ),
    "a reciprocal decay": (
        Place("h", ("energy",)), [(0.0, 1.6)], lambda x: -np.log(1 + 2 * np.exp(-x / 0.4)), (DECAY,), [0.4], "reciprocal", 2.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", TRUTHS)
def test_a_curve_is_the_formula_that_it_was_made_of(case):
    place, reaches, f, codes, numbers, form, size = TRUTHS[case]
    curve = coefficients_of(place, reaches, f)
    strength, noise = stiff(len(curve), len(case))
    found = formulas(place, reaches, curve + noise, strength, 8)
    first = found[0]
    assert (tuple(term.shape.code for term in first.terms), first.form) == (codes, form)
    np.testing.assert_allclose([v for term in first.terms for v in term.numbers], numbers, rtol=0.03)
    assert first.size == pytest.approx(size, rel=0.05)
    x = [one.ravel() for one in np.meshgrid(*(np.linspace(*reach, 30) for reach in reaches))]
    exact = f(*x) if form == "force" else np.exp(f(*x))
    np.testing.assert_allclose(first.value(*x), exact, atol=0.05 * np.ptp(exact))
    assert len(found) == 8 == len({(one.form, *(term.shape for term in one.terms)) for one in found})
    assert [one.cost for one in found] == sorted(one.cost for one in found)
    # Half of χ² with as many degrees of freedom as coefficients, less those fitted, beside what numbers must be worth.
    assert first.cost < 0.5 * len(curve) + 3 * math.sqrt(len(curve)) + 4 * (1 + len(numbers)) + 10


def test_a_formula_reads_as_one_types_it():
    place = Place("nu", ("rate", "energy"))
    terms = (Term(BY_CODE["{x} ** 2"], ()), Term(BY_CODE[DECAY], (0.4,)))
    names = [COORDINATES[name].text for name in place.of]
    said = {
        form: in_text(Formula(place, terms, -0.25, form, 0.0), names)
        for form in ("exponential", "linear", "reciprocal")
    }
    assert said["exponential"] == "exp(-0.25 (v/v_c)^2 exp(-|e/E_c|/0.4))"
    assert said["linear"] == "1 - 0.25 (v/v_c)^2 exp(-|e/E_c|/0.4)"
    assert said["reciprocal"].startswith("1/(1 ")
    alone = Formula(Place("force", ("elongation",)), terms[:1], 0.5, "force", 0.0)
    assert in_text(alone, ["u/u_c"]) == "F_c 0.5 (u/u_c)^2"


# --- the file of an effect ---------------------------------------------------------------------------------------


@pytest.fixture
def effect_of(tmp_path):
    """A factory: the effect that the file of a source makes."""

    def make(source, name):
        path = tmp_path / f"{name}.py"
        path.write_text(compiled(source), encoding="utf-8")
        (effect,) = registered(executed(path))
        assert effect.name == name and effect.family == "learned"
        return effect

    return make


def compiled(source):
    compile(source, "learned", "exec")
    return source


def contributed(effect, at, slot, **numbers):
    found = jax.vmap(effect(**numbers).contribute)(point(at))
    assert found.keys() == {slot}
    return found[slot]


@pytest.mark.parametrize("form", ["force", "exponential", "linear", "reciprocal"])
def test_the_file_of_a_formula_contributes_what_the_formula_says(form, effect_of):
    at, slot = states(), "force" if form == "force" else "h"
    reach, x = (-0.9, 1.1), np.clip(at["u"] / U, -0.9, 1.1)
    for number, shape in enumerate(SHAPES):
        place = Place(slot, ("elongation",))
        formula = Formula(place, (Term(shape, drawn(shape, *reach)),), -0.4 if number % 2 else 0.3, form, 0.0)
        effect = effect_of(source_of(formula, [reach], f"formula_{number}"), f"formula_{number}")
        free = {f"{n.symbol}_1": v for n, v in zip(shape.numbers, formula.terms[0].numbers, strict=True)}
        assert set(parameters_of(effect)) == {"a", *free}
        found = contributed(effect, at, slot, a=formula.size, **free)
        np.testing.assert_allclose(found, formula.value(x) * (F if form == "force" else 1.0), rtol=1e-9, atol=1e-6)
        # The defaults are the numbers, but for the size: an effect that does nothing.
        assert {key: parameters_of(effect)[key].neutral for key in free} == pytest.approx(free, rel=1e-5)
        np.testing.assert_array_equal(contributed(effect, at, slot), 0.0 if form == "force" else 1.0)


def test_the_file_of_a_product_has_the_states_that_it_needs(effect_of):
    at, place = states(), Place("force", ("recent_path", "direction"), 2.5)
    terms = (Term(BY_CODE[DECAY], (0.6,)), Term(OF_DIRECTION[1], ()))
    formula, reaches = Formula(place, terms, 0.2, "force", 0.0), [(0.1, 1.5), (-1.0, 1.0)]
    effect = effect_of(source_of(formula, reaches, "learned_effect"), "learned_effect")
    assert set(parameters_of(effect)) == {"a", "b_1", "fade"} and parameters_of(effect)["fade"].neutral == 2.5
    assert effect().states == ("recent_path",) and effect().needs == () and effect.needs_time
    found = contributed(effect, at, "force", a=0.2, b_1=0.6)
    expected = F * formula.value(np.clip(at["recent_path"], 0.1, 1.5), np.tanh(at["v"] / (0.02 * V)))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    rate = jax.vmap(effect(fade=2.5).flow)(point(at))["recent_path"]
    np.testing.assert_allclose(rate, np.abs(at["v"]) / U - at["recent_path"] * V / (2.5 * U), rtol=1e-12)
    place = Place("nu", ("largest_elongation", "since_reversal"))
    effect = effect_of(source_of(Formula(place, (terms[0], terms[0]), 0.2, "linear", 0.0), reaches, "other"), "other")
    assert set(parameters_of(effect)) == {"a", "b_1", "b_2"} and not effect().states and not effect.needs_time
    assert [state.name for state in effect().needs] == ["largest_elongation", "last_reversal"]


def curve_of(place, formula=None):
    count = len(place.degrees)
    reaches = ((-0.8, 0.5), (-1.0, 1.0))[: len(place.of)]
    spread = RANDOM.normal(scale=0.01, size=(count, count))
    return Curve(place, reaches, RANDOM.normal(scale=0.1, size=count), spread @ spread.T, formula)


@pytest.mark.parametrize("place", [Place("force", ("elongation", "direction")), Place("force", ("elongation", "rate")),
                                   Place("a", ("elongation",))], ids=lambda place: " ".join(place.of))  # fmt: skip
def test_the_file_of_a_curve_is_the_curve(place, effect_of):
    at, curve = states(), curve_of(place)
    effect = effect_of(source_of_curve(place, curve.reaches, curve.coefficients, "learned_effect"), "learned_effect")
    x = {"elongation": at["u"] / U, "direction": np.tanh(at["v"] / (0.02 * V)), "rate": at["v"] / V}
    x = [x[name] for name in place.of]
    size = F if place.slot == "force" else 1.0
    np.testing.assert_allclose(
        contributed(effect, at, place.slot, a=1.0), size * curve.value(*x), rtol=1e-6, atol=1e-8 * size
    )
    table = np.zeros((COUNTS[0], len(COUNTS)))
    table[*np.transpose(place.degrees)] = curve.coefficients
    xi = [np.clip((2 * v - high - low) / (high - low), -1, 1) for v, (low, high) in zip(x, curve.reaches, strict=False)]
    mean, deviation = curve.smooth(*x)
    np.testing.assert_allclose(
        mean, chebyshev.chebval2d(xi[0], xi[1] if xi[1:] else 0 * xi[0], table), rtol=1e-9, atol=1e-12
    )
    draws = RANDOM.multivariate_normal(curve.coefficients, curve.covariance, 4000)
    many = np.stack([replace(curve, coefficients=one).smooth(*x)[0] for one in draws[:400]])
    np.testing.assert_allclose(many.std(axis=0), deviation, rtol=0.2)


# --- findings ----------------------------------------------------------------------------------------------------


def discovery():
    place = Place("force", ("elongation", "rate"))
    formula = Formula(place, (Term(BY_CODE["{x} ** 2"], ()), Term(BY_CODE["{x}"], ())), 0.25, "force", 0.0)
    return Discovery(
        True, place=place, formula="F_c 0.25 …", probability=0.9, error=(0.3, 0.35), error_train=0.05, error_test=0.06,
        noise_floor=0.05, ranking=[Tried(place, 300.0, 0.9, 0.05)], curve=curve_of(place, formula), source="x = 1\n",
        scales=SCALES,
    )  # fmt: skip


def test_what_was_found_is_said_in_si(tmp_path):
    found = discovery()
    assert list(found.reach) == ["elongation", "rate"]
    np.testing.assert_allclose(list(found.reach.values()), [(-0.8 * U, 0.5 * U), (-V, V)])
    u, v = np.asarray([-0.1, 0.05, 0.9]), np.asarray([0.3, -3.0, 0.6])
    expected = 0.25 * F * (np.clip(u, -0.8 * U, 0.5 * U) / U) ** 2 * np.clip(v, -V, V) / V
    np.testing.assert_allclose(found.value({"rate": v, "elongation": u}), expected, rtol=1e-12)
    lines = found.lines()
    assert [line.at for line in lines] == pytest.approx([-V, 0.0, V])
    for line in lines:
        np.testing.assert_allclose(line.formula, 0.25 * F * (line.x / U) ** 2 * line.at / V, atol=1e-9 * F)
        assert (line.low < line.mean).all() and (line.mean < line.high).all()
        mean, deviation = found.curve.smooth(line.x / U, np.full(line.x.size, line.at / V))
        np.testing.assert_allclose(
            [line.mean, line.high], F * np.asarray([mean, mean + 1.645 * deviation]), atol=1e-4 * F
        )
    found.write(tmp_path / "it.py")
    assert (tmp_path / "it.py").read_text() == "x = 1\n"


def test_a_factor_is_a_factor():
    place = Place("nu", ("elongation",))
    formula = Formula(place, (Term(BY_CODE["jnp.abs({x})"], ()),), 0.5, "linear", 0.0)
    found = replace(discovery(), place=place, curve=curve_of(place, formula))
    np.testing.assert_allclose(found.value({"elongation": np.asarray([-0.1, 0.0])}), [1.2, 1.0])
    (line,) = found.lines()
    assert line.at is None and (line.low > 0).all()
    np.testing.assert_allclose(line.mean**2, line.low * line.high, rtol=1e-9)


def test_the_summary_has_the_keys_of_its_contract(tmp_path):
    found = discovery()
    content = found.summary()
    assert content.keys() >= {"found", "place", "formula", "probability", "error_train", "error_test", "file"}
    assert content["found"] is True and content["place"] == {"slot": "force", "of": ["elongation", "rate"]}
    assert (
        content["file"] == "learned_effect.py"
        and replace(found, effect="learned_effect_2").file == "learned_effect_2.py"
    )
    assert "a force parallel to the element that depends on the elongation and the rate" in repr(found)
    nothing = Discovery(False, "the noise explains the residual")
    assert nothing.summary().items() >= {"found": False, "reason": "the noise explains the residual"}.items()
    assert "nothing was learned: the noise" in repr(nothing) and nothing.reach == {}
    with pytest.raises(ValueError, match="the noise explains"):
        nothing.write(tmp_path / "it.py")
