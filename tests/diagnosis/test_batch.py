"""Batch of a large model: one program for all sets of effects, which computes what acts and gives what the whole model gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.config.load import load_study
from hsed_jax.diagnosis import batch as module
from hsed_jax.diagnosis.batch import Batch, Part
from hsed_jax.inference.observation import Outputs
from hsed_jax.inference.simulations import outputs_of, points_of_a_call
from hsed_jax.measurements import Campaign
from hsed_jax.physics import gates
from hsed_jax.physics.effects import EFFECTS as CATALOGUE
from hsed_jax.physics.effects.base import merged, neutral
from hsed_jax.physics.effects.shaped import shapes_of
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

pytestmark = pytest.mark.optimised
EFFECTS = ("hardening", "viscous_damping", "stiffness_degradation", "mass_error")


@pytest.fixture(scope="module")
def case(request):
    """A large model of a short record, its neutral parameters, and simulations of every kind of set."""
    changes = ["observe=quantities", f"model.effects={{{', '.join(f'{name}: {{}}' for name in EFFECTS)}}}"]
    built = Built(load_study(request.config.rootpath / "configs" / "hidden_effect.yaml", changes))
    names = tuple(built.mechanics.parameters[0])
    law = {"A": 4.5e5, "beta": 1.1}
    known = {f"{effect}.{n}": p.neutral for effect in EFFECTS for n, p in parameters_of(CATALOGUE[effect]).items()}
    neutral = np.array([{**law, **known}[name] for name in names])
    columns = {effect: np.array([k for k, n in enumerate(names) if n.startswith(f"{effect}.")]) for effect in EFFECTS}
    space = built.experiments.space
    cube = space.initial_design(3)
    conditions = Conditions({n: jnp.asarray(x) for n, x in space.si(space.declared(cube)).items()})
    shapes = {name: shapes_of(CATALOGUE[name]) for name in EFFECTS}
    parts = [
        Part(name, k, neutral[k], np.array([names[one].split(".")[1] in shapes[name] for one in k]))
        for name, k in columns.items()
    ]
    sets = [(), ("hardening",), ("viscous_damping", "hardening"), ("stiffness_degradation",), ("mass_error",),
            ("hardening", "stiffness_degradation"), tuple(EFFECTS)]  # fmt: skip
    thetas = np.tile(neutral, (3 * len(sets), 1))
    for number, chosen in enumerate(sets):
        for name in chosen:
            # Of an effect of two amplitudes the second one alone.
            thetas[3 * number : 3 * number + 3, columns[name][-1]] += 0.1
    mixed = np.random.default_rng(0).permutation(len(thetas))
    return built, names, conditions, parts, thetas[mixed], np.tile(np.arange(3), len(sets))[mixed]


@pytest.mark.parametrize(
    "price", [pytest.param(-1, marks=pytest.mark.whole), 10**12], ids=["programs of their own", "one program"]
)
def test_a_batch_gives_what_the_whole_model_gives(case, monkeypatch, price):
    built, names, conditions, parts, thetas, experiments = case
    monkeypatch.setattr(module, "_PRICE", price)
    # Without parts everything is computed.
    whole, ok = Batch(built.simulation.simulator, built.inference.observation, names, conditions)(thetas, experiments)
    batch = Batch(built.simulation.simulator, built.inference.observation, names, conditions, parts)
    found, converged = batch(thetas, experiments)
    np.testing.assert_array_equal(converged, ok)
    assert ok.all() and batch.simulations == len(thetas)
    np.testing.assert_allclose(found, whole, rtol=1e-9)
    # In the order that was asked for, of the experiment that was asked for.
    theta = dict(zip(names, thetas[4], strict=True))
    at = jax.tree.map(lambda leaf: leaf[experiments[4]], conditions)
    exact, _ = built.simulation.simulator.quantities(theta, at, tuple(built.study.quantities))
    np.testing.assert_allclose(found[4], exact, rtol=1e-9)


@pytest.mark.whole
def test_effects_that_are_no_candidates_always_act(case):
    built, names, conditions, parts, thetas, experiments = case
    whole, _ = Batch(built.simulation.simulator, built.inference.observation, names, conditions)(thetas, experiments)
    # Those of the model as it is: a specimen's and the structure's are among them.
    batch = Batch(built.simulation.simulator, built.inference.observation, names, conditions, parts[:2])
    np.testing.assert_allclose(batch(thetas, experiments)[0], whole, rtol=1e-9)


def test_what_is_absent_of_all_that_run_together_is_not_computed():
    called = []

    def part(name, value):
        def say():
            return {
                "force": jax.pure_callback(
                    lambda v: called.append(name) or v, jnp.zeros(()), value, vmap_method="sequential"
                )
            }

        return gates.Contributor(lambda: ("force",), say)

    @jax.jit
    def forces(values, acts):
        acting = tuple(acts[k] for k in range(8))

        def one(value):
            parts = [part(k, value * k) for k in range(8)]
            return gates.gathered(parts, acting, merged, neutral)["force"]

        return jax.vmap(one, axis_name=gates.BATCH_AXIS)(values)

    values = jnp.asarray([1.0, 2.0])
    np.testing.assert_array_equal(forces(values, jnp.arange(8) == 8), [0.0, 0.0])
    assert not called
    np.testing.assert_array_equal(forces(values, (jnp.arange(8) == 3) | (jnp.arange(8) == 7)), [10.0, 20.0])
    assert set(called) == {3, 7}


def test_simulations_of_one_model_run_together_and_often_in_a_program_of_their_own(case, monkeypatch):
    built, names, conditions, parts, thetas, _ = case
    batch = Batch(built.simulation.simulator, built.inference.observation, names, conditions, parts)
    monkeypatch.setattr(module, "_PRICE", 7 * built.simulation.simulator.timeline.steps)
    differs = thetas != batch._present.neutral
    kinds = np.unique(differs, axis=0, return_inverse=True)[1].ravel()
    # Three of each of seven models, at once and once more.
    for _ in range(2):
        ((served, places),) = batch._served(thetas, None)
        assert served.present is not None and sorted(places) == list(range(len(thetas)))
        assert np.count_nonzero(np.diff(kinds[places])) == 6
    found = list(batch._served(thetas, None))
    assert len(found) == 7 and all(served.present is None and len(places) == 3 for served, places in found)
    assert sorted(len(served.columns) for served, _ in found)[0] == 2


def two_records():
    """The model of a long record and a short one of imposed elongations, and the measurements."""
    phase = np.linspace(0, 6 * np.pi, 240)
    elongation = 0.02 * phase / phase[-1] * np.sin(phase)
    channels, records = {"elongation": "m", "force": "N"}, {"long": slice(0, 240), "short": slice(0, 100)}
    frames = {name: {"elongation": elongation[own], "force": 1e5 * np.sin(phase[own])} for name, own in records.items()}
    campaign = Campaign.from_frames(protocol="displacement", channels=channels, records=frames)
    study = {
        "study": "asked",
        "model": {
            "parameters": {"A": {"lognormal": [16.8, 0.3]}, "beta": {"lognormal": [5.3, 0.3]}, "gamma": 0.0, "n": 1.0}
        },
        "experiments": {"campaign": "nowhere"},
        "observe": "histories",
        "error": {"unknown": True},
        "steps": ["calibrate"],
    }
    built = Built(load_study(study), campaign)
    return built, built.inference.data(campaign, campaign.experiments)


@pytest.mark.parametrize("is_short", [False, True])
def test_a_history_is_simulated_as_far_as_it_is_asked_for(is_short):
    """To the last sample that is used, or earlier where fewer are asked for: those are as in the whole simulation."""
    built, data = two_records()
    names, used = ("A", "beta"), np.asarray(data.weights) > 0
    if is_short:
        used[0, 150:] = False
    whole = Batch(built.simulation.simulator, built.inference.observation, names, data.conditions)
    batch = Batch(built.simulation.simulator, built.inference.observation, names, data.conditions, used=used)
    thetas, experiments = np.tile([2.0e7, 200.0], (9, 1)) * np.linspace(0.7, 1.3, 9)[:, None], np.arange(9) % 2
    expected, _ = whole(thetas, experiments)
    found, ok = batch(thetas, experiments)
    assert ok.all()
    np.testing.assert_array_equal(np.where(used[experiments], found, 0), np.where(used[experiments], expected, 0))
    asked = np.where(experiments == 0, 60, 40)
    found, _ = batch(thetas, experiments, asked)
    known = np.arange(found.shape[1]) < asked[:, None]
    np.testing.assert_array_equal(found[known], expected[known])
    # Later ones were not made.
    late = np.arange(found.shape[1]) > asked.max() + 40
    assert np.ptp(found[:, late], axis=1).max() == 0 and np.ptp(expected[::2, late], axis=1).min() > 0
    # A program that calls back into Python could not be kept for the next process.
    model, batch = Outputs(built.simulation.simulator, built.inference.observation, names), jnp.asarray(experiments)
    lowered = module._outputs.lower(
        model, data.conditions, None, jnp.asarray(thetas), batch, jnp.asarray(9), jnp.full(9, 40)
    )
    assert "callback" not in lowered.as_text()


def three_windows():
    """The model of three windows of one record, and the measurements."""
    phase = np.linspace(0, 6 * np.pi, 240)
    frame = {"elongation": 0.02 * phase / phase[-1] * np.sin(phase), "force": 1e5 * np.sin(phase)}
    ends = {"E01": (0, 60), "E02": (90, 130), "E03": (130, 200)}
    campaign = Campaign.from_frames(
        [{"id": name, "from": begin, "to": end} for name, (begin, end) in ends.items()],
        protocol="displacement",
        channels={"elongation": "m", "force": "N"},
        records=dict.fromkeys(ends, frame),
    )
    built = Built(two_records()[0].study, campaign)
    return built, built.inference.data(campaign, campaign.experiments)


THETAS = np.asarray([[2.0e7, 200.0], [1.5e7, 250.0]])


@pytest.mark.whole
def test_windows_of_one_record_have_one_simulation():
    """As far as the last of them needs it; each window gives what it gives alone."""
    built, data = three_windows()
    model, observation, names = built.simulation.simulator, built.inference.observation, ("A", "beta")
    used = np.asarray(data.weights) > 0
    batch = Batch(model, observation, names, data.conditions, used=used)
    found, ok = batch(np.repeat(THETAS, 3, axis=0), np.tile(np.arange(3), 2))
    assert ok.all() and batch.simulations == 2
    for number, own in enumerate(used):
        conditions = jax.tree.map(lambda leaf, k=number: leaf[k][None], data.conditions)
        alone, _ = Batch(model, observation, names, conditions)(THETAS, np.zeros(2, dtype=int))
        np.testing.assert_array_equal(found[number::3][:, own], alone[:, own])


@pytest.mark.whole
def test_a_calibration_simulates_the_windows_of_one_record_once():
    built, data = three_windows()
    campaign = built.campaign
    one = built.inference.data(campaign, campaign.experiments[:1])
    assert np.asarray(data.first).tolist() == [0, 0, 0] and points_of_a_call(data) == points_of_a_call(one)
    outputs, ok = outputs_of(built.inference.posterior, data, THETAS[:, None])
    expected, _ = outputs_of(built.inference.posterior, one, THETAS[:, None])
    assert outputs.shape[:2] == (2, 3) and ok.all()
    np.testing.assert_array_equal(outputs, np.repeat(expected, 3, axis=1))
    # While experiments are added to a padded program, its shapes stay.
    padded = built.inference.data(campaign, campaign.experiments, size=5)
    assert np.asarray(padded.first).tolist() == [0, 1, 2, 3, 4]


def test_nothing_is_simulated_after_the_end_of_a_record(monkeypatch):
    built, data = two_records()
    asked: list[np.ndarray] = []

    def outputs(*args):
        asked.append(np.asarray(args[-1]))
        return _outputs(*args)

    _outputs = module._outputs
    monkeypatch.setattr(module, "_outputs", outputs)
    used = np.asarray(data.weights) > 0
    batch = Batch(built.simulation.simulator, built.inference.observation, ("A", "beta"), data.conditions, used=used)
    batch(np.tile([2.0e7, 200.0], (2, 1)), np.array([0, 1]))
    # Steps that the records take, in a program that has more.
    taken = [int(built.inference.observation.grid.divisions(e.record).sum()) for e in built.experiments.campaign]
    assert sorted({int(stop) for stops in asked for stop in stops}) == sorted(taken)
    assert max(taken) < built.simulation.simulator.timeline.steps


def test_a_call_has_many_points_unless_their_outputs_are_many():
    """Python takes longer for a call of two points than the simulations of them."""
    _, data = three_windows()

    def points(experiments: int, outputs: int) -> int:
        return points_of_a_call(data._replace(values=np.zeros((experiments, outputs)), first=np.arange(experiments)))

    assert points(1, 3) == 128 and points(64, 3) == 32
    assert points(64, 1024) == 4 and points(64, 2**18) == 1
