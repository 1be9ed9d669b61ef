"""What no effect of the catalogue is: coordinates against NumPy, free functions and their evidence against SciPy."""

import math
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from builders.dictionary import FUNCTIONS, SIGMA, N, measured_of, rivals_problem
from builders.instants import RANDOM, SCALES, E, F, U, V, point, states
from builders.springs import spring_campaign, spring_study
from numpy.polynomial import chebyshev
from scipy.stats import multivariate_normal

import hsed_jax as hx
from hsed_jax.analysis.calibration import Calibration
from hsed_jax.analysis.discovery import _Beside, discover
from hsed_jax.config.load import load_study
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.diagnosis.search import Search
from hsed_jax.discovery.places import FADES, Motion, Place, Reaches, places, values
from hsed_jax.discovery.screen import evidence, learned, process
from hsed_jax.discovery.search import held_out_error
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign
from hsed_jax.physics.effects import EFFECTS, Catalogue
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import (
    COUNTS,
    DEGREES,
    POWERS,
    SLOTS,
    FreeForce,
    FreeFunction,
    deviations,
    powers_of,
)
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator, Timeline
from hsed_jax.study.build import Built

# --- coordinates in the simulation -------------------------------------------------------------------------------

STEP, STEPS, FINER = 1 / 400, 1200, 50
LAW = {"A": 5e5, "beta": 8.0, "gamma": 0.0, "n": 1.0}
# So little of a function, over F_c, that nothing follows from it; and a reach that nothing leaves.
LITTLE, REACH = 1e-6, 100.0


def motion(time):
    """Elongation and rate: cycles of two frequencies, which turn between the steps and leave smaller loops."""
    first, second = 2 * np.pi / 1.53, 2 * np.pi / 0.47
    elongation = 0.22 * np.sin(first * time) + 0.09 * np.sin(second * time)
    return elongation, 0.22 * first * np.cos(first * time) + 0.09 * second * np.cos(second * time)


@pytest.fixture(scope="module")
def pulled():
    """A program: the force of a component test with a free function of these parameters, or with none, (steps + 1,)."""
    elongation, rate = motion(np.arange(2 * STEPS + 1) * STEP / 2)
    conditions = Conditions(
        {}, Recorded(Tabulated(Imposed(jnp.asarray(elongation), jnp.asarray(rate))), jnp.full(STEPS, STEP))
    )
    neutral = {f"learned.{name}": p.neutral for name, p in parameters_of(FreeFunction).items()}
    plain = Simulator(None, None, Timeline(STEP, STEPS), scales=SCALES)
    free = replace(plain, effects=Catalogue.of([FreeFunction]))
    program = jax.jit(lambda numbers: free.respond({**LAW, **numbers}, conditions, ("force",)))

    def force(**numbers):
        if not numbers:
            response = plain.respond(LAW, conditions, ("force",))
        else:
            given = neutral | {f"learned.{name}": value for name, value in numbers.items()}
            response = program({name: jnp.asarray(float(value)) for name, value in given.items()})
        assert response.ok
        return np.asarray(response.channels["force"])

    return force


@pytest.fixture(scope="module")
def fine(pulled):
    """The same motion in fifty times as many samples; the force of the law between its steps."""
    time = np.arange(STEPS * FINER + 1) * STEP / FINER
    return Motion(time, *motion(time), np.interp(time, time[::FINER], pulled()))


# What NumPy makes of sums over samples misses, over the characteristic value: of rectangles half a sample.
ATOL = {"since_reversal": 1e-3, "energy": 3e-3} | dict.fromkeys(("recent_path", "lagged_elongation"), 2e-3)


