"""Asking and telling by hand: requests on the disk, answers from it, and the command line of both."""

import dataclasses
import json
import math
import subprocess
import sys

import jax
import numpy as np
import pandas as pd
import pytest
import yaml
from builders.designs import STUDY as PERFORMED

from hsed_jax import AskTell, campaign_of
from hsed_jax.command_line import main
from hsed_jax.config.load import load_study
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.errors import UserError
from hsed_jax.measurements import read_at2, read_campaign
from hsed_jax.runs.folder import RunFolder
from hsed_jax.runs.workflow import Waiting, run
from hsed_jax.study.build import Built
from hsed_jax.tables import odds

INPUTS = {"V_P": {"uniform": [150, 300], "unit": "cm/s"}, "T_P": {"uniform": [0.5, 1.5], "unit": "s"}}
DESIGN = PERFORMED["design"] | {"iterations": 4}
STUDY = PERFORMED | {"study": "by_hand", "inputs": INPUTS, "experiments": {"folder": {}}, "design": DESIGN}
SPECIMEN = PERFORMED["experiments"]
CHANNELS = {
    "time": {"column": "t", "unit": "s"},
    "elongation": {"column": "du", "unit": "mm"},
    "force": {"column": "F", "unit": "kN"},
}
WITH_RECORDS = STUDY | {"experiments": {"folder": {"channels": CHANNELS}}}


@pytest.fixture(scope="module")
def specimen():
    """What is tested: from inputs in SI to quantities."""
    laboratory = Built(load_study(STUDY | {"experiments": SPECIMEN})).site.laboratory
    return lambda **inputs: laboratory.perform(0, inputs).quantities


@pytest.fixture(scope="module")
def recorded():
    """What is tested, with records: from inputs in SI to columns."""
    laboratory = Built(load_study(STUDY | {"experiments": SPECIMEN, "observe": "histories"})).site.laboratory

    def perform(**inputs):
        record = laboratory.perform(0, inputs).record
        return pd.DataFrame({"t": record.time, "du": 1e3 * record.channels["elongation"],
                             "F": 1e-3 * record.channels["force"]})  # fmt: skip

    return perform


def here(*arguments):
    status = main(list(arguments))
    assert status == 0, arguments


def elsewhere(*arguments):
    command = "import sys; from hsed_jax.command_line import main; sys.exit(main())"
    subprocess.run([sys.executable, "-c", command, *arguments], check=True, capture_output=True)


def requested(folder):
    """The request of the newest attempt in a run folder that nobody answered, as people read it."""
    files = sorted(folder.glob("laboratory/*/request.json"), key=lambda f: f.stat().st_mtime_ns)
    return json.loads(files[-1].read_text())


@pytest.mark.parametrize(
    ("call", "steps"),
    [pytest.param(here, 1, marks=pytest.mark.whole), pytest.param(elsewhere, 5, marks=pytest.mark.slow)],
    ids=["one process", "many"],
)
def test_a_campaign_by_the_command_line_alone_ends_as_the_same_events_at_once(call, steps, tmp_path, specimen):
    folder, file = tmp_path / "run", tmp_path / "study.yaml"
    study = STUDY | {"design": STUDY["design"] | {"iterations": steps}}
    file.write_text(yaml.safe_dump(study, sort_keys=False))

    def ask(*more):
        call("ask", str(file), "--output", str(folder), *more)
        return requested(folder)

    def tell(id, *more):
        call("tell", str(folder), id, *more)

    def told(inputs, scale=1.0):
        si = {name: scale * about["si"] for name, about in inputs.items()}
        return [f"--quantity={name}={value!r}" for name, value in specimen(**si).items()]

    for number in range(3 + steps):
        request = ask()
        id, inputs = request["id"], request["inputs"]
        if number == 1:
            tell(id, "--failed", "the pump stopped")
            tell(id, *told(ask("--again", id)["inputs"]))
        elif number == 3:
            tell(id, "--abandoned", "the specimen broke")
        elif number == 2:  # tested elsewhere than asked
            tested = [f"--input={name}={1.01 * about['value']!r}" for name, about in inputs.items()]
            tell(id, *tested, *told(inputs, 1.01))
        else:
            tell(id, *told(inputs))

    at_once = tmp_path / "at_once"
    with AskTell(load_study(study), at_once) as one:
        for number in range(3 + steps):
            (asked,) = one.ask()
            # Only a step of the design knows what it expects.
            assert ("expected to teach whether the discrepancy exceeds" in one.told(asked)) == (number >= 3)
            if number == 1:
                one.failed(asked.id, "the pump stopped")
                asked = one.ask_again(asked.id)
                one.tell(asked.id, quantities=specimen(**asked.si))
            elif number == 3:
                one.abandoned(asked.id, "the specimen broke")
            elif number == 2:
                tested = {name: 1.01 * value for name, value in asked.inputs.items()}
                si = {name: 1.01 * value for name, value in asked.si.items()}
                one.tell(asked.id, inputs=tested, quantities=specimen(**si))
            else:
                one.tell(asked.id, quantities=specimen(**asked.si))
        assert one.stop_reason == "iterations"
        assert one.ask() == []
        with AskTell(output=folder) as other:
            assert other.stop_reason == "iterations"
            jax.tree.map(
                np.testing.assert_array_equal,
                *(dataclasses.astuple(c.conduct.state) for c in (other, one)),
            )
    assert [e.status for e in read_campaign(folder / "campaign")].count("completed") == 2 + steps


