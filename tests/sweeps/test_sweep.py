"""A sweep: its points, its folder, what comes out, and that nothing is lost when workers or the sweep itself are killed."""

import gc
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pytest
import xarray as xr
import yaml
from builders import studies
from distributed import default_client

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.reporting.sweep_figures import comparison
from hsed_jax.runs import workflow
from hsed_jax.sweeps import workers
from hsed_jax.sweeps.folder import SweepFolder, alone, note, outcome, run_folder
from hsed_jax.sweeps.plan import Plan, plan_of
from hsed_jax.sweeps.results import dataset_of, scalars, table_of
from hsed_jax.sweeps.sweep import gather, sweep

# Of a rig that may take its process with it: `dies_once` the first time, `dies` and `stops` as long as there is a file `broken`.
RIG = """
import os
import signal
from pathlib import Path

HERE = Path(__file__).parent


def perform(request):
    V_P, T_P = request.inputs["V_P"], request.inputs["T_P"]
    with (HERE / "performed.txt").open("a") as log:
        log.write(f"{request.id}\\n")
    return {"peak_force": 1e5 * V_P, "peak_elongation": 0.2 * V_P * T_P, "dissipated_energy": 1e4 * V_P**2}


def dies_once(request):
    if request.id == "E03" and not (HERE / "died").exists():
        (HERE / "died").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return perform(request)


def dies(request):
    if (HERE / "broken").exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return perform(request)


def stops(request):
    if request.id == "E02" and (HERE / "broken").exists():
        raise KeyboardInterrupt
    return perform(request)
"""
FUNCTION = "experiments.python.function"
PATIENCE = 600


@pytest.fixture
def file(tmp_path):
    """A study whose laboratory is a rig of the test's own."""
    return written(tmp_path)


@pytest.fixture
def study(file):
    return hx.load_study(file)


def written(folder: Path) -> Path:
    (folder / "rig.py").write_text(RIG)
    path = folder / "small.yaml"
    excitation = {**studies.content()["excitation"], "duration": 4.0}
    rig = {"python": {"file": "rig.py", "function": "perform"}}
    design = {"initial": 4, "iterations": 0}
    path.write_text(
        studies.text(seed=0, excitation=excitation, experiments=rig, steps=["design"], design=design, calibration={})
    )
    return path


def points_of(study, values=None, points=(), ranges=None, samples=None):
    return plan_of(study, values or {}, points, ranges or {}, samples).points


# Points


def test_values_are_combined_the_last_key_fastest(study):
    points = points_of(study, {"seed": [0, 1], "error.relative": np.array([0.1, 0.2])})
    assert [tuple(point.values()) for point in points] == [(0, 0.1), (0, 0.2), (1, 0.1), (1, 0.2)]
    assert all(type(value) in (int, float) for point in points for value in point.values())


def test_points_ranges_and_values_multiply(study):
    ranges = {"error.relative": [0.01, 0.1]}
    points = points_of(study, {"seed": [0, 1]}, [{"design.initial": 4}, {"design.initial": 5}], ranges, 3)
    assert len(points) == 12 and len({json.dumps(point) for point in points}) == 12
    assert all(set(point) == {"seed", "design.initial", "error.relative"} for point in points)


def test_samples_fill_their_ranges_and_are_the_same_again(study):
    ranges = {"error.relative": [0.01, 0.11], "scales.force": {"loguniform": [1e3, 1e5]}}
    points = points_of(study, ranges=ranges, samples=50)
    assert points == points_of(study, ranges=ranges, samples=50)
    relative = np.array([point["error.relative"] for point in points])
    force = np.array([point["scales.force"] for point in points])
    # A Latin hypercube: one sample in each fiftieth of each distribution.
    assert sorted(((relative - 0.01) / 0.1 * 50).astype(int)) == list(range(50))
    assert sorted((np.log(force / 1e3) / np.log(100) * 50).astype(int)) == list(range(50))


def test_a_study_of_a_point_has_its_values_to_the_last_bit(study):
    value = 0.1 + 0.2
    (changed,) = plan_of(
        study, {"error.relative": [value], "model.effects": [{"hardening": {}}]}, (), {}, None
    ).studies()
    assert changed.error.relative == value and list(changed.model.effects) == ["hardening"]
    assert changed.seed == study.seed and Path(changed.experiments.python.file).is_absolute()


