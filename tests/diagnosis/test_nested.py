"""Coordinates in a box, and fits of nested models side by side: against SciPy's densities and SciPy's bounded least squares."""

from typing import ClassVar

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares, lsq_linear

from hsed_jax.diagnosis import nested
from hsed_jax.diagnosis.batch import Batch
from hsed_jax.diagnosis.box import Box, quadratic_minimum
from hsed_jax.diagnosis.fit_state import Target, Task
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.inference.priors import Prior
from hsed_jax.inference.watch import Watch

LAWS = {
    "uniform": ([2e5, 9e5], stats.uniform(2e5, 7e5)),
    "normal": ([0.4, 0.3], stats.norm(0.4, 0.3)),
    "half_normal": (1.5, stats.halfnorm(scale=1.5)),
    "truncated_normal": ({"loc": 0.0, "scale": 0.3, "low": -0.5, "high": 3.0}, stats.truncnorm(-5 / 3, 10, 0, 0.3)),
    "lognormal": ([13.0, 0.7], stats.lognorm(0.7, scale=np.exp(13.0))),
    "exponential": (2.0, stats.expon(scale=0.5)),
    "beta": ([2.0, 5.0], stats.beta(2, 5)),
    "gamma": ([4.0, 3.0], stats.gamma(4, scale=1 / 3)),
}
# Numpyro has no closed quantiles of these: the prior takes them from a sample.
SAMPLED = ("beta", "gamma")
SHARES = np.array([0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99])
FIRST = np.array([0])


# --- the box ---------------------------------------------------------------------------------------------------------


@pytest.fixture(params=LAWS)
def law(request):
    arguments, truth = LAWS[request.param]
    return request.param, Box({"k": Prior(request.param, arguments)}), truth


def stretch(box, x):
    """dθ/dx by a central difference."""
    return (box.theta(x + 1e-6) - box.theta(x - 1e-6))[:, 0] / 2e-6


def test_coordinates_come_back_and_are_of_order_one(law):
    _, box, truth = law
    theta = truth.ppf(SHARES)[:, None]
    x = box.x(theta)
    np.testing.assert_allclose(box.theta(x), theta, rtol=1e-12, atol=1e-12)
    assert np.all(np.diff(x[:, 0]) > 0) and np.abs(x).max() < 6
    assert abs(box.x(np.array([truth.median()]))[0]) < 0.1


def test_a_bound_of_the_prior_is_a_bound_of_the_coordinate(law):
    name, box, truth = law
    low, high = truth.support()
    if name in ("lognormal", "gamma"):  # on the logarithmic scale zero is infinitely far away
        assert (box.low[0], box.high[0]) == (-np.inf, np.inf)
        return
    ends = box.theta(np.array([[box.low[0]], [box.high[0]]]))[:, 0]
    np.testing.assert_allclose(ends, [low, high], rtol=1e-12, atol=1e-12)


def test_density_is_that_of_the_prior_times_the_stretch(law):
    _, box, truth = law
    theta = truth.ppf(SHARES)
    x = box.x(theta[:, None])
    exact = truth.logpdf(theta) + np.log(stretch(box, x))
    np.testing.assert_allclose(box.log_density(x, FIRST)[:, 0], exact, atol=2e-3)


def test_density_in_the_box_integrates_to_one(law):
    _, box, truth = law
    low, high = box.x(truth.ppf([[1e-5], [1 - 1e-5]]))[:, 0]
    x = np.linspace(max(low, box.low[0]), min(high, box.high[0]), 20001)
    assert np.trapezoid(np.exp(box.log_density(x[:, None], FIRST)[:, 0]), x) == pytest.approx(1.0, abs=1e-3)


