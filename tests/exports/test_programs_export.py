"""Laws for other programs: the equations of their manuals with the exported numbers have the forces of our simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml
from builders import run_folders
from scipy.integrate import solve_ivp

from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.exports.programs import entries, markdown
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.forms import forms_of
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator
from hsed_jax.physics.timeline import Timeline

REACH, STEPS = 0.05, 4000
SCALES = Scales(force=2e4, elongation=0.04, rate=0.3, energy=2e3)
BILINEAR = {"k": 2e6, "F_y": 2e4, "b": 0.04}
WEN = {"A": 2e6, "beta": 45.0, "gamma": 45.0, "n": 1.0}
SHARP = {"A": 2e6, "beta": 45.0 * 2e4**-0.8, "gamma": 0.0, "n": 1.8}
HARDENING, SHAPE = {"hardening": ("linear", {"delta": 0.4})}, {"loop_shape": ("constant", {"delta": 1.0})}


def motion():
    """Time, elongation and rate of cycles that grow to the reach."""
    time = np.linspace(0, 3.0, 2 * STEPS + 1)
    growth, omega = REACH * time / 3.0, 2 * np.pi
    rate = REACH / 3.0 * np.sin(omega * time) + growth * omega * np.cos(omega * time)
    return time, growth * np.sin(omega * time), rate


def complete(effects):
    """Parameters of effects with those that their form holds."""
    return {name: {**forms_of(EFFECTS[name])[form].held, **given} for name, (form, given) in effects.items()}


def exported(law, values, effects):
    """The exported numbers by program and name."""
    made = {name: EFFECTS[name](**given) for name, given in complete(effects).items()}
    found = entries(LAWS[law](**values), made, SCALES, REACH, ELONGATION_AND_FORCE)
    return {(entry.program, entry.name): float(entry.value) for entry in found}


def ours(law, values, effects):
    """Forces by our own simulator, at every second sample of the motion."""
    time, elongation, rate = motion()
    given = {f"{name}.{key}": value for name, own in complete(effects).items() for key, value in own.items()}
    step = float(2 * time[1])
    simulator = Simulator(
        None, None, Timeline(step, STEPS), EFFECTS.only(tuple(effects)), SCALES, elements=(Element(law=LAWS[law]),)
    )
    recorded = Recorded(Tabulated(jax.tree.map(jnp.asarray, Imposed(elongation, rate))), jnp.full(STEPS, step))
    found = simulator.respond({**values, **given}, Conditions({}, recorded), ("force",))
    assert found.ok
    return np.asarray(found.channels["force"])


def kinematic(k, yield_force, c):
    """Plasticity in one dimension with the back-force α̇ = C u̇_p, by return mapping (Simo & Hughes 1998, box 1.5)."""
    plastic, back, forces = 0.0, 0.0, []
    for u in motion()[1]:
        trial = k * (u - plastic)
        excess = abs(trial - back) - yield_force
        if excess > 0:
            moved = np.sign(trial - back) * excess / (k + c)
            plastic, back = plastic + moved, back + c * moved
        forces.append(k * (u - plastic))
    return np.array(forces)[::2]


def wen(k, strength, ratio, exponent):
    """The Wen plasticity of the CSI Analysis Reference Manual, by SciPy."""
    time, _, _ = motion()

    def slope(t, z):
        rate = REACH / 3.0 * (np.sin(2 * np.pi * t) + 2 * np.pi * t * np.cos(2 * np.pi * t))
        return k / strength * rate * np.where(rate * z > 0, 1 - np.abs(z) ** exponent, 1.0)

    at = time[::2]
    z = solve_ivp(slope, (0, at[-1]), [0.0], t_eval=at, rtol=1e-8, atol=1e-10, max_step=2e-3).y[0]
    return ratio * k * motion()[1][::2] + (1 - ratio) * strength * z


def off(found, expected):
    return np.sqrt(np.mean((found - expected) ** 2)) / np.std(expected)


@pytest.mark.parametrize("effects", [{}, HARDENING], ids=["alone", "with hardening"])
def test_a_bilinear_law_has_our_forces_in_every_program(effects):
    found, expected = exported("bilinear", BILINEAR, effects), ours("bilinear", BILINEAR, effects)
    of_abaqus = kinematic(found["Abaqus", "D11"], found["Abaqus", "yield force"], found["Abaqus", "C"])
    assert off(of_abaqus, expected) < 1e-6 and found["Abaqus", "gamma"] == 0.0
    # The kinematic rules of SeismoStruct and SAP2000 by their curves: C is what the slope after yielding leaves.
    k, r = found["SeismoStruct", "K0"], found["SeismoStruct", "r"]
    assert off(kinematic(k, found["SeismoStruct", "Fy"], k * r / (1 - r)), expected) < 1e-6
    (u1, u2), (f1, f2) = (
        [found["SAP2000", f"{what} of point {n} (and its negative)"] for n in (1, 2)]
        for what in ("deformation", "force")
    )
    slope = (f2 - f1) / (u2 - u1)
    assert u2 > REACH
    assert off(kinematic(f1 / u1, f1, slope / (1 - slope * u1 / f1)), expected) < 1e-6


@pytest.mark.parametrize(
    ("values", "effects"), [(WEN, {}), (SHARP, SHAPE), (WEN, HARDENING)], ids=["plain", "by loop_shape", "hardening"]
)
def test_a_bouc_wen_law_has_our_forces_in_sap2000(values, effects):
    found, expected = exported("bouc_wen", values, effects), ours("bouc_wen", values, effects)
    names = ("Stiffness", "Yield Strength", "Post Yield Stiffness Ratio", "Yielding Exponent")
    assert off(wen(*(found["SAP2000", name] for name in names)), expected) < 1e-3


@pytest.mark.parametrize(
    ("law", "values", "effects", "said"),
    [
        ("bouc_wen", WEN | {"gamma": 44.0}, {}, "gamma = beta"),
        ("bouc_wen", WEN | {"n": 0.9}, {}, "n of at least 1"),
        ("takeda", BILINEAR, {}, "the law takeda is equal to none"),
        ("bilinear", BILINEAR, {"hardening": ("tension only", {"delta": 0.4})}, "hardening has no equal counterpart"),
        (
            "bilinear",
            BILINEAR,
            {"viscous_damping": ("linear", {"delta": 0.4})},
            "viscous_damping has no equal counterpart",
        ),
    ],
)
def test_what_is_not_equal_is_refused(law, values, effects, said):
    with pytest.raises(UserError, match=said):
        exported(law, values, effects)


def test_the_table_has_every_number_with_its_unit():
    table = markdown("A law", entries(LAWS["bilinear"](**BILINEAR), {}, SCALES, REACH, ELONGATION_AND_FORCE))
    assert "| SeismoStruct | bl_kin | K0 | 2000000 | N/m |" in table and "| bl_kin | r | 0.04 | 1 |" in table


@pytest.mark.whole
def test_the_command_writes_the_numbers_of_a_run(tmp_path, capsys):
    run = run_folders.write(tmp_path / "run")
    study = yaml.safe_load((run / "study.yaml").read_text(encoding="utf-8"))
    study["model"]["parameters"] |= {"beta": 10.0, "gamma": 10.0, "n": 1.0}
    (run / "study.yaml").write_text(yaml.safe_dump(study), encoding="utf-8")
    assert main(["export", str(run), "--programs", "--before"]) == 0
    table = (run / "export" / "programs.md").read_text(encoding="utf-8")
    # The map of the run has A = 5e5; its strength is A/(β + γ).
    assert "| Stiffness | 500000 | N/m |" in table and "| Yield Strength | 25000 | N |" in table
    study["model"]["parameters"]["gamma"] = 0.0
    (run / "study.yaml").write_text(yaml.safe_dump(study), encoding="utf-8")
    assert main(["export", str(run), "--programs", "--before"]) == 2
    assert "gamma = beta" in capsys.readouterr().err
