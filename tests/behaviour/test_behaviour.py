"""Numerical experiments on a specimen: against laws whose loops are known in closed form, and names against what effects do."""

import math

import numpy as np
import pytest

from hsed_jax.behaviour.contributions import contribution, dependence
from hsed_jax.behaviour.findings import Behaviour, Behaviours, ProbedCurve, Value, told
from hsed_jax.behaviour.histories import PLACES, Histories, Range, along_the_test, imposed, over_the_range, range_of
from hsed_jax.behaviour.names import Trait, called, trait
from hsed_jax.behaviour.probes import Probed, probed
from hsed_jax.behaviour.specimens import answers
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Simulator
from hsed_jax.physics.timeline import Timeline

STIFFNESS, YIELD, RATE = 2.0e6, 3.0e4, 0.4
VISITED = Range(0.06 * np.linspace(0, 1, 41) * (-1.0) ** np.arange(41), RATE)
STEP = 0.2 * YIELD / STIFFNESS


def elastoplastic(histories: Histories, factor=lambda energy, path, largest: 1.0) -> np.ndarray:
    """Elastic and perfectly plastic by a return map, its stiffness times a factor of what it has gone through; NumPy alone."""
    u = histories.imposed.elongation[:, ::2]
    force = np.zeros(u.shape)
    energy, path, largest = (np.zeros(len(u)) for _ in range(3))
    for k in range(1, u.shape[1]):
        moved = u[:, k] - u[:, k - 1]
        trial = force[:, k - 1] + STIFFNESS * factor(energy, path, largest) * moved
        force[:, k] = np.clip(trial, -YIELD, YIELD)
        energy += 0.5 * (force[:, k] + force[:, k - 1]) * moved
        path += np.abs(moved)
        largest = np.maximum(largest, np.abs(u[:, k]))
    return force


def read(histories: Histories, force: np.ndarray) -> Probed:
    return probed(histories, force, np.ones(len(force), dtype=bool))


def named(histories: Histories, with_it: np.ndarray, without: np.ndarray):
    both = read(histories, with_it), read(histories, without)
    return trait(contribution(histories, np.stack([with_it, without]), both, RATE))


@pytest.fixture(scope="module")
def histories() -> Histories:
    return over_the_range(VISITED, STEP)


def test_a_perfect_loop_has_its_closed_form(histories):
    found = read(histories, elastoplastic(histories)).quantities
    a = 0.5 * VISITED.elongation
    assert found["force+"] == pytest.approx(YIELD, rel=1e-12)
    assert found["force-"] == pytest.approx(YIELD, rel=1e-12)
    for name in ("initial_stiffness", "unloading_stiffness+", "unloading_stiffness-"):
        assert found[name] == pytest.approx(STIFFNESS, rel=1e-3), name
    # No force is left where the unloading from the peak has passed F_y/k.
    assert found["recentring"] == pytest.approx(YIELD / STIFFNESS / a, rel=0.02)
    assert np.abs(found["post_yield_stiffness"]).max() < 1e-9 * STIFFNESS
    assert found["pinching_ratio"] == pytest.approx(1.0)
    assert np.abs(found["rate_force"]).max() < 1e-3 * YIELD
    assert found["relaxation"] == pytest.approx(0.0)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.0])
def test_a_force_that_depends_on_the_rate_is_read_at_every_speed(histories, exponent):
    force = (
        elastoplastic(histories)
        + 5e3 * np.sign(histories.imposed.rate[:, ::2]) * np.abs(histories.imposed.rate[:, ::2] / RATE) ** exponent
    )
    found = read(histories, force)
    assert found.quantities["rate_force"] == pytest.approx(5e3 * (histories.speed / RATE) ** exponent, abs=0.02 * 5e3)