# What a user may get wrong


MISTAKES = {
    "unknown key": (["--set", "eror.relative=0.1"], "point 1 of 1 (eror.relative = 0.1): eror: there is no such key"),
    "bad value": (["--set", "error.relative=0.1,-1"], "point 2 of 2 (error.relative = -1): error.relative"),
    "no plan": (["--set", "steps=[compare]"], 'point 1 of 1 (steps = ["compare"]): steps: compare needs'),
    "nothing": ([], "nothing is swept"),
    "twice": (["--set", "seed=1", "--set", "seed=2"], "seed: this key is swept twice"),
    "two ways": (["--set", "seed=1", "--range", "seed=1,2", "--samples", "2"], "seed: this key is swept twice"),
    "set for all": (["seed=3", "--set", "seed=1,2"], "seed: this key is both set for all studies and swept"),
    "a part": (["--set", "error={relative: 0.1}", "--set", "error.relative=0.2"], "error.relative: this key is a part"),
    "same point": (["--set", "seed=1,2,1"], "points 1 and 3 are the same: seed = 1"),
    "no value": (["--set", "seed"], "--set seed: give a key and its values"),
    "name": (["--set", "study=a,b"], "the name of a study cannot be swept"),
    "no samples": (["--range", "error.relative=0.1,0.2"], "give the number of samples"),
    "no range": (["--samples", "3"], "samples need at least one range"),
    "range": (["--range", "error.relative=0.2,0.1", "--samples", "3"], "error.relative: uniform: the lower bound 0.2"),
    "no workers": (["--set", "seed=1", "--workers", "0"], "0 workers cannot do anything"),
    "no scheduler": (["--set", "seed=1", "--scheduler", "tcp://127.0.0.1:1"], "no Dask scheduler answers at tcp://127"),
    "no address": (["--set", "seed=1", "--scheduler", "nowhere at all"], "no Dask scheduler answers at nowhere"),
    "nothing to resume": (["--resume"], "there is no sweep to resume"),
    "no grid": (["--grid", "missing.yaml"], "missing.yaml: there is no such file"),
    "grid key": (
        ["--grid", "{values: {seed: [1]}, sample: 3}"],
        "sample: there is no such key; allowed here are values",
    ),
    "grid kind": (["--grid", "{values: [seed]}"], "values: this must be a mapping"),
    "grid list": (["--grid", "{values: {seed: 1}}"], "values.seed: give a list of values"),
    "grid range": (["--grid", "{ranges: {seed: 1}, samples: 3}"], "ranges.seed: give low and high"),
    "grid twice": (["--grid", "{values: {seed: [1]}}", "--set", "seed=2"], "seed: this key is swept twice"),
    "grid point": (["--grid", "{points: [seed]}"], "a point is a mapping"),
}


