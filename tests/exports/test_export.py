"""The law that is exported: run by OpenSees it has the forces of our own simulation; what has no counterpart is refused."""

import json
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.exports.counterparts import material
from hsed_jax.exports.scripts import peaks, python_script, tcl_script
from hsed_jax.laboratories.opensees import interpreter
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.forms import forms_of
from hsed_jax.physics.elements import Element
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Recorded, Simulator
from hsed_jax.physics.timeline import Timeline

REACH, STEPS = 0.05, 6000
SCALES = Scales(force=2e4, elongation=0.04, rate=0.3, energy=2e3)
BOUC_WEN = {"A": 2e6, "beta": 60.0, "gamma": 30.0, "n": 1.0}
SHARP = {"A": 2e6, "beta": 60.0 * 2e4**-0.8, "gamma": 25.0 * 2e4**-0.8, "n": 1.8}
YIELDING = {"k": 2e6, "F_y": 2e4, "b": 0.04}
STEEL = {**YIELDING, "R0": 16.0, "cR1": 0.92, "cR2": 0.15, "a1": 0.08, "a2": 1.5, "a3": 0.04, "a4": 2.0}
PINCHING = {"zeta": 0.7, "p": 4.0, "q": 0.1, "psi": 0.3, "spread": 0.05, "ratio": 0.4}

# Law, its parameters, effects with their form and parameters, each exported and run.
CASES = {
    "bouc_wen": ("bouc_wen", BOUC_WEN, {}),
    "bouc_wen, sharp": ("bouc_wen", SHARP, {}),
    "elastic": ("elastic", {"k": 2e6}, {}),
    "bilinear": ("bilinear", YIELDING, {}),
    "menegotto_pinto": ("menegotto_pinto", STEEL, {}),
    "takeda": ("takeda", YIELDING, {}),
    "stiffness_degradation": ("bouc_wen", BOUC_WEN, {"stiffness_degradation": ("linear", {"delta": 0.5})}),
    "both degradations": (
        "bouc_wen",
        BOUC_WEN,
        {"stiffness_degradation": ("linear", {"delta": 0.4}), "strength_degradation": ("linear", {"delta": 0.3})},
    ),
    "pinching": ("bouc_wen", BOUC_WEN, {"pinching": ("foliente", PINCHING)}),
    "pinching, sharp": ("bouc_wen", SHARP, {"pinching": ("foliente", PINCHING)}),
    "loop_shape": ("bouc_wen", BOUC_WEN, {"loop_shape": ("constant", {"delta": -0.8})}),
    "yield_sharpness": ("bouc_wen", BOUC_WEN, {"yield_sharpness": ("power", {"delta": 0.9})}),
    "yielding": ("elastic", {"k": 2e6}, {"yielding": ("to a bound", {"delta": 3.0, "phi": 0.7})}),
    "yielding, free": (
        *("elastic", {"k": 2e6}),
        {"yielding": ("free", {"delta": 2.0, "elastic": 0.3, "turned": 0.4, "sharpness": 1.4})},
    ),
    "hardening": ("bouc_wen", BOUC_WEN, {"hardening": ("linear", {"delta": 0.4})}),
    "hardening, one side": ("bilinear", YIELDING, {"hardening": ("tension only", {"delta": 0.4})}),
    "hardening, power": ("takeda", YIELDING, {"hardening": ("power", {"delta": 0.4, "power": 0.6})}),
    "cubic_stiffness": ("menegotto_pinto", STEEL, {"cubic_stiffness": ("cubic", {"delta": 0.5})}),
    "quadratic_stiffness": ("bouc_wen", BOUC_WEN, {"quadratic_stiffness": ("quadratic", {"delta": 0.5})}),
    "contact_stiffening": ("bilinear", YIELDING, {"contact_stiffening": ("hertz", {"delta": 0.8, "clearance": 0.4})}),
    "viscous_damping": ("bouc_wen", BOUC_WEN, {"viscous_damping": ("linear", {"delta": 0.5})}),
    "quadratic_damping": ("bouc_wen", BOUC_WEN, {"quadratic_damping": ("power", {"delta": 0.5, "power": 1.7})}),
    "power_damping": ("elastic", {"k": 2e6}, {"power_damping": ("power", {"delta": 0.5, "alpha": 0.6})}),
    "coulomb_friction, bristle": ("bilinear", YIELDING, {"coulomb_friction": ("bristle", {"delta": 0.3, "bristle": 0.06})}),
    "support_flexibility": ("bouc_wen", BOUC_WEN, {"support_flexibility": ("linear", {"delta": 0.3})}),
    "a series beside others": (
        "bouc_wen",
        BOUC_WEN,
        {"support_flexibility": ("linear", {"delta": 0.3}), "hardening": ("linear", {"delta": 0.3}),
         "coulomb_friction": ("bristle", {"delta": 0.2, "bristle": 0.06})},
    ),
}  # fmt: skip