def test_the_initial_stiffness_of_a_curved_branch_is_that_of_the_spring_beside_a_dashpot(histories):
    # Each branch of the spring is an exponential: its slope depends on where it is read.
    u, strength = histories.imposed.elongation[:, ::2], YIELD
    force = np.zeros(u.shape)
    for k in range(1, u.shape[1]):
        moved = u[:, k] - u[:, k - 1]
        limit = np.sign(moved) * strength
        force[:, k] = limit + (force[:, k - 1] - limit) * np.exp(-STIFFNESS / strength * np.abs(moved))
    beside = force + 1.2 * YIELD * histories.imposed.rate[:, ::2] / RATE
    alone, both = (read(histories, own).quantities for own in (force, beside))
    assert alone["initial_stiffness"] == pytest.approx(STIFFNESS, rel=0.02)
    assert both["initial_stiffness"] == pytest.approx(alone["initial_stiffness"], rel=0.05)
    # The secant holds the force of the dashpot at the peak, no more.
    assert np.all(both["reloading_stiffness"] < 3 * alone["reloading_stiffness"])


def test_play_is_as_wide_as_the_slack(histories):
    u, slack = histories.imposed.elongation[:, ::2], 0.008
    force = STIFFNESS * (u - np.clip(u, -slack, slack))
    assert read(histories, force).quantities["play"] == pytest.approx(2 * slack, rel=0.1)


DAMAGED = {
    "absorbed_energy": lambda energy, path, largest: np.exp(-energy / 6e4),
    "path": lambda energy, path, largest: 1 / (1 + path / 1.5),
    "largest_elongation": lambda energy, path, largest: 1 - 0.8 * largest / 0.06,
}


@pytest.mark.parametrize("driver", DAMAGED)
def test_what_a_stiffness_falls_with_is_told(histories, driver):
    found = read(histories, elastoplastic(histories, DAMAGED[driver]))
    shares = dependence(found.quantities["initial_stiffness"], found.drivers)
    (first, share), (_, second) = list(shares.items())[:2]
    assert first == driver
    assert share > 0.9 > second + 0.2


def test_a_stiffness_that_falls_exponentially_is_named_for_it(histories):
    found = named(histories, elastoplastic(histories, DAMAGED["absorbed_energy"]), elastoplastic(histories))
    assert found is not None
    assert (found.quantity, found.change, found.driver) == ("initial_stiffness", "falls", "absorbed_energy")
    assert found.names[0] == "stiffness_degradation"


def test_a_whole_loop_that_falls_has_the_names_of_stiffness_and_of_strength(histories):
    law = elastoplastic(histories)
    path = np.abs(np.diff(histories.imposed.elongation[:, ::2], axis=1, prepend=0.0)).cumsum(axis=1)
    found = named(histories, law * DAMAGED["path"](0.0, path, 0.0), law)
    assert found is not None
    assert (found.change, found.driver) == ("falls", "path")
    assert found.names == ("stiffness_degradation", "strength_degradation")
    # Such a behaviour does not tell one from the other, but it is not one near zero force only.
    assert [called(e, found) for e in ("strength_degradation", "pinching")] == [
        "strength_degradation",
        "stiffness_degradation",
    ]


@pytest.mark.parametrize(
    "share", [lambda least: np.full_like(least, 0.4), lambda least: 1 - 0.8 * np.exp(least / 0.03)]
)
def test_a_side_that_is_weaker_has_the_names_of_two_sides_that_differ(histories, share):
    law = elastoplastic(histories)
    least = np.minimum.accumulate(histories.imposed.elongation[:, ::2], axis=1)
    # Of the force in compression, a share is lost: always the same one, or more as it shortens.
    found = named(histories, np.where(law < 0, law * (1 - np.clip(share(least), 0.0, 0.9)), law), law)
    assert found is not None
    assert found.names == ("asymmetry", "buckling")


def rates(histories: Histories) -> np.ndarray:
    return histories.imposed.rate[:, ::2] / RATE


