"""The sequential design: its space, Eq. 12, and the laws that `init`, `ask`, `tell` keep."""

import dataclasses
from copy import deepcopy
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from hsed_jax.design.acquisition import sobol_candidates
from hsed_jax.design.acquisitions.expected_improvement import ExpectedImprovement
from hsed_jax.design.discrepancy import discrepancy, variance_over
from hsed_jax.design.drift import shares
from hsed_jax.design.feasible import too_near
from hsed_jax.design.sequential import DesignState, SequentialDesign, Trial
from hsed_jax.design.space import SAME_POINT, InputSpace, Point
from hsed_jax.design.teaching import told
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Error
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.priors import Prior

# --- the space of inputs -----------------------------------------------------------------------------------------

SPACE = InputSpace(
    {
        "V_P": Prior("uniform", [150.0, 300.0]),
        "T_P": Prior("normal", [1.0, 0.1]),
        "scale": Prior("lognormal", [0.0, 0.5]),
    },
    {"V_P": "cm/s", "T_P": "s", "scale": "1"},
    {"V_P": 0.01, "T_P": 1.0, "scale": 1.0},
)
TRUTHS = (stats.uniform(150, 150), stats.norm(1.0, 0.1), stats.lognorm(0.5))


def test_cube_and_declared_units_are_inverse_to_each_other():
    cube = np.random.default_rng(0).uniform(0.001, 0.999, (50, 3))
    np.testing.assert_allclose(SPACE.cube(SPACE.declared(cube)), cube, atol=1e-9)


def test_declared_inputs_are_the_quantiles_of_their_distributions():
    cube = np.random.default_rng(1).uniform(0.001, 0.999, (50, 3))
    expected = np.stack([truth.ppf(column) for truth, column in zip(TRUTHS, cube.T, strict=True)], axis=1)
    np.testing.assert_allclose(SPACE.declared(cube), expected, rtol=1e-7)


def test_inputs_reach_the_simulator_in_si():
    si = SPACE.si(np.array([[200.0, 1.1, 2.0]]))
    assert {name: float(values[0]) for name, values in si.items()} == {"V_P": 2.0, "T_P": 1.1, "scale": 2.0}


def test_initial_points_are_sobols_sequence_without_its_corner():
    expected = [[0.5, 0.5], [0.75, 0.25], [0.25, 0.75], [0.375, 0.375], [0.875, 0.875]]
    plane = InputSpace({n: Prior("uniform", [0, 1]) for n in "ab"}, {n: "1" for n in "ab"}, {n: 1.0 for n in "ab"})
    for count in (1, 2, 3, 4, 5):
        np.testing.assert_array_equal(plane.initial_design(count), expected[:count])


@pytest.mark.parametrize(("low", "high"), [(1.5, 3.0), (1e-7, 1e-6), (2e8, 9e8)])
def test_bounds_are_those_of_the_distribution_whatever_the_unit(low, high):
    space = InputSpace({"x": Prior("uniform", [low, high])}, {"x": "1"}, {"x": 1.0})
    np.testing.assert_allclose(space.bounds(), [[low, high]], rtol=1e-5)


# --- Eq. 12 ------------------------------------------------------------------------------------------------------


def norm(measured, predicted, variance, weights, groups):
    return jax.jit(lambda *of: discrepancy(*of, groups))(measured, predicted, variance, weights)


def test_discrepancy_is_equation_12_by_hand():
    measured, predicted = jnp.array([[10.0, 2.0], [20.0, 3.0]]), jnp.array([[13.0, 2.5], [20.0, 5.0]])
    # (10 − 13)²/9 + (2 − 2.5)²/0.25 = 2, and 0 + (3 − 5)²/0.25 = 16
    variance = jnp.array([9.0, 0.25])
    found = norm(measured, predicted, variance, jnp.ones((2, 2)), np.arange(2))
    np.testing.assert_array_equal(found, [2.0, 16.0])