# Pulls each material along a path; OpenSees has a process of its own, as in the laboratory.
DRIVER = """
import json, runpy, sys
import openseespy.opensees as ops
asked, found = json.load(open(sys.argv[1])), {}
for name, file in asked["files"].items():
    ops.wipe()
    runpy.run_path(file)["specimen"](ops, 1)
    ops.testUniaxialMaterial(1)
    forces = found[name] = []
    for u, v in zip(asked["elongation"], asked["rate"]):
        ops.setStrain(u, v)
        forces.append(ops.getStress())
json.dump(found, open(sys.argv[2], "w"))
"""


def motion():
    """Elongation, rate and time of cycles that grow to the reach."""
    time = np.linspace(0, 6.0, STEPS + 1)
    growth, omega = REACH * time / 6.0, 2 * np.pi
    return (
        time,
        growth * np.sin(omega * time),
        REACH / 6.0 * np.sin(omega * time) + growth * omega * np.cos(omega * time),
    )


def complete(effects):
    """Effects with every parameter of their form, those held, too."""
    found = {}
    for name, (form, given) in effects.items():
        found[name] = EFFECTS[name](**{**forms_of(EFFECTS[name])[form].held, **given})
    return found


def commands_of(case):
    law, values, effects = CASES[case]
    return material(LAWS[law](**values), complete(effects), SCALES, REACH)


@pytest.fixture(scope="module")
def by_opensees(openseespy, tmp_path_factory):
    """Forces by OpenSees of every case, from its exported script."""
    folder = tmp_path_factory.mktemp("scripts")
    _, elongation, rate = motion()
    files = {}
    for number, case in enumerate(CASES):
        file = folder / f"{number}.py"
        file.write_text(python_script(case, [], commands_of(case), REACH))
        files[case] = str(file)
    asked = folder / "asked.json"
    asked.write_text(json.dumps({"files": files, "elongation": elongation.tolist(), "rate": rate.tolist()}))
    subprocess.run([interpreter(), "-c", DRIVER, str(asked), str(folder / "found.json")], check=True)
    return {name: np.array(forces) for name, forces in json.loads((folder / "found.json").read_text()).items()}


def ours(case):
    """Forces by our own simulator."""
    law, values, effects = CASES[case]
    time, elongation, rate = motion()
    parameters = dict(values)
    for name, (form, given) in effects.items():
        held = forms_of(EFFECTS[name])[form].held
        parameters |= {f"{name}.{key}": value for key, value in {**held, **given}.items()}
    # The motion is sampled twice in each step of ours.
    step, steps = float(2 * time[1]), STEPS // 2
    simulator = Simulator(
        None, None, Timeline(step, steps), EFFECTS.only(tuple(effects)), SCALES, elements=(Element(law=LAWS[law]),)
    )
    recorded = Recorded(Tabulated(jax.tree.map(jnp.asarray, Imposed(elongation, rate))), jnp.full(steps, step))
    found = simulator.respond(parameters, Conditions({}, recorded), ("force",))
    assert found.ok
    return np.asarray(found.channels["force"])


# What each of our simulations takes is its compilation.
QUICK = ("both degradations", "pinching, sharp", "a series beside others")


@pytest.mark.verification("opensees")
@pytest.mark.parametrize("case", [c if c in QUICK else pytest.param(c, marks=pytest.mark.slow) for c in CASES])
def test_the_exported_law_has_the_forces_of_our_simulation(case, by_opensees, observed):
    expected, found = ours(case), by_opensees[case][::2]
    error = np.sqrt(np.mean((found - expected) ** 2)) / np.std(expected)
    # The materials of first order have most of it.
    observed(f"{case}: error of the force along growing cycles", "exported script in OpenSees", error, 0.01)


# --- the scripts -------------------------------------------------------------------------------------------------

# The Tcl script in a Tcl interpreter, its commands those of openseespy; what it prints, and what the Python script has.
BOTH = """
import json, runpy, sys, tkinter
import openseespy.opensees as ops
python, tcl_file = sys.argv[1:]
script = runpy.run_path(python)
words = [w.strip() for w in open(tcl_file) if w.startswith("foreach peak")]
peaks = [float(w) for w in words[0].split("{")[1].split("}")[0].split()]
first = script["loop"](ops, script["cycles"](peaks))
ops.wipe()
tcl, said = tkinter.Tcl(), []
def word(text):
    for kind in (int, float):
        try: return kind(text)
        except ValueError: pass
    return text
def command(name):
    def call(*given):
        if name == "pattern":
            *given, body = given
            ops.pattern(*map(word, given))
            return tcl.eval(body)
        found = getattr(ops, name)(*map(word, given))
        return "" if found is None else tuple(found) if isinstance(found, list) else found
    tcl.createcommand(name, call)
for name in ("wipe model node fix uniaxialMaterial element timeSeries pattern sp constraints numberer system test algorithm "
             "integrator analysis analyze eleResponse").split():
    command(name)
tcl.createcommand("puts", lambda text: said.append([float(w) for w in text.split(",")]))
tcl.call("source", tcl_file)
json.dump([first, said], sys.stdout)
"""


