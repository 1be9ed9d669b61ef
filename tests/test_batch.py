"""Batch of a large model: each runs the program of the effects that it has, and gives what the whole model gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.config.load import load_study
from hsed_jax.diagnosis import batch as module
from hsed_jax.diagnosis.batch import Batch, Part
from hsed_jax.physics.effects import EFFECTS as CATALOGUE
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

pytestmark = pytest.mark.optimised
EFFECTS = {"hardening": 0, "viscous_damping": 0, "stiffness_degradation": 1, "mass_error": 2}


@pytest.fixture(scope="module")
def case(request):
    """A large model of a short record, its neutral parameters, and lanes of every kind of set."""
    changes = ["observe=quantities", f"model.effects={{{', '.join(f'{name}: {{}}' for name in EFFECTS)}}}"]
    built = Built(load_study(request.config.rootpath / "configs" / "hidden_effect.yaml", changes))
    names = tuple(built.parameters[0])
    law = {"A": 4.5e5, "beta": 1.1}
    known = {f"{effect}.{n}": p.neutral for effect in EFFECTS for n, p in parameters_of(CATALOGUE[effect]).items()}
    neutral = np.array([{**law, **known}[name] for name in names])
    columns = {effect: np.array([k for k, n in enumerate(names) if n.startswith(f"{effect}.")]) for effect in EFFECTS}
    space = built.space
    cube = space.initial_design(3)
    conditions = Conditions({n: jnp.asarray(x) for n, x in space.si(space.declared(cube)).items()})
    parts = [Part(name, group, columns[name], neutral[columns[name]]) for name, group in EFFECTS.items()]
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
    "price",
    [pytest.param(-1, marks=pytest.mark.whole), 10**12],
    ids=["programs of their own", "one program"],
)
def test_lanes_give_what_the_whole_model_gives(case, monkeypatch, price):
    built, names, conditions, parts, thetas, experiments = case
    monkeypatch.setattr(module, "_PROGRAM", price)
    monkeypatch.setattr(module, "_PARAMETER", 0)
    whole, ok = Batch(built.simulator, built.observation, names, conditions)(thetas, experiments)
    lanes = Batch(built.simulator, built.observation, names, conditions, parts)
    kinds = lanes._by_program(thetas)
    # One of its own for each set, or one for whatever is asked, which is not every parameter.
    assert len(kinds) == (7 if price < 0 else 1)
    found, converged = lanes(thetas, experiments)
    np.testing.assert_array_equal(converged, ok)
    assert ok.all()
    np.testing.assert_allclose(found, whole, rtol=1e-9)
    # In the order that was asked for, of the experiment that was asked for.
    theta = dict(zip(names, thetas[4], strict=True))
    at = jax.tree.map(lambda leaf: leaf[experiments[4]], conditions)
    exact, _ = built.simulator.quantities(theta, at, tuple(built.study.quantities))
    np.testing.assert_allclose(found[4], exact, rtol=1e-9)


@pytest.fixture
def sized(case, monkeypatch):
    """Batch with effects of several sizes, where a program costs a thousand steps of a parameter; and the columns of effects."""
    sizes = {"found": (0, 5), "one": (1, 2), "other": (1, 2), "large": (2, 50)}
    ends = np.cumsum([size for _, size in sizes.values()])
    columns = {name: np.arange(end - size, end) for (name, (_, size)), end in zip(sizes.items(), ends, strict=True)}
    parts = [Part(name, group, columns[name], np.zeros(size)) for name, (group, size) in sizes.items()]
    built, names, conditions, *_ = case
    monkeypatch.setattr(module, "_PROGRAM", 1000 * built.simulator.timeline.steps)
    monkeypatch.setattr(module, "_PARAMETER", 0)
    lanes = Batch(built.simulator, built.observation, names, conditions, parts)
    return lanes, lambda *effects: frozenset(np.concatenate([columns[name] for name in effects]).tolist())


def served(lanes, *asked):
    """Sizes of the programs that lanes with these parameters run."""
    thetas = np.zeros((sum(count for _, count in asked), 59))
    ends = np.cumsum([count for _, count in asked])
    for (needed, count), end in zip(asked, ends, strict=True):
        thetas[end - count : end, sorted(needed)] = 1.0
    return sorted((len(columns), len(rows)) for columns, rows in lanes._by_program(thetas).items())


def test_programs_have_what_is_asked_of_them(sized):
    lanes, of = sized
    # Few lanes share a program, whatever their effects; many of one group have one of their own.
    assert served(lanes, (of("one"), 1), (of("other"), 1), (frozenset({0}), 1)) == [(5, 3)]
    assert served(lanes, (of("large"), 100), (frozenset({1}), 100)) == [(1, 100), (50, 100)]
    # What is missing a second time gets what had been missing as well.
    assert served(lanes, (of("other") | {1}, 1)) == [(6, 1)]
    assert served(lanes, (of("one") | {4}, 1), (of("large"), 1)) == [(7, 1), (50, 1)]


def test_what_is_asked_on_and_on_gets_a_program_of_its_own(sized):
    lanes, of = sized
    pairs = [of("one") | {0}, of("other") | {0}]
    assert served(lanes, (pairs[0], 1), (pairs[1], 1)) == [(5, 2)]
    # A lane saves two steps in a program of its own, which costs a thousand.
    assert [served(lanes, (pairs[0], 100)) for _ in range(8)] == [[(5, 100)]] * 4 + [[(3, 100)]] * 4
    assert served(lanes, (of("other"), 1), (pairs[0], 1)) == [(3, 1), (5, 1)]
    assert served(lanes, (frozenset(), 600)) == [(0, 600)]
