"""Samplers where they are at their limits: a poor emulator, weights that cannot be relied on, many parameters."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.posteriors import EXACT, drawn, find, measured_at, posterior_of

from hsed_jax.inference import blocks, moves
from hsed_jax.inference import maximum as search
from hsed_jax.inference.chains import _chains
from hsed_jax.inference.emulator import emulate
from hsed_jax.inference.fit import Fit
from hsed_jax.inference.importance import Weighted, resampled, weighted
from hsed_jax.inference.independent import weigh_around
from hsed_jax.inference.moves import moved
from hsed_jax.inference.nuts import Chains, Settings, advance, convergence
from hsed_jax.inference.priors import Prior
from hsed_jax.inference.sampling import _mixed, draw
from hsed_jax.inference.watch import Watch

# A number of chains is a program of its own, and one of NUTS takes seconds to compile.
LONG, SHORT = Settings(4, 100, 4000), Settings(2, 100, 500)

# Two parameters whose posterior is a bent ridge: y1 = a, y2 = b + a², so that (a, b + a²) is normal.
BENT = {"a": Prior("normal", [0.0, 10.0]), "b": Prior("normal", [0.0, 10.0])}


def bent(theta, conditions):
    a, b = theta
    return jnp.stack([a, b + conditions.inputs["x"] * a**2]), True


def ridge(bend, width=1.0, thin=1.0):
    """Posterior, data and mode; in (a, b + bend·a²) standard normal times `width` and `width · thin`, as good as."""
    posterior = posterior_of(bent, BENT, [width, width * thin])
    data = measured_at(np.full(1, bend), np.zeros((1, 2)))
    return posterior, data, find(posterior, data, starts=1)


def straight(chains, bend):
    """The draws in the coordinates in which they are normal."""
    a, b = np.moveaxis(np.asarray(chains.theta), -1, 0)
    return np.stack([a, b + bend * a**2], axis=-1)


@pytest.mark.whole
@pytest.mark.parametrize(("factor", "is_weighed"), [(1.0, True), (0.8, True), (2.5, False)])
def test_draws_are_exact_whatever_the_emulator(monkeypatch, factor, is_weighed):
    posterior, data, maximum = ridge(0.3)

    def wrong(*learned):
        right = emulate(*learned)
        assert float(right.error) < 1e-6  # the response is a quadratic
        # By it the posterior is wider by a quarter, or so narrow that no weights mend it.
        return dataclasses.replace(right, middle=factor * right.middle, components=factor * right.components)

    monkeypatch.setattr("hsed_jax.inference.chains.emulate", wrong)
    chains = drawn(posterior, data, maximum, LONG)
    assert chains.sampler == "nuts" and (chains.emulator_error is not None) == is_weighed
    normal = straight(chains, 0.3)
    error = 4 / np.sqrt(convergence(chains._replace(theta=normal)).ess_bulk.min())
    assert error < 0.1
    assert (np.abs(normal.mean(axis=(0, 1))) < error).all()
    assert (np.abs(normal.std(axis=(0, 1)) - 1) < 2 * error).all()
    theta, log_densities = (np.asarray(values)[0, ::500] for values in (chains.theta, chains.log_density))
    expected = jax.jit(jax.vmap(lambda t: posterior.log_density(posterior.unconstrain(t), data)))(theta)
    np.testing.assert_allclose(log_densities, expected, rtol=1e-6)


def saturating(theta, conditions):
    return jnp.tanh(theta) * conditions.inputs["x"], True


@pytest.mark.whole
@pytest.mark.parametrize("seed", [3, 5])
def test_where_a_polynomial_is_not_enough_nuts_asks_the_simulator(seed):
    # Beyond 2 the response saturates, and only the prior tells one value from another.
    posterior = posterior_of(saturating, {"a": Prior("normal", [0.0, 10.0])}, [0.1])
    data = measured_at(np.ones(1), np.full((1, 1), 0.99))
    maximum = find(posterior, data)
    # With these seeds weights of an emulator that ends before the posterior does would look well.
    chains = draw(posterior, data, maximum, jnp.asarray(0.5), jax.random.key(seed), Settings(4, 300, 1000))
    assert chains.sampler == "nuts" and chains.emulator_error is None
    grid = np.linspace(0, 60, 20001)
    density = np.exp(-0.5 * (grid / 10) ** 2 - 0.5 * ((np.tanh(grid) - 0.99) / 0.1) ** 2)
    mean = np.average(grid, weights=density)
    sd = np.sqrt(np.average((grid - mean) ** 2, weights=density))
    theta, error = np.asarray(chains.theta), sd / np.sqrt(convergence(chains).ess_bulk[0])
    assert theta.mean() == pytest.approx(mean, abs=4 * error) and theta.std() == pytest.approx(sd, abs=4 * error)


@pytest.mark.whole
def test_chains_that_diverge_are_moved_on_until_their_draws_are_those_of_the_posterior():
    # A thin bent ridge: the emulator is exact there, and its chains still diverge and hardly reach the ends.
    posterior, data, maximum = ridge(1.0, thin=0.2)
    chains = draw(posterior, data, maximum, jnp.asarray(0.5), jax.random.key(1), SHORT)
    assert chains.emulator_error is not None
    judged = convergence(chains)
    # Of the chains themselves 1000 draws were worth 4, and their standard deviation was below a half.  Steps by the simulator
    # alone did not settle in 800 simulations of each draw; what is settled has no doubt.
    assert judged.ess_bulk.min() > 500 and judged.divergences == 0 and chains.doubt is None
    a, rest = np.moveaxis(straight(chains, 1.0).reshape(-1, 2), -1, 0)
    assert a.std() == pytest.approx(1, abs=0.09) and abs(a.mean()) < 0.12
    assert rest.std() == pytest.approx(0.2, rel=0.09)
    theta, log_densities = (np.asarray(values)[0, ::50] for values in (chains.theta, chains.log_density))
    expected = jax.vmap(lambda t: posterior.log_density(posterior.unconstrain(t), data))(theta)
    np.testing.assert_allclose(log_densities, expected, rtol=1e-6)


@pytest.mark.whole
def test_draws_are_settled_where_they_are_right_and_not_where_they_are_not(monkeypatch):
    # (a, b + a²) is normal; the draws begin in the middle of the ridge, and short ways along it lead nowhere soon.
    monkeypatch.setattr(moves, "_LOOK", 5)
    monkeypatch.setattr(moves, "_MOST", 60)
    random = np.random.default_rng(0)
    a, rest = 0.1 * random.standard_normal((2, 1000))
    points = np.stack([a, 0.1 * rest - 2 * a**2], axis=1)

    def log_densities(x):
        return -0.5 * x[:, 0] ** 2 - 0.5 * ((x[:, 1] + 2 * x[:, 0] ** 2) / 0.1) ** 2

    def emulated(factor):
        def wander(going, standing, key):
            """Many steps by a density whose ridge is so much wider."""
            going = np.asarray(going)
            at = start = factor * log_densities(going)
            for one in jax.random.split(key, 100):
                tried = np.asarray(moves.directly(jnp.asarray(going), standing, one)[0])
                there = factor * log_densities(tried)
                taken = np.log(random.uniform(size=len(going))) < there - at
                going, at = np.where(taken[:, None], tried, going), np.where(taken, there, at)
            return going, at - start

        return wander

    slow = moved(log_densities, moves.directly, points, log_densities(points), random, Watch(), "slow")
    assert not slow.settled and slow.points[:, 0].std() < 0.8
    quick = moved(log_densities, emulated(0.9), points, log_densities(points), random, Watch(), "quick")
    assert quick.settled and quick.points[:, 0].std() == pytest.approx(1, abs=0.1)


@pytest.mark.whole
@pytest.mark.parametrize("dimensions", [1, 8])
def test_draws_that_lack_a_tail_grow_one(dimensions):
    # Exponential in one coordinate, of which the draws have nothing beyond the median; normal in the others.
    random = np.random.default_rng(0)
    points = random.standard_normal((2000, dimensions))
    points[:, 0] = -np.log(random.uniform(0.5, 1, 2000))

    def log_densities(x):
        return np.where(x[:, 0] > 0, -x[:, 0], -np.inf) - 0.5 * np.sum(x[:, 1:] ** 2, axis=1)

    found = moved(log_densities, moves.directly, points, log_densities(points), random, Watch(), "moves")
    assert found.settled
    np.testing.assert_array_equal(found.log_density, log_densities(found.points))
    tail = found.points[:, 0]
    assert np.quantile(tail, [0.5, 0.95]) == pytest.approx([0.693, 3.0], rel=0.12)
    assert tail.std() == pytest.approx(1, abs=0.12)
    np.testing.assert_allclose(found.points[:, 1:].std(axis=0), 1, atol=0.07)


def test_draws_that_cannot_be_moved_do_not_settle():
    points = np.random.default_rng(0).standard_normal((500, 2))
    nowhere, random = (lambda x: np.full(len(x), -np.inf)), np.random.default_rng(1)
    found = moved(nowhere, moves.directly, points, np.zeros(500), random, Watch(), "moves", 0.0)
    assert not found.settled
    np.testing.assert_array_equal(np.sort(found.points, axis=0), np.sort(points, axis=0))


# --- in blocks ---------------------------------------------------------------------------------------------------


class Notebook(Watch):
    """Keeps in memory, and interrupts when so many counts were heard."""

    def __init__(self, patience=10**9):
        self.kept, self.counts, self.patience = {}, [], patience

    def keep(self, name, arrays):
        self.kept[name] = [np.array(x) for x in arrays]

    def recall(self, name):
        return self.kept.get(name)

    def count(self, done, total):
        self.counts.append((done, total))
        if len(self.counts) == self.patience:
            raise KeyboardInterrupt


@pytest.mark.whole
def test_chains_stopped_and_taken_up_again_have_the_draws_of_chains_left_alone(monkeypatch):
    posterior, data, maximum = ridge(0.3)
    whole = drawn(posterior, data, maximum, LONG)
    monkeypatch.setattr(blocks, "_BLOCK", 0.005)
    monkeypatch.setattr(blocks, "_LOOK", 0.002)
    watch = Notebook(patience=3)
    with pytest.raises(KeyboardInterrupt):
        drawn(posterior, data, maximum, LONG, watch=watch)
    done, total = watch.counts[-1]
    assert 0 < done < total == 2 * 4100  # chains go in pairs
    again = drawn(posterior, data, maximum, LONG, watch=watch)
    for found, expected in zip(again[:5], whole[:5], strict=True):
        np.testing.assert_array_equal(found, expected)
    # What is finished is not drawn again, and what was kept of one posterior is not taken for another's.
    heard = len(watch.counts)
    np.testing.assert_array_equal(drawn(posterior, data, maximum, LONG, watch=watch).theta, whole.theta)
    assert len(watch.counts) == heard
    other = data._replace(values=data.values + 1)
    assert not np.array_equal(drawn(posterior, other, maximum, LONG, watch=watch).theta, whole.theta)


@pytest.mark.whole
def test_chains_of_any_length_share_a_program_and_begin_alike():
    posterior, data, maximum = ridge(0.3)
    keys, step_size = jax.random.split(jax.random.key(0), 2), jnp.asarray(0.5)

    def chains(settings):
        return _chains(posterior, data, maximum, None, step_size, keys, settings, Watch(), None)[0]

    longer = chains(Settings(2, 40, 60))
    programs = len(advance._made)
    shorter, adapted = chains(Settings(2, 40, 30)), chains(Settings(2, 60, 60))
    assert len(advance._made) == programs
    for found, expected in zip(shorter[:4], longer[:4], strict=True):
        np.testing.assert_array_equal(found, expected[:, :30])
    # The step size is adapted for as many iterations as are asked for.
    np.testing.assert_array_equal(shorter.step_size, longer.step_size)
    assert not np.array_equal(adapted.step_size, longer.step_size)


@pytest.mark.whole
def test_a_budget_leaves_the_draws_there_are_and_says_so():
    posterior, data, maximum = ridge(0.3)
    settings = Settings(2, 50, 100_000)
    drawn(posterior, data, maximum, settings, seconds=0.1)  # compiles
    chains = drawn(posterior, data, maximum, settings, seconds=1.0)
    made = chains.theta.shape[1]
    assert 10 <= made < 100_000 and chains.theta.shape == (2, made, 2) and chains.steps.shape == (2, made)
    assert np.ptp(np.asarray(chains.theta[:, -1])) > 0 and np.asarray(chains.steps).min() > 0
    expected = f"stopped by the budget of 1.0 s (calibration.seconds) after {made} of 100000 draws"
    assert chains.doubt == expected
    found = Fit(posterior, data, maximum, chains, convergence(chains), {})
    assert found.warning is not None and found.warning.startswith(expected)


@pytest.mark.whole
def test_a_budget_that_ends_in_the_adaptation_leaves_the_gaussian():
    posterior, data, maximum = ridge(0.3)
    chains = drawn(posterior, data, maximum, SHORT, seconds=1e-6)
    assert chains.sampler == "laplace" and chains.theta.shape == (2, 500, 2)
    assert chains.doubt is not None and "Gaussian around the MAP" in chains.doubt


@pytest.mark.whole
def test_weights_that_cannot_be_relied_on_leave_it_to_nuts():
    # A long thin crescent: no Student t covers it.
    posterior, data, maximum = ridge(3.0, width=3.0, thin=0.002)
    weighted = weigh_around(posterior, data, maximum, 1000, np.random.default_rng(0))
    assert not weighted.reliable
    chains = drawn(posterior, data, maximum, SHORT._replace(sampler="auto"))
    # Neither chains nor the steps that follow get round it soon, and that is said.
    assert chains.sampler == "nuts" and "did not settle" in (chains.doubt or "")
    # Who asks for them gets them, and is told; so does who gives NUTS no time.
    for sampler, seconds in (("importance", None), ("auto", 1e-6)):
        chains = drawn(posterior, data, maximum, SHORT._replace(sampler=sampler), seconds=seconds)
        assert chains.sampler == "importance" and "Pareto shape" in str(chains.doubt)


@pytest.mark.whole
def test_a_few_draws_are_left_to_nuts():
    posterior, data, maximum = ridge(0.2)
    chains = drawn(posterior, data, maximum, Settings(1, 5, 3, sampler="auto"))
    assert chains.sampler == "nuts" and chains.theta.shape == (1, 3, 2)


@pytest.mark.whole
def test_the_worth_of_weights_is_what_their_mean_scatters_by():
    posterior, data, maximum = ridge(0.2)
    constrained, means, worths, counts = jax.jit(jax.vmap(posterior.constrain)), [], [], []
    for seed in range(60):
        weighted = weigh_around(posterior, data, maximum, 400, np.random.default_rng(seed))
        means.append(weighted.weights @ np.asarray(constrained(weighted.points))[:, 0])
        worths.append(weighted.worth)
        counts.append(len(weighted.points))
    # Var(mean) = Var(a)/worth, a being standard normal here; sixty repetitions know a variance to 18 %.
    assert np.var(means) * np.mean(worths) == pytest.approx(1.0, abs=0.55)
    assert 0.5 * np.mean(counts) < np.mean(worths) <= np.mean(counts)


def test_weights_of_chains_that_stand_have_no_tail():
    log_densities = np.tile([0.0, -0.006], 20)
    draws = weighted(np.zeros((40, 2)), log_densities, log_densities)
    assert draws.shape == -np.inf and draws.reliable
    # Of chains that stand far apart one alone counts.
    log_densities = np.repeat([0.0, *-np.arange(5.0, 24.0)], 20)
    assert not weighted(np.zeros((400, 2)), log_densities, log_densities).reliable


def test_resampling_keeps_every_draw_as_often_as_it_weighs():
    weights = np.asarray([0.5, 0.25, 0.125, 0.125, 0.0])
    weighted = Weighted(np.arange(5.0)[:, None], -np.arange(5.0), weights, 0.0, 0.1)
    u, log_density = resampled(weighted, 80, np.random.default_rng(0))
    np.testing.assert_array_equal(np.bincount(np.asarray(u)[:, 0].astype(int), minlength=5), [40, 20, 10, 10, 0])
    np.testing.assert_array_equal(log_density, -np.asarray(u)[:, 0])


@pytest.mark.whole
@pytest.mark.verification("inference")
def test_ten_parameters_by_importance_sampling_have_the_closed_form(observed):
    names = [f"t{k}" for k in range(10)]
    mixing = np.random.default_rng(0).standard_normal((30, 10))
    posterior = posterior_of(
        lambda t, c: ((c.inputs["x"] @ t)[None], True), {n: Prior("normal", [0.0, 1.0]) for n in names}, [0.5]
    )
    truth = np.linspace(-1, 1, 10)
    y = mixing @ truth + 0.5 * np.random.default_rng(1).standard_normal(30)
    data = measured_at(mixing, y[:, None])
    covariance = np.linalg.inv(mixing.T @ mixing / 0.25 + np.eye(10))
    mean, sd = covariance @ (mixing.T @ y / 0.25), np.sqrt(np.diag(covariance))
    chains = drawn(posterior, data, find(posterior, data, starts=1), Settings(4, 100, 500, sampler="importance"))
    assert chains.sampler == "importance"
    draws = np.asarray(chains.theta).reshape(-1, 10)
    worth = np.sqrt(convergence(chains).ess_bulk.min())
    problem = "ten parameters by importance sampling, in standard errors"
    observed(f"{problem}: means", "closed form", worth * (draws.mean(axis=0) - mean) / sd, 4.5)
    observed(f"{problem}: covariance", "closed form", worth * (np.cov(draws.T) - covariance) / sd.max() ** 2, 9.0)


def test_one_program_serves_all_equal_posteriors(monkeypatch):
    from hsed_jax.inference import predict

    calls = 0

    class Counting(predict.eqx.Module):
        gain: jnp.ndarray

        def __call__(self, theta, conditions):
            nonlocal calls
            calls += 1
            return self.gain * theta * conditions.inputs["x"], True

    found = []
    for gain in (1.0, 2.0):
        posterior = posterior_of(Counting(jnp.asarray(gain)), {"a": Prior("normal", [0.0, 10.0])}, [0.1])
        found.append(float(find(posterior, measured_at(np.ones(3), np.ones((3, 1)))).theta[0]))
        if gain == 1.0:
            traced = calls
    assert found == pytest.approx([1.0, 0.5], rel=1e-3)
    assert 0 < traced == calls


# --- several modes ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair():
    """Posterior, data and modes of y = t² with a prior that prefers t > 0."""
    posterior = posterior_of(lambda t, c: (t**2 * c.inputs["x"], True), {"t": Prior("normal", [0.4, 2.0])}, [0.5])
    data = measured_at(np.ones(2), np.full((2, 1), 4.0))
    return posterior, data, find(posterior, data, starts=8)


@pytest.fixture(scope="module")
def pair_grid():
    """The same by integration: t, and its density, normalised."""
    t = np.linspace(-6, 6, 24001)
    density = np.exp(-0.5 * ((t - 0.4) / 2) ** 2 - ((t**2 - 4) / 0.5) ** 2)
    return t, density / density.sum()


def test_both_modes_are_found_and_hold_what_the_grid_says(pair, pair_grid):
    posterior, _, maximum = pair
    t, density = pair_grid
    assert [float(mode.theta[0]) for mode in maximum.modes] == pytest.approx(
        [t[(density * (t > 0)).argmax()], t[(density * (t < 0)).argmax()]], abs=1e-3
    )
    np.testing.assert_allclose(maximum.shares, [density[t > 0].sum(), density[t < 0].sum()], atol=0.01)
    assert maximum.warning(posterior.names) == "the posterior has 2 modes: t = 1.997 (60%); t = -1.995 (40%)"


@pytest.mark.verification("inference")
@EXACT
def test_draws_hold_both_modes_in_proportion(pair, pair_grid, sampler, observed):
    posterior, data, maximum = pair
    t, density = pair_grid
    chains = drawn(posterior, data, maximum, Settings(4, 100, 500, sampler=sampler))
    judged = convergence(chains)
    assert chains.sampler == sampler and judged.warning(posterior.names) is None
    draws = np.asarray(chains.theta)[..., 0]
    # Every chain holds both, and as much of each; the mean and the spread are those of the whole posterior.
    off = (draws > 0).mean(axis=1) - density[t > 0].sum()
    observed(f"share of draws in one of two modes by {sampler}", "integral over a line", off, 0.01)
    mean = t @ density
    assert draws.mean() == pytest.approx(mean, abs=0.05)
    assert draws.std() == pytest.approx(np.sqrt((t - mean) ** 2 @ density), rel=0.01)
    above, upper = t > 0, draws[draws > 0]
    one = t[above] @ density[above] / density[above].sum()
    assert upper.mean() == pytest.approx(one, abs=4 * upper.std() / np.sqrt(0.6 * judged.ess_bulk[0]))
    fit = Fit(posterior, data, maximum, chains, judged, {"t": "1"})
    assert fit.warning == maximum.warning(posterior.names) and "2 modes" in str(fit)


@pytest.mark.whole
def test_a_short_adaptation_ends_with_a_step_that_moves():
    # Of a standard normal, in whitened coordinates, a step of about one is accepted four times of five.
    posterior, data, maximum = ridge(0.0)
    chains = drawn(posterior, data, maximum, Settings(4, 20, 20))
    assert ((np.asarray(chains.step_size) > 0.4) & (np.asarray(chains.step_size) < 1.5)).all()
    assert len(np.unique(np.asarray(chains.theta[..., 0]))) > 0.5 * 4 * 20


def test_mixing_the_modes_hides_no_chain_that_has_not_converged():
    rng = np.random.default_rng(0)

    def chains_at(mode, off=0.0, worth=np.inf):
        theta = mode + rng.standard_normal((4, 500, 1))
        theta[2] += off
        none = jnp.zeros((4, 500), dtype=int)
        return Chains(jnp.asarray(theta), jnp.asarray(theta[..., 0]), none > 0, none, jnp.full(4, 0.5), worth=worth)

    shares, key = np.asarray([0.7, 0.3]), jax.random.key(0)
    good = _mixed([chains_at(0.0), chains_at(50.0, worth=60.0)], shares, key)
    assert good.theta.shape == (4, 500, 1) and convergence(good).rhat[0] < 1.01
    np.testing.assert_array_equal(good.theta[..., 0], good.log_density)
    np.testing.assert_allclose((np.asarray(good.theta[..., 0]) > 25).mean(axis=1), 0.3)
    # The variance of a mixed mean: Σ share²/worth.
    assert good.worth == pytest.approx(1 / (0.7**2 / 1400 + 0.3**2 / 60), rel=0.1)
    bad = _mixed([chains_at(0.0, off=40.0), chains_at(50.0)], shares, key)
    assert convergence(bad).rhat[0] > 1.01


def test_one_mode_is_searched_once_and_a_crescent_is_one_mode(monkeypatch):
    searched = []
    monkeypatch.setattr(search, "_mode", lambda *a, mode=search._mode: searched.append(0) or mode(*a))
    posterior, data, _ = ridge(0.2)
    searched.clear()
    assert find(posterior, data).others == () and len(searched) == 1
    posterior, data, _ = ridge(3.0, width=3.0, thin=0.002)
    assert find(posterior, data, starts=8).others == ()


@pytest.mark.slow
def test_two_stiffnesses_that_give_one_peak_force_are_both_found(paper_simulator, pulse_conditions):
    # Towards resonance the force rises with the stiffness and then falls: 117 kN at 5.8e5 and 8.2e5 N/m.
    simulator = paper_simulator()

    def respond(theta, conditions):
        return simulator.quantities({"A": theta[0], "beta": 1.0}, conditions, ("peak_force",))

    posterior = posterior_of(respond, {"A": Prior("uniform", [2e5, 9e5])}, [350.0])
    conditions = pulse_conditions([1.5], [0.6])
    A = np.linspace(2e5, 9e5, 2801)
    force = np.asarray(
        jax.lax.map(lambda a: respond(a[None], pulse_conditions(1.5, 0.6))[0][0], jnp.asarray(A), batch_size=64)
    )
    data = measured_at([0.0], [[1.17e5]])._replace(conditions=conditions)
    density = np.exp(-0.5 * ((force - 1.17e5) / 350.0) ** 2)
    density /= density.sum()
    valley = A[force.argmax()]
    below = np.arange(A.size) < force.argmax()
    maximum = find(posterior, data, starts=6)
    chains = drawn(posterior, data, maximum, Settings(4, 200, 500))
    draws = np.asarray(chains.theta).ravel()
    print(maximum.warning(posterior.names), "by integration", density[below].sum(), "drawn", (draws < valley).mean())
    assert sorted(float(mode.theta[0]) > valley for mode in maximum.modes) == [False, True]
    assert (draws < valley).mean() == pytest.approx(density[below].sum(), abs=0.05)
    assert convergence(chains).warning(posterior.names) is None
    np.testing.assert_allclose(
        np.quantile(draws, [0.05, 0.95]), np.interp([0.05, 0.95], np.cumsum(density), A), rtol=0.01
    )