@pytest.mark.parametrize("name", COORDINATES)
def test_a_coordinate_in_the_simulation_is_that_of_the_motion(name, pulled, fine):
    plain = pulled()
    for fade in FADES if COORDINATES[name].fades else (1.0,):
        numbers = {f"of_{name}_1": 1.0, "half_1": REACH, "fade": fade, "in_force": 1.0, "p_1_0": LITTLE * REACH}
        found = (pulled(**numbers) - plain) / (LITTLE * F)
        expected = values(name, fade, fine, SCALES)[::FINER]
        if name in ("direction", "force_along_motion"):
            # A direction turns over within some hundredths of the characteristic rate.
            is_moving = np.abs(fine.rate[::FINER]) > 0.12 * V
            assert is_moving.mean() > 0.8
            found, expected = found[is_moving], expected[is_moving]
        assert np.ptp(expected) > 0.3
        np.testing.assert_allclose(found, expected, atol=ATOL.get(name, 2e-4))


def test_reaches_are_the_ends_of_the_motion(fine):
    reaches = Reaches([fine, fine._replace(elongation=0.5 * fine.elongation)], SCALES)
    assert reaches.of(Place("force", ("elongation",))) == ((fine.elongation.min() / U, fine.elongation.max() / U),)
    assert reaches.of(Place("a", ("rate", "time"), 2.5))[1] == pytest.approx((0.0, STEP * STEPS * V / U))
    # What fades slower holds more of the path.
    highest = [reaches.of(Place("a", ("recent_path",), fade))[0][1] for fade in FADES]
    assert highest == sorted(highest) and highest[0] < highest[-1]
    still = Reaches([Motion(fine.time, *(np.zeros_like(fine.time) for _ in range(3)))], SCALES)
    for name in (name for name in COORDINATES if name != "time"):
        ((low, high),) = still.of(Place("force", (name,)))
        assert high - low >= 1.0


# --- the free function -------------------------------------------------------------------------------------------


def numbers_of(coefficients):
    return dict(zip(POWERS, powers_of(coefficients), strict=True))


def test_powers_are_those_of_the_polynomials_of_chebyshev():
    coefficients, (x, y) = RANDOM.normal(size=len(DEGREES)), RANDOM.uniform(-1, 1, (2, 50))
    table = np.zeros((COUNTS[0], len(COUNTS)))
    for (m, n), c in zip(DEGREES, coefficients, strict=True):
        table[m, n] = c
    powers = powers_of(coefficients)
    found = sum(p * x**m * y**n for (m, n), p in zip(DEGREES, powers, strict=True))
    # The largest power has the factor 2^16, so much is lost of sixteen digits.
    np.testing.assert_allclose(found, chebyshev.chebval2d(x, y, table), atol=1e-9)
    alone = coefficients * [n == 0 for _, n in DEGREES]
    found = sum(p * x**m for (m, _), p in zip(DEGREES, powers_of(alone), strict=True))
    np.testing.assert_allclose(found, chebyshev.chebval(x, alone[: COUNTS[0]]), atol=1e-9)
    many = RANDOM.normal(size=(3, len(DEGREES)))
    np.testing.assert_allclose(powers_of(many)[1], powers_of(many[1]), rtol=1e-12)


@pytest.mark.parametrize("of", [("elongation",), ("rate", "energy")])
def test_the_effect_is_the_polynomial_over_its_reach_and_held_beyond(of):
    place, at = Place("nu", of), states()
    reaches = {("elongation", 1.0): (-0.8, 0.5), ("rate", 1.0): (-1.0, 1.5), ("energy", 1.0): (0.0, 1.2)}
    table = np.zeros((COUNTS[0], len(COUNTS)))
    full = np.zeros(len(DEGREES))
    for m, n in place.degrees:
        full[DEGREES.index((m, n))] = table[m, n] = RANDOM.normal(scale=0.3) / (1 + m + n)
    effect = FreeFunction(**place.held([reaches[name, 1.0] for name in of]), **numbers_of(full))
    found = jax.vmap(effect.contribute)(point(at))
    x = {"elongation": at["u"] / U, "rate": at["v"] / V, "energy": at["energy"] / E}
    ends = [reaches[name, 1.0] for name in of]
    xi = [np.clip((2 * x[name] - high - low) / (high - low), -1, 1) for name, (low, high) in zip(of, ends, strict=True)]
    assert all(np.mean(np.abs(one) == 1) > 0.1 for one in xi)
    np.testing.assert_allclose(
        np.log(found["nu"]), chebyshev.chebval2d(xi[0], xi[1] if xi[1:] else 0 * xi[0], table), atol=1e-9
    )
    np.testing.assert_array_equal(found["force"], 0.0)
    np.testing.assert_array_equal(found["h"], 1.0)