@pytest.mark.parametrize("words, message", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_one_sentence_and_nothing_is_written(file, capsys, monkeypatch, words, message):
    monkeypatch.setattr(workers, "_PATIENCE", "1s")
    if words[:1] == ["--grid"] and words[1].startswith("{"):
        grid = file.parent / "grid.yaml"
        grid.write_text(words[1])
        words = ["--grid", str(grid), *words[2:]]
    output = file.parent / "sweep"
    assert main(["sweep", str(file), *words, "--output", str(output)]) == 2
    captured = capsys.readouterr()
    assert message in captured.err and len(captured.err.splitlines()) == 1 and captured.out == ""
    assert not output.exists()


@pytest.mark.parametrize("grid, studies", [("sweep_bias", 4), ("sweep_slurm", 16)], ids=["values", "jobs of a cluster"])
def test_the_ready_sweeps_are_valid_and_a_check_runs_nothing(grid, studies, tmp_path, capsys):
    words = ["configs/paper.yaml", "--grid", f"configs/{grid}.yaml", "--check", "--output", str(tmp_path / "out")]
    assert main(["sweep", *words]) == 0
    assert f"all {studies} studies of the sweep" in capsys.readouterr().out and not (tmp_path / "out").exists()
    assert main(["sweep", *words, "--set", "design.initial=-1,3"]) == 2
    assert "point 1 of" in capsys.readouterr().err


def test_a_folder_is_neither_overwritten_nor_mixed_into(file, study, tmp_path):
    sentence = {"seed": [1, 2]}
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").touch()
    (other / "sweep.yaml").touch()  # the user's own, of --grid
    for flag in ({}, {"force": True}, {"resume": True}):
        with pytest.raises(UserError, match="is not a folder of a sweep"):
            sweep(study, sentence, output=other, **flag)
    assert sorted(item.name for item in other.iterdir()) == ["sweep.yaml", "thesis.tex"]
    there, plan = tmp_path / "there", plan_of(study, sentence, (), {}, None)
    held = SweepFolder(there, plan, resume=False, force=False)
    with pytest.raises(UserError, match="in use by another running process"):
        sweep(study, sentence, output=there, force=True)
    held.close()
    with pytest.raises(UserError, match="holds a sweep already; say --resume"):
        sweep(study, sentence, output=there)
    with pytest.raises(UserError, match="a sweep of other points"):
        sweep(study, {"seed": [1, 3]}, output=there, resume=True)
    for given in ({}, sentence):
        with pytest.raises(UserError, match="a sweep of another study"):
            sweep(hx.load_study(file, ["design.initial=5"]), given, output=there, resume=True)
    again = SweepFolder(there, None, resume=True, force=False)
    again.close()
    assert again.plan == plan


# A study in a worker


@pytest.fixture
def folder(study, tmp_path):
    """The folder of a sweep of two studies, and what a run of one does: change `folder.does` for another."""
    with_two = SweepFolder(tmp_path / "two", plan_of(study, {"seed": [1, 2]}, (), {}, None), resume=False, force=False)
    yield with_two
    with_two.close()


@pytest.fixture
def run(folder, monkeypatch):
    """Runs the first point in this process with `run.does` in place of the study's steps; `run.count` of them so far."""

    def instead(study, here, **settings):
        run.count += 1
        here.mkdir(exist_ok=True)
        run.does()
        (here / "summary.json").write_text("{}")
        return SimpleNamespace(built=SimpleNamespace(mechanics=SimpleNamespace(units={"A": "N/m"})))

    def run():
        return workers.run_point(str(folder.path), 0, folder.plan.studies()[0].written(), False)

    run.count, run.does = 0, lambda: None
    monkeypatch.setattr(workflow, "run", instead)
    return run


def test_a_scheduler_that_does_not_answer_is_nobodys_default():
    # What failed is in cycles of references, and lives until they are collected.
    gc.disable()
    try:
        with pytest.raises(UserError, match="no Dask scheduler"), workers.remote_client("nowhere at all"):
            pass
        with pytest.raises(ValueError, match=r"[Nn]o client"):
            default_client()
    finally:
        gc.enable()


@pytest.mark.parametrize("error", [ZeroDivisionError("in two\nlines"), SystemExit("off"), UserError("diverges")])
def test_a_study_that_fails_is_noted_with_its_traceback_and_runs_again(folder, run, error):
    def fail():
        raise error

    run.does = fail
    assert run() == "failed" and folder.pending() == [0, 1]
    kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
    made = gather(folder)
    assert list(made.failures) == [1]
    assert made.failures[1].startswith(f"seed = 1: {kind}{' '.join(str(error).split())}\nTraceback")
    assert (
        "in fail" in (folder.path / "failures.txt").read_text() and made.count("failed") == made.count("pending") == 1
    )
    assert "1 failed, 1 pending" in repr(made) and "1 failed: seed = 1" in repr(made)
    run.does = lambda: None
    assert run() == "complete" and folder.pending() == [1] and gather(folder).failures == {}
    assert (folder.path / "failures.txt").read_text() == "none\n"


def test_a_study_that_completed_is_not_run_again_unless_its_results_are_gone(folder, run):
    assert run() == "complete" and run() == "complete" and run.count == 1
    (run_folder(folder.path, 0) / "summary.json").unlink()
    assert folder.pending() == [0, 1] and run() == "complete" and run.count == 2


def test_a_study_waits_for_the_process_that_has_it_already(folder, run):
    thread = threading.Thread(target=run)
    with alone(folder.path, 0):
        thread.start()
        thread.join(0.3)
        assert thread.is_alive() and run.count == 0
        (run_folder(folder.path, 0)).mkdir()
        (run_folder(folder.path, 0) / "summary.json").write_text("{}")
        note(folder.path, 0, {"status": "complete", "seconds": 1.0})
    thread.join(PATIENCE)
    assert run.count == 0 and outcome(folder.path, 0)["seconds"] == 1.0


# What comes out


SUMMARY = {
    "calibration": {
        "map": {"A": 4.2e5},
        "posterior": {"A": {"mean": 4.3e5, "sd": 1e4, "q05": 4e5, "q95": 4.6e5, "ess_bulk": 99.0, "rhat": 1.01}},
        "divergences": 0,
    },
    "comparison": {
        "train": {"error": 0.21, "noise_floor": 0.02},
        "test": {"error": 0.23, "noise_floor": 0.02},
        "adequate": False,
        "p_value": 0.0,
    },
    "diagnosis": {"verdict": "missing_effects", "effects": ["slip", "hardening"]},
    "improvement": {"steps": [{"error_train": 0.21}, {"error_train": 0.03, "error_test": 0.04}]},
    "design": {"inputs": [[1.0], [2.0]], "max_expected_improvement": [0.1, 0.05]},
}


def test_the_figures_of_a_summary():
    assert scalars(SUMMARY) == {
        "map.A": 4.2e5,
        "mean.A": 4.3e5,
        "sd.A": 1e4,
        "q05.A": 4e5,
        "q95.A": 4.6e5,
        "rhat.A": 1.01,
        "ess_bulk.A": 99.0,
        "divergences": 0,
        "error_train": 0.21,
        "error_test": 0.23,
        "noise_floor": 0.02,
        "adequate": False,
        "p_value": 0.0,
        "verdict": "missing_effects",
        "effects": "slip, hardening",
        "error_train_improved": 0.03,
        "error_test_improved": 0.04,
        "experiments": 2,
        "max_expected_improvement": 0.05,
    }
    assert scalars({"study": "x", "status": "complete"}) == {}


def finished(path, study, values, points=(), failed=()):
    """A sweep whose studies have ended: the MAP of A is 1e5 times the number of the study."""
    folder = SweepFolder(path, plan_of(study, values, points, {}, None), resume=False, force=False)
    for number in range(len(folder.plan.points)):
        run_folder(path, number).mkdir()
        content = {**SUMMARY, "calibration": {**SUMMARY["calibration"], "map": {"A": 1e5 * (number + 1)}}}
        (run_folder(path, number) / "summary.json").write_text(json.dumps(content))
        done = {"status": "complete", "units": {"A": "N/m"}, "seconds": 1.0}
        lost = {"status": "failed", "message": "m", "traceback": "t", "seconds": 1.0}
        note(path, number, lost if number + 1 in failed else done)
    made = gather(folder)
    folder.close()
    return made


def test_a_grid_is_a_table_and_a_dataset_with_a_dimension_for_each_key(study, tmp_path):
    values = {"seed": [0, 1], "model.effects": [{}, {"slip": {}}], "design.initial": [4, 5, 6]}
    made = finished(tmp_path / "grid", study, values, failed=[2])
    table = pd.read_parquet(tmp_path / "grid" / "table.parquet")
    pd.testing.assert_frame_equal(table, made.table)
    assert table.index.tolist() == list(range(1, 13)) and table["status"].value_counts()["complete"] == 11
    assert table.loc[5, ["seed", "model.effects", "design.initial"]].tolist() == [0, '{"slip": {}}', 5]
    data = xr.load_dataset(tmp_path / "grid" / "results.nc", engine="h5netcdf")
    assert dict(data.sizes) == {"seed": 2, "model.effects": 2, "design.initial": 3}
    chosen = data.sel({"seed": 1, "model.effects": "{}", "design.initial": 6})
    assert float(chosen["map.A"]) == 9e5 and int(chosen["number"]) == 9 and data["map.A"].units == "N/m"
    gap = data.sel({"seed": 0, "model.effects": "{}", "design.initial": 5})
    assert np.isnan(gap["map.A"]) and str(gap["status"].item()) == "failed" and np.isnan(gap["adequate"])
    assert (tmp_path / "grid" / "figures" / "comparison.png").stat().st_size > 10_000


def test_points_that_are_no_grid_have_a_row_each(study, tmp_path):
    points = [{"seed": 0, "error.relative": 0.1}, {"seed": 1, "error.relative": 0.2}, {"seed": 2}]
    made = finished(tmp_path / "points", study, {}, points)
    assert dict(made.dataset.sizes) == {"number": 3} and made.dataset["map.A"].values.tolist() == [1e5, 2e5, 3e5]
    assert np.isnan(made.table.loc[3, "error.relative"])
    assert "3 studies" in repr(made) and "all complete" in repr(made) and "nan" not in repr(made)


def test_a_sweep_that_came_to_nothing_is_gathered_all_the_same(study, tmp_path):
    made = finished(tmp_path / "none", study, {"seed": [0, 1]}, failed=[1, 2])
    assert made.count("failed") == 2 and list(made.failures) == [1, 2]
    assert not (tmp_path / "none" / "figures").exists()
    assert len(pd.read_parquet(tmp_path / "none" / "table.parquet")) == 2


def frame(**columns):
    table = pd.DataFrame(columns)
    return table.assign(status="complete", **{"map.A": 1e5 + 1e3 * np.arange(len(table)), "error_test": 0.1})


def test_the_figure_has_a_line_for_each_combination_of_the_other_keys():
    import itertools

    rows = list(itertools.product([0, 1, 2], ["slip", "pinching"]))
    table = frame(seed=[a for a, _ in rows], effect=[b for _, b in rows])
    picture = comparison(table, ["seed", "effect"], True, {"A": "N/m"})
    estimates, errors = picture.figure.axes
    assert [line.get_xydata()[:, 1].tolist() for line in estimates.lines] == [[101, 103, 105], [100, 102, 104]]
    assert estimates.get_ylabel() == "A [kN/m]" and estimates.get_xlabel() == "seed"
    assert errors.get_ylabel() == "Test error [–]"
    texts = [text.get_text() for text in picture.figure.legends[0].get_texts()]
    assert texts == ["effect = pinching", "effect = slip"]
    assert "map.A from 1e+05 to 1.05e+05" in picture.alt


def test_the_figure_of_other_points_has_a_column_for_each_key():
    table = frame(**{"error.relative": [0.1, 0.2, 0.3], "kind": ["b", "a", "b"]})
    picture = comparison(table, ["error.relative", "kind"], False, {"A": "N/m"})
    axes = picture.figure.axes
    assert [ax.get_xlabel() for ax in axes] == ["error.relative", "kind"] * 2
    assert axes[1].lines[0].get_xdata().tolist() == [1, 0, 1]


# Processes


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory):
    """A sweep of which one study takes its process with it once, and one fails as long as there is a file `broken`."""
    here = tmp_path_factory.mktemp("disturbed")
    study = hx.load_study(written(here))
    (here / "broken").touch()
    points = [{FUNCTION: "perform", "seed": n} for n in (0, 1)] + [{FUNCTION: "dies_once"}, {FUNCTION: "stops"}]
    done = sweep(study, points=points, output=here / "sweep", n_workers=1, progress=False)
    return study, done, (here / "performed.txt").read_text().split()