@pytest.mark.parametrize(
    "case", ["stiffness_degradation", "pinching, sharp", "hardening, power", "a series beside others"]
)
def test_tcl_and_python_give_the_same_loop(case, openseespy, tmp_path):
    pytest.importorskip("tkinter", reason="this Python has no Tcl")
    for name, script in (("a.py", python_script), ("a.tcl", tcl_script)):
        (tmp_path / name).write_text(script("A title.", ["A note."], commands_of(case), REACH))
    done = subprocess.run(
        [interpreter(), "-c", BOTH, *(str(tmp_path / name) for name in ("a.py", "a.tcl"))],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    python, tcl = map(np.array, json.loads(done.stdout))
    assert python.shape == tcl.shape == (400 * len(peaks(REACH)) + 1, 2)
    np.testing.assert_allclose(tcl, python, rtol=1e-8, atol=1e-8 * np.abs(python).max())
    assert np.abs(python[:, 0]).max() == pytest.approx(REACH) and np.ptp(python[:, 1]) > 1e4


# --- what is refused ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "values", "effects", "said"),
    [
        ("takeda", {**YIELDING, "alpha": 0.4}, {}, "takeda with alpha > 0 has no counterpart"),
        ("bouc_wen", BOUC_WEN, {"gap": ("fixed", {"delta": 0.1})}, "gap has no counterpart in OpenSees; calibrate without it"),
        ("bouc_wen", BOUC_WEN, {"slip": ("gaussian", {"delta": 0.1})}, "slip has no counterpart"),
        ("bilinear", YIELDING, {"isotropic_hardening": ("linear", {"delta": 0.1})}, "isotropic_hardening has no counterpart"),
        ("bouc_wen", BOUC_WEN, {"stiffness_degradation": ("exponential", {"delta": 0.1})},
         r"stiffness_degradation in this form \(growth = 1, where OpenSees has 0\) .* linear, driven by energy"),
        ("bouc_wen", BOUC_WEN, {"stiffness_degradation": ("linear of path", {"delta": 0.1})}, "in this form"),
        ("bouc_wen", BOUC_WEN, {"pinching": ("gaussian", {"zeta": 0.5})}, "pinching in this form"),
        ("bouc_wen", BOUC_WEN, {"pinching": ("foliente", PINCHING), "strength_degradation": ("linear", {"delta": 0.1})},
         "pinching with strength_degradation"),
        ("bouc_wen", BOUC_WEN, {"hardening": ("linear", {"delta": 0.1}), "strength_degradation": ("linear", {"delta": 0.1})},
         "strength_degradation with hardening: OpenSees' material counts the energy of its own force"),
        ("bouc_wen", BOUC_WEN, {"viscous_damping": ("linear", {"delta": -0.1})}, "viscous_damping with a negative amplitude"),
        ("bouc_wen", BOUC_WEN, {"viscous_damping": ("thinning", {"delta": 0.1, "bend": 0.4})}, "viscous_damping in this form"),
        ("bouc_wen", BOUC_WEN, {"power_damping": ("free", {"delta": 0.1, "bend": 1.0})}, "power_damping in this form"),
        ("bouc_wen", BOUC_WEN, {"coulomb_friction": ("sharp", {"delta": 0.1})}, "coulomb_friction in this form .* is bristle"),
    ],
)  # fmt: skip
def test_what_has_no_counterpart_is_refused_by_name(law, values, effects, said):
    with pytest.raises(UserError, match=said):
        material(LAWS[law](**values), complete(effects), SCALES, REACH)


def test_an_effect_of_no_size_is_left_out():
    plain = material(LAWS["bouc_wen"](**BOUC_WEN), {}, SCALES, REACH)
    assert material(LAWS["bouc_wen"](**BOUC_WEN), complete({"gap": ("fixed", {"delta": 0.0})}), SCALES, REACH) == plain


# --- a run folder ------------------------------------------------------------------------------------------------

STUDY = """
study: beam
model:
  spring: bouc_wen
  parameters: {{A: {{uniform: [1.0e6, 3.0e6]}}, beta: {{uniform: [10.0, 90.0]}}, gamma: 30.0, n: 1.0}}
  effects: {effects}
  own_effects: {own}
experiments: {{campaign: campaign}}
observe: histories
channels: [force]
steps: [calibrate, compare]
"""


