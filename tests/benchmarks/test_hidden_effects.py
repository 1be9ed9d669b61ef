"""The benchmark of hidden effects, reduced: campaigns by other programs, whose truth the diagnosis cannot know."""

import json
from collections import Counter
from itertools import groupby

import numpy as np
import pytest
import yaml
from hidden import check
from hidden.campaigns import coloured, make
from hidden.cases import Case, draw
from hidden.catalogue import EFFECTS, FORMULAS, REAL
from hidden.degrading import reversals
from hidden.mixtures import drawn, mixable, mixture
from hidden.probed import forces
from hidden.sensors import Program
from hidden.specimen import EXTRA, Scales, Specimen, pull
from hidden_effects import diagnosed, plan, score, table
from numpy.testing import assert_allclose

from hsed_jax.behaviour.histories import Range, along_the_test
from hsed_jax.behaviour.specimens import alone, answers, longest_step
from hsed_jax.physics import scales as of_package
from hsed_jax.physics.effects import EFFECTS as CATALOGUE
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.simulator import Simulator
from hsed_jax.physics.timeline import Timeline

OTHER = [(effect, name) for effect, name in FORMULAS if name not in ("same", "opensees")]
IN_THE_SPECIMEN = [key for key, formula in FORMULAS.items() if formula.place == "specimen"]


def result(tmp_path, kind, effects, noise=0.05, size=0.10, experiments=6, test=4, seed=0):
    """Make, diagnose and score one case."""
    campaign, truth = tmp_path / "campaign", tmp_path / "truth.json"
    make(Case(kind, effects, size, noise, experiments, test, seed), campaign, truth)
    return score(diagnosed(campaign).summary(), json.loads(truth.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "effect",
    [
        pytest.param("strength_degradation", marks=pytest.mark.whole),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("slip", "quadratic_stiffness", "stribeck_friction")),
    ],
)
def test_a_hidden_effect_is_named_in_a_component_test(tmp_path, effect):
    found = result(tmp_path, "component", ((effect, "same"),))
    assert (found["verdict"], found["named"]) == ("missing_effects", [effect])
    before, after, noise = found["error"]
    assert after < 1.15 * noise
    assert after < before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "formula"),
    [
        ("stiffness_degradation", "exponential in hysteretic work"),
        ("asymmetry", "stiffness and strength"),
        ("hardening", "kinematic"),
    ],
)
def test_another_formula_of_the_same_physics_is_named_by_its_family(tmp_path, effect, formula):
    found = result(tmp_path, "component", ((effect, formula),), noise=0.02)
    assert found["family"], found


@pytest.mark.parametrize(
    ("noise", "experiments"),
    [
        pytest.param(0.02, 3, marks=pytest.mark.whole),
        pytest.param(0.05, 6, marks=pytest.mark.slow),
        pytest.param(0.10, 6, marks=pytest.mark.slow),
    ],
)
def test_nothing_is_named_where_nothing_is_missing(tmp_path, noise, experiments):
    found = result(tmp_path, "component", (), noise=noise, experiments=experiments, size=0.0, seed=experiments)
    assert (found["verdict"], found["named"]) == ("adequate", [])


@pytest.mark.slow
def test_two_hidden_effects_are_both_named(tmp_path):
    effects = (("quadratic_stiffness", "same"), ("coulomb_friction", "same"))
    found = result(tmp_path, "component", effects, noise=0.02)
    assert sorted(found["named"]) == ["coulomb_friction", "quadratic_stiffness"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect", ["stiffness_degradation", "mass_error", "time_offset", "cubic_stiffness", "pinching"]
)
def test_a_hidden_effect_is_named_in_a_shaken_structure(tmp_path, effect):
    found = result(tmp_path, "shaken", ((effect, "same"),))
    assert (found["verdict"], found["named"]) == ("missing_effects", [effect])


@pytest.mark.slow
def test_three_numbers_per_experiment_tell_it_too(tmp_path):
    found = result(tmp_path, "quantities", (("stiffness_degradation", "same"),), 0.02, 0.25, 20, 6)
    assert found["named"] == ["stiffness_degradation"]


def moved(formula, delta):
    """Force and slope of a specimen at 200 random states, with and without an effect of amplitude δ in a formula."""
    random, n = np.random.default_rng(3), 200
    scales = Scales(2.0e5, 0.2, 1.0, 5.0e4)
    state = np.zeros((EXTRA + formula.states, n))
    state[4], state[5:7] = random.uniform(-3e5, 3e5, n), random.uniform(0, 8e4, (2, n))
    u, v = random.uniform(-0.3, 0.3, n), random.uniform(-1.5, 1.5, n)
    state[7] = np.abs(u) + random.uniform(0, 2, n)
    # What an effect remembers is zero where it does nothing, and has any value where it does something.
    state[EXTRA:] = random.uniform(0, 5, (formula.states, n)) * (delta != 0)
    reach = np.abs(u) + random.uniform(0, 0.1, (2, n))
    specimen = Specimen(np.full(n, 4e5), np.ones(n), scales)
    plain = specimen(u, v, state, reach)
    drawn = {key: np.mean(bounds) for key, bounds in formula.draws.items()}
    specimen.acts = [(formula.act, {"delta": np.full(n, delta), **drawn}, formula.states)]
    return plain, specimen(u, v, state, reach), specimen.rows