def test_at_no_coefficients_it_does_exactly_nothing(pulled):
    is_on = {f"in_{slot}": 1.0 for slot in SLOTS}
    np.testing.assert_array_equal(pulled(**is_on, of_rate_1=1.0, of_energy_2=1.0), pulled())
    for kind in (FreeFunction, FreeForce):
        found = jax.vmap(kind(**{f"in_{slot}": 1.0 for slot in kind.slots}).contribute)(point(states()))
        assert found.keys() == set(kind.slots)
        for slot, value in found.items():
            np.testing.assert_array_equal(value, 0.0 if slot == "force" else 1.0)


def test_a_factor_stays_positive_whatever_the_coefficients():
    effect = FreeFunction(
        in_a=1.0, in_nu=-1.0, in_h=0.2, of_elongation_1=1.0, **dict.fromkeys(POWERS, 0.0) | {"p_1_0": 1e3}
    )
    found = jax.vmap(effect.contribute)(point(states()))
    for slot in SLOTS[1:]:
        assert (found[slot] >= math.exp(-3.001)).all() and (found[slot] <= math.exp(3.001)).all()
        assert np.ptp(found[slot]) > 10


@pytest.mark.parametrize("length", [0.4, 1.0, 2.5])
@pytest.mark.parametrize("size", [0.1, 1.0])
def test_deviations_are_those_of_a_process_of_this_size_and_length(length, size):
    theta = np.linspace(0, np.pi, 2001)
    own = deviations(length, size, COUNTS[0])
    columns = chebyshev.chebvander(np.cos(theta), COUNTS[0] - 1) * own
    variance = np.sum(columns**2, axis=1)
    assert np.trapezoid(variance, theta) / np.pi == pytest.approx(size**2, rel=1e-9)
    # Away from the ends, where images begin, what differs at a distance is that of Matérn 5/2, but for a constant.
    r = math.sqrt(5) * np.linspace(0.0, 0.3, 40) / length
    apart = chebyshev.chebvander(np.cos(np.pi / 2 + np.linspace(0.0, 0.3, 40)), COUNTS[0] - 1) * own - columns[1000]
    found, matern = np.sum(apart**2, axis=1), 1 - (1 + r + r**2 / 3) * np.exp(-r)
    if length < 1:
        np.testing.assert_allclose(found / found[-1], matern / matern[-1], atol=0.03)
    assert (np.diff(found) > 0).all()


# --- its evidence ------------------------------------------------------------------------------------------------


def standing(columns, r, law=None):
    """G and b of columns (N, m), the law's columns taken out."""
    M = np.eye(len(r)) if law is None else np.eye(len(r)) - law @ np.linalg.solve(law.T @ law, law.T)
    return columns.T @ M @ columns, columns.T @ M @ r


@pytest.mark.parametrize("seed", range(3))
def test_the_evidence_is_that_of_a_linear_model(seed):
    draw = np.random.default_rng(seed)
    J, law, own = draw.normal(size=(40, 6)), draw.normal(size=(40, 2)), draw.uniform(0.05, 2.0, 6)
    r = J @ (own * draw.normal(size=6)) + draw.normal(size=40)
    gain, most = evidence(*standing(J, r), own)
    alone = multivariate_normal(np.zeros(40), np.eye(40))
    with_function = multivariate_normal(np.zeros(40), np.eye(40) + (J * own**2) @ J.T)
    assert gain == pytest.approx(with_function.logpdf(r) - alone.logpdf(r), rel=1e-9)
    np.testing.assert_allclose(most, np.linalg.solve(J.T @ J + np.diag(own**-2.0), J.T @ r), rtol=1e-9)
    # A law that is as unsure as can be takes what it can, and nothing is gained from that.
    wide = 1e5 * law @ law.T + np.eye(40)
    gain, _ = evidence(*standing(J, r, law), own)
    before, after = (multivariate_normal(np.zeros(40), wide + more) for more in (0.0, (J * own**2) @ J.T))
    expected = after.logpdf(r) - before.logpdf(r)
    assert gain == pytest.approx(expected, abs=1e-3)
    assert evidence(*standing(law @ draw.normal(size=(2, 3)), r, law), own[:3])[0] == pytest.approx(0.0, abs=1e-6)