def test_the_same_misfit_counts_the_same_whatever_else_is_missing():
    # Two quantities and a history of four samples, every one a standard deviation off: three outputs, the norm is 3.
    groups, variance = np.array([0, 1, 2, 2, 2, 2]), jnp.array([4.0, 0.25, *[4 * 9.0] * 4])
    off = jnp.array([2.0, 0.5, 3.0, 3.0, 3.0, 3.0])
    weights = jnp.array(
        [[1, 1, 1, 1, 1, 1], [0, 1, 1, 1, 1, 1], [1, 0, 1, 0, 0, 1], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 0, 0]], float
    )
    found = norm(jnp.tile(off, (5, 1)), jnp.zeros((5, 6)), variance, weights, groups)
    np.testing.assert_allclose(found, [3.0, 3.0, 3.0, 3.0, np.nan])


def test_of_an_incomplete_experiment_the_norm_is_the_mean_of_what_was_measured():
    # By hand: outputs of 1 and 0.25 of their variances, the third missing: 3/2·1.25.  A history of which half is there, alone.
    groups, variance = np.array([0, 1, 2, 2]), jnp.array([9.0, 0.25, 2.0, 2.0])
    measured = jnp.array([[3.0, 0.25, 7.0, 7.0], [1e30, 1e30, 2.0, 1e30]])
    weights = jnp.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    found = norm(measured, jnp.zeros((2, 4)), variance, weights, groups)
    np.testing.assert_allclose(found, [1.5 * 1.25, 3.0 * 2**2])


def test_variance_over_inputs_passes_over_diverged_simulations():
    values = np.random.default_rng(0).normal(3.0, 2.0, (40, 2))
    ok = np.arange(40) % 4 != 0
    junk = np.where(ok[:, None], values, 1e9)
    np.testing.assert_allclose(
        variance_over(jnp.asarray(junk), jnp.asarray(ok, float), np.arange(junk.shape[1])), values[ok].var(axis=0)
    )


# --- a toy study: the model is a plane, the truth has a bump ------------------------------------------------------

BUMP = np.array([0.7, 0.3])


def truth(cube):
    """One measured quantity: what the model can say, and a bump that it cannot."""
    x = np.asarray(cube)
    return float(2.0 + x[0] + 0.5 * x[1] + 0.8 * np.exp(-30 * np.sum((x - BUMP) ** 2)))


def toy_posterior():
    def respond(theta, conditions):
        x = conditions.inputs
        return jnp.stack([theta[0] + theta[1] * x["a"] + 0.5 * x["b"]]), True

    priors = {"offset": Prior("uniform", [0.0, 5.0]), "slope": Prior("uniform", [0.0, 3.0])}
    return Posterior(Predictor(respond), priors, [Error(0.05, is_relative=True)], ["y"], np.arange(1))


@pytest.fixture(scope="module")
def toy():
    """A factory of designs that share one posterior."""
    posterior = toy_posterior()
    space = InputSpace({n: Prior("uniform", [0, 1]) for n in "ab"}, {n: "1" for n in "ab"}, {n: 1.0 for n in "ab"})

    def make(**changes) -> SequentialDesign:
        options = {
            "posterior": posterior, "space": space, "size": 16, "gaps": np.array([np.inf]),
            "settings": Settings(2, 10, 20), "starts": 2, "candidates": 512, "acquisition": "expected_improvement",
            "kriging": {"starts": 4}, "variance_over_parameters": False, "seed": 0,
        }  # fmt: skip
        return SequentialDesign(**{**options, **changes})

    return make


@pytest.fixture(scope="module")
def campaign(toy):
    """A design that has asked eight times: itself, the states before each question, the answers."""
    design = toy()
    state, asked = begun(design), []
    for number in range(8):
        before = state
        chosen, state, info = design.ask(state, jax.random.key(number))
        asked.append((before, chosen, info))
        state = design.tell(state, chosen.tolist(), [truth(chosen)])
    return design, state, asked


def begun(design, count=4):
    state = design.init()
    for cube in design.space.initial_design(count):
        state = design.tell(state, cube.tolist(), [truth(cube)])
    return state


def same_state(one, other):
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        jax.tree.map(np.testing.assert_array_equal, a, b)


