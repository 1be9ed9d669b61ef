"""Asking and telling: the same events give the same design, in one process or in many, whatever fails on the way."""

import dataclasses

import jax
import numpy as np
import pytest
from builders.designs import STUDY

from hsed_jax.config.load import load_study
from hsed_jax.design.feasible import near_failures
from hsed_jax.design.stopping import StopRules, stop_reason
from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import Measured
from hsed_jax.runs.conduct import Conduct
from hsed_jax.runs.folder import RunFolder
from hsed_jax.study.build import Built


@pytest.fixture(scope="module")
def built():
    return Built(load_study(STUDY))


@pytest.fixture
def begin(built, tmp_path):
    """A factory: the design in a folder, taken up where its journal ends."""
    open_stores = []

    def take_up(folder="run"):
        for store in open_stores:
            store.close()
        path = tmp_path / folder
        store = RunFolder(path, built.study.written(), resume=path.exists())
        open_stores.append(store)
        return Conduct(built, store)

    yield take_up
    for store in open_stores:
        store.close()


def measure(built, asked):
    return built.site.laboratory.perform(asked.number, asked.si)


def events(built, conduct):
    """A campaign as life is: each entry does one thing with the design as it stands then."""
    exact = {"V_P": 2.2, "T_P": 0.9}

    def initial(conduct):
        asked = conduct.ask()
        conduct.tell(asked.id, measure(built, asked))

    def off_request(conduct):
        asked = conduct.ask()
        tested = {name: 1.01 * value for name, value in asked.inputs.items()}
        si = tested  # the inputs' units are SI
        conduct.tell(asked.id, built.site.laboratory.perform(asked.number, si), tested)

    def fails(conduct):
        conduct.give_up(conduct.ask().id, "the pump stopped")

    def abandoned(conduct):
        conduct.give_up(conduct.ask().id, "the specimen broke", abandon=True)

    def uninvited(conduct):
        conduct.tell("X1", built.site.laboratory.perform(90, exact), exact)

    def two_at_once(conduct):
        first, second = conduct.ask(), conduct.ask()
        conduct.tell(second.id, measure(built, second))
        conduct.tell(first.id, measure(built, first))

    return [initial, initial, off_request, fails, uninvited, abandoned, two_at_once, initial]


def same(one, other):
    jax.tree.map(np.testing.assert_array_equal, *(dataclasses.astuple(state) for state in (one, other)))


@pytest.fixture(scope="module")
def at_once(built, tmp_path_factory):
    """The state after all events in one process."""
    store = RunFolder(tmp_path_factory.mktemp("once") / "run", built.study.written())
    conduct = Conduct(built, store)
    for event in events(built, conduct):
        event(conduct)
    store.close()
    return conduct


@pytest.mark.whole
def test_taken_up_after_every_event_the_design_is_the_same(begin, built, at_once):
    for event in events(built, at_once):
        event(begin())
    same(begin().state, at_once.state)


@pytest.mark.whole
def test_what_became_of_each_experiment_is_in_the_campaign(at_once):
    found = {e.id: e.status for e in at_once.campaign}
    assert list(found.values()).count("completed") == 7
    assert [id for id, status in found.items() if status == "failed"] == ["E04"]
    assert at_once.campaign["E04"].reason == "the pump stopped"
    assert [e.reason for e in at_once.campaign if e.status == "abandoned"] == ["the specimen broke"]
    assert found["X1"] == "completed"
    assert at_once.pending == []


@pytest.mark.whole
def test_inputs_as_tested_are_what_the_design_learns_from(at_once):
    third = at_once.campaign["E03"]
    asked = at_once.design.space.declared(at_once.design.space.initial_design(3))[2]
    assert list(third.inputs.values()) == pytest.approx(1.01 * asked)
    assert at_once.state.trials[2].point.si["V_P"] == pytest.approx(1.01 * asked[0])


@pytest.mark.whole
def test_two_that_are_out_at_once_are_not_the_same_experiment(at_once):
    measured = at_once.state.cube
    distances = np.linalg.norm(measured[:, None] - measured[None], axis=-1) + 10 * np.eye(len(measured))
    assert distances.min() > 1e-3


def test_an_experiment_that_failed_can_be_asked_again_and_an_abandoned_one_cannot(begin, built):
    conduct = begin()
    first = conduct.ask()
    conduct.give_up(first.id, "no oil")
    again = begin().ask_again(first.id)
    assert again.inputs == first.inputs
    taken_up = begin()
    assert taken_up.pending == [first.id]
    taken_up.give_up(first.id, "no specimen", abandon=True)
    with pytest.raises(UserError, match="abandoned"):
        begin().ask_again(first.id)
    with pytest.raises(UserError, match="abandoned already"):
        begin().tell(first.id, measure(built, first))


