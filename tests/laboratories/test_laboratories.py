"""Laboratories outside this program: what they are told, what they hand over, and everything that goes wrong in between."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import yaml
from builders.designs import STUDY as PERFORMED

from hsed_jax.command_line import run_main
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.laboratories.command import CommandLaboratory
from hsed_jax.laboratories.process import run_program
from hsed_jax.laboratories.python import PythonLaboratory
from hsed_jax.laboratories.request import Programme
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.measurements import Channel, read_at2, read_campaign
from hsed_jax.physics.simulator import Timeline
from hsed_jax.runs.workflow import Run, run
from hsed_jax.study.build import Built

INPUTS = {"V_P": 2.25, "T_P": 1.0}
CHANNELS = {
    "time": Channel("time", "ms", "t"),
    "elongation": Channel("elongation", "mm", "du"),
    "force": Channel("force", "kN", "F"),
}
QUANTITIES = {"peak_force": Channel("peak_force", "kN", "Fmax")}

# A test bench that measures two sines, 10 mm and 2 kN, at 200 Hz.
BENCH = """
import json, math, os, signal, sys, time
request = json.load(open("request.json"))
rows = [[5 * k, 10 * math.sin(math.pi * k / 100), 2 * math.sin(math.pi * k / 100)] for k in range(801)]
quantities = {"Fmax": 2.0}
print("shaking", request["id"])
"""
WRITE = """
with open("record.csv", "w") as file:
    file.write("t,du,F\\n" + "".join(",".join(map(repr, row)) + "\\n" for row in rows))