def test_slope_and_curvature_are_derivatives_of_the_density(law):
    _, box, truth = law

    def exact(x):
        points = np.array([[x]])
        return float((truth.logpdf(box.theta(points)[:, 0]) + np.log(stretch(box, points)))[0])

    h = 0.02
    for theta in truth.ppf([0.1, 0.4, 0.6, 0.9]):
        x = float(box.x(np.array([theta]))[0])
        terms = box.terms(np.array([x]), FIRST)
        assert terms.value[0] == pytest.approx(exact(x), abs=2e-3)
        assert terms.slope[0] == pytest.approx((exact(x + h) - exact(x - h)) / (2 * h), abs=5e-3)
        second = (exact(x + h) - 2 * exact(x) + exact(x - h)) / h**2
        assert terms.curvature[0] == pytest.approx(max(-second, 0.0), abs=2e-2)


def test_quantiles_are_the_priors_own(law):
    name, box, truth = law
    found = box.theta(box.quantiles(FIRST, SHARES[:, None]))[:, 0]
    if name in SAMPLED:
        np.testing.assert_allclose(truth.cdf(found), SHARES, atol=0.02)
    else:
        np.testing.assert_allclose(found, truth.ppf(SHARES), rtol=1e-6, atol=1e-9)


def test_columns_are_chosen_by_index_and_do_not_mix():
    box = Box({name: Prior(name, arguments) for name, (arguments, _) in LAWS.items()})
    columns = np.array([4, 1, 2])
    shares = np.array([[0.1, 0.5, 0.9], [0.7, 0.2, 0.4]])
    x = np.zeros((2, len(LAWS)))
    x[:, columns] = box.quantiles(columns, shares)
    theta = box.theta(x)
    truths = [truth for _, truth in LAWS.values()]
    for place, column in enumerate(columns):
        np.testing.assert_allclose(truths[column].cdf(theta[:, column]), shares[:, place], atol=1e-6)
        alone = Box({"k": Prior(box.names[column], LAWS[box.names[column]][0])})
        np.testing.assert_allclose(
            box.log_density(x, columns)[:, place], alone.log_density(x[:, [column]], FIRST)[:, 0], rtol=1e-12
        )


def test_what_is_possible_bounds_a_prior_that_reaches_further():
    priors = {"k": Prior("lognormal", [0.0, 0.7]), "c": Prior("normal", [0.0, 1.0])}
    box = Box(priors, limits={"k": (0.0, 2.0), "c": (-0.5, float("inf"))})
    np.testing.assert_allclose(box.theta(box.high)[0], 2.0)
    np.testing.assert_allclose(box.theta(box.low)[1], -0.5)
    # Zero has no logarithm, and is beyond every value of one anyway.
    assert np.isneginf(box.low[0]) and np.isposinf(box.high[1])


# --- fits ------------------------------------------------------------------------------------------------------------


class Analytic(Batch):
    """Predictions by a formula f(θ, experiment) -> (J,); remembers what it was asked."""

    def __init__(self, formula, diverges=lambda theta: False):
        self.formula, self.diverges = formula, diverges
        self.asked: list[tuple[np.ndarray, np.ndarray]] = []

    def __call__(self, thetas, experiments, samples=None):
        self.asked.append((thetas, experiments))
        ok = np.array([not self.diverges(theta) for theta in thetas], dtype=float)
        rows = [self.formula(t, e) if good else None for t, e, good in zip(thetas, experiments, ok, strict=True)]
        size = len(self.formula(thetas[0], 0))
        return np.array([np.zeros(size) if row is None else row for row in rows]), ok


def models_of(formula, priors, neutral, **more):
    return NestedModels(Analytic(formula, **more), Box(priors), np.asarray(neutral, dtype=float))


TIME = np.linspace(0.0, 3.0, 25)
SIGMA = 0.05


def target_of(values, weights=None, sigma=SIGMA):
    values = np.asarray(values, dtype=float)
    weights = np.ones((1, *values.shape)) if weights is None else np.asarray(weights, dtype=float)
    return Target(values, np.full(values.shape, sigma), weights, np.zeros(values.shape))


def noisy(clean, seed=0):
    return np.asarray(clean) + SIGMA * np.random.default_rng(seed).standard_normal(np.shape(clean))


def decay(theta, experiment):
    """Amplitude and rate, at three dilutions."""
    return (1.0 + experiment) * theta[0] * np.exp(-theta[1] * TIME)