@pytest.mark.whole
def test_expected_improvement_finds_the_largest_discrepancy(campaign):
    _, state, _ = campaign
    tested = state.cube[4:]
    # The nearest of eight choices; of eight points at random the nearest would be 0.2 away on average.
    assert np.linalg.norm(tested - BUMP, axis=1).min() < 0.1
    best = max(
        range(len(state.trials)), key=lambda i: truth(state.cube[i]) - 2 - state.cube[i, 0] - 0.5 * state.cube[i, 1]
    )
    assert np.linalg.norm(state.cube[best] - BUMP) < 0.1


def test_no_point_is_tested_twice(campaign):
    _, state, _ = campaign
    points = state.cube
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(len(points))
    assert distance.min() > SAME_POINT


@pytest.mark.whole
def test_a_design_keeps_its_distance_and_replicates_do_not(campaign, toy):
    design, state, _ = campaign
    distance = np.linalg.norm(state.cube[:, None] - state.cube[None], axis=-1) + 9 * np.eye(len(state.trials))
    # A third of the mean distance of 16 experiments in a square.
    assert distance.min() >= 1 / 3 / 4
    free = toy(replicates=True)
    chosen, _, info = free.ask(state, jax.random.key(0))
    near = np.linalg.norm(state.cube - chosen, axis=1).min()
    best = np.argmax(ExpectedImprovement()(info.kriging, free.candidate_set, jax.random.key(0)))
    np.testing.assert_array_equal(chosen, np.asarray(free.candidate_set)[best])
    # It goes on where the discrepancy is largest; the other looks elsewhere.
    assert near < 1 / 3 / 4
    assert np.linalg.norm(state.cube - design.ask(state, jax.random.key(0))[0], axis=1).min() >= 1 / 3 / 4


@pytest.mark.parametrize("d", [1, 2, 3])
def test_planned_experiments_never_close_all_candidates_and_few_of_them_are_used_all_the_same(d):
    candidates = np.asarray(sobol_candidates(4096, d, 0))
    tested = [candidates[0]]
    for _ in range(39):
        closed = too_near(candidates, np.asarray(tested), 40, np.zeros(4096, bool))
        distance = np.linalg.norm(candidates[:, None] - np.asarray(tested)[None], axis=-1).min(axis=1)
        np.testing.assert_array_equal(closed, distance < 40 ** (-1 / d) / 3)
        # The worst that could happen: as dense as may be.
        tested.append(candidates[np.argmin(np.where(closed, np.inf, distance))])
    few = candidates[:2]
    open_one = ~too_near(few, few[:1] + 1e-3, 40, np.zeros(2, bool))
    assert open_one.tolist() == [False, True]
    assert not too_near(few[:1], few[:1] + 1e-3, 40, np.zeros(1, bool)).any()


@pytest.mark.whole
def test_a_drift_is_told_from_experiments_that_crowd(toy):
    # y = 2 + a + b/2 and a bump that the model does not know: a crowd there moves the estimates, a grid does not.
    design = toy(size=32)
    crowd = BUMP + 0.03 * np.random.default_rng(0).standard_normal((12, 2))
    grid = design.space.initial_design(16)
    both = design.init()
    for cube in [*grid, *crowd]:
        both = design.tell(both, cube.tolist(), [truth(cube)])
    even = design.init()
    for cube in grid:
        even = design.tell(even, cube.tolist(), [truth(cube)])
    crowded, spread = design.drift(both), design.drift(even)
    by = {name: crowded.designed[name] - spread.designed[name] for name in crowded.sd}
    moved = [name for name, sd in crowded.sd.items() if abs(by[name]) > 2 * sd]
    assert moved
    for name in moved:
        assert abs(crowded.over_inputs[name] - spread.over_inputs[name]) < 0.3 * abs(by[name])
    assert all(f"{name} is " in crowded.sentence({}) for name in moved)
    assert spread.sentence({}) is None


def test_the_shares_of_the_inputs_are_those_of_the_nearest():
    points = np.asarray(sobol_candidates(4096, 2, 0))
    found = shares(np.array([[0.25, 0.5], [0.75, 0.5], [0.75, 0.5 + 1e-9]]), points)
    assert found[0] == pytest.approx(0.5, abs=0.01) and found.sum() == pytest.approx(1.0)


