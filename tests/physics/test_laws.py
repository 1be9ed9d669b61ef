"""Spring laws: each against another program, as a path and as an oscillator; derivatives; effects; what a study may say."""

import json
import runpy
from collections import defaultdict
from functools import cache
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from builders.places import ROOT
from builders.shares import by_default
from laws_in_steps import Bilinear, MenegottoPinto, Takeda, shaken
from observations import of_largest, relative

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.diagnosis.candidates import applicable
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.base import AbstractSpringEffect, SpringPoint
from hsed_jax.physics.effects.forms import default_form, forms_of, slots_of
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.laws import LAWS, BoucWen
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Parametrised, Recorded, Simulator, Timeline
from hsed_jax.physics.specimen import Specimen, unserved
from hsed_jax.physics.structures import RayleighDamping, Structure
from hsed_jax.plain import dump_yaml
from hsed_jax.study.build import Built
from hsed_jax.study.plan import check_added

K, F_Y = 5e5, 6e4
SHARP = {"R0": 15.0, "a1": 0.1, "a3": 0.05, "a2": 1.5, "a4": 2.0}
CASES = {
    "elastic": {"k": K},
    "bilinear": {"k": K, "F_y": F_Y, "b": 0.05},
    "menegotto_pinto": {"k": K, "F_y": F_Y, "b": 0.05, **SHARP},
    "takeda": {"k": K, "F_y": F_Y, "b": 0.05, "alpha": 0.4},
    "bouc_wen": {"A": K, "beta": 0.03, "gamma": 0.004, "n": 1.5},
}
STEPPED = {"bilinear": Bilinear, "menegotto_pinto": MenegottoPinto, "takeda": Takeda}
OF_PATHS = [name for name in CASES if name != "bouc_wen"]
MASS, DAMPING = 8e3, 2 * 0.03 * np.sqrt(8e3 * K)
SCALES = Scales(F_Y, 0.25, 1.5, 2e4)
NAMES = ("peak_force", "peak_elongation", "dissipated_energy")


def along(law, elongations, **parameters) -> np.ndarray:
    """Force at each elongation of a path, committed there."""
    specimen = Specimen(LAWS[law](**parameters))

    def step(memory, u):
        return specimen.settle(u, 0.0, memory, jnp.asarray(False)), specimen.force(u, 0.0, memory)

    return np.asarray(jax.jit(lambda us: jax.lax.scan(step, specimen.start(), us)[1])(jnp.asarray(elongations)))


def cycles(seed=0, turns=25, each=150) -> np.ndarray:
    """A path of small steps with random turns, from a tenth of the yield elongation to eight times."""
    draw = np.random.default_rng(seed)
    ends = np.concatenate([[0.0], draw.uniform(-1, 1, turns) * draw.choice([0.1, 1.5, 8.0], turns) * F_Y / K])
    return np.concatenate([[0.0], *(np.linspace(a, b, each)[1:] for a, b in pairwise(ends))])


def oscillator(law, steps=400, effects=(), **changes) -> Simulator:
    """A mass on the specimen, shaken by a pulse for 4 s."""
    structure = Structure((MASS,), (), ((None, 0),), RayleighDamping(DAMPING / MASS, 0.0))
    pulse = Parametrised(NearFaultPulse, (("V_P", "V_P"), ("T_P", "T_P")))
    timeline = Timeline(4 / steps, steps)
    return Simulator(
        structure, pulse, timeline, EFFECTS.only(effects), SCALES, elements=(Element(law=LAWS[law]),), **changes
    )


def conditions(V_P=1.2) -> Conditions:
    return Conditions({"V_P": jnp.asarray(V_P), "T_P": jnp.asarray(0.9)})


@pytest.fixture(scope="session")
def ground():
    """From time to the ground acceleration of `conditions`, on steps of 0.2 ms."""
    step = 2e-4
    values = np.asarray(jax.vmap(NearFaultPulse(1.2, 0.9).sample)(step * np.arange(20_001)))
    return step, lambda time: values[round(time / step)]


# --- what every law says -----------------------------------------------------------------------------------------


def test_a_study_may_name_every_law():
    assert {name: law.name for name, law in LAWS.items()} == {name: name for name in LAWS}