def test_every_place_has_a_process_with_as_many_deviations_as_coefficients():
    every = places(SLOTS, True)
    assert len({(place.slot, place.of, place.fade) for place in every}) == len(every)
    for place in every:
        own = process(place, 1.0, 0.3)
        assert own.shape == (len(place.degrees),) and (own > 0).all()
        assert set(place.degrees) <= set(DEGREES)
        held = place.held([(0.0, 1.0) for _ in place.of])
        assert set(held) <= set(parameters_of(FreeFunction))
    for place in places(SLOTS, False):
        assert not {"rate", "time", "recent_path", "lagged_elongation"} & set(place.of)
    assert {place.slot for place in places(("force",), True)} == {"force"}


def test_of_a_draw_of_a_process_its_size_is_learned():
    place = Place("force", ("elongation",))
    J = chebyshev.chebvander(RANDOM.uniform(-1, 1, 400), COUNTS[0] - 1) / 0.02
    for size in (0.03, 0.3):
        r = J @ (process(place, 1.0, size) * RANDOM.normal(size=COUNTS[0])) + RANDOM.normal(size=400)
        found = learned(*standing(J, r), place)
        assert 0.3 * size < np.linalg.norm(found.deviations) / np.linalg.norm(process(place, 1.0, 1.0)) < 3 * size
        gain, coefficients = evidence(*standing(J, r), found.deviations)
        # The best of twelve, beside their mean.
        assert gain - math.log(12) <= found.gain <= gain
        np.testing.assert_array_equal(coefficients, found.coefficients)
    nothing = learned(*standing(J, RANDOM.normal(size=400)), place)
    assert nothing.gain < 0


# --- what is refused ---------------------------------------------------------------------------------------------

CAMPAIGN = Campaign("measured", "displacement")
LINE = """
study: line
model: {function: mine.py:line, parameters: {a: {uniform: [0.0, 1.0]}}}
experiments: {campaign: nowhere}
observe: quantities
quantities: [peak_force]
error: {relative: 0.1}
steps: [calibrate]
"""
STOREYS = """
study: storeys
structure:
  masses: [8.0e3, 9.0e3]
  specimens: {lower: {between: [ground, 1]}, upper: {between: [1, 2]}}
  damping: {modal: 0.05, specimen_stiffness: 5.0e5}
excitation: {near_fault_pulse: {V_P: v, T_P: T}, duration: 2.0}
inputs: {v: {uniform: [0.5, 1.0], unit: m/s}, T: {uniform: [0.5, 1.0], unit: s}}
observe: quantities
quantities: [peak_force]
model: {parameters: {A: {uniform: [1.0e5, 1.0e6]}, beta: 8.0}}
experiments: {campaign: nowhere}
steps: [calibrate]
"""
FUNCTION = """
def line(parameters, inputs):
    return {"peak_force": parameters["a"] * inputs["v"]}
"""


def calibrated(study, campaign):
    """As if it were."""
    return Mock(Calibration, built=Built(study, campaign), campaign=campaign)