json.dump(quantities, open("quantities.json", "w"))
"""


@pytest.fixture(scope="module")
def programme(paper_excitation):
    """Experiments of 4 s that are compared every 0.1 s; a velocity is given in cm/s."""
    return Programme({"V_P": "cm/s", "T_P": "s"}, paper_excitation, Timeline(0.01, 400, 10))


@pytest.fixture
def bench(programme, tmp_path):
    """A factory: the laboratory whose program is the test bench, with a further line before it writes."""

    def make(line="", *, write=WRITE, timeout=20.0, sensors=None):
        (tmp_path / "bench.py").write_text(BENCH + line + "\n" + write)
        sensors = Sensors(CHANNELS, QUANTITIES, at_sample_times=True) if sensors is None else sensors
        template = ("{python}", str(tmp_path / "bench.py"))
        return CommandLaboratory(template, programme, sensors, timeout, tmp_path / "work")

    return make


# --- what it is told ---------------------------------------------------------------------------------------------


def velocity(t, V_P, T_P, gamma=2.0, nu=0.1):
    """Eqs. 16 and 17 of the paper, written down once more."""
    tau = (t - gamma * T_P / 2) / T_P
    D_r = V_P * T_P * (np.sin(nu + gamma * np.pi) - np.sin(nu - gamma * np.pi)) / (4 * np.pi * (1 - gamma**2))
    v = (V_P / 2 * np.cos(2 * np.pi * tau + nu) - D_r / (gamma * T_P)) * (1 + np.cos(2 * np.pi * tau / gamma))
    return np.where(np.abs(tau) <= gamma / 2, v, 0.0)


def test_the_request_tells_inputs_motion_and_what_is_wanted(bench, tmp_path):
    bench().perform(6, INPUTS)
    folder = tmp_path / "work" / "E07-1"
    request = json.loads((folder / "request.json").read_text())
    assert request["id"] == "E07"
    assert request["inputs"] == {
        "V_P": {"value": 225.0, "unit": "cm/s", "si": 2.25},
        "T_P": {"value": 1.0, "unit": "s", "si": 1.0},
    }
    assert request["record"] == {"step": pytest.approx(0.1), "samples": 41}
    assert request["channels"]["elongation"] == {"column": "du", "unit": "mm"}
    assert request["quantities"] == {"peak_force": {"column": "Fmax", "unit": "kN"}}
    with (folder / "ground_motion.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["t [s]", "ag [m/s^2]"]
    time, ground = np.array(rows, float).T
    assert request["ground_motion"] == {"step": time[1], "samples": time.size, "channel": "ground_acceleration"}
    assert time[0] == 0 and time[-1] == pytest.approx(4.0)
    d = 1e-6
    slope = (velocity(time + d, **INPUTS) - velocity(time - d, **INPUTS)) / (2 * d)
    # At the ends of the pulse, where its acceleration has a kink, the quotient is off by first order in d.
    np.testing.assert_allclose(ground, slope, atol=1e-5 * np.abs(ground).max())
    step, of_at2 = read_at2(folder / "ground_motion.AT2")
    assert step == pytest.approx(time[1], rel=1e-7)
    np.testing.assert_allclose(of_at2, ground, atol=1e-7 * np.abs(ground).max())


def test_a_template_names_folder_id_python_and_inputs(programme, tmp_path):
    script = "import json, sys; print(sys.argv[2]); json.dump({'Fmax': float(sys.argv[3])}, open(sys.argv[1], 'w'))"
    template = ("{python}", "-c", script, "{folder}/quantities.json", "{id}/{T_P}", "{V_P}")
    lab = CommandLaboratory(template, programme, Sensors({}, QUANTITIES), 20.0, tmp_path)
    # In the unit that was declared.
    assert lab.perform(0, INPUTS).quantities == {"peak_force": 225.0 * 1000}
    assert (tmp_path / "E01-1" / "stdout.txt").read_text() == "E01/1.0\n"


# --- what it hands over ------------------------------------------------------------------------------------------


def csv_semicolon(folder, columns):
    rows = zip(*columns.values(), strict=True)
    lines = [";".join(columns), *(";".join(f"{v:.9f}".replace(".", ",") for v in row) for row in rows)]
    (folder / "record.csv").write_text("# bench 3\n" + "\n".join(lines) + "\n")


def hdf5(folder, columns):
    with h5py.File(folder / "record.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values


@pytest.mark.parametrize(
    "write", [csv_semicolon, hdf5, lambda folder, columns: scipy.io.savemat(folder / "record.mat", columns)]
)
def test_records_of_any_format_are_si_at_the_times_of_the_study(programme, tmp_path, write):
    t = np.arange(801) * 5.0
    source = tmp_path / "measured"
    source.mkdir()
    write(source, {"t": t, "du": 10 * np.sin(np.pi * t / 500), "F": 2 * np.sin(np.pi * t / 500)})
    (source / "quantities.csv").write_text("Fmax\n2.0\n")
    copy = "import shutil, sys; shutil.copytree(sys.argv[1], '.', dirs_exist_ok=True)"
    sensors = Sensors(CHANNELS, QUANTITIES, at_sample_times=True)
    lab = CommandLaboratory(("{python}", "-c", copy, str(source)), programme, sensors, 20.0, tmp_path / "work")
    quantities, record = lab.perform(0, INPUTS)
    assert quantities == {"peak_force": 2000.0}
    np.testing.assert_allclose(record.time, np.arange(41) * 0.1, atol=1e-12)
    np.testing.assert_allclose(record["elongation"], 0.01 * np.sin(2 * np.pi * record.time), atol=1e-10)
    np.testing.assert_allclose(record["force"], 2e3 * np.sin(2 * np.pi * record.time), atol=1e-5)
    # It was not measured: it is what was asked for.
    d = 1e-5
    ground = (velocity(record.time + d, **INPUTS) - velocity(record.time - d, **INPUTS)) / (2 * d)
    np.testing.assert_allclose(record["ground_acceleration"], ground, atol=2e-4 * np.abs(ground).max())


def test_a_measured_ground_motion_is_kept_and_samples_are_its_own_where_peaks_are_observed(programme, tmp_path):
    units = {"time": "s", "ground_acceleration": "g", "force": "kN"}
    channels = {name: Channel(name, unit) for name, unit in units.items()}
    columns = {name: str(position) for position, name in enumerate(units, 1)}  # the file has no header
    rows = [f"{0.3 * k:.1f} {0.5 * (-1) ** k} {k + 1.0}" for k in range(9)]
    script = f"open('record.txt', 'w').write({chr(10).join(rows)!r})"
    lab = CommandLaboratory(("{python}", "-c", script), programme, Sensors(channels, {}, columns), 20.0, tmp_path)
    record = lab.perform(0, INPUTS).record
    np.testing.assert_allclose(record.time, 0.3 * np.arange(9))
    np.testing.assert_allclose(record["ground_acceleration"], 0.5 * 9.80665 * (-1.0) ** np.arange(9))
    np.testing.assert_array_equal(record["force"], 1000.0 * np.arange(1, 10))


# --- what goes wrong ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("sys.exit('the oil is cold')", r"ended with status 1: the oil is cold$"),
        ("print('valve'); sys.exit(3)", r"ended with status 3: shaking E01 \| valve$"),
        ("sys.exit(200)", r"ended with status 200"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", r"was killed by SIGSEGV"),
        ("sys.exit(0)", r"left no record\.csv in .*E01-1 \(also read: .*record\.h5"),
        ("open('record.txt', 'w')", r"left record\.csv and record\.txt in .*; only one is allowed"),
        ("rows[3][1] = math.nan", r"record\.csv: elongation at 0\.015 s: .*"),
        ("rows[7][0] = 25", r"record\.csv: time at .*"),
        ("rows = rows[:500]", r"lasts from 0 to 2\.495 s; the study compares from 0 to 4 s"),
        ("rows = [[t, 0.0, f] for t, _, f in rows]", r"record\.csv: elongation.*"),
        ("rows = [row[:2] for row in rows]", r"record\.csv"),
        ("rows = [['volts'] * 3] * 801", r"record\.csv.*volts"),
        ("quantities = {'Fmax': math.nan}", r"quantities\.json: peak_force is nan"),
        ("quantities = {'Fmax': 'much'}", r"quantities\.json: peak_force is 'much'; numbers are wanted"),
        ("quantities = {'Fmax': [1.0, 2.0]}", r"peak_force is \[1\.0, 2\.0\]; a quantity is one finite number"),
        ("quantities = {'F_max': 2.0}", r"quantities\.json: there is no peak_force"),
        ("quantities = [2.0]", r"quantities\.json: it must be a mapping of names to numbers"),
    ],
)
def test_an_experiment_that_gives_nothing_to_use_fails_with_one_reason(bench, line, reason):
    with pytest.raises(ExperimentFailed, match=reason) as failed:
        bench(line).perform(0, INPUTS)
    assert "\n" not in str(failed.value)


def test_files_that_cannot_be_read_fail_the_experiment(bench):
    with pytest.raises(ExperimentFailed, match=r"record\.csv"):
        bench(write="open('record.csv', 'wb').write(bytes(range(256)))").perform(0, INPUTS)
    with pytest.raises(ExperimentFailed, match=r"quantities\.json: it is not valid JSON"):
        bench(write=WRITE + "open('quantities.json', 'w').write('{')").perform(0, INPUTS)


def test_a_program_that_cannot_be_started_fails_the_experiment(programme, tmp_path):
    lab = CommandLaboratory(("no-such-program",), programme, Sensors({}, QUANTITIES), 20.0, tmp_path)
    with pytest.raises(ExperimentFailed, match="no-such-program cannot be started: No such file"):
        lab.perform(0, INPUTS)


def test_what_a_program_said_is_kept_and_a_further_attempt_has_a_folder_of_its_own(bench, tmp_path):
    lab = bench("sys.exit('the oil is cold')")
    for _ in range(2):
        with pytest.raises(ExperimentFailed):
            lab.perform(0, INPUTS)
    assert bench().perform(0, INPUTS).quantities == {"peak_force": 2000.0}
    folders = sorted((tmp_path / "work").iterdir())
    assert [folder.name for folder in folders] == ["E01-1", "E01-2", "E01-3"]
    assert [(folder / "stdout.txt").read_text() for folder in folders] == ["shaking E01\n"] * 3
    assert [(folder / "stderr.txt").read_text() for folder in folders] == ["the oil is cold\n"] * 2 + [""]


# --- nothing of it is left alive ----------------------------------------------------------------------------------

# A program and a child of its own, which write for as long as they live.
CHILD = "(while :; do echo >> child; sleep 0.02; done) & "
BEATS = CHILD + "while :; do echo >> parent; sleep 0.02; done"


def still(folder):
    """Whether nobody writes any more."""
    sizes = [(folder / name).stat().st_size for name in ("parent", "child")]
    time.sleep(0.4)
    return sizes == [(folder / name).stat().st_size for name in ("parent", "child")]


def wait_until(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_folders_in_no_workspace_are_gone_with_the_process():
    code = (
        "from hsed_jax.laboratories.command import CommandLaboratory\n"
        "folder = CommandLaboratory(('true',), None, None, 1.0)._new_folder('E01')\n"
        "assert folder.is_dir()\n"
        "print(folder)\n"
    )
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert not Path(made.stdout.strip()).parent.exists()


def test_at_its_time_limit_a_program_and_its_children_die(tmp_path):
    begin = time.monotonic()
    with pytest.raises(ExperimentFailed, match=r"sh was stopped after its time limit of 0\.8 s"):
        run_program(["sh", "-c", BEATS], tmp_path, 0.8)
    assert time.monotonic() - begin < 5.0
    assert (tmp_path / "child").stat().st_size > 3 and still(tmp_path)


def test_children_that_outlive_a_program_die_with_it(tmp_path):
    run_program(["sh", "-c", CHILD + "sleep 0.3; echo > parent"], tmp_path, 20.0)
    assert (tmp_path / "child").stat().st_size > 3 and still(tmp_path)


@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGINT])
def test_when_we_are_killed_the_program_and_its_children_die(tmp_path, kill):
    script = "import sys, pathlib; from hsed_jax.laboratories import process; "
    script += "process.run_program(sys.argv[2:], pathlib.Path(sys.argv[1]), 60)"
    words = [sys.executable, "-c", script, str(tmp_path), "sh", "-c", BEATS]
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    wait_until(lambda: all((tmp_path / name).exists() for name in ("parent", "child")))
    assert not still(tmp_path)
    process.send_signal(kill)
    process.wait()
    wait_until(lambda: still(tmp_path), 10.0)


# --- a Python function -------------------------------------------------------------------------------------------


def sines(request):
    t = 1000 * request.sample_times
    return {"t": t, "du": 10 * np.sin(np.pi * t / 500), "F": 2 * np.sin(np.pi * t / 500), "Fmax": request.inputs["V_P"]}


def test_a_function_returns_what_was_measured_in_declared_units(programme):
    lab = PythonLaboratory(sines, programme, Sensors(CHANNELS, QUANTITIES, at_sample_times=True))
    quantities, record = lab.perform(0, INPUTS)
    assert quantities == {"peak_force": 225e3}
    np.testing.assert_allclose(record["elongation"], 0.01 * np.sin(2 * np.pi * record.time), atol=1e-15)


def broken(request):
    raise RuntimeError("no pressure")


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        (broken, "broken failed with RuntimeError: no pressure"),
        (lambda request: sys.exit(4), "failed with SystemExit: 4"),
        (lambda request: 3.0, "returned 3.0; a mapping of names to numbers or arrays is wanted"),
        (lambda request: {"Fmax": 2.0}, "there is no time"),
        (lambda request: sines(request) | {"F": [1.0, 2.0]}, r"'force' has shape \(2,\)"),
        (lambda request: sines(request) | {"F": [[1.0], [2.0, 3.0]]}, "force is no array"),
        (lambda request: sines(request) | {"Fmax": float("inf")}, "peak_force is inf"),
        (lambda request: sines(request) | {"Fmax": "2"}, "numbers are wanted"),
    ],
)
def test_a_function_that_gives_nothing_to_use_fails_the_experiment(programme, function, reason):
    lab = PythonLaboratory(function, programme, Sensors(CHANNELS, QUANTITIES, at_sample_times=True))
    with pytest.raises(ExperimentFailed, match=reason):
        lab.perform(0, INPUTS)


# --- in a study --------------------------------------------------------------------------------------------------

# A rig that simulates the paper's structure with a Bouc–Wen specimen, by itself: plain Python, RK4 between the samples of the
# ground motion.
RIG = """
import csv, json, math, os, sys, time

