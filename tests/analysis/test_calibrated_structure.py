"""Masses, stiffnesses and damping with priors: calibrated with the law, from YAML alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hsed_jax as hx
from hsed_jax.analysis import remedy
from hsed_jax.errors import UserError
from hsed_jax.physics.simulator import Conditions
from hsed_jax.study.build import Built

STUDY = """
study: uncertain_frame
structure:
  masses: [8.0e3, {lognormal: [9.1, 0.15]}]
  springs:
    - {between: [ground, 1], stiffness: {uniform: [2.0e5, 8.0e5]}}
    - {between: [2, ground], stiffness: 1.0e6}
  specimen: {between: [1, 2]}
  damping: {modal: {uniform: [0.0, 0.15]}, specimen_stiffness: 5.0e5}
excitation:
  near_fault_pulse: {V_P: V_P, T_P: 1.0}
  duration: 5.0
inputs: {V_P: {uniform: [1.0, 2.0], unit: m/s}}
model:
  parameters: {A: {uniform: [2.0e5, 9.0e5]}, beta: 1.0}
experiments:
  virtual:
    parameters: {A: 5.0e5, beta: 1.0}
    structure: {mass_2: 1.0e4, stiffness_1: 4.5e5, ratio: 0.04}
    noise: {relative: 0.02}
observe: histories
channels: [force, elongation, acceleration_2_absolute]
steps: [calibrate]
design: {initial: 2}
calibration: {sampler: laplace}
"""
TRUTH = {"A": 5e5, "structure.mass_2": 1e4, "structure.stiffness_1": 4.5e5, "structure.ratio": 0.04}


def study(tmp_path, *changes):
    (tmp_path / "study.yaml").write_text(STUDY)
    return hx.load_study(tmp_path / "study.yaml", changes)


@pytest.mark.whole
def test_they_are_recovered_with_the_law(tmp_path):
    found = hx.calibrate(study(tmp_path)).fit.summary()
    assert list(found) == list(TRUTH)
    for name, truth in TRUTH.items():
        assert abs(found[name]["mean"] - truth) < 4 * found[name]["sd"]
        assert found[name]["sd"] < 0.05 * truth


@pytest.mark.whole
def test_an_improved_model_is_calibrated_from_where_it_fits_best(tmp_path, monkeypatch):
    begun, whole = {}, remedy.calibrate_built

    def begins(built, campaign, start, **settings):
        # The model as it was is calibrated again where a better fit of it was found.
        if "viscous_damping.delta" not in built.mechanics.parameters[0]:
            return whole(built, campaign, start=start, **settings)
        begun.update(zip(built.mechanics.parameters[0], np.asarray(start).tolist(), strict=True))
        raise InterruptedError

    calibration = hx.calibrate(study(tmp_path, "experiments.virtual.effects.viscous_damping={delta: 0.2}"))
    monkeypatch.setattr(remedy, "calibrate_built", begins)
    with pytest.raises(InterruptedError):
        hx.improve(calibration, effects=["viscous_damping"])
    # There is only noise between it and the truth, whatever comes first in the study and in the search.
    assert begun == pytest.approx({**TRUTH, "viscous_damping.delta": 0.2}, rel=0.2)


@pytest.mark.whole
def test_their_derivatives_are_those_of_differences(tmp_path):
    built = Built(study(tmp_path))
    conditions = Conditions({"V_P": jnp.asarray(1.5)})

    def peak(mass):
        parameters = {**TRUTH, "structure.mass_2": mass}
        return built.simulation.simulator.respond(parameters, conditions).quantities["peak_force"]

    slope = (peak(1.001e4) - peak(0.999e4)) / 20.0
    assert float(jax.jacfwd(peak)(1e4)) == pytest.approx(float(slope), rel=1e-3)


def test_the_step_resolves_the_shortest_period_that_the_priors_allow(tmp_path):
    plain = Built(study(tmp_path)).simulation.timeline.step
    stiff = Built(
        study(tmp_path, "structure.springs=[{between: [ground, 1], stiffness: {uniform: [2e5, 8e7]}}]")
    ).simulation.timeline
    assert stiff.step < 0.3 * plain
    assert np.isfinite(plain)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            "structure.masses=[{normal: [1.0e3, 500.0]}, 9.0e3]",
            r"structure.masses\[1\]: this prior reaches from -2e\+03",
        ),
        ("structure.damping.modal={uniform: [0.0, 1.5]}", "structure.damping.modal: this prior reaches from"),
        ("structure.masses=[{gauss: [1, 2]}, 9.0e3]", r"structure.masses\[1\]: there is no distribution 'gauss'"),
        ("experiments.virtual.structure={ratio: 0.04, mass_2: 1.0e4}", "structure.stiffness_1: this key is required"),
        (
            "experiments.virtual.structure={mass_1: 1.0, mass_2: 1.0e4, stiffness_1: 4.0e5, ratio: 0.04}",
            "structure.mass_1: this is for numbers that the study gives priors; with one are mass_2, stiffness_1, ratio",
        ),
    ],
)
def test_a_mistake_is_said_with_its_place(tmp_path, change, message):
    with pytest.raises(UserError, match=message):
        Built(study(tmp_path, change)).check()