def added(formula, delta):
    plain, changed, _ = moved(formula, delta)
    return changed[0] - plain[0]


def test_each_part_of_a_mixture_has_its_share_of_the_amplitude():
    mixed = mixture("hardening", "0.40 log + 0.60 three slopes")
    log, slopes = (FORMULAS["hardening", name] for name in ("log", "three slopes"))
    parts = added(log, 0.4 * 0.3) + added(slopes, 0.6 * 0.3)
    assert_allclose(added(mixed, 0.3), parts, rtol=1e-9, atol=1e-6)


def test_parts_of_a_mixture_have_states_of_their_own():
    formula = mixture("relaxation", "0.50 same + 0.50 three times")
    assert formula.states == sum(FORMULAS["relaxation", name].states for name in ("same", "three times"))
    assert len(moved(formula, 0.3)[1][2]) == formula.states


def test_a_mixture_has_two_formulas_and_another_number_others():
    names = {drawn("pinching", seed) for seed in range(20)}
    assert len(names) > 10
    for name in names:
        (one, first), (other, second) = (part.split(" ", 1)[::-1] for part in name.split(" + "))
        assert one != other and {one, other} <= set(mixable("pinching"))
        assert float(first) + float(second) == pytest.approx(1.0)


@pytest.mark.parametrize(("effect", "name"), IN_THE_SPECIMEN)
def test_a_formula_does_nothing_at_zero_and_something_elsewhere(effect, name):
    plain, neutral, rows = moved(FORMULAS[effect, name], 0.0)
    assert_allclose(neutral[0], plain[0], rtol=1e-15)
    assert_allclose(neutral[1], plain[1], rtol=1e-12)
    assert len(neutral[2]) == rows - EXTRA
    plain, changed, _ = moved(FORMULAS[effect, name], 0.3)
    assert all(np.isfinite(part).all() for part in changed[:2])
    assert max(np.max(np.abs(changed[i] - plain[i]) / np.max(np.abs(plain[i]))) for i in range(2)) > 1e-6


def test_many_effects_have_three_formulas_beside_the_catalogues():
    counts = Counter(effect for effect, _ in OTHER)
    assert sum(count >= 3 for count in counts.values()) >= 15
    assert set(REAL) <= set(counts) <= set(EFFECTS) | set(REAL)


def test_the_simulator_counts_reversals_and_knows_the_largest_elongation_of_each_side():
    program = Program(np.array([0.3]), np.array([1.3]), 3.0, lead=0.4)
    scales = Scales(2.0e5, 0.2, 1.0, 5.0e4)
    found = []
    for act, states in (
        (lambda x, s, p: setattr(s, "force", reversals(x, s)), 2),
        (lambda x, s, p: setattr(s, "force", x.high), 0),
        (lambda x, s, p: setattr(s, "force", x.low), 0),
    ):
        # A spring without stiffness: what is left of the force is what the effect writes.
        specimen = Specimen(np.full(1, 1e-12), np.ones(1), scales, [(act, {}, states)])
        found.append(pull(specimen, program, 2.5e-3, 3.0))
    count, high, low = (run.force[:, 0] for run in found)
    u, v = found[0].u[:, 0], found[0].v[:, 0]
    turns = np.flatnonzero(np.diff(np.sign(v)))
    # A turn is over within some tenths of the characteristic elongation.
    settled = np.searchsorted(
        np.cumsum(np.abs(np.diff(u))), np.cumsum(np.abs(np.diff(u)))[turns] + 5 * 0.1 * scales.elongation
    )
    assert len(turns) == 8
    assert np.all(settled < np.append(turns[1:], len(u)))
    assert_allclose(np.diff(count[settled]), 1, atol=0.01)
    assert_allclose(high, np.maximum.accumulate(np.maximum(u, 0)), atol=1e-12)
    assert_allclose(low, np.maximum.accumulate(np.maximum(-u, 0)), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "name"),
    [("stiffness_degradation", "stairs of reversals"), ("strength_degradation", "log of each side's elongation")],
)
def test_a_formula_with_a_memory_is_resolved_in_time(effect, name):
    """Against DOP853 in steps of its own."""
    difference = check.against_scipy(effect, name, "component")
    assert difference is not None
    assert difference < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "name"), [key for key in OTHER if key in IN_THE_SPECIMEN])
def test_every_other_formula_has_the_size_that_was_asked(tmp_path, effect, name):
    campaign, truth = tmp_path / "campaign", tmp_path / "truth.json"
    make(Case("component", ((effect, name),), 0.10, 0.05, 3, 1, 0), campaign, truth)
    assert json.loads(truth.read_text(encoding="utf-8"))["change"] == pytest.approx(0.10, rel=0.06)