# Rate lognormal: the posterior in log(rate) has its maximum where this residual belongs.
DECAY = {"a": Prior("normal", [1.0, 0.5]), "b": Prior("lognormal", [0.0, 0.5])}


def best_decay(values, weights):
    """Maximum in (a, log b) by SciPy, with the posterior's standard deviations there."""

    def residual(p):
        theta = (p[0], np.exp(p[1]))
        misfit = [np.sqrt(weights[e]) * (decay(theta, e) - values[e]) / SIGMA for e in range(len(values))]
        return np.concatenate([*misfit, [(p[0] - 1.0) / 0.5, p[1] / 0.5]])

    found = least_squares(residual, [1.0, 0.0], xtol=1e-14, ftol=1e-14)
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac))), found.cost


@pytest.fixture(scope="module")
def decays():
    return noisy([decay((1.3, 0.6), e) for e in range(3)])


def in_logs(theta):
    return np.array([theta[0], np.log(theta[1])])


def test_a_fit_ends_where_scipys_does(decays):
    models = models_of(decay, DECAY, [1.0, 1.0])
    target = target_of(decays)
    starts = models.box.quantiles(np.arange(2), np.array([[0.1, 0.1], [0.9, 0.9], [0.05, 0.95], [0.5, 0.5]]))
    best, sd, cost = best_decay(decays, target.weights[0])
    for fit in models.fit(target, [Task(models.submodel(np.arange(2)), start) for start in starts]):
        theta = models.theta(fit.x, fit.submodel)
        # It stops where a step gains less than 0.02 nats: √0.04 of a standard deviation.
        assert np.all(np.abs(in_logs(theta) - best) < 0.2 * sd)
        # Two normal priors, each in a coordinate scaled by half its 16-84 % range (0.99446 standard deviations).
        constant = 2 * stats.norm.logpdf(0) + 2 * np.log(0.99446)
        assert fit.cost + constant == pytest.approx(cost, abs=0.03)
        np.testing.assert_allclose(fit.predicted, [decay(theta, e) for e in range(3)], rtol=1e-12)
        residual = fit.predicted - decays
        np.testing.assert_allclose(target.standardised(0, np.arange(3), residual), residual / SIGMA, rtol=1e-12)