@pytest.mark.parametrize("name", LAWS)
def test_every_law_says_what_it_is(name):
    law = LAWS[name]
    assert law.name == name and law.title.strip() and law.reference.strip()
    assert getattr(law, "__final__", False)
    assert law.__doc__ and not law.__doc__.startswith(f"{law.__name__}(")
    known = parameters_of(law)
    assert known and set(law.steepest) <= set(known)
    for parameter in known.values():
        assert parameter.symbol.strip() and parameter.unit.strip() and parameter.meaning.strip()
        if parameter.neutral is not None:
            assert parameter.lower <= parameter.neutral <= parameter.upper
    made = law(**CASES[name])
    virgin = Specimen(made)
    assert virgin.force(0.0, 0.0, virgin.start()) == 0.0
    # The initial stiffness, the yield elongation and the quantiles that make it steep are what they are called.
    small = 1e-4 * min(float(made.yield_elongation), 1.0)
    slope = along(name, [small], **CASES[name])[0] / small
    if name == "bouc_wen":
        slope = virgin.rates(0.0, 1.0, virgin.start())["hysteretic"]
    assert float(slope) == pytest.approx(float(made.stiffness), rel=1e-3)
    if name != "elastic":
        assert float(made.yield_elongation) == pytest.approx(float(made.strength) / float(made.stiffness))
        assert np.isfinite(float(made.steepness))
    for parameter, quantile in law.steepest.items():
        other = law(**{**CASES[name], parameter: CASES[name][parameter] * (1.5 if quantile > 0.5 else 1 / 1.5)})
        assert (other.stiffness, other.steepness) >= (made.stiffness, made.steepness)
        assert other.stiffness > made.stiffness or other.steepness > made.steepness


# --- paths of imposed elongation ---------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def opensees_table() -> pd.DataFrame:
    return pd.read_csv(ROOT / "tests" / "data" / "laws.csv", comment="#")


@pytest.mark.verification("laws")
@pytest.mark.parametrize(
    ("column", "law", "more"),
    [
        ("bilinear", "bilinear", {}),
        ("menegotto_pinto", "menegotto_pinto", {"R0": 18.0}),
        ("isotropic", "menegotto_pinto", {"R0": 18.0, "a1": 0.1, "a2": 1.5, "a3": 0.05, "a4": 2.0}),
        ("takeda", "takeda", {}),
    ],
)
def test_forces_along_a_path_are_those_of_opensees(opensees_table, column, law, more, observed):
    parameters = {"k": 2e6, "F_y": 2e4, "b": 0.05, **more}
    expected = opensees_table[column].to_numpy()
    path, stepped = opensees_table["elongation"], STEPPED[law](**parameters)
    reference = "OpenSees (kept forces of ten digits)"
    observed(f"{law}: forces along a path", reference, of_largest(along(law, path, **parameters), expected), 1e-9)
    error = of_largest([stepped.move(u) for u in path], expected)
    observed(f"{law}: forces along a path, by the law in steps", reference, error, 1e-9)


@pytest.mark.verification("laws")
@pytest.mark.parametrize("law", STEPPED)
@pytest.mark.parametrize("seed", range(3))
def test_forces_along_any_path_are_those_of_the_law_in_steps(law, seed, observed):
    path, stepped = cycles(seed), STEPPED[law](**CASES[law])
    error = of_largest(along(law, path, **CASES[law]), [stepped.move(u) for u in path])
    observed(f"{law}: forces along random paths", "law in steps", error, 1e-11)


@pytest.mark.verification("laws")
def test_an_elastic_spring_is_one(observed):
    path = cycles()
    observed("elastic: forces along a random path", "k Δu", of_largest(along("elastic", path, k=K), K * path), 0.0)


@pytest.mark.parametrize("law", STEPPED)
def test_commits_on_one_way_change_nothing(law):
    # What is committed matters at turns alone: a path of its turns has the forces of one in small steps.
    path = cycles(5)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(path)), append=2.0, prepend=2.0))
    fine, coarse = along(law, path, **CASES[law])[turns], along(law, path[turns], **CASES[law])
    np.testing.assert_allclose(coarse, fine, rtol=0, atol=1e-10 * np.abs(fine).max())