@pytest.mark.parametrize("stride", [2, 3, 4, 5, 6, 8])
def test_a_part_of_the_plan_is_spread_over_kinds_effects_and_formulas(stride):
    for group, cases in plan().items():
        part = cases[::stride]
        whole, kinds = Counter(case.kind for case in cases), Counter(case.kind for case in part)
        # A stride meets each run of cases of a kind to within one; mixtures have four of each kind, the others one.
        runs = Counter(kind for kind, _ in groupby(case.kind for case in cases))
        assert max(runs.values()) == (4 if group.startswith("mixed") else 1), group
        assert all(abs(kinds[kind] - count / stride) <= runs[kind] for kind, count in whole.items()), group
        if group.startswith("other formula"):
            assert {case.effects[0] for case in cases} == {key for key in OTHER if key[0] in EFFECTS}
            # An effect comes up as often as its number of formulas says, a formula hardly ever twice.
            whole, effects = (Counter(case.effects[0][0] for case in some) for some in (cases, part))
            assert all(abs(effects[effect] - count / stride) <= 3 for effect, count in whole.items())
            assert len({case.effects for case in part}) > 0.8 * min(len(part), len(OTHER))


def test_noise_with_a_memory_has_the_declared_variance():
    noise = coloured(np.random.default_rng(0), (20_000, 3), 0.8)
    assert_allclose(noise.std(axis=0), 1, atol=0.05)
    assert_allclose([np.corrcoef(column[1:], column[:-1])[0, 1] for column in noise.T], 0.8, atol=0.02)
    # Stationary from the first sample on.
    starts = coloured(np.random.default_rng(1), (3, 20_000), 0.8)
    assert_allclose(starts.std(axis=1), 1, atol=0.03)


@pytest.mark.whole
def test_a_campaign_with_coarse_records_and_noise_that_remembers_declares_neither(tmp_path):
    fine, coarse = (Case("component", (), 0.0, 0.05, 3, 1, 0, memory=0.7, every=every) for every in (1, 8))
    for case, name in ((fine, "fine"), (coarse, "coarse")):
        make(case, tmp_path / name, tmp_path / f"{name}.json")
    records = [
        np.loadtxt(tmp_path / name / "records" / "E01.csv", delimiter=",", skiprows=1) for name in ("fine", "coarse")
    ]
    assert [len(record) for record in records] == [400, 50]
    assert_allclose(records[1][:, :2], records[0][::8, :2], rtol=1e-6, atol=1e-9)
    declared = [
        yaml.safe_load((tmp_path / name / "campaign.yaml").read_text())["channels"] for name in ("fine", "coarse")
    ]
    assert declared[0] == declared[1]
    assert declared[0]["force"]["noise"] == {"relative": 0.05}


def test_the_table_counts_false_alarms_and_errors_that_rise():
    row = {
        "group": "g", "verdict": "missing_effects", "first": True, "family": True, "exact": False, "covered": [],
        "absorbed": False,
        "case": {"kind": "shaken", "effects": [["gap", "same"]]},
    }  # fmt: skip
    rows = [
        row | {"named": ["gap", "slip"], "error": [0.1, 0.2, 0.05], "seconds": 3.0},
        row | {"named": ["gap"], "exact": True, "error": [0.1, 0.05, 0.05], "seconds": 5.0},
        # Of two effects one, where the noise is all that is left: there was no more to see.
        row | {"named": ["gap"], "absorbed": True, "error": [0.1, 0.05, 0.05], "seconds": 4.0},
    ]
    head, _, line = table(rows).splitlines()
    cells = dict(zip(head.split(" | "), line.split(" | "), strict=True))
    assert (cells["false alarms"], cells["error raised"], cells["exact set"]) == ("1", "1", "50 %")
    assert "g: gap (same)" in table(rows, "formula")


@pytest.mark.whole
def test_the_hidden_specimen_and_the_package_answer_the_same_numerical_experiments_alike():
    visited = Range(0.2 * np.linspace(0, 1, 13) * (-1.0) ** np.arange(13), 1.0)
    case = Case("component", (("stiffness_degradation", "same"),), 0.1, 0.02, 6, 4, 5)
    plan, scales = draw(case), Scales(3e5, 0.2, 1.0, 3e5)
    histories = along_the_test(visited, longest_step(1 / plan.beta, visited.elongation))
    own = forces(plan, [0.7], scales, *histories.imposed)
    simulator = Simulator(
        structure=None,
        excitation=None,
        timeline=Timeline(None, 1, 1),
        effects=CATALOGUE.only(["stiffness_degradation"]),
        scales=of_package.Scales(*scales),
    )
    held = {
        f"stiffness_degradation.{name}": float(known.neutral)
        for name, known in parameters_of(simulator.effects["stiffness_degradation"]).items()
        if known.shapes
    }
    specimen = alone(simulator, simulator.elements[0], held)
    values = {"A": plan.A, "beta": plan.beta, "gamma": 0.0, "n": 1.0, "stiffness_degradation.delta": 0.7}
    found = answers(specimen, [values], histories.imposed)
    assert found.ok.all()
    assert_allclose(found.force[0], own, atol=0.01 * np.abs(own).max())
