"""The benchmark of hidden effects, reduced: campaigns by other programs, whose truth the diagnosis cannot know."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from hidden.campaigns import make
from hidden.cases import Case
from hidden_effects import diagnosed, score


def result(tmp_path, kind, effects, noise=0.05, size=0.10, experiments=6, test=4, seed=0):
    """Make, diagnose and score one case."""
    campaign, truth = tmp_path / "campaign", tmp_path / "truth.json"
    make(Case(kind, effects, size, noise, experiments, test, seed), campaign, truth)
    return score(diagnosed(campaign), json.loads(truth.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "effect",
    [
        "strength_degradation",
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
@pytest.mark.parametrize("effect", ["stiffness_degradation", "asymmetry", "hardening"])
def test_another_formula_of_the_same_physics_is_named_by_its_family(tmp_path, effect):
    found = result(tmp_path, "component", ((effect, "other"),), noise=0.02)
    assert found["family"], found


@pytest.mark.parametrize(
    ("noise", "experiments"),
    [(0.02, 3), pytest.param(0.05, 6, marks=pytest.mark.slow), pytest.param(0.10, 6, marks=pytest.mark.slow)],
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