@pytest.mark.verification("laws")
@pytest.mark.parametrize("law", OF_PATHS)
def test_a_component_test_finds_turns_between_its_samples(law, observed):
    # 3 cycles in 100 steps, out of step with them: peaks and work of the continuous motion.
    steps, amplitude = 100, 0.4
    time = np.arange(2 * steps + 1) / (2 * steps)
    omega = 2 * np.pi * 3
    imposed = Imposed(amplitude * np.sin(omega * time + 0.3), amplitude * omega * np.cos(omega * time + 0.3))
    start = along(law, [0.0, imposed.elongation[0]], **CASES[law])[1]
    whole = amplitude * np.sin(omega * np.linspace(0, 1, 20_001) + 0.3)
    fine = np.concatenate([np.linspace(0, whole[0], 50), whole])
    force = along(law, fine, **CASES[law])
    simulator = Simulator(None, None, Timeline(0.01, steps), elements=(Element(law=LAWS[law]),))
    recorded = Recorded(Tabulated(jax.tree.map(jnp.asarray, imposed)), jnp.full(steps, 1 / steps))
    found = simulator.respond(CASES[law], Conditions({}, recorded), ("force",))
    assert found.ok
    assert found.channels["force"][0] == pytest.approx(start, rel=1e-12)
    for name, peak in (("peak_force", np.abs(force).max()), ("peak_elongation", amplitude)):
        error = relative(found.quantities[name], peak)
        observed(f"{law}: {name} of three cycles in 100 steps", "path of 20000 steps", error, 1e-4)
    work = np.trapezoid(force[50:], fine[50:])
    # Over the largest force times the amplitude; the law has corners within steps.
    error = (found.quantities["dissipated_energy"] - work) / (np.abs(force).max() * amplitude)
    observed(f"{law}: dissipated energy of three cycles in 100 steps", "path of 20000 steps", error, 4e-3)


# --- an oscillator -----------------------------------------------------------------------------------------------


@pytest.mark.verification("laws")
@pytest.mark.parametrize("law", by_default(STEPPED, lambda law: law == "bilinear"))
def test_a_shaken_oscillator_is_that_of_central_differences(law, ground, observed):
    step, acceleration = ground
    expected = shaken(STEPPED[law](**CASES[law]), MASS, DAMPING, acceleration, step, 20_000)
    assert expected["peak_elongation"] > 1.8 * F_Y / K  # it yields
    for steps, within in ((200, 3e-4), (800, 1e-4)):  # 40 steps to the period, and 160
        # With the force, as other tests ask for it, too: what is equal is compiled once.
        found = oscillator(law, steps).respond(CASES[law], conditions(), ("force",))
        assert found.ok
        for name in NAMES:
            error = relative(found.quantities[name], expected[name])
            observed(
                f"{law}: {name} of an oscillator, {steps} steps", "central differences, 20000 steps", error, within
            )


def test_an_elastic_oscillator_is_the_bouc_wen_one_without_yielding():
    found = oscillator("elastic", 200).respond({"k": K}, conditions(), ("force",))
    same = oscillator("bouc_wen", 200).respond({"A": K, "beta": 0.0}, conditions(), ("force",))
    for name in NAMES:
        assert found.quantities[name] == pytest.approx(float(same.quantities[name]), rel=1e-5, abs=0.2)
    np.testing.assert_allclose(found.channels["force"], same.channels["force"], rtol=0, atol=1.0)