@pytest.mark.slow
def test_experiments_that_are_out_at_once_are_chosen_for_what_they_tell_together(tmp_path, recorded):
    by = STUDY["design"] | {"initial": 3, "iterations": 2, "acquisition": "discriminate"}
    study = load_study(WITH_RECORDS | {"observe": "histories", "error": {"relative": 0.05}, "design": by})
    with AskTell(study, tmp_path / "run") as design:
        for asked in design.ask(3):
            design.tell(asked.id, record=recorded(**asked.si))
        one, other = design.ask(2)
        first, second = design.conduct.steps
    apart = np.abs(np.asarray(first["cube"]) - second["cube"]).max()
    # A neighbour of what is out would tell what that will have told already.
    assert one.inputs != other.inputs and apart > 0.1
    assert 0 < second["acquisition"] <= first["acquisition"]


def test_what_an_experiment_is_expected_to_teach_is_said_in_words():
    assert (
        ACQUISITIONS["expected_improvement"]
        .lesson(0.03, [0.1, None, math.nan, 0.3])
        .endswith("by 10 % of it, on average")
    )
    assert ACQUISITIONS["expected_improvement"].lesson(0.03, [None]) == ACQUISITIONS["sobol"].lesson(1.0, [0.3]) == ""
    assert ACQUISITIONS["discriminate"].lesson(math.log(20), []).endswith("odds of 20 to 1")
    assert odds(40.0) == "more than a million to 1"


@pytest.mark.whole
def test_a_request_tells_all_that_a_laboratory_needs(tmp_path, recorded):
    study = load_study(WITH_RECORDS | {"design": STUDY["design"] | {"limits": {"stroke": 0.6}}})
    with AskTell(study, tmp_path / "run") as design:
        (asked,) = design.ask()
        folder = design.folder(asked.id)
        request = json.loads((folder / "request.json").read_text())
        assert request["inputs"]["V_P"] == {"value": 225.0, "unit": "cm/s", "si": 2.25}
        assert request["limits"]["stroke"] == 0.6
        motion = pd.read_csv(folder / "ground_motion.csv").to_numpy()
        step, acceleration = read_at2(folder / "ground_motion.AT2")
        np.testing.assert_allclose(acceleration, motion[:, 1], atol=1e-6 * np.abs(motion[:, 1]).max())
        assert step == pytest.approx(motion[1, 0])
        # 2.25 m/s is the velocity of the pulse.
        velocity = np.cumsum(motion[:, 1]) * step
        assert np.abs(velocity).max() == pytest.approx(2.25, rel=0.1)
        # The specimen lies within what is expected, but for the degradation that the model lacks.
        expected, measured = pd.read_csv(folder / "expected.csv"), recorded(**asked.si)
        assert [c for c in expected if c.startswith("force")] == ["force 5% [kN]", "force 50% [kN]", "force 95% [kN]"]
        assert np.all(expected["force 5% [kN]"] <= expected["force 95% [kN]"])
        early = expected["t [s]"] < 0.5
        inside = expected["elongation 5% [mm]"][early].min() <= measured["du"][measured["t"] < 0.5].min()
        assert inside
        assert request["expected"]["peak_force"]["5%"] < measured["F"].abs().max() * 1e3 * 1.3


def test_what_is_left_in_the_folder_of_a_request_is_the_answer(tmp_path, recorded):
    with AskTell(load_study(WITH_RECORDS), tmp_path / "run") as design:
        (asked,) = design.ask()
        with pytest.raises(UserError, match=r"left no record\.csv"):
            design.tell(asked.id)
        columns = recorded(**asked.si)
        columns.to_csv(design.folder(asked.id) / "record.csv", index=False)
        design.tell(asked.id)
        kept = design.campaign[asked.id].record
        np.testing.assert_allclose(kept.channels["force"], 1e3 * columns["F"], rtol=1e-12)
        # The ground motion that was asked for stands beside it.
        assert np.abs(kept.channels["ground_acceleration"]).max() > 1.0


