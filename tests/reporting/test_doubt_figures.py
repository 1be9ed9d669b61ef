"""Pictures of doubted records: one for each, named after it, in which the samples that are meant are those that are wrong."""

from pathlib import Path

import numpy as np
import pytest
from builders.records import as_record, clean, in_mm, loop

from hsed_jax.command_line import main
from hsed_jax.measurements import Campaign, Channel, Experiment, Finding, Record, check_campaign, write_campaign
from hsed_jax.reporting.doubt_figures import doubts_picture, write_pictures

PNG = b"\x89PNG"


def spans(campaign, kind):
    (finding,) = [f for f in check_campaign(campaign) if f.kind == kind]
    return [*finding.spans]


def test_the_samples_of_a_doubt_are_those_that_were_changed():
    data = loop()
    assert spans(in_mm({k: np.delete(v, slice(301, 315)) for k, v in data.items()}), "jump") == [(300, 302)]
    slipped = data | {"elongation": np.where(np.arange(480) == 433, data["elongation"] - 3e-3, data["elongation"])}
    assert any(a <= 433 < b for a, b in spans(in_mm(slipped), "slip"))
    clipped = data | {"force": np.clip(data["force"], -2.2e4, 2.2e4)}
    marked = np.concatenate([np.arange(a, b) for a, b in spans(in_mm(clipped), "clipped")])
    assert marked.size and set(marked) <= set(np.flatnonzero(np.abs(clipped["force"]) == 2.2e4))
    held = {k: np.insert(v, 375, np.full(60, v[375])) for k, v in data.items()}
    held["force"][375:435] *= np.linspace(1, 0.7, 60)
    assert any(a <= 380 and b >= 430 for a, b in spans(in_mm(held), "hold"))
    changed = data | {"elongation": np.where(np.arange(480) < 243, 1e-3, 1) * data["elongation"]}
    assert spans(in_mm(changed), "unit") == [(243, 480)]


def test_every_doubted_record_has_a_picture_and_no_other(tmp_path):
    records = {"E01": loop(seed=1, noise=0.1), "odd/name": loop(), "E03": loop(seed=2, noise=0.1)}
    records["odd/name"]["elongation"] += 1e-3
    channels = {"elongation": Channel("elongation", "mm"), "force": Channel("force", "kN")}
    experiments = tuple(Experiment(id.replace("/", "."), record=as_record(data)) for id, data in records.items())
    campaign = Campaign("x", "displacement", channels=channels, experiments=experiments)
    findings = check_campaign(campaign)
    assert {f.experiment for f in findings} == {"odd.name"}
    ((id, path),) = write_pictures(campaign, findings, tmp_path / "figures")
    assert (id, path) == ("odd.name", tmp_path / "figures" / "doubts_odd.name.png")
    assert path.read_bytes().startswith(PNG) and [*(tmp_path / "figures").iterdir()] == [path]


def test_the_same_record_and_doubts_are_the_same_picture_and_marks_change_it():
    campaign = in_mm(loop() | {"elongation": loop()["elongation"] + 1e-3})
    (experiment,) = campaign
    found = [f for f in check_campaign(campaign) if f.level == "doubt"]
    one = doubts_picture(campaign, experiment, found)
    assert one is not None and one == doubts_picture(campaign, experiment, found)
    bare = [Finding("doubt", f.experiment, f.channel, f.time, f.message, f.kind, f.has_time) for f in found]
    assert one != doubts_picture(campaign, experiment, bare)


def test_a_record_without_a_loop_and_a_doubt_of_its_time_are_drawn():
    data = clean()
    channels = {"time": Channel("time", "s"), "ground_acceleration": Channel("ground_acceleration", "g"),
                "displacement_1": Channel("displacement_1", "mm")}  # fmt: skip
    motion = {"ground_acceleration": data["ground_acceleration"], "displacement_1": data["elongation"]}
    late = Record(data["time"] + 0.3 * (data["time"] >= 5), motion)
    campaign = Campaign("x", "ground_motion", channels=channels, experiments=(Experiment("E01", record=late),))
    found = check_campaign(campaign)
    assert [f.kind for f in found] == ["gap"] and found[0].spans == ((999, 1001),)
    assert (doubts_picture(campaign, campaign["E01"], found) or b"").startswith(PNG)


def test_an_error_or_a_doubt_of_a_quantity_is_not_drawn(tmp_path):
    data = loop()
    data["force"][100] = np.nan
    campaign = in_mm(data)
    assert [*write_pictures(campaign, check_campaign(campaign), tmp_path)] == []
    clean_one = in_mm(loop())
    said = Finding("doubt", "E01", "peak_force", None, "too large", "unit")
    assert [*write_pictures(clean_one, [said], tmp_path)] == [] and [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("wrong", [True, False])
def test_check_writes_the_picture_beside_the_study_and_names_it(tmp_path, monkeypatch, capsys, wrong):
    monkeypatch.chdir(tmp_path)
    write_campaign(in_mm(loop() | {"elongation": loop()["elongation"] + wrong * 1e-3}), tmp_path / "wall")
    assert main(["init", "wall"]) == 0
    capsys.readouterr()
    assert main(["check", "wall/study.yaml"]) == 0
    said, path = capsys.readouterr().out, Path("wall/figures/doubts_E01.png")
    assert path.exists() == wrong == (f"E01: the picture {path} marks the doubtful samples" in said)


def test_a_folder_that_cannot_be_written_does_not_stop_the_check(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_campaign(in_mm(loop() | {"elongation": loop()["elongation"] + 1e-3}), tmp_path / "wall")
    assert main(["init", "wall"]) == 0
    Path("wall/figures").write_text("a file where the folder would be")
    assert main(["check", "wall/study.yaml"]) == 0
    said = capsys.readouterr()
    assert "cannot be written" in said.err and "the study is valid" in said.out