@pytest.mark.verification("laws")
@pytest.mark.parametrize(
    "law", by_default(["elastic", "bilinear", "menegotto_pinto", "takeda"], lambda law: law == "bilinear")
)
def test_a_shaken_structure_is_that_of_opensees(law, openseespy, tmp_path, observed):
    name, values = {
        "elastic": ("Elastic", (K,)),
        "bilinear": ("Steel01", (F_Y, K, 0.05)),
        "menegotto_pinto": ("Steel02", (F_Y, K, 0.05, 15.0, 0.925, 0.15, 0.1, 1.5, 0.05, 2.0)),
        # Its unloading is as stiff as its loading: with a stiffness that depends on the side OpenSees mixes both in one step.
        "takeda": ("Hysteretic", (F_Y, 0.12, 1.2e5, 2.52, -F_Y, -0.12, -1.2e5, -2.52, 1.0, 1.0, 0.0, 0.0, 0.0)),
    }[law]
    (tmp_path / "mine.py").write_text(f"def specimen(ops, tag):\n    ops.uniaxialMaterial({name!r}, tag, *{values})\n")
    content = load_study(ROOT / "configs" / "opensees.yaml").model_dump(mode="json", exclude_none=True)
    content["inputs"] = {"V_P": {"uniform": [1.5, 3.0], "unit": "m/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}}
    content["excitation"] = {"near_fault_pulse": {"V_P": "V_P", "T_P": "T_P"}, "duration": 4.0}
    parameters = {**CASES[law], **({"alpha": 0.0} if law == "takeda" else {})}
    content["model"] = {"spring": law, "parameters": {**parameters, "k": {"uniform": [4e5, 6e5]}}}
    ours = {"virtual": {"parameters": parameters}}
    theirs = {"opensees": {"material": {"file": str(tmp_path / "mine.py")}, "step": 1e-3}}
    found, expected = (
        Built(load_study({**content, "experiments": where}))
        .site.laboratory.perform(0, {"V_P": 2.25, "T_P": 1.0})
        .quantities
        for where in (ours, theirs)
    )
    for quantity, value in expected.items():
        if law == "elastic" and quantity == "dissipated_energy":
            continue  # what the spring still stores at the end, which is next to nothing
        error = relative(found[quantity], value)
        observed(f"{law}: {quantity} of a shaken frame", f"OpenSees {name}", error, 1e-3)


# --- derivatives and batches -------------------------------------------------------------------------------------


@cache
def quantities_of(law):
    """From the parameters of an oscillator to its quantities, on steps so fine that no kink is within a difference."""
    simulator, names = oscillator(law, 400), tuple(CASES[law])
    return jax.jit(lambda theta: simulator.quantities(dict(zip(names, theta, strict=True)), conditions(), NAMES)[0])


@pytest.mark.parametrize("law", by_default(OF_PATHS, lambda law: law == "bilinear"))
def test_derivatives_of_an_oscillator_are_those_of_differences(law):
    quantities, values = quantities_of(law), np.array(list(CASES[law].values()), float)
    found = np.asarray(jax.jit(jax.jacfwd(quantities))(values))
    expected = np.empty_like(found)
    for i, value in enumerate(values):
        h = 1e-5 * value
        moved = h * np.eye(len(values))[i]
        expected[:, i] = (quantities(values + moved) - quantities(values - moved)) / (2 * h)
    scale = np.abs(np.asarray(quantities(values)))[:, None]
    # As relative changes of quantities per relative change of a parameter.
    np.testing.assert_allclose(found * values / scale, expected * values / scale, rtol=0, atol=3e-4)


@pytest.mark.parametrize("law", OF_PATHS)
def test_derivatives_are_finite_wherever_a_path_may_be(law):
    names = tuple(parameters_of(LAWS[law]))
    given = {**{n: p.neutral for n, p in parameters_of(LAWS[law]).items()}, **CASES[law]}
    u_y = F_Y / K
    # At rest, twice at one place, exactly at yield, turned there, and at zero force again.
    path = jnp.asarray([0.0, 0.0, u_y, u_y, 2 * u_y, 2 * u_y, u_y, 0.0, -3 * u_y, -u_y, -3 * u_y, 0.0])

    def forces(theta):
        specimen = Specimen(LAWS[law](**dict(zip(names, theta, strict=True))))

        def step(memory, u):
            return specimen.settle(u, 0.0, memory, jnp.asarray(False)), specimen.force(u, 0.0, memory)

        return jax.lax.scan(step, specimen.start(), path)[1]

    slopes = jax.jit(jax.jacfwd(forces))(jnp.asarray([given[n] for n in names]))
    assert np.isfinite(slopes).all() and np.abs(slopes[:, names.index("k")]).max() > 0


@pytest.mark.parametrize("law", by_default(OF_PATHS, lambda law: law == "bilinear"))
def test_a_batch_is_its_members(law):
    one, many = quantities_of(law), np.array(list(CASES[law].values())) * np.linspace(0.8, 1.2, 3)[:, None]
    batch = jax.jit(jax.vmap(one))(many)
    np.testing.assert_allclose(batch, np.stack([one(theta) for theta in many]), rtol=1e-12)


# --- effects -----------------------------------------------------------------------------------------------------


def test_what_an_effect_writes_to_is_found_without_being_told():
    assert slots_of(EFFECTS["pinching"]) == ("h",)
    assert slots_of(EFFECTS["hardening"]) == ("force",)
    assert [name for name, effect in EFFECTS.items() if unserved(effect, BoucWen)] == ["yielding"]


@pytest.mark.parametrize("effect", [name for name, kind in EFFECTS.items() if issubclass(kind, AbstractSpringEffect)])
def test_an_effect_writes_to_the_same_slots_with_every_driver(effect):
    kind, scales = EFFECTS[effect], Scales(1.0, 1.0, 1.0, 1.0)
    for label, form in forms_of(kind).items():
        values = {**dict.fromkeys(form.parameters(kind), 0.3), **form.held}
        point = SpringPoint(0.4, 0.2, 0.3, defaultdict(lambda: 0.5), scales, 1.0, 0.1)
        assert {*kind(**values).contribute(point)} == {*slots_of(kind, label)}


@pytest.mark.parametrize("law", by_default(LAWS, lambda law: law == "bouc_wen"))
def test_effects_at_their_neutral_values_leave_a_law_as_it_is(law):
    served = [name for name, effect in EFFECTS.items() if not unserved(effect, LAWS[law])]
    assert {"gap", "hardening", "viscous_damping", "fracture", "force_gain"} <= set(served)
    assert ("strength_degradation" in served) == (law != "elastic")
    neutral = {
        f"{n}.{key}": jnp.asarray(known.neutral)
        for n in served
        for key, known in default_form(EFFECTS[n]).parameters(EFFECTS[n]).items()
    }
    plain = oscillator(law, 200).respond(CASES[law], conditions(), ("force",))
    found = oscillator(law, 200, served).respond({**CASES[law], **neutral}, conditions(), ("force",))
    for name in NAMES:
        assert found.quantities[name] == pytest.approx(float(plain.quantities[name]), rel=1e-10)


@pytest.mark.verification("effects")
@pytest.mark.parametrize("law", by_default(["bilinear", "menegotto_pinto", "takeda"], lambda law: law == "bilinear"))
def test_strength_falls_with_work_as_in_steps(law, ground, observed):
    step, acceleration = ground
    delta = 0.3
    expected = shaken(
        STEPPED[law](**CASES[law]),
        MASS,
        DAMPING,
        acceleration,
        step,
        20_000,
        nu=lambda e: 1 + delta * e / SCALES.energy,
    )
    plain = oscillator(law, 800).respond(CASES[law], conditions()).quantities
    found = oscillator(law, 800, ["strength_degradation"]).respond(
        {**CASES[law], "strength_degradation.delta": delta}, conditions()
    )
    # The force is largest at the corner where the law yields, as it weakens from there; it falls between samples.
    for name, within in {"peak_force": 5e-3, "peak_elongation": 1e-3, "dissipated_energy": 1e-3}.items():
        error = relative(found.quantities[name], expected[name])
        observed(f"strength_degradation: {name} of an oscillator, {law}", "law in steps", error, within)
    assert abs(found.quantities["peak_elongation"] / plain["peak_elongation"] - 1) > 0.02


@pytest.mark.verification("effects")
@pytest.mark.parametrize("law", OF_PATHS)
def test_a_law_behind_a_slack_is_the_law_of_what_is_beyond_it(law, observed):
    slack, path = 0.05, cycles(2)
    gap = EFFECTS["gap"](delta=slack / SCALES.elongation)
    specimen = Specimen(LAWS[law](**CASES[law]), (gap,), SCALES)

    def step(memory, u):
        return specimen.settle(u, 0.0, memory, jnp.asarray(False)), specimen.force(u, 0.0, memory)

    found = np.asarray(jax.lax.scan(step, specimen.start(), jnp.asarray(path))[1])
    beyond = along(law, path - np.clip(path, -slack, slack), **CASES[law])
    error = of_largest(found, np.where(np.abs(path) >= slack, beyond, 0.0))
    observed(f"gap: forces along a random path, {law}", "law beyond the slack", error, 1e-9)


def test_forces_beside_a_law_of_paths_see_its_force_of_now():
    # Half of the element is lost from the start: half its force is left, at every elongation of a step.
    fracture = EFFECTS["fracture"](delta=0.5, life=1e-6)
    memory = {**Specimen(LAWS["takeda"](**CASES["takeda"]), (fracture,)).start(), "travel": jnp.asarray(1.0)}
    u = 0.7 * F_Y / K
    whole = Specimen(LAWS["takeda"](**CASES["takeda"]))
    broken = Specimen(whole.law, (fracture,))
    assert broken.force(u, 0.0, memory) == pytest.approx(0.5 * float(whole.force(u, 0.0, whole.start())), rel=1e-12)


def test_an_effect_that_a_law_has_no_place_for_is_no_silence():
    specimen = Specimen(LAWS["takeda"](**CASES["takeda"]), (EFFECTS["slip"](delta=0.1),), SCALES)
    with pytest.raises(ValueError, match="slip: it writes to the slot compliance, which the law takeda does not have"):
        specimen.force(0.1, 0.0, specimen.start())


# --- a law that hardens ------------------------------------------------------------------------------------------


HARDENING = {"A": 5e4, "beta": 800.0, "gamma": -1100.0}  # of the benchmark of Noël & Schoukens


def hardened(path) -> np.ndarray:
    """Bouc–Wen force with n = 1 at each elongation of a path, by its exponentials."""
    A, beta, gamma = HARDENING.values()
    forces, z = [0.0], 0.0
    for du in np.diff(path):
        slope = gamma - beta  # against the force; b: dz = (A − b|z|) du
        if z * du < 0:
            to_zero = np.log1p(-slope * abs(z) / A) / -slope
            if abs(du) < to_zero:
                z = np.sign(z) * (A / slope + (abs(z) - A / slope) * np.exp(slope * abs(du)))
                forces.append(z)
                continue
            z, du = 0.0, np.sign(du) * (abs(du) - to_zero)
        slope = gamma + beta
        z = np.sign(du) * (A / slope + (abs(z) - A / slope) * np.exp(-slope * abs(du)))
        forces.append(z)
    return np.asarray(forces)


@pytest.mark.verification("laws")
def test_a_bouc_wen_law_that_hardens_follows_its_exponentials(observed):
    steps, amplitude, omega = 400, 2e-3, 2 * np.pi * 3
    time = np.arange(2 * steps + 1) / (2 * steps)
    imposed = Imposed(amplitude * np.sin(omega * time), amplitude * omega * np.cos(omega * time))
    fine = hardened(amplitude * np.sin(omega * np.linspace(0, 1, 100 * steps + 1)))
    simulator = Simulator(None, None, Timeline(1 / steps, steps), elements=(Element(law=BoucWen),))
    recorded = Recorded(Tabulated(jax.tree.map(jnp.asarray, imposed)), jnp.full(steps, 1 / steps))
    found = simulator.respond({**HARDENING, "n": 1.0}, Conditions({}, recorded), ("force",))
    assert found.ok
    # Stiffer on loading than the elastic spring, and stiffer still on unloading: it dissipates.
    peak = np.abs(fine).max()
    assert peak > 1.2 * HARDENING["A"] * amplitude
    assert found.quantities["dissipated_energy"] > 0
    error = of_largest(found.channels["force"], fine[::100])
    observed("bouc_wen that hardens: force along three cycles", "exponentials", error, 1e-3)
    observed("bouc_wen that hardens: peak force", "exponentials", relative(found.quantities["peak_force"], peak), 1e-4)


def test_a_law_that_hardens_has_no_strength_and_effects_measure_by_where_it_is_twice_as_stiff():
    law = BoucWen(**HARDENING)
    assert law.strength == np.inf and law.yield_elongation == np.inf
    assert law.yardstick == pytest.approx(5e4 / 300)
    loading = Specimen(law).rates(0.0, 1.0, {**Specimen(law).start(), "hysteretic": law.yardstick})["hysteretic"]
    assert loading == pytest.approx(2 * law.stiffness)
    sharp = BoucWen(**HARDENING, n=1.5)
    assert sharp.strength == np.inf and sharp.yardstick == pytest.approx((5e4 / 300) ** (1 / 1.5))
    # One that softens has its strength for both; in between both go beyond all bounds, and derivatives are numbers.
    softening = BoucWen(5e4, 800.0, -500.0)
    assert softening.strength == softening.yardstick == pytest.approx(5e4 / 300)
    assert BoucWen(5e4, 800.0, -800.0).strength == np.inf
    for gamma in (-500.0, -800.0, -1100.0):
        slopes = jax.jacfwd(lambda g, n: BoucWen(5e4, 800.0, g, n).yardstick, (0, 1))(gamma, 1.5)
        assert np.isfinite(slopes).all()


@pytest.mark.parametrize("effect", ["slip", "pinching", "yield_sharpness", "gap"])
@pytest.mark.parametrize("gamma", [-800.0, -1100.0])
def test_effects_with_a_strength_in_their_formula_are_had_with_a_law_that_hardens(effect, gamma):
    kind = EFFECTS[effect]
    form = "in series" if effect == "gap" else None
    known = (forms_of(kind)[form] if form else default_form(kind)).parameters(kind)
    held = (forms_of(kind)[form] if form else default_form(kind)).held
    values = {name: 0.3 if name == "delta" else max(one.neutral or 0.0, 0.1) for name, one in known.items()}
    scales = Scales(100.0, 2e-3, 0.4, 0.1)

    def rate(given, z):
        specimen = Specimen(BoucWen(5e4, 800.0, gamma), (kind(**held, **given),), scales)
        memory = {name: jnp.asarray(1e-3) for name in specimen.start()} | {"hysteretic": z}
        return specimen.rates(1e-3, 0.1, memory)["hysteretic"]

    both = jax.jit(lambda z: (rate(values, z), jax.jacfwd(rate)(values, z)))
    for z in (0.0, 10.0, 100.0, 1000.0):
        value, slopes = both(z)
        assert np.isfinite(value) and np.isfinite(list(slopes.values())).all()
    plain = Specimen(BoucWen(5e4, 800.0, gamma)).rates(1e-3, 0.1, {"hysteretic": 10.0, "energy": 0.0})["hysteretic"]
    assert gamma == -800.0 or abs(both(10.0)[0] / plain - 1) > 1e-3  # it does something


# --- a study -----------------------------------------------------------------------------------------------------


STUDY = {
    "study": "laws",
    "structure": {
        "masses": [MASS],
        "springs": [],
        "specimen": {"between": ["ground", 1]},
        "damping": {"modal": 0.03, "specimen_stiffness": K},
    },
    "excitation": {"near_fault_pulse": {"V_P": "V_P", "T_P": 0.9}, "duration": 4.0},
    "inputs": {"V_P": {"uniform": [0.8, 1.6], "unit": "m/s"}},
    "model": {
        "spring": "takeda",
        "parameters": {"k": {"lognormal": [13.0, 0.4]}, "F_y": {"lognormal": [11.2, 0.4]}, "alpha": {}},
    },
    "experiments": {"virtual": {"parameters": {"k": K, "F_y": F_Y, "alpha": 0.4}, "noise": {"relative": 0.02}}},
    "observe": "histories",
    "design": {"initial": 3, "iterations": 0},
    "calibration": {"sampler": "laplace"},
    "steps": ["calibrate"],
}  # fmt: skip


def study(**changes):
    return load_study({**STUDY, **changes})


@pytest.mark.whole
def test_a_calibration_from_yaml_alone_finds_the_parameters(tmp_path):
    (tmp_path / "study.yaml").write_text(dump_yaml(STUDY), encoding="utf-8")
    assert main(["run", str(tmp_path / "study.yaml"), "--output", str(tmp_path / "run")]) == 0
    found = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))["calibration"]
    for name, value in {"k": K, "F_y": F_Y, "alpha": 0.4}.items():
        posterior = found["posterior"][name]
        assert abs(posterior["mean"] - value) < 4 * posterior["sd"] and posterior["sd"] < 0.05 * value
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Model: a peak-oriented spring of Takeda" in page


