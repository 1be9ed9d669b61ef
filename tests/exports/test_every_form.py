"""Every form of every effect with each driver, alone in a model: it can be simulated, added by `improve`, and exported."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.shares import by_default, has_default_driver

import hsed_jax as hx
from hsed_jax.config.schema import CalibrationEntry, Study
from hsed_jax.diagnosis.candidates import with_effects
from hsed_jax.errors import UserError
from hsed_jax.exports.calibrated import Calibrated
from hsed_jax.exports.counterparts import material
from hsed_jax.exports.scripts import python_script, tcl_script
from hsed_jax.exports.table import latex, markdown, rows
from hsed_jax.measurements import Campaign, Channel, Noise
from hsed_jax.physics.effects import EFFECTS, AbstractSetupEffect
from hsed_jax.physics.effects.forms import forms_of
from hsed_jax.physics.laws import BoucWen
from hsed_jax.physics.laws.base import Turn
from hsed_jax.physics.simulator import Conditions, Simulator
from hsed_jax.physics.specimen import unserved
from hsed_jax.study.build import Built

LAWS = {
    "bouc_wen": {"A": {"uniform": [2e6, 9e6]}, "beta": {"uniform": [50.0, 200.0]}, "gamma": 0.0, "n": 1.0},
    "elastic": {"k": {"uniform": [2e6, 9e6]}},
}
SHAKEN = {
    "structure": {
        "masses": [2e4, 2e4],
        "springs": [{"between": [1, 2], "stiffness": 4e6}, {"between": [2, "ground"], "stiffness": 4e6}],
        "specimen": {"between": ["ground", 1]},
        "damping": {"modal": 0.02, "specimen_stiffness": 4e6},
    },
    "excitation": {"near_fault_pulse": {"V_P": 0.5, "T_P": 0.5}, "duration": 2.0},
}
CYCLES = {"excitation": {"imposed": {"amplitudes": [0.02, 0.04], "cycles": 1, "rate": 0.05}}}
FORMS = tuple((name, label) for name, effect in EFFECTS.items() for label in forms_of(effect))


@cache
def plain(law: str, drive: str) -> Built:
    """A study without effects whose characteristic values are given, so that nothing is computed to have them."""
    scales = {"force": 4e4, "elongation": 0.02, "rate": 0.05, "energy": 2e3}
    driven = SHAKEN if drive == "shaken" else CYCLES
    truth = {"A": 5e6, "beta": 100.0} if law == "bouc_wen" else {"k": 5e6}
    content = {"study": "forms", "model": {"spring": law, "parameters": LAWS[law]}, "scales": scales, **driven,
               "experiments": {"virtual": {"parameters": truth}}, "error": {"relative": 0.01}}  # fmt: skip
    return Built(Study.model_validate(content))


def of_effect(name: str) -> Built:
    """A plain model that can have an effect."""
    effect = EFFECTS[name]
    law = "elastic" if unserved(effect, BoucWen) else "bouc_wen"
    return plain(law, "shaken" if effect.shaken_only else "cycles")


def with_form(name: str, label: str) -> Built:
    """The model with one effect in one form, as `improve` makes it."""
    return Built(with_effects(of_effect(name), [name], {name: label}))


def middle(built: Built) -> dict[str, float]:
    """The free parameters in the middle of their priors."""
    return {name: float(prior.quantile(0.5)) for name, prior in built.mechanics.parameters[0].items()}


def simulated(built: Built) -> set[str]:
    """Names of what a simulation computes: traced, so that what is missing is found and nothing is compiled."""
    model, at = built.simulation.planned_simulator, jax.tree.map(jnp.asarray, middle(built))
    assert isinstance(model, Simulator)
    if any(issubclass(effect, AbstractSetupEffect) for effect in model.effects.values()):
        channels = ("elongation", "force", "energy")
        return set(jax.eval_shape(lambda at: model.respond(at, Conditions({}), channels), at).channels)

    def step(at):
        """One step of the integration that ends in a reversal; the integrator around it is the same for every effect."""
        specimen, u, v = model.system(at).specimens[0], jnp.asarray(0.01), jnp.asarray(0.05)
        memory = specimen.start()
        force, flow = specimen.force_and_rates(u, v, memory, 0.02)
        turn = Turn(jnp.asarray(True), jnp.asarray(0.02), jnp.asarray(0.5), u, u, v, -v)
        return specimen.turned(turn, memory, flow, memory), force

    (memory, _), _ = jax.eval_shape(step, at)
    return set(memory)


@pytest.mark.parametrize(("name", "label"), by_default(FORMS, has_default_driver))
def test_a_form_alone_is_simulated_and_exported(name, label):
    built = with_form(name, label)
    assert "energy" in simulated(built)
    at = middle(built)
    told = {key: {"mean": value, "q05": 0.9 * value, "q95": 1.1 * value} for key, value in at.items()}
    model = Calibrated(built, at, told, built.simulation.scales)
    table = rows(model)
    assert all(key in text for key in at for text in (markdown(table), latex(table).replace(r"\_", "_")))
    law, effects, outside = model.of(built.mechanics.elements[0])
    assert [*effects, *outside] == [name]
    try:
        commands = material(law, effects, model.scales, model.reach())
    except UserError as refused:
        assert "no counterpart" in str(refused) and name in str(refused)
    else:
        assert python_script("", [], commands, 0.04) and tcl_script("", [], commands, 0.04)


@pytest.mark.parametrize("name", EFFECTS)
def test_all_forms_of_an_effect_are_simulated_in_one_model(name):
    # The model from which `improve` starts: what tells the forms apart is free, and no form is left out.
    opened = Built(with_effects(of_effect(name), [name]), open_forms=(name,))
    assert "energy" in simulated(opened)


CHANGED_BY_ENERGY = {
    "viscous_damping": "heating",
    "power_damping": "heating",
    "coulomb_friction": "heating",
    "hardening": "wearing of energy",
    "support_flexibility": "loosening",
}


@pytest.mark.parametrize("name", CHANGED_BY_ENERGY)
def test_what_changes_with_the_absorbed_energy_alone_has_a_response(name):
    built = with_form(name, CHANGED_BY_ENERGY[name])
    sizes = {f"{name}.delta": 0.3, f"{name}.wears": 0.2}
    gained, same = (hx.simulate(built.study, {}, {**sizes, f"{name}.worn": worn}).quantities for worn in (1.0, 0.0))
    assert all(np.isfinite(value) for value in gained.values())
    assert abs(gained["dissipated_energy"] / same["dissipated_energy"] - 1) > 1e-3


@pytest.mark.whole
def test_a_model_is_improved_by_an_effect_that_changes_with_the_absorbed_energy():
    truth = with_form("hardening", "wearing of energy")
    at = {"A": 5e6, "beta": 100.0, "hardening.delta": 0.5, "hardening.worn": -0.8, "hardening.wears": 0.5}
    found = hx.simulate(truth.study, {}, at, ("elongation", "force"))
    time = np.asarray(truth.simulation.planned_simulator.times({}))
    record = {"time": time, **{name: np.asarray(values) for name, values in found.channels.items()}}
    channels = {"time": "s", "elongation": "m", "force": Channel("force", "N", noise=Noise(200.0))}
    campaign = Campaign.from_frames(records={"E01": record}, protocol="displacement", channels=channels)
    study = of_effect("hardening").study.model_copy(
        update={"observe": "histories", "calibration": CalibrationEntry(sampler="laplace", starts=2)}
    )
    fit = hx.calibrate(study, campaign)
    better = hx.improve(fit, effects=["hardening"], forms={"hardening": "wearing of energy"})
    assert better.trail.steps[-1].error_train < 0.1 * better.trail.steps[0].error_train