@pytest.mark.whole
def test_a_failure_is_isolated_and_a_dead_process_replaced(disturbed):
    _, done, performed = disturbed
    assert done.table["status"].tolist() == ["complete", "complete", "complete", "failed"]
    assert done.failures[4].startswith(f'{FUNCTION} = "stops": Interrupted: ') and "Traceback" in done.failures[4]
    # What was measured before the process died is not measured again.
    assert len(performed) == 4 + 4 + 4 + 1


@pytest.mark.slow
def test_resuming_runs_what_failed_and_nothing_else(disturbed):
    study, first, performed = disturbed
    here = first.path.parent
    (here / "broken").unlink()
    second = sweep(study, output=first.path, resume=True, n_workers=1, progress=False)
    assert second.count("complete") == 4 and second.table["experiments"].tolist() == [4] * 4
    columns = second.table.columns.difference(["message"])
    pd.testing.assert_frame_equal(second.table.loc[:3, columns], first.table.loc[:3, columns], check_dtype=False)
    measured = [(run_folder(second.path, n) / "campaign" / "experiments.csv").read_bytes() for n in range(4)]
    assert measured[0] == measured[2] == measured[3]
    assert (here / "performed.txt").read_text().split() == [*performed, "E02", "E03", "E04"]


DROPPING = """
import gc, signal, sys, time
from hsed_jax.interruptions import heed_interruptions
heed_interruptions()


def once(*_):
    gc.callbacks.remove(once)
    signal.raise_signal(signal.SIGTERM)


gc.callbacks.append(once)
try:
    gc.collect(0)
    time.sleep(30)
except KeyboardInterrupt:
    sys.exit(7)
"""