@pytest.mark.whole
def test_a_specimen_may_have_another_law_than_the_model():
    virtual = {"spring": "menegotto_pinto", "parameters": {"k": K, "F_y": F_Y, "b": 0.05}}
    built = Built(study(experiments={"virtual": virtual}))
    assert [e.law for e in (*built.mechanics.virtual.elements, *built.mechanics.elements)] == [
        LAWS["menegotto_pinto"],
        LAWS["takeda"],
    ]
    found = built.site.laboratory.perform(0, {"V_P": 1.2}).record
    model = built.simulation.simulator.respond(
        {"k": K, "F_y": F_Y, "alpha": 0.4}, Conditions({"V_P": jnp.asarray(1.2)}), ("force",)
    )
    assert np.abs(found["force"] - model.channels["force"]).max() > 0.05 * F_Y
    again = load_study(built.study.written())
    assert again.experiments == built.study.experiments and again.model == built.study.model


def test_a_diagnosis_of_a_law_looks_for_what_it_has_a_place_for_and_says_what_not():
    built = Built(study())
    names = applicable(built, built.site.empty_campaign())
    assert "strength_degradation" in names and "pinching" not in names
    (said,) = built.mechanics.naming.left_out()
    assert "takeda" in said and "pinching" in said and "hardening" not in said
    with pytest.raises(
        UserError, match="slip cannot be added: it writes to the slot compliance, which the law takeda does not have"
    ):
        check_added(built.study, ["slip"], built.mechanics.naming)
    model = {"parameters": {"A": {"uniform": [1e5, 9e5]}, "beta": 1.0}}
    plain = Built(study(model=model, experiments={"virtual": {"parameters": {"A": K, "beta": 1.0}}}))
    assert plain.mechanics.naming.left_out() == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"spring": "takedo"}, r"model\.spring: there is no spring law 'takedo' \(did you mean takeda\?\); laws are"),
        ({"spring": "mine.py:Mine"}, r"there is no such file"),
        ({"spring": {"file": "mine.py"}}, r"model\.spring\.class: this key is required"),
        ({"spring": {"file": "mine.py", "class": "Mine", "klass": 1}}, r"model\.spring\.klass: .* allowed here are file, class"),
        ({"spring": "elastic"}, r"model\.parameters\.F_y: there is no such parameter; allowed here are k"),
        ({"parameters": {"k": {"uniform": [1e5, 9e5]}}}, r"model\.parameters\.F_y: this key is required \(yield force, N\)"),
        ({"parameters": {"k": {}, "F_y": F_Y}}, r"model\.parameters\.k: there is no default prior"),
        ({"effects": {"pinching": {}}}, r"model\.effects\.pinching: it writes to the slot h, which the law takeda does not have"),
        ({"parameters": {"k": K, "F_y": F_Y}}, r"at least one parameter needs a prior, such as k:"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(changes, said):
    with pytest.raises(UserError, match=said):
        Built(study(model={**STUDY["model"], **changes})).check()


def test_the_specimen_of_a_virtual_laboratory_is_checked_by_its_own_law():
    virtual = {"spring": "elastic", "parameters": {"k": K}, "effects": {"asymmetry": {"delta": 0.1}}}
    with pytest.raises(UserError, match=r"experiments\.virtual\.effects\.asymmetry: .* the law elastic does not have"):
        Built(study(experiments={"virtual": virtual})).check()


def test_the_page_of_laws_is_what_the_code_says():
    made = runpy.run_path(str(ROOT / "docs" / "laws.py"))["page"]()
    assert (ROOT / "docs" / "laws.md").read_text(encoding="utf-8") == made, "run `python docs/laws.py`"


# --- a law of a user's own ---------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    """A study beside the law that the documentation shows."""
    page = (ROOT / "docs" / "laws.md").read_text(encoding="utf-8")
    example = page.split("```python\n")[1].split("```")[0]
    (tmp_path / "mine.py").write_text(example, encoding="utf-8")
    model = {"spring": {"file": "mine.py", "class": "Cubic"}, "parameters": {"k": {"uniform": [2e5, 9e5]}, "u_c": 0.2}}
    virtual = {"parameters": {"k": K, "u_c": 0.2}}
    (tmp_path / "study.yaml").write_text(
        hx.load_study({**STUDY, "model": model, "experiments": {"virtual": virtual}}).model_dump_json(
            exclude_none=True
        ),
        encoding="utf-8",
    )
    return tmp_path


def test_the_law_of_the_documentation_is_one(folder):
    given = load_study(folder / "study.yaml", ["inputs={V_P: {uniform: [0.8, 1.6], unit: m/s}}"])
    built = Built(given)
    assert (
        built.mechanics.elements[0].law.name == "cubic" and built.mechanics.virtual.elements == built.mechanics.elements
    )
    assert Built(given).mechanics.elements == built.mechanics.elements  # executed once
    response = built.simulation.simulator.respond({"k": K}, conditions(), ("force", "elongation"))
    u = np.asarray(response.channels["elongation"])
    np.testing.assert_allclose(response.channels["force"], K * u * (1 + (u / 0.2) ** 2), rtol=1e-12, atol=1e-6)
    written = given.written()["model"]["spring"]
    assert written == {"file": str((folder / "mine.py").resolve()), "class": "Cubic"}
    assert given.code == ["mine.py"]
    assert main(["check", str(folder / "study.yaml")]) == 2  # it would execute a file, and nobody said that it may


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        (None, "Cubic", "there is no such file"),
        ("x = 1 / 0", "Cubic", "ZeroDivisionError"),
        ("x = 1", "Cubic", "it has no class 'Cubic'"),
        ("class Cubic: pass", "Cubic", r"Cubic is no hsed_jax\.physics\.laws\.AbstractSpringLaw"),
        (
            "from hsed_jax.physics.laws import AbstractSpringLaw\nclass Cubic(AbstractSpringLaw):\n    name = 'c'",
            "Cubic",
            "Cubic lacks title, reference, steepest, force, start, stiffness, strength",
        ),
    ],
)
def test_an_own_law_that_is_none_is_one_clear_message(folder, text, name, said):
    (folder / "mine.py").unlink()
    if text is not None:
        (folder / "mine.py").write_text(text, encoding="utf-8")
    given = load_study(folder / "study.yaml", ["inputs={V_P: {uniform: [0.8, 1.6], unit: m/s}}"])
    with pytest.raises(UserError, match=rf"model\.spring: mine\.py: .*{said}"):
        _ = Built(given).mechanics.parameters