@pytest.mark.parametrize(
    ("content", "words"), [(LINE, "spring law.*function"), (STOREYS, "one specimen.*named specimens")]
)
def test_what_it_cannot_look_into_is_one_clear_message(content, words, tmp_path):
    (tmp_path / "mine.py").write_text(FUNCTION)
    (tmp_path / "study.yaml").write_text(content)
    table = pd.DataFrame({"id": ["E01"], "v": [0.6], "T": [0.7], "peak_force": [1e4]})
    measured = Campaign.from_frames(
        table, protocol="ground_motion", quantities={"peak_force": "N"}, inputs={"v": "m/s", "T": "s"}
    )
    fit = calibrated(load_study(tmp_path / "study.yaml"), measured)
    with pytest.raises(UserError, match=rf"^discover: .*{words}"):
        discover(fit)


def test_where_nothing_is_missing_or_all_is_named_nothing_is_learned():
    fit, error = calibrated(spring_study(), spring_campaign(0.0)), (0.05, 0.06)
    found = hx.discover(fit, diagnosis=Mock(Diagnosis, verdict="adequate", error=error))
    assert not found.found and found.reason == "the noise explains the residual" and found.error == error
    named = Mock(Diagnosis, verdict="missing_effects", effects=["slip", "gap"], is_explained=True, error=error)
    found = hx.discover(fit, diagnosis=named)
    assert not found.found and found.reason == "the catalogue explains the residual: slip and gap"


@pytest.mark.parametrize(
    "steps", [["discover"], ["calibrate", "compare", "discover"], ["calibrate", "discover", "compare", "diagnose"]]
)
def test_it_follows_a_diagnosis(steps):
    with pytest.raises(UserError, match=r"^steps: "):
        Built(spring_study(steps=steps), CAMPAIGN).check()
    with pytest.raises(UserError, match="put diagnose before it"):
        Built(spring_study(steps=["calibrate", "compare", "discover"]), CAMPAIGN).check()


@pytest.mark.parametrize(("taken", "name"), [([], "learned_effect"), (["learned_effect"], "learned_effect_2"),
                                             (["learned_effect", "learned_effect_2"], "learned_effect_3")])  # fmt: skip
def test_what_was_learned_before_keeps_its_name(taken, name):
    known = [type(one, (FreeForce,), {"name": one}) for one in taken]
    beside = SimpleNamespace(_built=SimpleNamespace(mechanics=SimpleNamespace(catalogue=EFFECTS.joined(known))))
    assert _Beside._name.fget(beside) == name


# --- what was not fitted -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("held_out", [0, 1, 3])
def test_what_was_held_out_is_the_judge_and_else_what_is_left_out_in_turn(held_out):
    random = np.random.default_rng(3)
    functions = np.concatenate([FUNCTIONS, random.standard_normal((len(FUNCTIONS), 3, FUNCTIONS.shape[2]))], axis=1)
    theta = np.zeros(len(FUNCTIONS))
    theta[:3] = 1.5, -0.7, 0.4
    values = np.einsum("k,knj->nj", theta, functions) + SIGMA * random.standard_normal(functions.shape[1:])
    problem = rivals_problem(functions, values[:N])
    search = Search(problem.models, problem.train, problem.law, problem.effects, lambda fit: False)
    search.start()
    search.run()
    assert search.best == {"effect_0"}
    if held_out:
        problem = problem._replace(test=measured_of(values[N : N + held_out]))
    now, before = ((problem.models, search.model(effects).fit) for effects in (search.best, ()))
    found = held_out_error(problem, search.standard.target, now, before)

    def residuals(fit):
        return values[N:] - np.einsum("k,knj->nj", problem.models.theta(fit.x, fit.submodel), functions[:, N:])

    if held_out:
        tested = values[N : N + held_out]
        error = np.sqrt(np.mean(residuals(now[1])[:held_out] ** 2)) / np.std(tested)
        assert found.error == pytest.approx(error)
    if held_out == 3:
        taken = np.mean(residuals(before[1]) ** 2 - residuals(now[1]) ** 2, axis=1) / np.mean(tested**2) / 3
        np.testing.assert_allclose(found.gain.parts, taken, rtol=1e-9)
    else:
        assert len(found.gain.parts) == N
    assert found.gain.total > found.gain.standard_error > 0