K1, K2, KS, M1, M2, A, BETA = 4e5, 1e6, 5e5, 8e3, 9e3, 5e5, 1.0
# 5 % in both modes: C = 0.1 M^(1/2) S^(1/2) M^(1/2) with S = M^(-1/2) K M^(-1/2), and the root of a 2 x 2 matrix in closed form.
S11, S12, S22 = (K1 + KS) / M1, -KS / math.sqrt(M1 * M2), (K2 + KS) / M2
root = math.sqrt(S11 * S22 - S12**2)
scale = 0.1 / math.sqrt(S11 + S22 + 2 * root)
C11, C12, C22 = scale * (S11 + root) * M1, scale * S12 * math.sqrt(M1 * M2), scale * (S22 + root) * M2

def rates(u1, u2, v1, v2, f, ground):
    a1 = (f - K1 * u1 - C11 * v1 - C12 * v2) / M1 - ground
    a2 = (-f - K2 * u2 - C12 * v1 - C22 * v2) / M2 - ground
    rate = v2 - v1
    return v1, v2, a1, a2, A * rate - BETA * abs(rate) * f

def moved(state, slope, h):
    return [x + h * dx for x, dx in zip(state, slope)]

request = json.load(open("request.json"))
ground = [float(row[1]) for row in list(csv.reader(open("ground_motion.csv")))[1:]]
h = request["ground_motion"]["step"]
state, work = [0.0] * 5, 0.0
history = [(0.0, 0.0)]
for before, after in zip(ground, ground[1:]):
    middle = (before + after) / 2
    k1 = rates(*state, before)
    k2 = rates(*moved(state, k1, h / 2), middle)
    k3 = rates(*moved(state, k2, h / 2), middle)
    k4 = rates(*moved(state, k3, h), after)
    state = [x + h / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in zip(state, k1, k2, k3, k4)]
    history.append((state[1] - state[0], state[4]))
    (u0, f0), (u1, f1) = history[-2:]
    work += (f0 + f1) / 2 * (u1 - u0)