@pytest.mark.whole
def test_a_run_waits_for_an_answer_and_goes_on_with_it(tmp_path, recorded):
    study = load_study(WITH_RECORDS, ["design.initial=2", "design.iterations=1", "steps=[design]"])
    folder, resume = tmp_path / "run", False
    for number in range(2):
        with pytest.raises(Waiting, match=f"E0{number + 1} is asked"):
            run(study, folder, resume=resume, progress=False, figures=False)
        resume = True
        request = requested(folder)
        si = {name: about["si"] for name, about in request["inputs"].items()}
        recorded(**si).to_csv(folder / "laboratory" / f"{request['id']}-1" / "record.csv", index=False)
    # Both count: the third is chosen by a step of the design.
    with pytest.raises(Waiting, match="E03 is asked"):
        run(study, folder, resume=True, progress=False, figures=False)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["status"] == "waiting" and len(summary["design"]["max_expected_improvement"]) == 1


def test_several_are_out_at_once_and_asking_again_changes_nothing(tmp_path):
    with AskTell(load_study(STUDY), tmp_path / "run") as design:
        two = design.ask(2)
        assert [asked.id for asked in two] == ["E01", "E02"]
        assert [asked.id for asked in design.ask(2)] == ["E01", "E02"]
    events = RunFolder(tmp_path / "run", load_study(STUDY).written(), resume=True)
    assert [event["event"] for event in events.events()] == ["asked", "asked"]
    events.close()


def test_a_request_that_was_not_written_is_written_when_asked_for(tmp_path):
    with AskTell(load_study(STUDY), tmp_path / "run") as design:
        design.conduct.ask()  # killed before the request was on the disk
    with AskTell(output=tmp_path / "run") as design:
        (asked,) = design.ask()
        assert (design.folder(asked.id) / "request.json").is_file()


def test_a_record_until_the_failure_is_kept_and_not_fitted(tmp_path, recorded):
    with AskTell(load_study(WITH_RECORDS), tmp_path / "run") as design:
        (asked,) = design.ask()
        half = recorded(**asked.si).iloc[:40]
        design.failed(asked.id, "the rod slipped", record=half)
    (kept,) = read_campaign(tmp_path / "run" / "campaign")
    assert (kept.status, kept.reason, len(kept.record)) == ("failed", "the rod slipped", 40)


def test_earlier_experiments_are_taken_once(tmp_path):
    campaign = campaign_of(load_study(STUDY | {"experiments": SPECIMEN}))
    with AskTell(load_study(STUDY), tmp_path / "run") as design:
        assert design.take(campaign) == ["E01", "E02", "E03"]
        assert design.take(campaign) == []
        for experiment in campaign:
            assert design.campaign[experiment.id].quantities == pytest.approx(experiment.quantities)
        assert design.conduct.pending == []


def test_a_second_process_is_refused(tmp_path):
    with AskTell(load_study(STUDY), tmp_path / "run"):
        with pytest.raises(UserError, match="is in use by another running process"):
            AskTell(output=tmp_path / "run")
        with pytest.raises(UserError, match="is in use by another running process"):
            run(load_study(STUDY), tmp_path / "run", resume=True)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tell", "RUN", "E01"], "left no quantities.json"),
        (["tell", "RUN", "E09", "--quantity", "peak_force=1"], "was not asked"),
        (["tell", "RUN", "E01", "--quantity", "peak_force=many"], "write NAME=VALUE with a number"),
        (["tell", "RUN", "E01", "--quantity", "peak=1"], "the study declares peak_force"),
        (["tell", "RUN", "E01", "--record", "none.csv"], "declares no channels"),
        (["tell", "RUN", "E01", "--failed", " "], "say why"),
        (["tell", "RUN"], "give the ID"),
        (["ask", "RUN", "--again", "E01"], "only one that failed"),
        (["ask", "RUN", "--again", "E07"], "there is no experiment 'E07'"),
        (["ask", "RUN", "--count", "0"], "at least 1"),
        (["ask", "RUN", "--batch", "0"], "at least 1"),
        (["ask", "RUN", "--count", "1000000000"], "ask for at most 3"),
        (["ask", "RUN", "seed=3"], "its study is fixed"),
        (["ask", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_a_mistake_gets_one_message_and_changes_nothing(arguments, said, tmp_path, capsys):
    folder = tmp_path / "run"
    with AskTell(load_study(STUDY), folder) as design:
        design.ask()
    journal = (folder / "journal.jsonl").read_text()
    assert main([str(folder) if word == "RUN" else word for word in arguments]) == 2
    output = capsys.readouterr().err
    assert said in output
    assert output.count("\n") == 1
    assert (folder / "journal.jsonl").read_text() == journal