def interval(mean, low, high):
    return {"mean": mean, "sd": (high - low) / 3.3, "q05": low, "q95": high}


@pytest.fixture
def run_folder(tmp_path):
    """A finished run, as far as an export looks at it."""

    def written(effects="{}", own="[]", **improvement):
        folder = tmp_path / "run"
        (folder / "campaign").mkdir(parents=True, exist_ok=True)
        campaign = {
            "name": "beam", "protocol": "displacement",
            "channels": {"time": {"column": "t", "unit": "s"}, "elongation": {"column": "u", "unit": "mm"},
                         "force": {"column": "f", "unit": "kN"}},
        }  # fmt: skip
        (folder / "campaign" / "campaign.yaml").write_text(json.dumps(campaign))
        (folder / "campaign" / "experiments.csv").write_text("id,record,status\nE01,E01.csv,completed\n")
        rows = "".join(f"{0.1 * i},{40 * np.sin(0.1 * i)},{np.sin(0.1 * i)}\n" for i in range(100))
        (folder / "campaign" / "E01.csv").write_text(f"t,u,f\n{rows}")
        study = STUDY.format(effects=effects, own=own)
        (folder / "study.yaml").write_text(study)
        (folder / "improved.yaml").write_text(STUDY.format(effects="{hardening: {}}", own=own))
        found = {
            "map": {"A": 2e6, "beta": 60.0},
            "posterior": {"A": interval(2.01e6, 1.9e6, 2.1e6), "beta": interval(61.0, 55.0, 66.0)},
        }
        summary = {"study": "beam", "status": "complete", "calibration": found, "scales": SCALES._asdict()}
        if improvement:
            summary["improvement"] = improvement
        (folder / "summary.json").write_text(json.dumps(summary))
        about = {"python": "3.12", "versions": {"hsed_jax": "0.2.0"}, "git": None, "seed": 0,
                 "machine": {"platform": "x", "processor": "x", "cores": 2}, "sessions": [{"start": "now"}]}  # fmt: skip
        (folder / "provenance.json").write_text(json.dumps(about))
        return folder

    return written


def test_the_improved_law_is_exported_and_before_it_the_one_as_it_was(run_folder, capsys):
    more = {"A": 1.9e6, "beta": 58.0, "hardening.delta": 0.25}
    folder = run_folder(map=more, posterior={name: interval(v, 0.9 * v, 1.1 * v) for name, v in more.items()})
    assert main(["export", str(folder), "--opensees"]) == 0
    assert capsys.readouterr().out.count("wrote") == 2
    for name in ("specimen.py", "specimen.tcl"):
        text = (folder / "export" / name).read_text()
        assert "1900000.0" in text and "Parallel" in text and "-0.0399" in text  # the loop goes as far as the test
    assert f"{0.25 * SCALES.force / SCALES.elongation!r}" in (folder / "export" / "specimen.py").read_text()
    assert main(["export", str(folder), "--opensees", "--before", "--out", str(folder / "plain")]) == 0
    text = (folder / "plain" / "specimen.py").read_text()
    assert "2000000.0" in text and "Parallel" not in text


def test_the_table_has_units_intervals_and_priors(run_folder):
    folder = run_folder()
    paths = hx.export(folder, kind="table")
    assert [path.name for path in paths] == ["parameters.md", "parameters.tex"]
    plain, tex = (path.read_text() for path in paths)
    assert "| `A` | $A$ | N/m | 2.01e+06 | 1.9e+06 to 2.1e+06 | uniform(1e+06, 3e+06) |" in plain
    assert r"\texttt{beta} & $\beta$ & 1/m & $61$ & $55$ to $66$ & uniform(10, 90) \\" in tex
    assert r"2.01 \times 10^{6}" in tex and tex.count("\\\\") == 3


def test_code_of_a_run_is_not_executed(run_folder, capsys):
    folder = run_folder(own="[mine.py]")
    (folder / "mine.py").write_text("raise SystemExit('executed')")
    assert main(["export", str(folder), "--opensees"]) == 2
    assert "its model is the user's code (mine.py)" in capsys.readouterr().err


def test_mistakes_are_one_line(run_folder, tmp_path, capsys):
    assert main(["export", str(tmp_path / "none"), "--table"]) == 2
    assert "is not a run folder" in capsys.readouterr().err
    assert main(["export", str(run_folder())]) == 2
    assert "choose what to export: --opensees, --table" in capsys.readouterr().err
    folder = run_folder()
    (folder / "summary.json").write_text('{"study": "beam", "status": "complete"}')
    assert main(["export", str(folder), "--table"]) == 2
    assert "the run has no calibration" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="choose another folder"):
        hx.export(run_folder(), tmp_path / "file" / "here")
