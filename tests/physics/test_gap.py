"""A slack that a step crosses whole: the response on coarse steps is that on fine ones, and changes evenly with the slack."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.places import ROOT

from hsed_jax.config.load import load_study
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions
from hsed_jax.physics.specimen import Specimen
from hsed_jax.study.build import Built

STUDY = ROOT / "configs" / "hidden_effect.yaml"
U, V = 0.25, 1.5
STEP, SAMPLES = 1 / 64, 384


@pytest.fixture(scope="module")
def elongation():
    """Elongation of the specimen under a pulse, by slack over characteristic elongation and steps per sample, (samples + 1,)."""
    built = Built(load_study(STUDY))
    simulator = replace(
        built.simulation.simulator, effects=EFFECTS.only(["gap"]), scales=Scales(1.2e5, U, V, 2e4), constants=()
    )
    conditions = Conditions({"V_P": jnp.asarray(2.2), "T_P": jnp.asarray(0.9)})
    law = {"A": jnp.asarray(5e5), "beta": jnp.asarray(1.0), "gamma": jnp.asarray(0.0), "n": jnp.asarray(1.0)}

    def respond(slack, fineness):
        timeline = simulator.timeline._replace(step=STEP / fineness, steps=SAMPLES * fineness, every=fineness)
        one = replace(simulator, timeline=timeline)
        run = jax.jit(jax.vmap(lambda d: one.respond(law | {"gap.delta": d}, conditions, ("elongation",)).channels))
        return np.asarray(run(jnp.asarray(slack))["elongation"])

    return respond


@pytest.mark.whole
@pytest.mark.verification("effects")
def test_coarse_steps_cross_a_slack_as_fine_ones_do(elongation, observed):
    slack = np.asarray([0.01, 0.03, 0.06])
    coarse, fine = elongation(slack, 1), elongation(slack, 32)
    # What the slack does to the response is many times what the coarse steps miss of it.
    effect = np.sqrt(np.mean((fine - elongation(np.zeros(3), 32)) ** 2, axis=1))
    missed = np.sqrt(np.mean((coarse - fine) ** 2, axis=1))
    observed("gap: error of coarse steps over the effect of the slack", "32 times finer steps", missed / effect, 0.05)


def test_the_response_changes_evenly_with_the_slack(elongation):
    slack = np.linspace(0.02, 0.05, 61)
    at = elongation(slack, 1)
    apart = np.sqrt(np.mean((at - at[30]) ** 2, axis=1))
    # The distance from the response in the middle falls and rises again: a fit that follows its slope arrives.
    assert (np.diff(apart[:30]) < 0).all() and (np.diff(apart[31:]) > 0).all()


def test_of_a_step_the_share_outside_the_slack_counts():
    specimen = Specimen(BoucWen(2e6, 40.0, 0.0, 1.0), (EFFECTS["gap"](delta=0.1),), Scales(1.0, 0.1, 1.0, 1.0))
    memory = {name: jnp.asarray(3e4 if name == "hysteretic" else 0.0) for name in specimen.start()}
    # The slack is 10 mm to either side; within a step of 10 ms, 40 mm are gone through.
    for elongation, share in ((0.0, 0.5), (0.02, 0.75), (0.03, 1.0), (0.05, 1.0), (-0.015, 0.625)):
        force, _ = specimen.force_and_rates(elongation, 4.0, memory, 0.01)
        assert float(force) == pytest.approx(3e4 * share)
        assert float(specimen.force(elongation, 4.0, memory)) == (3e4 if abs(elongation) >= 0.01 else 0.0)