time.sleep(float(os.environ.get("RIG_SECONDS", "0")))
if len(sys.argv) > 1 and int(request["id"][1:]) % int(sys.argv[1]) == 0:
    sys.exit("the pump stopped")
peaks = [max(abs(sample[i]) for sample in history) for i in (0, 1)]
json.dump({"umax": 1e3 * peaks[0], "Fmax": 1e-3 * peaks[1], "E": 1e-3 * work}, open("quantities.json", "w"))
"""
# The study of another file: the programs that it compiles are kept and serve here, too.
STUDY = {key: given for key, given in PERFORMED.items() if key != "experiments"}
MEASURED = {
    "peak_force": {"unit": "kN", "column": "Fmax"},
    "peak_elongation": {"unit": "mm", "column": "umax"},
    "dissipated_energy": {"unit": "kJ", "column": "E"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the rig in it."""
    made = tmp_path_factory.mktemp("rig")
    (made / "rig.py").write_text(RIG)
    (made / "leaves.py").write_text("import sys; sys.exit(0)")
    (made / "program.tcl").write_text("puts 1")
    return made


@pytest.fixture
def study(folder):
    """A factory: the study whose experiments are as given, from a file in the folder of the rig."""

    def make(**experiments):
        path = folder / "study.yaml"
        path.write_text(yaml.safe_dump(STUDY | {"experiments": experiments}))
        return load_study(path)

    return make