@pytest.mark.parametrize(
    ("tell", "said"),
    [
        (lambda c: c.tell("E09", Measured({"peak_force": 1.0})), "was not asked; give its inputs"),
        (lambda c: c.tell("X1", Measured({"peak_force": 1.0}), {"V_P": 2.0}), "its inputs are V_P, T_P"),
        (lambda c: c.tell("X1", Measured({"peak_force": 1.0}), {"V_P": 9.0, "T_P": 1.0}), "lie outside"),
        (lambda c: c.tell(c.ask().id, Measured({})), "nothing that the study observes"),
        (lambda c: c.give_up("E09", "why not"), "was not asked"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_is_written(begin, tell, said):
    conduct = begin()
    with pytest.raises(UserError, match=said):
        tell(conduct)
    told = [e for e in conduct.store.events() if e["event"] != "asked"]
    assert told == []


@pytest.mark.whole
def test_more_experiments_than_planned_find_room(begin, built):
    conduct = begin()
    planned = conduct.design.size
    for number in range(planned + 2):
        inputs = {"V_P": 1.6 + 0.1 * number, "T_P": 1.0}
        conduct.tell(
            f"X{number}",
            Measured({"peak_force": 1e5 + number, "peak_elongation": 0.2, "dissipated_energy": 2e4}),
            inputs,
        )
    assert len(conduct.state.trials) == planned + 2
    assert len(conduct.design.data(conduct.state).values) == 2 * planned
    same(begin().state, conduct.state)


# What may be asked.


@pytest.mark.whole
def test_a_limit_keeps_the_design_where_the_response_stays_below_it(built, tmp_path):
    free = Built(load_study(STUDY))
    study = load_study(STUDY | {"design": STUDY["design"] | {"limits": {"stroke": 0.35}}})
    limited = Built(study)
    draws = np.tile([[5e5, 1.0]], (8, 1))
    closed = limited.design.limits(draws, limited.design.sequential.candidate_set)
    assert 0.1 < closed.mean() < 0.9
    declared = limited.experiments.space.declared(np.asarray(limited.design.sequential.candidate_set))
    for index in (int(np.argmax(closed)), int(np.argmin(closed))):
        si = {name: float(values[index]) for name, values in limited.experiments.space.si(declared).items()}
        plain = free.simulation.simulator.quantities({"A": 5e5, "beta": 1.0}, _conditions(si), ("peak_elongation",))[0]
        assert (float(plain[0]) > 0.35) == closed[index]


@pytest.mark.whole
def test_where_experiments_cost_something_a_cheaper_one_is_asked(built, tmp_path):
    cost = {"fixed": -1.4, "per": {"V_P": 1.0}}
    with pytest.raises(UserError, match=r"design\.cost\.fixed"):
        load_study(STUDY | {"design": STUDY["design"] | {"cost": cost}})
    cost = {"fixed": 0.0, "per": {"V_P": 1.0, "T_P": 4.0}}
    priced, asked = Built(load_study(STUDY | {"design": STUDY["design"] | {"cost": cost}})), {}
    priced.check()
    ordered = STUDY["design"] | {"cost": cost, "acquisition": "sobol"}
    with pytest.raises(UserError, match=r"design\.cost: a cost does not change the order of the experiments of sobol"):
        Built(load_study(STUDY | {"design": ordered})).check()
    np.testing.assert_allclose(priced.design.sequential.cost(np.array([[2.0, 0.5]])), [4.0])
    assert priced.design.sequential.cost.bounds == pytest.approx((1.5 + 2.0, 3.0 + 6.0))
    for name, one in (("free", built), ("priced", priced)):
        store = RunFolder(tmp_path / name, one.study.written(), resume=False)
        conduct = Conduct(one, store)
        for _ in range(3):
            first = conduct.ask()
            peak = 1e5 * first.inputs["V_P"]
            conduct.tell(
                first.id, Measured({"peak_force": peak, "peak_elongation": 0.2, "dissipated_energy": peak / 5})
            )
        conduct.ask()
        (asked[name],) = conduct.steps
        store.close()
    assert asked["priced"]["max_expected_improvement"] == asked["free"]["max_expected_improvement"]
    (cheap,), (dear,) = (
        priced.design.sequential.cost(priced.experiments.space.declared(np.array([asked[name]["cube"]])))
        for name in ("priced", "free")
    )
    assert cheap < dear


def _conditions(si):
    import jax.numpy as jnp

    from hsed_jax.physics.simulator import Conditions

    return Conditions({name: jnp.asarray(value) for name, value in si.items()})


def test_failures_close_what_is_near_them_until_experiments_there_succeed():
    grid = np.stack(np.meshgrid(*[np.linspace(0.05, 0.95, 19)] * 2), axis=-1).reshape(-1, 2)
    failed = np.array([[0.5, 0.5]])
    closed = near_failures(grid, failed, np.empty((0, 2)))
    distance = np.linalg.norm(grid - failed, axis=1)
    assert closed[distance < 0.05].all() and not closed[distance > 0.2].any()
    assert not near_failures(grid, failed, np.array([[0.5, 0.52], [0.5, 0.48]])).any()
    assert not near_failures(grid, np.empty((0, 2)), failed).any()


# When it has learned enough.


def steps(maps, improvement=1.0, width=0.1, **more):
    def posterior(a):
        return {"A": {"mean": a, "q05": a * (1 - width / 2), "q95": a * (1 + width / 2)}}

    return [{"max_expected_improvement": improvement, "map": {"A": a}, "posterior": posterior(a)} | more for a in maps]


@pytest.mark.parametrize(
    ("rules", "taken", "reason"),
    [
        ({}, steps([1.0] * 9, improvement=0.0), None),
        ({"expected_improvement": 1e-3}, steps([1.0], improvement=1e-4), "expected_improvement"),
        ({"expected_improvement": 1e-3}, steps([1.0], improvement=1e-2), None),
        ({"stable_map": 0.01}, steps([2.0, 1.001, 1.002, 0.999, 1.0]), "stable_map"),
        ({"stable_map": 0.01}, steps([1.0, 1.02, 1.0, 1.0]), None),
        ({"stable_map": 0.01}, steps([1.0, 1.0, 1.0]), None),
        ({"posterior_width": 0.2}, steps([3.0], width=0.1), "posterior_width"),
        ({"posterior_width": 0.05}, steps([3.0], width=0.1), None),
        ({"verdict": True}, steps([3.0], verdict="missing_effects"), "verdict"),
        ({"verdict": True}, steps([3.0], verdict="adequate"), None),
        ({"expected_improvement": 1.0}, [], None),
    ],
)
def test_a_rule_stops_the_design_and_says_which(rules, taken, reason):
    assert stop_reason(StopRules(**rules), taken) == reason