def test_an_interruption_that_python_drops_is_heeded_all_the_same():
    done = subprocess.run([sys.executable, "-c", DROPPING], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr) == (7, "")


def command(*words):
    return [
        sys.executable,
        "-c",
        "import sys; from hsed_jax.command_line import main; sys.exit(main())",
        *map(str, words),
    ]


def same(one, other):
    """Whether two sweeps came to the same, times apart."""
    tables = [pd.read_parquet(path / "table.parquet").drop(columns="seconds") for path in (one, other)]
    pd.testing.assert_frame_equal(*tables)
    data = [xr.load_dataset(path / "results.nc", engine="h5netcdf").drop_vars("seconds") for path in (one, other)]
    xr.testing.assert_identical(*data)


def kill_a_worker(pid, random):
    """Kill one of the processes that run the studies of a sweep."""
    children = [child for child in psutil.Process(pid).children(True) if "spawn_main" in " ".join(child.cmdline())]
    if children:
        os.kill(random.choice(children).pid, signal.SIGKILL)
    return bool(children)


CALIBRATED = [
    "experiments={virtual: {parameters: {A: 5.0e5, beta: 1.0, gamma: 0.0, n: 1.0}, noise: {relative: 0.02}}}",
    "steps=[calibrate]",
    "calibration={chains: 1, warmup: 20, draws: 40, starts: 2}",
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep of calibrations that nobody disturbed: (words of its command, its folder)."""
    here = tmp_path_factory.mktemp("whole")
    words = ["sweep", written(here), *CALIBRATED, "--set", "seed=0,1,2,3,4,5", "--set", "error.relative=0.02,0.05"]
    done = subprocess.run(command(*words, "--output", here / "sweep"), capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0 and "12 studies" in done.stdout and "all complete" in done.stdout, done.stderr
    return words, here / "sweep"


@pytest.mark.slow
def test_workers_killed_at_random_moments_change_nothing(whole, tmp_path):
    words, expected = whole
    chance, killed = random.Random(5), 0
    process = subprocess.Popen(
        command(*words, "--output", tmp_path / "s"), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    while process.poll() is None and killed < 4:
        time.sleep(chance.uniform(4, 12))
        killed += process.poll() is None and kill_a_worker(process.pid, chance)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, errors.decode()
    assert killed >= 2
    same(tmp_path / "s", expected)


@pytest.mark.slow
@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM], ids=lambda stop: stop.name)
def test_a_sweep_stopped_at_random_moments_is_resumed(whole, tmp_path, stop):
    words, expected = whole
    chance, flags, stopped = random.Random(int(stop)), [], 0
    while True:
        process = subprocess.Popen(
            command(*words, *flags, "--output", tmp_path / "s"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            _, errors = process.communicate(timeout=chance.uniform(8, 25) if stopped < 4 else PATIENCE)
        except subprocess.TimeoutExpired:
            # Ctrl-C reaches every process of the terminal.
            os.killpg(process.pid, stop) if stop == signal.SIGINT else process.send_signal(stop)
            stopped += 1
            _, errors = process.communicate(timeout=PATIENCE)
            assert process.returncode == (-signal.SIGKILL if stop == signal.SIGKILL else 3), errors
            assert "Traceback" not in errors and (stop == signal.SIGKILL or "stopped" in errors), errors
            flags = ["--resume"] if (tmp_path / "s" / "sweep.yaml").exists() else []
            continue
        assert process.returncode == 0, errors
        break
    assert stopped >= 2
    same(tmp_path / "s", expected)


@pytest.mark.whole
def test_a_sweep_runs_on_a_scheduler_by_its_address(tmp_path):
    from distributed import LocalCluster

    study = hx.load_study(written(tmp_path))
    with LocalCluster(n_workers=1, threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0") as cluster:
        done = sweep(study, {"seed": [0, 1]}, output=tmp_path / "s", scheduler=cluster.scheduler_address)
    assert done.table["status"].tolist() == ["complete", "complete"]
    assert done.table["experiments"].tolist() == [4, 4]


@pytest.mark.slow
def test_two_hundred_studies_on_a_cluster_with_a_worker_killed(tmp_path):
    from distributed import LocalCluster

    study = hx.load_study(written(tmp_path))
    with LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0") as cluster:
        victim = cluster.workers[0].process.pid

        def kill():
            while len(list((tmp_path / "s" / "outcomes").glob("*.json"))) < 80:
                time.sleep(0.01)
            os.kill(victim, signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        seeds = {"seed": list(range(200))}
        done = sweep(study, seeds, output=tmp_path / "s", scheduler=cluster.scheduler_address, progress=False)
        killer.join()
    assert done.count("complete") == 200 and done.table["seed"].tolist() == list(range(200))
    assert done.table["experiments"].tolist() == [4] * 200
    # None is lost and none is done twice, but for the experiment under way in the process that died.
    assert 800 <= len((tmp_path / "performed.txt").read_text().split()) <= 801
    ends = [json.loads((run_folder(done.path, n) / "provenance.json").read_text())["sessions"] for n in range(200)]
    assert all(["end" in session for session in sessions].count(True) == 1 for sessions in ends)


@pytest.mark.slow
def test_a_study_that_kills_its_process_again_and_again_has_failed(tmp_path):
    study = hx.load_study(written(tmp_path))
    (tmp_path / "broken").touch()
    done = sweep(study, {FUNCTION: ["dies", "perform"], "seed": [0, 1]}, output=tmp_path / "s", progress=False)
    assert done.table["status"].tolist() == ["failed", "failed", "complete", "complete"]
    assert "its process died again and again" in done.failures[1] and "KilledWorker" in done.failures[1]


@pytest.mark.slow
def test_the_command_says_how_many_failed(tmp_path):
    (tmp_path / "broken").touch()
    words = ["sweep", written(tmp_path), "--set", f"{FUNCTION}=stops,perform", "--output", tmp_path / "s"]
    done = subprocess.run(command(*words), capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    assert f"1 of 2 studies failed: {tmp_path / 's' / 'failures.txt'} has the reasons" in done.stdout
    assert yaml.safe_load((tmp_path / "s" / "sweep.yaml").read_text())["points"][0] == {FUNCTION: "stops"}


def test_a_lost_plan_is_the_same_again(folder):
    assert isinstance(folder.plan, Plan)
    assert table_of(folder.path, folder.plan)["status"].tolist() == ["pending", "pending"]
    assert dataset_of(table_of(folder.path, folder.plan), ("seed",)).sizes == {"seed": 2}


@pytest.mark.slow
def test_a_wrong_address_is_told_within_ten_seconds():
    begin = time.perf_counter()
    with pytest.raises(UserError, match="no Dask scheduler answers"), workers.remote_client("tcp://127.0.0.1:1"):
        pass
    assert time.perf_counter() - begin < 10


def test_the_workers_of_this_machine_leave_nothing_in_its_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with workers.local_client(1, 1) as client:
        assert client.submit(int, 3).result() == 3
        assert any(tmp_path.iterdir())  # theirs, while they are there
    assert [*tmp_path.iterdir()] == []