@pytest.mark.parametrize(
    ("experiments", "said"),
    [
        ({"command": "{python} rig.py {V_Q}"}, r"experiments\.command\.run: it contains \{V_Q\}; allowed are .*\{T_P\}"),
        ({"command": "no-such-program"}, r"experiments\.command\.run: there is no program no-such-program"),
        ({"command": "./rig.py"}, r"experiments\.command\.run: there is no program .*rig\.py that may be executed"),
        ({"command": "sh 'rig.py"}, r"experiments\.command\.run: no closing quotation"),
        ({"command": "  "}, r"experiments\.command\.run: name a program"),
        ({"command": {"run": "true", "timeout": 0}}, r"experiments\.command\.timeout"),
        ({"command": {"rum": "true"}}, r"experiments\.command\.rum: there is no such key \(did you mean run\?\)"),
        ({"command": "true", "python": "rig.py"}, r"give exactly one of .*; given are command, python"),
        (
            {"command": {"run": "true", "quantities": MEASURED | {"peak_force": {"unit": "mm"}}}},
            r"peak_force.*'mm'.*force",
        ),
        (
            {"command": {"run": "true", "quantities": MEASURED | {"peak_force": {"unit": "furlong per"}}}},
            r"experiments\.command.*peak_force",
        ),
        ({"command": {"run": "true", "channels": {"time": {"unit": "s"}}}}, r"peak_force is observed and not measured"),
        ({"command": {"run": "true", "channels": {"force": {"unit": "N"}}}}, r"experiments\.command: .*time"),
        ({"command": {"run": "true", "quantities": {"peak_farce": {"unit": "N"}}}}, r"peak_farce"),
        ({"python": "none.py"}, r"experiments\.python: there is no such file .*none\.py"),
        ({"python": "rig.py:shake"}, r"experiments\.python: .*rig\.py fails with FileNotFoundError"),
        ({"python": "leaves.py"}, r"experiments\.python: leaves\.py fails with SystemExit"),
        ({"python": "program.tcl"}, r"experiments\.python: program\.tcl must be a Python file"),
        ({"python": {"function": "shake"}}, r"experiments\.python\.file: this key is required, unless a function is given"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_before_anything_is_performed(folder, study, experiments, said):
    with pytest.raises(UserError, match=said) as refused:
        Built(study(**experiments)).check()
    assert "\n" not in str(refused.value)


def test_a_user_is_told_with_status_2(folder, capsys):
    (folder / "study.yaml").write_text(yaml.safe_dump(STUDY | {"experiments": {"command": "no-such-program"}}))
    assert run_main([str(folder / "study.yaml"), "--check"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and "study.yaml: experiments.command.run: there is no program" in line


def test_files_beside_the_study_are_found_from_anywhere(study, folder):
    for given in ("{python} rig.py {study}/x", {"run": "{python} rig.py {study}/x"}):
        written = study(command=given).written()["experiments"]["command"]["run"]
        words = ("{python}", str(folder / "rig.py"), f"{folder}/x")
        assert load_study(STUDY | {"experiments": {"command": written}}).experiments.command.words(Path("/")) == words
    assert study(python="lab.py:go").written()["experiments"]["python"]["file"] == str(folder / "lab.py")


def test_a_function_from_a_file_or_from_python_performs_a_campaign(study, folder):
    text = "def perform(request):\n    return {'peak_force': 1e3 * request.number + request.si['V_P']}\n"
    (folder / "lab.py").write_text(text)
    named = study(python="lab.py").model_copy(update={"quantities": ["peak_force"]})
    campaign = Built(named).site.perform()
    assert campaign["E01"].quantities == {"peak_force": 2.25} and campaign["E02"].quantities["peak_force"] > 1000
    open_ended = study(python={}).model_copy(update={"quantities": ["peak_force"]})
    given = Built(open_ended, function=lambda request: {"peak_force": 7.0}).site.perform()
    assert [e.quantities["peak_force"] for e in given] == [7.0] * 3
    started = Run(
        open_ended, folder / "run", resume=False, force=False, progress=False, laboratory=lambda _: {"peak_force": 8.0}
    )
    assert started.built.site.laboratory.perform(0, INPUTS).quantities == {"peak_force": 8.0}
    started.store.close()
    failing = Built(open_ended, function=broken).site.perform()
    assert [(e.status, e.reason) for e in failing] == [("failed", "broken failed with RuntimeError: no pressure")] * 3


@pytest.mark.whole
def test_a_run_with_a_program_that_crashes_at_every_third_experiment_ends_and_learns(study, tmp_path):
    crashing = study(command={"run": "{python} rig.py 3", "quantities": MEASURED, "timeout": 60})
    done = run(crashing.model_copy(update={"steps": ["design"]}), tmp_path / "run", progress=False, figures=False)
    campaign = read_campaign(tmp_path / "run" / "campaign")
    assert [e.status for e in campaign] == ["completed", "completed", "failed"] * 3
    assert all(e.reason.endswith("ended with status 1: the pump stopped") for e in campaign if e.status == "failed")
    assert [e["event"] for e in events(tmp_path / "run")].count("failed") == 3
    assert (tmp_path / "run" / "laboratory" / "E03-1" / "stderr.txt").read_text() == "the pump stopped\n"
    assert done.stop_reason == "iterations" and len(done.steps) == 6
    # V_P from 1.5 to 3 m/s and T_P from 0.5 to 1.5 s, from 0 to 1.
    asked = np.array([[(e.inputs["V_P"] - 1.5) / 1.5, e.inputs["T_P"] - 0.5] for e in campaign])
    gaps = np.linalg.norm(asked[:, None] - asked, axis=-1)
    # Away from what failed, and nothing twice.
    assert min(gaps[2, 3:].min(), gaps[5, 6:].min()) > 0.05 and gaps[np.triu_indices(9, 1)].min() > 1e-3
    # The rig has no secret but its parameters.
    assert done.steps[-1]["map"]["A"] == pytest.approx(5e5, rel=2e-3)
    assert done.steps[-1]["map"]["beta"] == pytest.approx(1.0, rel=5e-3)


# --- killed at random moments -------------------------------------------------------------------------------------


def events(path):
    """The journal without what a clock says."""
    lines = (path / "journal.jsonl").read_text().splitlines()
    return [{k: v for k, v in json.loads(line).items() if k != "seconds"} for line in lines]


def contents(path):
    return {file.name: file.read_bytes() for file in sorted((path / "campaign").rglob("*")) if file.is_file()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["command", "virtual"])
def test_kills_at_random_moments_lose_and_double_no_experiment(folder, tmp_path, kind):
    """Set KILLS to kill more often; a run that ends is compared, and a new one is killed."""
    rig = {"run": "{python} rig.py 3", "quantities": MEASURED}
    specimen = {"parameters": {"A": 5e5, "beta": 1.0, "gamma": 0.0, "n": 1.0}, "noise": {"relative": 0.01}}
    experiments = {"command": rig} if kind == "command" else {"virtual": specimen}
    (folder / "study.yaml").write_text(yaml.safe_dump(STUDY | {"experiments": experiments, "steps": ["design"]}))

    def begin(path, *flags):
        words = [sys.executable, "-m", "hsed_jax.run", str(folder / "study.yaml"), "--output", str(path), *flags]
        return subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env={**os.environ, "RIG_SECONDS": "1"}
        )

    whole = tmp_path / "whole"
    for _ in range(2):  # the second finds its programs compiled: that is how long a run takes
        started = time.monotonic()
        process = begin(whole, *(["--force"] if whole.exists() else []))
        _, errors = process.communicate()
        assert process.returncode == 0, errors
    length = time.monotonic() - started

    moments, kills, runs, sessions = random.Random(1), 0, 0, 0
    most = int(os.environ.get("KILLS", "6"))
    while kills < most or sessions:
        path = tmp_path / f"run {runs}"
        started, process = time.monotonic(), begin(path, *(["--resume"] if path.exists() else []))
        sessions += 1
        try:
            _, errors = process.communicate(timeout=moments.uniform(0.0, length) if kills < most else None)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
            continue
        assert process.returncode == 0, errors
        assert events(path) == events(whole)
        assert contents(path) == contents(whole)
        assert (path / "summary.json").read_bytes() == (whole / "summary.json").read_bytes()
        if sessions == 1:  # what else the machine does changes how long a run takes
            length = min(length, time.monotonic() - started)
        print(f"{kind}: run {runs} ended after {sessions} sessions; {kills} kills so far")
        runs, sessions = runs + 1, 0
    assert runs >= 1 and kills == most


def test_a_program_that_deletes_what_it_said_fails_its_experiment_alone(tmp_path):
    with pytest.raises(ExperimentFailed, match="ended with status 3: it said nothing"):
        run_program(["sh", "-c", "rm stdout.txt stderr.txt; exit 3"], tmp_path, 20.0)