ADDED = {
    "coulomb_friction": lambda h: 8e3 * np.sign(rates(h)),
    # Falls by 7 %, which is less than a practical size.
    "coulomb_friction ": lambda h: 8.5e3 * np.sign(rates(h)) * (0.93 + 0.07 * np.exp(-np.abs(rates(h)) / 0.2)),
    "stribeck_friction": lambda h: 8e3 * np.sign(rates(h)) * (0.5 + 0.5 * np.exp(-np.abs(rates(h)) / 0.3)),
    "viscous_damping": lambda h: 9e3 * rates(h),
    "quadratic_damping": lambda h: 9e3 * rates(h) * np.abs(rates(h)),
    "power_damping": lambda h: 9e3 * np.sign(rates(h)) * np.abs(rates(h)) ** 0.4,
    "hardening": lambda h: 2e5 * h.imposed.elongation[:, ::2],
    "cubic_stiffness": lambda h: 2e4 * (h.imposed.elongation[:, ::2] / 0.06) ** 3,
    "quadratic_stiffness": lambda h: 2e4 * (h.imposed.elongation[:, ::2] / 0.06) ** 2,
}


@pytest.mark.parametrize("name", ADDED)
def test_a_force_beside_the_law_is_named_for_what_it_is(histories, name):
    law = elastoplastic(histories)
    found = named(histories, law + ADDED[name](histories), law)
    assert found is not None
    assert found.names[0] == name.strip()


@pytest.mark.parametrize(
    ("effect", "names", "name"),
    [
        ("pinching", ("stiffness_degradation",), "stiffness_degradation"),
        ("stribeck_friction", ("coulomb_friction",), "coulomb_friction"),
        ("slip", ("pinching", "slip", "gap"), "slip"),
        # What changes loops looks like a force of the elongation where hardly anything yields.
        ("loop_shape", ("cubic_stiffness", "hardening"), "loop_shape"),
        ("pinching", ("hardening",), "pinching"),
        # A spring with a dashpot in series that hardly moves during the test.
        ("relaxation", ("hardening",), "hardening"),
    ],
)
def test_a_name_is_exchanged_for_one_of_its_own_kind(effect, names, name):
    assert called(effect, Trait("quantity", "falls", "path", names)) == name
    assert called(effect, None) == effect


def test_what_is_of_no_practical_size_has_no_name(histories):
    law = elastoplastic(histories)
    assert named(histories, law + 100.0 * np.sign(rates(histories)), law) is None


def test_dependence_tells_the_driver_from_one_that_goes_along():
    rng = np.random.default_rng(0)
    driver, other = rng.random(32), rng.random(32)
    shares = dependence(np.exp(-2 * driver), {"other": other, "driver": driver, "mixed": driver + 0.5 * other})
    assert next(iter(shares)) == "driver"
    assert shares["driver"] > 0.97
    assert shares["other"] < 0.3
    assert dependence(np.ones(32), {"driver": driver}) == {"driver": 0.0}


def test_a_record_turns_where_it_goes_back_and_not_in_its_noise():
    time = np.linspace(0, 1, 4001)
    clean = 0.05 * np.sin(2 * np.pi * 3 * time)
    noisy = clean + 2e-4 * np.random.default_rng(1).standard_normal(time.size)
    found = range_of(noisy, RATE)
    assert len(found.turns) == 8
    assert np.abs(found.turns[1:-1]) == pytest.approx(0.05, rel=0.03)
    assert found.path == pytest.approx(12 * 0.05, rel=0.03)


def test_the_test_is_followed_to_shares_of_its_path():
    found = along_the_test(VISITED, STEP)
    until = found.ends[0] + 1
    moved = np.abs(np.diff(found.imposed.elongation[:, ::2][:, :until], axis=1)).sum(axis=1)
    # The way to zero over a smaller half cycle comes on top, and a share ends at the last reversal before it.
    assert moved == pytest.approx(np.asarray(PLACES) * VISITED.path, abs=3 * VISITED.elongation)
    assert np.all(np.diff(moved) > 0)
    # The rate is the slope of the elongation.
    slope = np.diff(found.imposed.elongation[:, ::2], axis=1)
    length = np.where(found.imposed.lengths > 0, found.imposed.lengths, 1.0)
    middle = found.imposed.rate[:, 1::2]
    assert np.abs(slope / length - middle)[found.imposed.lengths > 0].max() < 0.1 * RATE