def test_standardised_differences_are_white_where_the_noise_remembers():
    # Two histories of one experiment beside each other: the first sample of each has no memory.
    random, rho, size = np.random.default_rng(0), 0.8, 4000
    memory = np.where(np.arange(2 * size) % size == 0, 0.0, rho)[None]
    white = random.standard_normal((1, 2 * size))
    noise = np.zeros((1, 2 * size))
    for k in range(2 * size):
        noise[0, k] = memory[0, k] * noise[0, k - 1] + np.sqrt(1 - memory[0, k] ** 2) * white[0, k]
    sigma = np.linspace(1.0, 5.0, 2 * size)[None]
    weights = np.r_[np.full(size, 0.25), np.zeros(size // 2), np.ones(size - size // 2)]
    target = Target(np.zeros((1, 2 * size)), sigma, weights[None, None], memory)
    found = target.standardised(0, target.rows(0), sigma * noise)
    # A sample without a weight is not known: the next one has no innovation to be compared with.
    is_known = np.r_[np.ones(size + 1), np.zeros(size // 2), np.ones(size - size // 2 - 1)] > 0
    np.testing.assert_allclose(found[0, is_known], (np.sqrt(weights) * white[0])[is_known], atol=1e-9)
    assert target.misfit(0, sigma * noise) == pytest.approx(0.5 * np.sum(found**2))


def test_gradient_and_hessian_are_those_of_the_cost(decays):
    models = models_of(decay, DECAY, [1.0, 1.0])
    target = target_of(decays)
    (fit,) = models.fit(target, [Task(models.submodel(np.arange(2)), models.neutral)])

    def residual(x):
        theta = models.box.theta(x)
        p = in_logs(theta)
        prior = [(p[0] - 1.0) / 0.5, p[1] / 0.5]
        return np.concatenate([*((decay(theta, e) - decays[e]) / SIGMA for e in range(3)), prior])

    h = 1e-5
    jacobian = np.stack([(residual(fit.x + h * e) - residual(fit.x - h * e)) / (2 * h) for e in np.eye(2)], axis=1)
    hessian = jacobian.T @ jacobian
    np.testing.assert_allclose(fit.hessian, hessian, rtol=2e-3)
    # Forward differences of 1e-4: a share of 1e-4 of the curvature.
    np.testing.assert_allclose(fit.gradient, jacobian.T @ residual(fit.x), atol=1e-3 * hessian.max())


def test_weights_choose_experiments_and_count_them(decays):
    models = models_of(decay, DECAY, [1.0, 1.0])
    weights = np.ones((4, 3, TIME.size))
    weights[1, 1:] = 0.0
    weights[2, 0] = 0.0
    weights[3, 2] = 0.1
    # The experiments disagree, so that it matters which are used.
    values = decays * np.array([[1.0], [1.3], [0.8]])
    target = target_of(values, weights)
    for use in range(4):
        models.batch.asked.clear()
        (fit,) = models.fit(target, [Task(models.submodel(np.arange(2)), models.neutral, use)])
        best, sd, _ = best_decay(values, weights[use])
        assert np.all(np.abs(in_logs(models.theta(fit.x, fit.submodel)) - best) < 0.2 * sd)
        rows = np.flatnonzero(weights[use].any(axis=1))
        assert set(np.concatenate([e for _, e in models.batch.asked])) == set(rows)
        unused = np.setdiff1d(np.arange(3), rows)
        assert not fit.predicted[unused].any() and fit.predicted[rows].any()


def test_a_fit_that_has_settled_keeps_its_derivatives(decays):
    models, target = models_of(decay, DECAY, [1.0, 1.0]), target_of(decays)
    task = Task(models.submodel(np.arange(2)), models.neutral)
    (fit,) = models.fit(target, [task])
    # The last thing that was asked for is the point where it ended, in the three experiments, and not one around it.
    thetas, experiments = models.batch.asked[-1]
    assert sorted(experiments) == [0, 1, 2]
    np.testing.assert_array_equal(thetas, np.tile(models.theta(fit.x, fit.submodel), (3, 1)))
    (there,) = models.fit(target, [Task(task.submodel, fit.x)])
    np.testing.assert_allclose(fit.hessian, there.hessian, rtol=0.02)
    sd = np.sqrt(np.diag(np.linalg.inv(there.hessian)))
    np.testing.assert_allclose(fit.gradient * sd, there.gradient * sd, atol=0.02)


def test_fits_made_side_by_side_are_those_made_alone(decays):
    models = models_of(decay, DECAY, [1.0, 1.0])
    weights = np.ones((2, 3, TIME.size))
    weights[1, 1:] = 0.0
    target = target_of(decays, weights)
    tasks = [
        Task(models.submodel(np.arange(2)), models.neutral),
        Task(models.submodel(np.array([1])), models.neutral, 1),
        Task(models.submodel(np.array([0])), models.neutral),
    ]
    together = models.fit(target, tasks)
    for task, fit in zip(tasks, together, strict=True):
        (alone,) = models.fit(target, [task])
        assert alone.cost == fit.cost
        np.testing.assert_array_equal(alone.x, fit.x)


def test_no_fit_waits_for_the_steps_of_another_one(decays):
    models = models_of(decay, DECAY, [1.0, 1.0])
    target = target_of(decays)
    starts = models.box.quantiles(np.arange(2), np.random.default_rng(3).uniform(size=(12, 2)))
    tasks = [Task(models.submodel(np.arange(2)), start) for start in starts]

    def calls_of(tasks):
        models.batch.asked.clear()
        models.fit(target, tasks)
        return len(models.batch.asked)

    alone = [calls_of([task]) for task in tasks]
    assert calls_of(tasks) == max(alone) > min(alone)


def test_a_fit_that_goes_on_with_other_errors_begins_with_what_is_known(decays):
    def ends(is_known):
        models = models_of(decay, DECAY, [1.0, 1.0])
        submodel = models.submodel(np.arange(2))
        (fit,) = models.fit(target_of(decays), [Task(submodel, models.neutral)])
        models.batch.asked.clear()
        weights = np.ones((2, *decays.shape))
        weights[1, 2] = 0.0
        other = target_of(decays, weights, sigma=3 * SIGMA)
        tasks = [Task(submodel, fit.x, use, known=fit if is_known else None) for use in (0, 1)]
        return models.fit(other, tasks), sum(len(thetas) for thetas, _ in models.batch.asked)

    (known, little), (anew, work) = ends(True), ends(False)
    # Once at the start and two differences, of three experiments and of two.
    assert little <= work - 3 * (3 + 2)
    for one, other in zip(known, anew, strict=True):
        # It ends where no step gains what ends a fit.
        assert one.cost == pytest.approx(other.cost, abs=nested._GAIN)
        np.testing.assert_allclose(one.hessian, other.hessian, rtol=0.05)
        assert not one.predicted[2].any() or one.use == 0


def test_a_fit_with_nothing_to_gain_asks_for_no_simulation_and_one_that_moves_gets_there(decays):
    models, target = models_of(decay, DECAY, [1.0, 1.0]), target_of(decays)
    submodel = models.submodel(np.arange(2))
    (fit,) = models.fit(target, [Task(submodel, models.neutral)])
    models.batch.asked.clear()
    (again,) = models.fit(target, [Task(submodel, fit.x, known=fit)])
    assert not models.batch.asked
    np.testing.assert_array_equal(again.x, fit.x)
    assert again.cost == pytest.approx(fit.cost, rel=1e-12)
    for known in (fit, again):
        assert 0.5 * known.gradient @ np.linalg.solve(known.hessian, known.gradient) < 1e-3 * nested._GAIN
    # Other measurements move it.
    moved = target_of(0.5 * decays)
    (known,), (anew,) = (models.fit(moved, [Task(submodel, fit.x, known=k)]) for k in (fit, None))
    assert np.abs(anew.x - fit.x).max() > 0.1
    assert known.cost == pytest.approx(anew.cost, abs=nested._GAIN)
    np.testing.assert_allclose(known.x, anew.x, atol=0.01)


def test_a_fit_that_is_far_behind_others_and_does_not_catch_up_is_left_where_it_is(decays):
    models, target = models_of(decay, DECAY, [1.0, 1.0]), target_of(decays)
    submodel, small = models.submodel(np.arange(2)), models.submodel(np.arange(1))
    best, behind = models.fit(target, [Task(submodel, models.neutral), Task(small, models.neutral)])
    assert behind.cost > best.cost + nested._BEHIND
    other = target_of(0.99 * decays)
    tasks = [Task(submodel, best.x, rivals=0, known=best), Task(small, behind.x, rivals=1, known=behind)]
    _, left = models.fit(other, tasks)
    (alone,) = models.fit(other, [Task(small, behind.x, known=behind)])
    assert alone.cost < left.cost
    np.testing.assert_array_equal(left.x, behind.x)
    assert np.isfinite(left.cost)


def test_derivatives_that_are_too_many_are_let_go(decays, monkeypatch):
    models, target = models_of(decay, DECAY, [1.0, 1.0]), target_of(decays)
    task = Task(models.submodel(np.arange(2)), models.neutral)
    (kept,) = models.fit(target, [task])
    monkeypatch.setattr(nested, "_KEPT", 0)
    (without,) = models.fit(target, [task])
    # Not even a view holds them.
    assert kept.slopes.size and not without.slopes.size and without.slopes.base is None
    assert without.cost == pytest.approx(kept.cost, abs=0.03)


def test_fits_that_were_kept_are_not_made_again_and_are_the_same_to_the_last_bit(decays):
    class Notebook(Watch):
        kept: ClassVar[dict[str, list[np.ndarray]]] = {}

        def keep(self, name, arrays):
            self.kept[name] = list(arrays)

        def recall(self, name):
            return self.kept.get(name)

    def ends(more, moved=0.0):
        models = models_of(decay, DECAY, [1.0, 1.0])
        models = NestedModels(models.batch, models.box, np.array([1.0, 1.0]), Notebook())
        tasks = [
            Task(models.submodel(np.arange(2)), models.neutral + moved, rivals=0),
            Task(models.submodel(np.arange(2)), models.neutral + 0.3, rivals=0),
            *[Task(models.submodel(np.array([1])), models.neutral)] * more,
        ]
        return models.fit(target_of(decays), tasks), sum(len(thetas) for thetas, _ in models.batch.asked)

    # A start that differs by rounding, as that of a search that goes on with other programs does, is the same fit.
    (made, work), (again, little), (_, anew) = ends(1), ends(1, 1e-13), ends(2)
    for one, other in zip(made, again, strict=True):
        for name in ("x", "cost", "predicted", "gradient", "hessian"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert little == 3 * 3 and work > 3 * little and anew > 3 * little


def test_held_parameters_keep_their_neutral_values_to_the_last_bit(decays):
    # A value that the way through the coordinates would change.
    box = Box(DECAY)
    tried = np.array([[1.0, value] for value in np.linspace(0.3, 2.0, 200)])
    rate = tried[np.flatnonzero(box.theta(box.x(tried))[:, 1] != tried[:, 1])[0], 1]
    models = models_of(decay, DECAY, [1.3, rate])
    assert models.box.theta(models.neutral)[1] != rate
    (fit,) = models.fit(target_of(decays), [Task(models.submodel(np.array([0])), models.neutral)])
    assert np.isfinite(fit.cost)
    for thetas, _ in models.batch.asked:
        assert np.all(thetas[:, 1] == rate)
    assert models.theta(fit.x, fit.submodel)[1] == rate


BASIS = np.sin(3 * TIME)


def with_amplitude(theta, experiment):
    """A line and an amplitude that cannot be negative."""
    return theta[0] + theta[1] * TIME + theta[2] * BASIS


AMPLITUDE = {"a": Prior("normal", [0.0, 1.0]), "b": Prior("uniform", [-1.0, 0.8]), "c": Prior("half_normal", 0.5)}


def bounded(values):
    def residual(p):
        return np.append((with_amplitude(p, 0) - values[0]) / SIGMA, [p[0] / 1.0, p[2] / 0.5])

    bounds = ([-np.inf, -1.0, 0.0], [np.inf, 0.8, np.inf])
    found = least_squares(residual, [0.1, 0.1, 0.1], bounds=bounds, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


@pytest.mark.parametrize(
    ("truth", "resting"),
    [((0.3, 0.2, 0.4), []), ((0.3, 0.2, -0.3), [2]), ((0.3, 1.1, 0.4), [1]), ((0.3, 1.1, -0.3), [1, 2])],
    ids=["inside", "amplitude at zero", "slope at its upper bound", "both"],
)
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_what_would_leave_its_bounds_rests_on_them(truth, resting, share):
    values = noisy([with_amplitude(truth, 0)])
    models = models_of(with_amplitude, AMPLITUDE, [0.0, 0.0, 0.0])
    start = models.box.quantiles(np.arange(3), np.full((1, 3), share))[0]
    (fit,) = models.fit(target_of(values), [Task(models.submodel(np.arange(3)), start)])
    theta = models.theta(fit.x, fit.submodel)
    best, sd = bounded(values)
    assert np.all(np.abs(theta - best) < 0.2 * sd)
    ends = {1: 0.8, 2: 0.0}
    for column in resting:
        assert theta[column] == pytest.approx(ends[column], abs=1e-12)
        # Downhill is beyond the bound.
        assert fit.gradient[column] * (1 if column == 2 else -1) > 0
    inside = [k for k in range(3) if k not in resting]
    assert np.all(np.abs(fit.gradient[inside]) < 0.2 * np.sqrt(np.diag(fit.hessian)[inside]))


def test_a_fit_reaches_a_distant_optimum_at_the_end_of_a_narrow_valley():
    """The step to it is cut off in one coordinate, and the other one has to follow the valley."""

    def valley(theta, experiment):
        return np.append(0.7 * (2 * theta[1] - theta[0]) * np.ones(24), theta[0])

    models = models_of(valley, {"a": Prior("normal", [0.0, 1.0]), "b": Prior("normal", [0.0, 1.0])}, [0.0, 0.0])
    submodel = models.submodel(np.arange(2))
    (fit,) = models.fit(target_of([np.append(np.zeros(24), -4.0)]), [Task(submodel, models.neutral)])
    # The measurements of the last output change, so that the optimum is eight deviations away along the valley.
    (moved,) = models.fit(target_of([np.append(np.zeros(24), 4.0)]), [Task(submodel, fit.x, known=fit)])
    jacobian = np.r_[np.tile([-0.7, 1.4], (24, 1)), [[1.0, 0.0]]] / SIGMA
    precision = jacobian.T @ jacobian + np.eye(2)
    exact = np.linalg.solve(precision, jacobian.T @ np.append(np.zeros(24), 4.0 / SIGMA))
    np.testing.assert_allclose(
        models.theta(moved.x, submodel), exact, atol=0.2 * np.sqrt(np.linalg.inv(precision)[0, 0])
    )


@pytest.mark.parametrize("seed", range(20))
def test_the_way_to_a_minimum_within_bounds_never_rises_and_ends_near_scipys(seed):
    random = np.random.default_rng(seed)
    size = int(random.integers(2, 9))
    jacobian = random.normal(size=(size + 2, size)) + 3 * random.normal(size=(size + 2, 1))
    hessian, gradient = jacobian.T @ jacobian + 0.01 * np.eye(size), 3 * random.normal(size=size)
    low, high = -3 * np.abs(random.normal(size=size)), 3 * np.abs(random.normal(size=size))
    step, is_held = quadratic_minimum(gradient, hessian, low, high)

    def value(d):
        return gradient @ d + 0.5 * d @ hessian @ d

    assert np.all((step >= low) & (step <= high)) and all(value(t * step) <= 0 for t in np.linspace(0, 1, 11))
    np.testing.assert_array_equal(is_held, (step == low) | (step == high))
    root = np.linalg.cholesky(hessian).T
    best = lsq_linear(root, -np.linalg.solve(root.T, gradient), (low, high)).x
    assert value(step) == pytest.approx(value(best), abs=0.1 * abs(value(best)))


def dead_zone(theta, experiment):
    """Nothing happens until the second parameter exceeds 0.5: no derivative at neutral tells of it."""
    return theta[0] * TIME + np.maximum(theta[1] - 0.5, 0.0) * BASIS


DEAD = {"a": Prior("normal", [0.0, 1.0]), "g": Prior("half_normal", 1.0)}


def test_starts_over_the_prior_find_what_has_no_gradient_at_neutral():
    values = noisy([dead_zone((0.7, 1.4), 0)])
    models = models_of(dead_zone, DEAD, [0.0, 0.0])
    target = target_of(values)
    free = np.arange(2)
    (stuck,) = models.fit(target, [Task(models.submodel(free), models.neutral)])
    assert models.theta(stuck.x, stuck.submodel)[1] == pytest.approx(0.0, abs=1e-12)
    starts = np.tile(models.neutral, (4, 1))
    starts[:, 1] = models.box.quantiles(np.array([1]), np.array([[0.1], [0.35], [0.65], [0.9]]))[:, 0]
    ends = models.fit(target, [Task(models.submodel(free), start, rivals=0) for start in starts])
    best = min(ends, key=lambda f: f.cost)

    def residual(p):
        return np.append((dead_zone(p, 0) - values[0]) / SIGMA, p)

    found = least_squares(residual, [0.5, 1.0], bounds=([-np.inf, 0], np.inf))
    sd = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    assert np.all(np.abs(models.theta(best.x, best.submodel) - found.x) < 0.2 * sd)
    assert best.cost < stuck.cost - 100


def two_valleys(theta, experiment):
    return np.array([(theta[0] ** 2 - 1.0) + 0.2 * theta[0]] * 5)


def test_rivals_end_in_one_that_is_the_best_of_them():
    models = models_of(two_valleys, {"a": Prior("normal", [0.0, 2.0])}, [0.0])
    # At a = −1.1 and 0.9 the output is zero; the prior likes the second better.
    target = target_of(np.zeros((1, 5)), sigma=0.01)
    starts = models.box.x(np.array([[-2.0], [-1.5], [1.6], [0.4]]))
    rivals = models.fit(target, [Task(models.submodel(FIRST), start, rivals=7) for start in starts])
    assert sum(np.isfinite(fit.cost) for fit in rivals) == 1
    alone = models.fit(target, [Task(models.submodel(FIRST), start) for start in starts])
    ends = np.array([models.theta(f.x, f.submodel)[0] for f in alone])
    np.testing.assert_allclose(ends, [-1.105, -1.105, 0.905, 0.905], atol=0.01)
    assert min(f.cost for f in rivals) <= min(f.cost for f in alone) + 0.02


def test_groups_of_rivals_do_not_take_part_in_one_anothers_races(decays):
    models = models_of(decay, DECAY, [1.0, 1.0])
    target = target_of(decays)
    starts = models.box.quantiles(np.arange(2), np.array([[0.1, 0.1], [0.9, 0.9], [0.2, 0.7], [0.7, 0.2]]))
    tasks = [Task(models.submodel(np.arange(2)), s, rivals=0) for s in starts] + [
        Task(models.submodel(np.array([0])), s, rivals=1) for s in starts
    ]
    ends = models.fit(target, tasks)
    for group in (ends[:4], ends[4:]):
        assert sum(np.isfinite(f.cost) for f in group) == 1


# --- simulations that diverge ----------------------------------------------------------------------------------------


def test_a_start_that_diverges_costs_its_own_fit_only(decays):
    models = models_of(decay, DECAY, [1.0, 1.0], diverges=lambda theta: theta[1] > 1.5)
    target = target_of(decays)
    bad, good = (models.box.x(np.array(theta)) for theta in ((1.0, 1.8), (1.0, 1.2)))
    lost, found = models.fit(
        target, [Task(models.submodel(np.arange(2)), bad), Task(models.submodel(np.arange(2)), good)]
    )
    best, sd, _ = best_decay(decays, target.weights[0])
    assert lost.cost == np.inf
    assert np.all(np.abs(in_logs(models.theta(found.x, found.submodel)) - best) < 0.2 * sd)


def test_a_step_into_divergence_is_taken_back(decays):
    # Of the way from the start to the optimum at (1.3, 0.6) the first full steps overshoot below 0.55.
    models = models_of(decay, DECAY, [1.0, 1.0], diverges=lambda theta: theta[1] < 0.55 or theta[0] > 1.5)
    target = target_of(decays)
    starts = models.box.x(np.array([[0.2, 3.0], [1.4, 0.56], [0.7, 1.5]]))
    best, sd, _ = best_decay(decays, target.weights[0])
    for fit in models.fit(target, [Task(models.submodel(np.arange(2)), start) for start in starts]):
        assert np.isfinite(fit.cost)
        assert np.all(np.abs(in_logs(models.theta(fit.x, fit.submodel)) - best) < 0.2 * sd)


def test_an_optimum_beyond_divergence_is_approached_and_never_crossed(decays):
    models = models_of(decay, DECAY, [1.0, 1.0], diverges=lambda theta: theta[1] < 0.7)
    target = target_of(decays)
    start = models.box.x(np.array([1.0, 1.2]))
    (fit,) = models.fit(target, [Task(models.submodel(np.arange(2)), start)])
    theta = models.theta(fit.x, fit.submodel)
    assert 0.7 <= theta[1] < 0.8 and np.isfinite(fit.cost)


def test_a_model_that_always_diverges_is_survived(decays):
    models = models_of(decay, DECAY, [1.0, 1.0], diverges=lambda theta: True)
    target = target_of(decays)
    fits = models.fit(target, [Task(models.submodel(np.arange(2)), models.neutral, rivals=0) for _ in range(3)])
    assert all(fit.cost == np.inf for fit in fits)
    assert models.fit(target, []) == []