def test_an_improvement_below_a_millionth_of_the_largest_is_shown_as_none():
    assert told([0.2, 0.05, 3e-7, 1e-9, 1e-44]) == [0.2, 0.05, 3e-7, 0.0, 0.0]
    assert told([]) == [] and told([0.0]) == [0.0]
    assert "by 0 % of it" in ExpectedImprovement.lesson(1e-44, [0.3])


@pytest.mark.whole
def test_few_candidates_are_used_up_one_by_one_and_then_there_are_none(toy):
    design = toy(candidates=4, acquisition="random")
    state = begun(design)
    for number in range(4):
        chosen, state, _ = design.ask(state, jax.random.key(number))
        state = design.tell(state, chosen.tolist(), [truth(chosen)])
    assert len({tuple(c) for c in state.cube[4:8]}) == 4
    with pytest.raises(ValueError, match="candidates"):
        design.ask(state, jax.random.key(9))


def test_ask_is_pure_same_state_and_key_same_answer(campaign):
    design, _, asked = campaign
    state, chosen, info = asked[3]
    copy = deepcopy(state)
    again, _, same = design.ask(state, jax.random.key(3))
    np.testing.assert_array_equal(again, chosen)
    assert same.expected_improvement == info.expected_improvement
    np.testing.assert_array_equal(same.chains.theta, info.chains.theta)
    same_state(state, copy)


def test_tell_leaves_the_old_state_alone(toy):
    design = toy()
    before = begun(design)
    after = design.tell(before, [0.1, 0.9], [1.0])
    assert len(before.trials) == 4 and len(after.trials) == 5
    same_state(before, begun(design))


@pytest.mark.whole
def test_a_full_design_makes_room_for_as_many_more(toy):
    design = toy(size=4)
    assert len(design.data(begun(design)).values) == 4
    state = design.tell(begun(design), [0.1, 0.9], [1.0])
    data = design.data(state)
    assert data.values.shape[0] == 8 and int(data.count) == 5
    assert design.ask(state, jax.random.key(0))[0].shape == (2,)


def test_steps_after_the_first_compile_nothing(toy):
    # The data grow by one experiment per step; they are padded to the planned size so that no program changes.
    compiled = []

    def listen(event, duration, **_):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(duration)

    design = toy(candidates=300)
    state = begun(design)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        counts = []
        for number in range(5):
            chosen, state, _ = design.ask(state, jax.random.key(number))
            state = design.tell(state, chosen.tolist(), [truth(chosen)])
            counts.append(len(compiled))
    finally:
        jax.monitoring.clear_event_listeners()
    assert counts[0] > 0, "the event that this test listens to has another name"
    assert counts[1:] == [counts[0]] * 4


def test_a_failed_experiment_is_not_asked_again_and_says_nothing_of_the_discrepancy(toy, campaign):
    design, _, asked = campaign
    state, chosen, _ = asked[2]
    failed = design.tell(state, chosen.tolist(), [np.nan])
    other, _, info = design.ask(failed, jax.random.key(2))
    assert np.linalg.norm(other - chosen) > SAME_POINT
    assert len(failed.trials) == len(state.trials) + 1
    mask = np.asarray(info.kriging.mask)
    assert mask.sum() == len(state.trials) and not mask[len(failed.trials) - 1]
    data = design.data(failed)
    assert float(data.weights.sum()) == len(state.trials)


def test_a_missing_quantity_counts_for_nothing_and_the_others_still_count():
    def respond(theta, conditions):
        return jnp.stack([theta[0] * conditions.inputs["a"], theta[0] + conditions.inputs["a"]]), True

    errors = [Error(0.05, is_relative=True), Error(0.1)]
    posterior = Posterior(Predictor(respond), {"t": Prior("uniform", [0, 5])}, errors, ["y", "z"], np.arange(2))
    space = InputSpace({"a": Prior("uniform", [0, 1])}, {"a": "1"}, {"a": 1.0})
    design = SequentialDesign(posterior, space, 3, np.full(2, np.inf), Settings(), 2, 16, "random", {}, False, 0)
    data = design.data(design.tell(design.init(), [0.5], [np.nan, 3.0]))
    np.testing.assert_array_equal(data.weights, [[0, 1], [0, 0], [0, 0]])
    assert float(data.values[0, 1]) == 3.0