@pytest.mark.parametrize(
    "amplitudes",
    [
        np.linspace(0, 1, 40),
        np.linspace(0, 1, 41),
        np.append(np.linspace(0, 1, 41), 0.0),
        np.sin(np.linspace(0, np.pi, 41)),
    ],
)
def test_the_loop_does_not_depend_on_the_branch_that_the_test_ended_on(amplitudes):
    # Sliders in parallel that yield one after the other, some only beyond the test: after a large half cycle the force stays on
    # one side in smaller loops.  Nothing changes in them with the history.
    visited = Range(0.06 * amplitudes * (-1.0) ** np.arange(len(amplitudes)), RATE)
    histories = along_the_test(visited, STEP)
    u, yields = histories.imposed.elongation[:, ::2], np.linspace(0.004, 0.08, 20)
    each = np.zeros((len(u), u.shape[1], 20))
    for k in range(1, u.shape[1]):
        each[:, k] = np.clip(each[:, k - 1] + (u[:, k] - u[:, k - 1])[:, None], -yields, yields)
    found = read(histories, 1e6 * each.sum(axis=2)).quantities
    for name in ("strength+", "strength-", "initial_stiffness"):
        assert found[name] == pytest.approx(found[name][0], rel=0.1), name
    assert found["strength+"] == pytest.approx(found["strength-"], rel=0.1)


def test_histories_that_could_not_be_simulated_have_no_number(histories):
    force = elastoplastic(histories)
    ok = np.arange(len(force)) != 3
    force[3] = np.nan
    found = probed(histories, force, ok)
    assert math.isnan(found.quantities["force+"][3])
    assert np.isfinite(found.quantities["force+"][ok]).all()


@pytest.mark.parametrize("lost", [0.0, 0.3])
def test_a_specimen_that_reloads_towards_its_peak_keeps_its_strength(lost):
    # Oriented to the origin: at a given elongation the force falls with the largest one, as of pinched concrete, but the force at
    # the largest one is F_y throughout, less a share that is lost with the path.
    histories = along_the_test(VISITED, STEP)
    u = histories.imposed.elongation[:, ::2]
    path = np.cumsum(np.abs(np.diff(u, axis=1, prepend=0.0)), axis=1)
    kept = 1 - lost * np.minimum(path / VISITED.path, 1.0)
    peak = np.maximum(np.maximum.accumulate(np.abs(u), axis=1), YIELD / STIFFNESS)
    found = read(histories, kept * YIELD * u / peak).quantities
    for side, at in zip("+-", histories.ends[5:], strict=True):
        # The last cycles of one side are smaller than those of the other by a fortieth.
        least = np.abs(u[:, at]) / peak[:, at]
        assert least.min() > 0.97
        assert found[f"strength{side}"][-1] == pytest.approx(YIELD * (1 - lost) * least[-1], rel=0.02)
        assert found[f"strength{side}"][0] == pytest.approx(YIELD * (1 - 0.1 * lost) * least[0], rel=0.03)
        assert found[f"force{side}"][-1] < 0.55 * found[f"force{side}"][0]


@pytest.mark.parametrize("side", [1, -1])
def test_the_strength_of_a_side_is_read_as_far_as_the_side_was_tested(side):
    one_sided = side * 0.06 * np.asarray([0.0, 0.5, -0.7, 1.0, 0.1, 0.9, 0.0])
    small = side * 0.06 * np.asarray([0.0, 0.5, 0.1, 1.0, 0.1, 0.9, 0.0])
    for turns, least in ((one_sided, 0.7), (small, 0.5)):
        histories = along_the_test(Range(turns, RATE), STEP)
        u = histories.imposed.elongation[:, ::2]
        reached = {1: u[:, histories.ends[5]], -1: -u[:, histories.ends[6]]}
        assert reached[side] == pytest.approx(0.06) and reached[-side] == pytest.approx(least * 0.06)
        # An elastic specimen has the force of these elongations.
        found = read(histories, STIFFNESS * u).quantities
        strengths = {1: found["strength+"], -1: found["strength-"]}
        assert strengths[side] == pytest.approx(0.06 * STIFFNESS, rel=0.02)
        assert strengths[-side] == pytest.approx(least * 0.06 * STIFFNESS, rel=0.02)


