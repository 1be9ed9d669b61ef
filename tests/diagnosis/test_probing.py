"""What is said of the behaviour of a specimen is what its effects do, whether a diagnosis or the study names them."""

import numpy as np
import pytest
from builders.springs import spring_study

from hsed_jax.diagnosis.candidates import problem_of
from hsed_jax.diagnosis.evidence import Sampled
from hsed_jax.diagnosis.fit_state import FitState
from hsed_jax.diagnosis.fits import Model
from hsed_jax.diagnosis.probing import Probe
from hsed_jax.measurements import Campaign, Channel, Experiment, Record
from hsed_jax.study.build import Built

# Steel whose corners become round with the plastic excursion (Menegotto and Pinto 1973), without isotropic hardening.
STEEL = {"k": 1e7, "F_y": 8e4, "b": 0.02, "R0": 15.0, "cR1": 0.925}
LOST = 0.02


def campaign() -> Campaign:
    """Growing cycles to zero; the force does not matter, because nothing is fitted."""
    turns = 0.05 * np.repeat([0.1, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0], 4) * np.tile([1.0, -1.0], 14)
    turns = np.asarray([0.0, *turns, 0.0])
    elongation = np.interp(np.linspace(0, turns.size - 1, 800), np.arange(turns.size), turns)
    record = Record(np.arange(800.0), {"elongation": elongation, "force": 1e7 * np.clip(elongation, -8e-3, 8e-3)})
    channels = {"elongation": Channel("elongation", "mm"), "force": Channel("force", "kN")}
    return Campaign("steel", "displacement", {}, channels, {}, (Experiment("E", record=record),))


def told(model: dict, known: dict[str, float], effects: set[str], model_error: float = 0.0):
    """The behaviour of a model with known parameters and a relative error, of which a diagnosis has named some effects."""
    study = spring_study(model={"spring": "menegotto_pinto", **model})
    problem = problem_of(Built(study, campaign()), campaign(), effects=[*effects] or ["coulomb_friction"])
    x = problem.models.point({name: value for name, value in known.items() if name in problem.names})
    submodel = problem.models.submodel(np.arange(len(problem.names)))
    fit = FitState(submodel, x, 0)
    named = Model(frozenset(effects), {}, {}, fit, 0.0, 0.0, 1.0)
    plain = named._replace(effects=frozenset())
    theta = problem.models.theta(x, submodel)
    assert problem.simulator is not None and problem.visited is not None
    probe = Probe(problem, problem.simulator, problem.visited)
    return probe.behaviours(plain, named, Sampled(0.0, 1.0, theta[None], np.ones(1)), model_error)


@pytest.mark.whole
def test_what_a_law_does_without_any_effect_is_no_change():
    found = told({"parameters": STEEL}, {}, set())
    # The slope at zero force differs along the test, because the corners become round.
    curve = found.curves["initial_stiffness"].mean
    assert abs(curve[-1] / curve[0] - 1) > 0.1
    assert found.changes == [] and "; strength stays within 4 % of 80.1 kN" in found.sentence


@pytest.mark.whole
def test_an_effect_that_the_study_has_is_told_as_one_that_a_diagnosis_names():
    named = told({"parameters": STEEL}, {"stiffness_degradation.delta": LOST}, {"stiffness_degradation"})
    declared = told({"parameters": STEEL, "effects": {"stiffness_degradation": {"delta": LOST}}}, {}, set())
    for found in (named, declared):
        (stiffness,) = (one for one in found.changes if one.quantity == "initial_stiffness")
        assert stiffness.change == "falls"
        assert stiffness.after.mean < 0.8 * stiffness.before.mean
    assert named.sentence == declared.sentence


@pytest.mark.whole
@pytest.mark.parametrize("lost", [2.86e-5, 2.9e-5, 3.0e-5])
def test_a_specimen_that_is_alike_to_both_sides_changes_on_both(lost):
    # A tenth is lost in tension.  In compression, which is read after it, the change is by 0.01 to 0.02 of that smaller.
    law = {"spring": "bouc_wen", "parameters": {"A": 1e7, "beta": 125.0, "gamma": 0.0}}
    found = told(law, {"strength_degradation.delta": lost}, {"strength_degradation"})
    (strength,) = (one for one in found.changes if one.quantity == "strength")
    assert (strength.change, strength.sides) == ("falls", "both")
    assert "extrapolation" not in strength.sentence


@pytest.mark.whole
def test_a_strength_that_no_measured_force_comes_near_is_told_as_an_extrapolation():
    law = {"spring": "bouc_wen", "parameters": {"A": 1e7, "beta": 50.0, "gamma": 0.0}}
    found = told(law, {"strength_degradation.delta": 3e-5}, {"strength_degradation"})
    (strength,) = (one for one in found.changes if one.quantity == "strength")
    assert strength.before.mean > 1.5e5
    assert "is an extrapolation, the largest measured force is 80 kN" in strength.sentence


@pytest.mark.whole
def test_that_a_specimen_returns_to_zero_is_told_though_it_does_so_all_the_time():
    # A tendon of the strength of the law beside it: the force is zero near the origin, and not at half of the elongation.
    law = {"spring": "bouc_wen", "parameters": {"A": 1e7, "beta": 250.0, "gamma": 0.0}}
    found = told(law, {"self_centering.delta": 1.0}, {"self_centering"}, 0.01)
    (returns,) = (one for one in found.changes if one.quantity == "recentring")
    assert returns.change == "differs" and returns.after.mean > returns.before.mean + 0.3
    assert "without the named effects" in returns.sentence and "recentring is" in found.sentence


@pytest.mark.whole
@pytest.mark.parametrize("model_error", [0.01, 0.5])
@pytest.mark.parametrize(("effect", "quantity"), [("hardening", "elastic_force"), ("coulomb_friction", "strength")])
def test_a_force_is_told_unless_the_error_of_the_model_hides_it(effect, quantity, model_error):
    found = told({"parameters": STEEL}, {f"{effect}.delta": 0.2}, {effect}, model_error)
    assert {quantity} <= {one.quantity for one in found.changes} or model_error > 0.1
    assert model_error < 0.1 or found.changes == []