@pytest.mark.whole
def test_a_model_that_diverges_at_a_tested_point_has_no_discrepancy_there(toy):
    def respond(theta, conditions):
        x = conditions.inputs
        y = theta[0] + theta[1] * x["a"] + 0.5 * x["b"]
        return jnp.stack([jnp.where((x["a"] == 0.75), jnp.nan, y)]), True

    priors = {"offset": Prior("uniform", [0.0, 5.0]), "slope": Prior("uniform", [0.0, 3.0])}
    errors = [Error(0.05, is_relative=True)]
    design = toy(posterior=Posterior(Predictor(respond), priors, errors, ["y"], np.arange(1)))
    state = begun(design)
    _, _, info = design.ask(state, jax.random.key(0))
    assert state.cube[1, 0] == 0.75
    assert np.isnan(info.discrepancy[1]) and np.isfinite(np.delete(info.discrepancy, 1)).all()
    np.testing.assert_array_equal(np.asarray(info.kriging.mask)[:4], [True, False, True, True])


def test_too_many_failures_are_said_and_not_computed_with(toy):
    design = toy()
    state = design.init()
    for cube in design.space.initial_design(3):
        state = design.tell(state, cube.tolist(), [np.nan])
    with pytest.raises(UserError, match="0 of 3 experiments"):
        design.ask(state, jax.random.key(0))


@pytest.mark.parametrize("acquisition", ["expected_improvement", "max_variance", "random", "sobol"])
def test_every_acquisition_asks_an_untested_point_of_the_cube(toy, acquisition):
    design = toy(acquisition=acquisition)
    state = begun(design)
    chosen, _, info = design.ask(state, jax.random.key(0))
    assert ((chosen >= 0) & (chosen <= 1)).all() and np.isfinite(info.value)
    assert np.linalg.norm(state.cube[:4] - chosen, axis=1).min() > SAME_POINT
    assert info.expected_improvement >= 0


@pytest.mark.parametrize("over_parameters", [False, True])
def test_reported_discrepancy_is_equation_12_at_the_map(toy, over_parameters):
    design = toy(variance_over_parameters=over_parameters)
    state = begun(design)
    _, _, info = design.ask(state, jax.random.key(0))
    offset, slope = np.asarray(info.maximum.theta)
    a, b = state.cube[:4].T
    residual = np.asarray([t.outputs[0] for t in state.trials[:4]]) - (offset + slope * a + 0.5 * b)
    # Var of slope·a + b/2 over the unit square: (slope² + 1/4)/12; 256 Sobol points carry it to 1 %.
    variance, tolerance = (slope**2 + 0.25) / 12, 0.02
    if over_parameters:
        # Total variance: its mean over the draws, and the variance of the mean; every second or third draw is taken.
        offsets, slopes = np.asarray(info.chains.theta).reshape(-1, 2).T
        variance, tolerance = np.mean((slopes**2 + 0.25) / 12) + np.var(offsets + slopes / 2), 0.1
    np.testing.assert_allclose(info.discrepancy, residual**2 / variance, rtol=tolerance)


def test_the_surrogate_of_a_step_is_made_again_from_what_the_journal_keeps(campaign):
    design, state, asked = campaign
    _, _, info = asked[4]
    again = design.surrogate(
        state, info.discrepancy.tolist(), np.asarray(info.kriging.lengths).tolist(), float(info.kriging.nugget)
    )
    points = jnp.asarray(np.random.default_rng(0).uniform(size=(20, 2)))
    for one, other in zip(again.predict(points), info.kriging.predict(points), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("status", "advice"), [("pending", "tell the results"), ("failed", "design.initial")])
def test_a_design_with_too_little_to_go_on_says_what_to_do_about_it(status, advice):
    point = Point(np.zeros(1), {"x": 0.0}, {"x": 0.0})
    trials = (Trial(point, np.ones(1), "completed"), Trial(point, np.full(1, np.nan), status))
    design = SimpleNamespace(space=SimpleNamespace(names=("x",)), kriging={})
    design.least = SequentialDesign.least.fget(design)
    with pytest.raises(UserError, match=f"only 1 of 2 experiments have usable results.*{advice}"):
        SequentialDesign._check_enough(design, DesignState(trials))