def test_the_main_changes_are_said_first_and_what_stays_is_compared_with_the_model_as_it_was():
    value = Value(2.0e7, 1.9e7, 2.1e7)
    falls = [
        Behaviour(quantity, "falls", {}, Value(3.0e7, 3.0e7, 3.0e7), value, "N/m", sentence=quantity)
        for quantity in ("unloading_stiffness", "post_yield_stiffness", "strength", "recentring")
    ]
    assert Behaviours(falls).sentence == "strength; recentring"
    assert Behaviours(falls[:2]).sentence == "unloading_stiffness; post_yield_stiffness"
    constant = {side: ProbedCurve(*np.full((4, 3), force)) for side, force in (("+", 5.1e4), ("-", -4.9e4))}
    of_one = Behaviours(
        falls[2:3], {"storey2.strength": 0.034}, {f"storey2.strength{s}": c for s, c in constant.items()}
    )
    assert of_one.sentence == "strength; storey2: strength stays within 3 % of 50 kN"
    constant["-"] = ProbedCurve(*np.full((4, 3), -4e4))
    of_sides = Behaviours(falls[2:3], {"strength": 0.034}, {f"strength{s}": c for s, c in constant.items()})
    assert of_sides.sentence == "strength; strength stays within 3 % of 51 kN in tension and 40 kN in compression"
    of_none = Behaviours((), {"strength": 0.034}, {"strength+": constant["+"]})
    assert of_none.sentence == "strength stays within 3 % of 51 kN" and Behaviours().sentence == ""
    flag = Behaviour("recentring", "differs", {}, Value(0.42, 0.42, 0.42), Value(0.97, 0.96, 0.98), "1")
    assert told(flag, ELONGATION_AND_FORCE) == "recentring is 0.97 (90 %: 0.96 to 0.98), without the named effects 0.42"


def test_short_and_long_histories_together_have_the_forces_of_the_closed_form():
    # With n = 1 and γ = 0, each branch is an exponential. Two models of 40 histories fill more than one chunk.
    turns = [np.asarray([0.0, *(0.01 * (-1.0) ** k for k in range(count))]) for count in np.arange(40) % 20 + 1]
    histories = imposed(turns, [0.01] * len(turns), step=2e-4)
    models = [{"A": 2e7, "beta": beta, "gamma": 0.0, "n": 1.0} for beta in (100.0, 300.0)]
    found = answers(Simulator(None, None, Timeline(None, 1), scales=Scales(force=2e5)), models, histories)
    assert found.ok.all()
    for model, force in zip(models, found.force, strict=True):
        strength = model["A"] / model["beta"]
        for own, last in zip(turns, force[:, -1], strict=True):
            z = 0.0
            for change in np.diff(own):
                z = np.sign(change) * strength + (z - np.sign(change) * strength) * np.exp(-model["beta"] * abs(change))
            assert last == pytest.approx(z, rel=1e-4)
        assert np.all(force[np.arange(len(turns)), np.argmax(histories.lengths > 0, axis=1)] == 0)


def test_a_strength_beyond_the_measured_forces_is_said_to_be_an_extrapolation():
    one = Behaviour("strength", "falls", {}, Value(2e5, 1.5e5, 2.5e5), Value(2e4, 1e4, 3e4), "N")
    plain = "strength falls from 200 to 20 kN (90 %: 10 to 30)"
    assert told(one, ELONGATION_AND_FORCE) == told(one, ELONGATION_AND_FORCE, 1.9e5) == plain
    beyond = "; 200 kN is an extrapolation, the largest measured force is 75 kN)"
    assert told(one, ELONGATION_AND_FORCE, 7.5e4) == plain.removesuffix(")") + beyond
