"""The command line and the run folder: what is left behind, and that nothing is lost when a run is stopped or killed."""

import copy
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
import yaml
from builders import studies

from hsed_jax.analysis.calibration import calibrate_built
from hsed_jax.command_line import run_main
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import data_of
from hsed_jax.inference.watch import Watch
from hsed_jax.interruptions import Interrupted
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.measurements import Experiment, read_campaign, write_campaign
from hsed_jax.physics.simulator import Conditions
from hsed_jax.reporting import design_figures
from hsed_jax.runs.ask_tell import AskTell
from hsed_jax.runs.conduct import Conduct
from hsed_jax.runs.folder import RunFolder
from hsed_jax.runs.progress import Progress
from hsed_jax.runs.reading import read_run
from hsed_jax.runs.workflow import Run, run
from hsed_jax.study.build import Built

IN_CM = {"V_P": {"uniform": [150.0, 300.0], "unit": "cm/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}}
NOISY = {"virtual": {**studies.content()["experiments"]["virtual"], "noise": {"relative": 0.01}}}
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")
# A run compiles for a minute on a cold cache and a slow machine.
PATIENCE = 400


def command(*words):
    return [sys.executable, "-m", "hsed_jax.run", *map(str, words)]


def finish(*words):
    """Run the command line to its end."""
    return subprocess.run(command(*words), capture_output=True, text=True, timeout=PATIENCE, env=environment())


def begin(*words):
    return subprocess.Popen(
        command(*words), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )


def environment():
    return {**os.environ, "MPLBACKEND": "Agg"}


def journal(folder):
    """Events of the journal so far, a line that is being written left out."""
    path = folder / "journal.jsonl"
    text = path.read_text() if path.exists() else ""
    return [json.loads(line) for line in text.rpartition("\n")[0].splitlines()]


def wait_for(condition, process):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def summary_text(folder):
    return (folder / "summary.json").read_text()


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "small.yaml"
    path.write_text(studies.text(inputs=IN_CM, experiments=NOISY, steps=["design", "calibrate"]))
    return path


@pytest.fixture(scope="module")
def whole(study, tmp_path_factory):
    """The folder of a run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    done = finish(study, "--output", folder)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr and f"results in {folder}" in done.stdout
    return folder


# --- what a run leaves -------------------------------------------------------------------------------------------


@pytest.mark.whole
def test_a_run_leaves_the_files_of_its_contract(whole):
    for name in ("study.yaml", "provenance.json", "journal.jsonl", "results.nc", "summary.json", "report.html"):
        assert (whole / name).is_file(), name
    assert (whole / "campaign" / "campaign.yaml").is_file() and (whole / "campaign" / "experiments.csv").is_file()
    figures = {path.suffix: 0 for path in (whole / "figures").iterdir()}
    for path in (whole / "figures").iterdir():
        figures[path.suffix] += 1
        assert path.stat().st_size > 1000
    assert figures.keys() == {".png", ".svg"} and figures[".png"] == figures[".svg"] > 0
    assert not list(whole.rglob("*.part")) and not list(whole.rglob("*.tmp"))


@pytest.mark.whole
def test_the_summary_has_the_keys_of_its_contract_and_only_finite_numbers(whole):
    def refuse(word):
        raise AssertionError(word)

    summary = json.loads(summary_text(whole), parse_constant=refuse)
    assert summary["study"] == "small" and summary["status"] == "complete"
    for name in ("A", "beta"):
        assert set(summary["calibration"]["posterior"][name]) == {"mean", "sd", "q05", "q95", "ess_bulk", "rhat"}
        assert isinstance(summary["calibration"]["map"][name], float)
        # Three steps and the final calibration.
        assert len(summary["design"]["map"][name]) == 4
    assert isinstance(summary["calibration"]["divergences"], int)
    assert np.shape(summary["design"]["inputs"]) == (6, 2)
    assert summary["design"]["inputs"][0] == [225.0, 1.0]
    assert len(summary["design"]["max_expected_improvement"]) == 3
    assert summary["design"]["stop_reason"] == "iterations"


@pytest.mark.whole
def test_the_journal_tells_the_campaign_in_order(whole):
    events = [(event["event"], event.get("experiment", event.get("number"))) for event in journal(whole)]
    initial = [(kind, f"E{i:02d}") for i in (1, 2, 3) for kind in ("asked", "performed")]
    steps = [
        pair for i in range(3) for pair in (("step", i), ("asked", f"E{i + 4:02d}"), ("performed", f"E{i + 4:02d}"))
    ]
    assert events == initial + steps


@pytest.mark.whole
def test_the_campaign_is_read_back_as_the_journal_has_it(whole):
    campaign = read_campaign(whole / "campaign")
    performed = {event["experiment"]: event for event in journal(whole) if event["event"] == "performed"}
    assert [experiment.id for experiment in campaign] == list(performed)
    for experiment in campaign:
        event = performed[experiment.id]
        assert experiment.status == "completed"
        assert experiment.quantities == event["quantities"]
        assert experiment.inputs["V_P"] == pytest.approx(event["inputs"]["V_P"] / 100, rel=1e-15)
        assert experiment.inputs["T_P"] == event["inputs"]["T_P"]
    assert campaign.inputs == {"V_P": "cm/s", "T_P": "s"}
    assert campaign.quantities["peak_force"].noise.relative == 0.01


@pytest.mark.whole
def test_results_open_as_a_tree_with_units(whole):
    with xr.open_datatree(whole / "results.nc", engine="h5netcdf") as tree:
        assert tree["posterior"].dataset.sizes == {"chain": 2, "draw": 40}
        assert tree["posterior"]["A"].attrs["units"] == "N/m" and tree["posterior"]["beta"].attrs["units"] == "1/m"
        assert tree["sample_stats"]["diverging"].dtype == bool
        observed = tree["observed_data"]
        assert [observed[q].attrs["units"] for q in QUANTITIES] == ["N", "m", "J"]
        assert observed["V_P"].attrs["units"] == "cm/s"
        events = [event for event in journal(whole) if event["event"] == "performed"]
        np.testing.assert_array_equal(observed["peak_force"], [e["quantities"]["peak_force"] for e in events])
        summary = json.loads(summary_text(whole))
        assert float(tree["posterior"]["A"].mean()) == pytest.approx(summary["calibration"]["posterior"]["A"]["mean"])


@pytest.mark.whole
def test_what_the_figures_show_is_in_the_results(whole):
    with xr.open_datatree(whole / "results.nc", engine="h5netcdf") as tree:
        shown = tree["illustrations"]
        driven = shown["excitation"].to_dataset().load()
        assert driven["ground_acceleration"].attrs["units"] == "m/s^2" and driven["V_P"].attrs["units"] == "cm/s"
        assert (driven["V_P"].values[0], driven["T_P"].values[0]) == pytest.approx((225.0, 1.0))
        step = np.diff(driven["time"].values)
        velocity = np.cumsum(driven["ground_acceleration"].values[:, 1:] * step, axis=1)
        np.testing.assert_allclose(100 * np.abs(velocity).max(axis=1), driven["V_P"], rtol=0.02)
        specimen, model, same = (
            shown[f"responses/{of}"].to_dataset().load() for of in ("specimen", "model", "model_at_truth")
        )
        # The specimen degrades, which the model lacks.
        assert np.abs(same["force"]).max() > 1.05 * np.abs(specimen["force"][0]).max()
        # With the parameters that were estimated, it is nearer.
        for channel in ("force", "elongation"):
            far, near = (np.sqrt(((one[channel][0] - specimen[channel][0]) ** 2).mean()) for one in (same, model))
            assert near < far, channel
        alone = shown["estimates_alone"].to_dataset().load()
        assert alone["unit"].values.tolist() == ["N/m", "1/m"] and alone["map"].shape == (2, 13, 13)
        assert alone["map"].values[0].min() > 2e5 and alone["map"].values[0].max() < 5e5  # softer than when it was new
    axes = design_figures.responses(specimen, model, "").figure.axes
    measured, predicted = axes[0].get_lines()
    np.testing.assert_allclose(1e3 * measured.get_ydata(), specimen["force"][1])
    np.testing.assert_allclose(1e3 * predicted.get_ydata(), model["force"][1])


@pytest.mark.whole
def test_arviz_opens_the_results(whole):
    import arviz as az

    with az.from_netcdf(whole / "results.nc") as tree:
        assert "A" in tree["posterior"]


@pytest.mark.whole
def test_provenance_says_with_what_and_when(whole):
    provenance = json.loads((whole / "provenance.json").read_text())
    assert (
        provenance["seed"] == 3 and provenance["versions"]["jax"] and provenance["machine"]["cores"] == os.cpu_count()
    )
    (session,) = provenance["sessions"]
    assert session["start"] <= session["end"]


@pytest.mark.slow
def test_the_written_study_repeats_the_run_to_the_last_byte(whole, tmp_path):
    done = finish(whole / "study.yaml", "--output", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "again" / "summary.json").read_bytes() == (whole / "summary.json").read_bytes()
    assert (tmp_path / "again" / "study.yaml").read_bytes() == (whole / "study.yaml").read_bytes()


# --- a folder that is there already ------------------------------------------------------------------------------


def refusal(arguments, capsys) -> str:
    assert run_main([str(word) for word in arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    return line


@pytest.mark.whole
def test_an_existing_run_is_neither_overwritten_nor_mixed_into(study, whole, capsys):
    before = {path: path.stat().st_mtime_ns for path in whole.rglob("*")}
    line = refusal([study, "--output", whole], capsys)
    assert str(whole) in line and "--resume" in line and "--force" in line
    assert {path: path.stat().st_mtime_ns for path in whole.rglob("*")} == before


@pytest.mark.whole
def test_another_study_is_not_resumed_and_the_key_that_differs_is_named(study, whole, capsys):
    before = (whole / "journal.jsonl").read_bytes()
    line = refusal([study, "--output", whole, "--resume", "model.parameters.gamma=0.1"], capsys)
    assert "model.parameters.gamma" in line and "0.0" in line and "0.1" in line
    assert (whole / "journal.jsonl").read_bytes() == before


def test_a_folder_that_is_no_run_is_left_alone_even_by_force(study, tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("ten years of work")
    for flag in ([], ["--resume"], ["--force"]):
        assert "not a run folder" in refusal([study, "--output", tmp_path, *flag], capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_folder_of_measurements_with_a_study_in_it_is_no_run_and_loses_nothing(study, tmp_path, capsys):
    for name in ("campaign.yaml", "experiments.csv", "study.yaml"):
        (tmp_path / name).write_text("measured")
    for flag in ([], ["--resume"], ["--force"]):
        assert "not a run folder" in refusal([study, "--output", tmp_path, *flag], capsys)
    assert {path.read_text() for path in tmp_path.glob("[ces]*")} == {"measured"}


def test_there_is_nothing_to_resume_where_there_is_nothing(study, tmp_path, capsys):
    assert "no run to resume" in refusal([study, "--output", tmp_path / "new", "--resume"], capsys)


def test_resume_and_force_exclude_each_other(study, tmp_path):
    with pytest.raises(SystemExit) as exit:
        run_main([str(study), "--output", str(tmp_path), "--resume", "--force"])
    assert exit.value.code == 2


def test_what_a_step_found_is_told_when_it_ends(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Run, "_design", lambda self: None)
    monkeypatch.setattr(Run, "_calibrate", lambda self: setattr(self, "calibration", "what calibrate found"))

    def stop(self):
        raise UserError(f"told so far: {capsys.readouterr().out}")

    monkeypatch.setattr(Run, "_compare", stop)
    assert run_main([str(study), "--output", str(tmp_path / "run"), "steps=[calibrate, compare]"]) == 2
    assert "what calibrate found" in capsys.readouterr().err


def test_an_output_that_cannot_be_written_is_the_users_to_mend(study, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for output in (tmp_path / "file" / "run", tmp_path / ("a" * 300)):
        assert "cannot be written" in refusal([study, "--output", output], capsys)


@pytest.mark.parametrize("left", [(), (".lock",), (".lock", "study.yaml.part")])
def test_a_run_killed_in_its_first_moment_can_be_resumed_and_started_anew(tmp_path, left):
    for number, flags in enumerate(({"resume": True}, {})):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name in left:
            (folder / name).write_text("")
        store = RunFolder(folder, {"study": "x", "seed": 0}, **flags)
        assert store.events() == []
        store.close()


def test_force_throws_away_what_was_there(tmp_path):
    first = RunFolder(tmp_path / "run", {"study": "x", "seed": 0})
    first.record("asked", experiment="E01")
    first.close()
    (first.path / "notes.txt").write_text("mine")
    second = RunFolder(tmp_path / "run", {"study": "y", "seed": 0}, force=True)
    assert second.events() == [] and yaml.safe_load((second.path / "study.yaml").read_text())["study"] == "y"
    assert (second.path / "notes.txt").read_text() == "mine"
    second.close()


def test_a_full_disk_ends_the_writing_of_results_and_not_the_process(tmp_path):
    store = RunFolder(tmp_path / "run", {"study": "x", "seed": 0})
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            store.write_results(xr.DataTree(xr.Dataset({"x": ("n", np.zeros(10))})))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (store.path / "results.nc").exists()
    store.close()


def test_a_folder_is_lent_to_one_process_and_given_back_by_a_refusal(tmp_path):
    first = RunFolder(tmp_path / "run", {"study": "x", "seed": 0})
    with pytest.raises(UserError, match="in use"):
        RunFolder(tmp_path / "run", {"study": "x", "seed": 0}, resume=True)
    first.close()
    with pytest.raises(UserError, match="another study: seed was 0 and is now 1") as kept:
        RunFolder(tmp_path / "run", {"study": "x", "seed": 1}, resume=True)
    RunFolder(tmp_path / "run", {"study": "x", "seed": 0}, resume=True).close()
    assert kept


def test_the_journal_keeps_numbers_to_the_last_bit_and_survives_a_cut_line(tmp_path):
    store = RunFolder(tmp_path / "run", {"study": "x", "seed": 0})
    numbers = [0.1, 1 / 3, 1e-300, float(np.nextafter(1.0, 2.0)), float("nan")]
    store.record("step", numbers=numbers)
    store.record("asked", experiment="E02")
    store.close()
    path = tmp_path / "run" / "journal.jsonl"
    whole = path.read_text()
    for cut in (1, 10, len(whole.splitlines()[1])):
        path.write_text(whole[:-cut])
        again = RunFolder(tmp_path / "run", {"study": "x", "seed": 0}, resume=True)
        (event,) = again.events()
        np.testing.assert_array_equal(event["numbers"], numbers)
        again.record("asked", experiment="E02")
        assert path.read_text() == whole
        again.close()


@pytest.mark.parametrize("text", ["", "{}", "[]", "\0\0\0", "{", '{"sessions": []}', '{"sessions": 3}'])
def test_a_damaged_provenance_is_one_clear_message(tmp_path, text):
    RunFolder(tmp_path / "run", {"study": "x", "seed": 0}).close()
    (tmp_path / "run" / "provenance.json").write_text(text)
    with pytest.raises(UserError, match=r"provenance\.json: it is damaged; delete it"):
        RunFolder(tmp_path / "run", {"study": "x", "seed": 0}, resume=True)
    (tmp_path / "run" / "provenance.json").unlink()
    store = RunFolder(tmp_path / "run", {"study": "x", "seed": 0}, resume=True)
    store.write_summary({"study": "x", "status": "complete"})
    store.close()
    (tmp_path / "run" / "provenance.json").write_text(text)
    with pytest.raises(UserError, match=r"study\.yaml: it is damaged|provenance\.json: it is damaged"):
        read_run(tmp_path / "run")


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"", b"[1, 2]", b"a: [", b"\0"])
def test_a_written_study_that_is_none_is_one_clear_message(tmp_path, content):
    RunFolder(tmp_path / "run", {"study": "x", "seed": 0}).close()
    (tmp_path / "run" / "study.yaml").write_bytes(content)
    with pytest.raises(UserError, match=r"study\.yaml: (it is damaged|cannot be read as text)"):
        RunFolder(tmp_path / "run", {"study": "x", "seed": 0}, resume=True)


@pytest.mark.parametrize("line", [b"\0\0\0", b"garbage", b"\xff", b"3", b"[]", b"{}", b'{"event": 3}', b"[" * 100_000])
def test_a_journal_that_is_damaged_in_its_middle_is_one_clear_message(tmp_path, line):
    store = RunFolder(tmp_path / "run", {"study": "x", "seed": 0})
    for name in ("E01", "E02"):
        store.record("asked", experiment=name)
    first, second, _ = (path := store.path / "journal.jsonl").read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([first, line, second, b""]))
    with pytest.raises(UserError, match=r"journal\.jsonl: line 2 is no event; restore it .* --campaign "):
        store.events()
    path.unlink()
    path.mkdir()
    with pytest.raises(UserError, match=r"journal\.jsonl: it cannot be read"):
        store.events()
    store.close()


ASKED = {"experiment": "E01", "inputs": {"V_P": 225.0, "T_P": 1.0}, "cube": [0.5, 0.5]}


@pytest.mark.parametrize(
    ("event", "content"),
    [
        ("asked", {"experiment": "E01"}),
        ("asked", {**ASKED, "cube": "x"}),
        ("performed", {"experiment": "E01"}),
        ("performed", {**ASKED, "inputs": {"V_P": "x", "T_P": 1.0}}),
        ("performed", {**ASKED, "inputs": 3.0}),
        ("step", {"number": 0, "cube": [0.5, 0.5]}),
        ("perfXrmed", ASKED),
    ],
)
def test_an_event_that_lacks_a_key_is_one_clear_message(built, tmp_path, event, content):
    store = RunFolder(tmp_path / "run", built.study.written())
    store.record("asked", **ASKED)
    store.record(event, **content)
    with pytest.raises(UserError, match=r"journal\.jsonl: line 2 is not a complete event"):
        Conduct(built, store)
    store.close()


def test_experiments_that_a_lost_journal_does_not_know_are_not_performed_again(built, tmp_path):
    store = RunFolder(tmp_path / "run", built.study.written())
    inputs, quantities = {"V_P": 2.25, "T_P": 1.0}, dict.fromkeys(QUANTITIES, 1.0)
    campaign = built.site.empty_campaign()
    for name in ("E01", "E02", "E03"):
        campaign = campaign.add(Experiment(name, inputs, quantities=quantities))
    write_campaign(campaign, store.campaign)
    with pytest.raises(UserError, match=r"journal\.jsonl: it is empty or gone, .* hsed tell STUDY\.yaml --output DIR"):
        Conduct(built, store)
    for event in ("asked", "performed"):
        store.record(event, **ASKED, quantities=quantities)
    with pytest.raises(UserError, match=r"journal\.jsonl: it does not know E02, E03, which would be performed again"):
        Conduct(built, store)
    store.close()
    # What the message says to do.
    with AskTell(built.study, tmp_path / "other") as design:
        assert design.take(read_campaign(store.campaign)) == ["E01", "E02", "E03"]


def test_many_terminations_are_one(tmp_path):
    code = """if True:
        import time
        from hsed_jax.interruptions import heed_interruptions
        heed_interruptions()
        try:
            print("ready", flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            time.sleep(0.5)
            print("kept")
        time.sleep(0.2)
    """
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    for _ in range(9):
        process.terminate()
        time.sleep(0.05)
    out, errors = process.communicate(timeout=30)
    assert (out, errors, process.returncode) == ("kept\n", "", 0)


# --- a run that was stopped, at every line of its journal ---------------------------------------------------------


@pytest.fixture(scope="module")
def built(study):
    """One set of compiled programs for many runs."""
    made = Built(load_study(study))
    made.check()
    assert made.design  # what is made before it is copied is shared
    return made


@pytest.fixture
def quick(built, monkeypatch):
    """Runs the design alone, without figures, on programs that are compiled already; gives the summary."""

    def twin(study, *_, **__):
        """What is built already, under another study."""
        other = copy.copy(built)
        object.__setattr__(other, "study", study)
        return other

    monkeypatch.setattr("hsed_jax.runs.workflow.Built", twin)
    monkeypatch.setattr("hsed_jax.runs.figures.draw", lambda *_: None)

    def go(folder, *overrides, **flags):
        study = load_study(built.study.written(), ["steps=[design]", *overrides])
        return run(study, folder, progress=False, **flags), summary_text(folder)

    return go


@pytest.mark.slow
@pytest.mark.parametrize(
    "overrides",
    [
        pytest.param(("design.iterations=2",), id="iterations"),
        pytest.param(("design.stop.expected_improvement=10.0",), id="expected_improvement"),
    ],
)
def test_a_run_stopped_after_any_line_of_its_journal_ends_as_if_it_had_not_been(quick, tmp_path, overrides):
    done, expected = quick(tmp_path / "whole", *overrides)
    lines = (tmp_path / "whole" / "journal.jsonl").read_text().splitlines(keepends=True)
    assert done.stop_reason == overrides[0].split("=")[0].rpartition(".")[2]
    assert len(done.steps) == (1 if done.stop_reason == "expected_improvement" else 2)
    for kept in range(len(lines) + 1):
        folder = tmp_path / f"stopped after {kept}"
        shutil.copytree(tmp_path / "whole", folder)
        cut = lines[kept][: len(lines[kept]) // 2] if kept < len(lines) and kept % 2 else ""
        (folder / "journal.jsonl").write_text("".join(lines[:kept]) + cut)
        (folder / "summary.json").unlink()
        # A record is on the disk before its line is, and none of later ones.
        known = [json.loads(line) for line in lines[: kept + 1]]
        performed = {event["experiment"] for event in known if event["event"] == "performed"}
        held = read_campaign(tmp_path / "whole" / "campaign")
        shutil.rmtree(folder / "campaign")
        if kept:
            experiments = tuple(e for e in held if e.id in performed)
            write_campaign(replace(held, experiments=experiments), folder / "campaign")
        _, found = quick(folder, *overrides, resume=True)
        assert found == expected, f"stopped after line {kept}"
        campaigns = [read_campaign(f / "campaign") for f in (folder, tmp_path / "whole")]
        assert [e.quantities for e in campaigns[0]] == [e.quantities for e in campaigns[1]]


@pytest.mark.whole
def test_a_failed_experiment_is_recorded_and_the_run_goes_on(quick, tmp_path, monkeypatch):
    perform = VirtualLaboratory.perform

    def break_one(self, number, inputs):
        if number == 4:
            raise ExperimentFailed("the actuator stopped")
        return perform(self, number, inputs)

    monkeypatch.setattr(VirtualLaboratory, "perform", break_one)
    done, _ = quick(tmp_path / "run")
    campaign = read_campaign(tmp_path / "run" / "campaign")
    assert [e.status for e in campaign] == ["completed"] * 4 + ["failed", "completed"]
    assert campaign["E05"].reason == "the actuator stopped" and not campaign["E05"].quantities
    assert [e["reason"] for e in journal(tmp_path / "run") if e["event"] == "failed"] == ["the actuator stopped"]
    inputs = json.loads(summary_text(tmp_path / "run"))["design"]["inputs"]
    assert len(inputs) == 6 and len({tuple(x) for x in inputs}) == 6 and len(done.steps) == 3


# --- processes that are stopped and killed ------------------------------------------------------------------------


@pytest.mark.whole
def test_an_interrupted_killed_and_resumed_run_ends_as_if_nothing_had_been(whole, tmp_path, capsys):
    folder = tmp_path / "run"
    # The study as the whole run wrote it: that must repeat it, too.
    words = (whole / "study.yaml", "--output", folder)

    # Ctrl-C during the design: exit 3 and one message.  Meanwhile nobody else may use the folder.
    process = begin(*words)
    wait_for(lambda: len(journal(folder)) >= 4, process)
    assert "in use" in refusal([*words, "--resume"], capsys)
    wait_for(lambda: any(event["event"] == "step" for event in journal(folder)), process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 3, errors
    assert "Traceback" not in errors and errors.count("--resume") == 1
    assert json.loads(summary_text(folder))["status"] == "interrupted"

    # kill -9 while it goes on, and a journal whose last line was cut.
    process = begin(*words, "--resume")
    time.sleep(random.uniform(6.0, 12.0))
    process.kill()
    process.communicate()
    with (folder / "journal.jsonl").open("a") as file:
        file.write('{"event": "step", "num')

    done = finish(*words, "--resume")
    assert done.returncode == 0, done.stderr
    assert summary_text(folder) == summary_text(whole)
    assert len(json.loads((folder / "provenance.json").read_text())["sessions"]) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_kills_at_random_moments_change_no_number(study, whole, tmp_path, seed):
    moments = random.Random(seed)
    folder = tmp_path / "run"
    flags: list[str] = []
    for _ in range(3):
        process = begin(study, "--output", folder, *flags)
        try:
            process.wait(timeout=moments.uniform(0.5, 40.0))
        except subprocess.TimeoutExpired:
            process.kill()
        process.communicate()
        flags = ["--resume"] if folder.exists() else []
    done = finish(study, "--output", folder, *flags)
    assert done.returncode == 0, done.stderr
    assert summary_text(folder) == summary_text(whole)


@pytest.mark.slow
def test_a_finished_run_resumed_is_the_same_run(study, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    done = finish(study, "--output", folder, "--resume")
    assert done.returncode == 0, done.stderr
    assert summary_text(folder) == summary_text(whole)
    assert (folder / "journal.jsonl").read_bytes() == (whole / "journal.jsonl").read_bytes()


# --- what takes long is seen, stopped and taken up again ----------------------------------------------------------


LONG = ("steps=[calibrate]", "calibration.draws=20000", "calibration.warmup=50")


def interrupted(folder, number, *words):
    """Signal a run while it draws; how long it took to answer [s], and what it said."""
    process = begin(*words)
    wait_for(lambda: list((folder / "reached").glob("draws-*.npz")), process)
    began = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE)
    return process.returncode, time.monotonic() - began, errors


@pytest.mark.slow
def test_draws_are_stopped_within_seconds_and_taken_up_again(study, tmp_path):
    whole, folder = tmp_path / "whole", tmp_path / "run"
    done = finish(study, *LONG, "--output", whole)
    assert done.returncode == 0, done.stderr
    flags: list[str] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        status, seconds, errors = interrupted(folder, number, study, *LONG, "--output", folder, *flags)
        assert status == 3 and "Traceback" not in errors, errors
        assert "while it was at calibrate, 1 of 1 steps" in errors and "design" not in errors
        assert "draws of the posterior" in errors and "/20050 [" in errors
        # Two seconds on a machine that has nothing else to do.
        assert seconds < 10
        assert json.loads(summary_text(folder))["status"] == "interrupted"
        flags = ["--resume"]
    done = finish(study, *LONG, "--output", folder, "--resume")
    assert done.returncode == 0, done.stderr
    assert summary_text(folder) == summary_text(whole)
    assert not (folder / "reached").exists()


def test_a_run_says_at_which_step_it_was_stopped(study, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("hsed_jax.runs.workflow.calibrate_built", stop)
    with pytest.raises(Interrupted, match="stopped while it was at calibrate, 1 of 2 steps; nothing is lost"):
        run(load_study(study, ["steps=[calibrate, compare]"]), tmp_path / "run", progress=False)
    found = json.loads(summary_text(tmp_path / "run"))
    assert found == {"study": "small", "status": "interrupted", "references": {"bouc_wen": "Bouc 1967; Wen 1976"}}


@pytest.mark.slow
def test_a_diagnosis_that_was_stopped_goes_on_where_it_was(study, tmp_path, monkeypatch):
    from hsed_jax.diagnosis.batch import Batch

    simulated = 0

    def counted(self, thetas, experiments, of=Batch.__call__):
        nonlocal simulated
        simulated += len(experiments)
        if simulated > limit:
            raise KeyboardInterrupt
        return of(self, thetas, experiments)

    def go(folder, **flags):
        nonlocal simulated
        simulated = 0
        steps = load_study(study, ["steps=[calibrate, compare, diagnose, improve]", "design.initial=5"])
        run(steps, folder, progress=False, figures=False, **flags)
        return simulated, summary_text(folder)

    monkeypatch.setattr(Batch, "__call__", counted)
    limit = 10**9
    work, expected = go(tmp_path / "whole")
    limit = work * 3 // 4
    with pytest.raises(Interrupted, match="while it was at"):
        go(tmp_path / "run")
    limit = 10**9
    rest, found = go(tmp_path / "run", resume=True)
    assert found == expected
    assert rest < 0.6 * work


def test_progress_says_what_is_done_and_how_long_it_will_take(capsys):
    with Progress("calibrate", True) as watch:
        watch.report("draws of the posterior")
        watch.count(10, 40)
        watch._bar.refresh()
    with Progress("calibrate", False) as watch:
        watch.report("nobody hears this")
        watch.count(1, 2)
    said = capsys.readouterr().err
    assert re.search(r"calibrate: draws of the posterior: +25% \|.*\| 10/40 \[00:00<00:\d\d\]", said)
    assert "nobody" not in said


def test_the_error_of_the_most_probable_parameters_is_said_before_anything_is_drawn(capsys):
    measured = np.asarray(
        [[0.0, 2.0, 4.0, 2.0], [9.0, 9.0, 9.0, 9.0]]
    )  # mean 2, RMS about it √2; the second row is padding
    predicted = np.asarray([[1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 0.0, 0.0]])
    data = data_of(Conditions({}), measured, np.ones((2, 4), dtype=bool), np.ones((2, 4)), 1)
    for show in (True, False):
        with Progress("improve", show) as watch:
            watch.fitted(predicted, data, np.zeros(4, dtype=int))
        said = "improve: the error on the fitted experiments is 0.866 at the most probable parameters"
        assert (said in capsys.readouterr().out) == show


@pytest.mark.whole
def test_a_fit_tells_what_it_found_before_it_draws(study, monkeypatch):
    heard = []

    class Heard(Watch):
        def fitted(self, predicted, data, groups):
            heard.append("fitted")

    monkeypatch.setattr("hsed_jax.inference.fit.draw", lambda *_: heard.append("draws") or pytest.fail("stop"))
    built = Built(load_study(study))
    with pytest.raises(pytest.fail.Exception):
        calibrate_built(built, built.site.perform(), watch=Heard())
    assert heard == ["fitted", "draws"]


def test_what_a_run_has_reached_is_read_back_and_garbage_is_not(tmp_path):
    store = RunFolder(tmp_path / "run", {"study": "x", "seed": 0})
    kept = [np.arange(3.0), np.asarray(7), np.zeros((0, 2))]
    store.keep("draws-1", kept)
    for found, expected in zip(store.recall("draws-1") or [], kept, strict=True):
        np.testing.assert_array_equal(found, expected)
    (tmp_path / "run" / "reached" / "draws-1.npz").write_bytes(b"PK\x03\x04 cut short")
    assert store.recall("draws-1") is None and store.recall("draws-2") is None
    store.close()
