"""A project of DesignSafe: written and read again it is the same campaign and study, and its metadata are those of the portal."""

import json

import numpy as np
import pytest
from builders import run_folders
from builders.springs import spring_campaign, spring_study

import hsed_jax as hx
from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record, read_campaign, write_campaign
from hsed_jax.plain import dump_yaml

# Fields of the entities, from designsafe/apps/api/projects_v2/schema_models of the portal, which forbids others.
OF_FILES = {"files", "fileTags", "fileObjs"}
COMMON = {"title", "description", "project"}
HYBRID = COMMON | OF_FILES | {"hybridSimulations"}
FIELDS = {
    "designsafe.project": {"projectId", "projectType", "title", "description", "pi", "nhTypes", "keywords", "authors"},
    "designsafe.project.experiment": COMMON
    | {"facility", "experimentType", "equipmentType", "procedureStart", "authors"},
    "designsafe.project.model_config": COMMON | OF_FILES | {"experiments"},
    "designsafe.project.sensor_list": COMMON | OF_FILES | {"experiments", "modelConfigs"},
    "designsafe.project.event": COMMON | OF_FILES | {"experiments", "modelConfigs", "sensorLists", "eventType"},
    "designsafe.project.analysis": COMMON | OF_FILES | {"experiments", "analysisType", "application"},
    "designsafe.project.report": COMMON | OF_FILES | {"experiments"},
    "designsafe.project.hybrid_simulation": COMMON | {"simulationType", "authors"},
    "designsafe.project.hybrid_simulation.global_model": HYBRID,
    "designsafe.project.hybrid_simulation.coordinator": HYBRID | {"globalModels"},
    "designsafe.project.hybrid_simulation.exp_substructure": HYBRID | {"globalModels", "coordinators"},
    "designsafe.project.hybrid_simulation.exp_output": HYBRID | {"globalModels", "coordinators", "expSubstructures"},
    "designsafe.project.hybrid_simulation.analysis": HYBRID,
    "designsafe.project.hybrid_simulation.report": HYBRID,
}
# Which entity is directly below which, by `ALLOWED_RELATIONS` of the portal.
BELOW = {
    "designsafe.project": {"experiment", "hybrid_simulation"},
    "designsafe.project.experiment": {"analysis", "report", "model_config"},
    "designsafe.project.model_config": {"sensor_list"},
    "designsafe.project.sensor_list": {"event"},
    "designsafe.project.hybrid_simulation": {"analysis", "report", "global_model"},
    "designsafe.project.hybrid_simulation.global_model": {"coordinator"},
    "designsafe.project.hybrid_simulation.coordinator": {"exp_substructure"},
    "designsafe.project.hybrid_simulation.exp_substructure": {"exp_output"},
}


def full_campaign():
    """Inputs, quantities, both kinds of noise, a test, a window, a shared record, a failed and a planned experiment."""
    time = np.linspace(0.0, 2.0, 41)
    records = [Record(time, {"ground_acceleration": a * np.sin(7 * time), "force": a * 1e3 * time}) for a in (1.0, 0.3)]
    metadata = {"operator": "A. N. Other; shift 2"}
    experiments = (
        Experiment("E 01", {"V": 0.1}, record=records[0], quantities={"peak_force": 2.0e3}, metadata=metadata),
        Experiment("e-01", {"V": 0.3}, record=records[0], quantities={"peak_force": 1.9e3}, window=(0.5, 1.5)),
        Experiment("T_1", {"V": 0.7}, record=records[1], split="test"),
        Experiment("F1", {"V": 0.9}, status="failed", reason="a valve leaked"),
        Experiment("P1", {"V": 1.1}, status="pending"),
    )
    channels = {
        "time": Channel("time", "ms", "t"),
        "ground_acceleration": Channel("ground_acceleration", "g", "ag [g]"),
        "force": Channel("force", "kip", "F", Noise(relative=0.02)),
    }
    quantities = {"peak_force": Channel("peak_force", "kN", "Fmax", Noise(absolute=30.0))}
    return Campaign("frame 3, phase Ä", "ground_motion", {"V": "ft/s"}, channels, quantities, experiments)


def springs(folder, head="# Priors are those of the laboratory.\n"):
    write_campaign(spring_campaign(0.0), folder)
    content = spring_study().written() | {"experiments": {"campaign": "."}}
    (folder / "study.yaml").write_text(head + dump_yaml(content), encoding="utf-8")
    return folder


def write_run(folder):
    run_folders.write(folder)
    (folder / "report.html").write_text("<html></html>", encoding="utf-8")
    return folder


def nodes(tree):
    yield tree
    for child in tree["children"]:
        yield from nodes(child)


def metadata(project):
    return json.loads((project / "metadata.json").read_text(encoding="utf-8"))


def without_place(study):
    return {key: value for key, value in study.written().items() if key != "experiments"}


@pytest.mark.parametrize("hybrid", [False, True])
def test_a_campaign_that_is_written_and_read_is_the_same(tmp_path, hybrid):
    campaign = full_campaign()
    write_campaign(campaign, tmp_path / "tests")
    hx.write_designsafe(tmp_path / "tests", tmp_path / "project", hybrid=hybrid)
    found = hx.read_designsafe(tmp_path / "project")
    assert found.campaign == campaign and found.study is None
    assert [e.split for e in found.campaign] == [e.split for e in campaign]
    # The experiments that shared a record share it still.
    assert found.campaign["E 01"].record is found.campaign["e-01"].record


@pytest.mark.parametrize("hybrid", [False, True])
def test_the_metadata_have_the_entities_and_the_fields_of_the_portal(tmp_path, hybrid):
    run = write_run(tmp_path / "run")
    hx.write_designsafe(run, tmp_path / "project", hybrid=hybrid)
    tree, project = metadata(tmp_path / "project"), tmp_path / "project"
    kinds = {node["name"] for node in nodes(tree)}
    part = "hybrid_simulation" if hybrid else "experiment"
    assert kinds == {n for n in FIELDS if ("hybrid" in n) == hybrid or n == "designsafe.project"}
    assert tree["value"]["projectType"] == ("hybrid_simulation" if hybrid else "experimental")
    assert [child["name"].rpartition(".")[2] for child in tree["children"]] == [part]
    ids = {node["uuid"] for node in nodes(tree)}
    assert len(ids) == len(list(nodes(tree)))
    named = set()
    for node in nodes(tree):
        value = node["value"]
        assert value.keys() <= FIELDS[node["name"]] and value["title"]
        assert {child["name"].rpartition(".")[2] for child in node["children"]} <= BELOW.get(node["name"], set())
        for key in ("project", "experiments", "modelConfigs", "sensorLists", "hybridSimulations", "globalModels"):
            assert set(value.get(key, [])) <= ids
        files = value.get("fileObjs", [])
        named |= {file["path"] for file in files}
        assert {tag["fileUuid"] for tag in value.get("fileTags", [])} <= {file["uuid"] for file in files}
    # Every file has one category, and none is missing.
    written = {f"/{p.relative_to(project).as_posix()}" for p in project.rglob("*") if p.is_file()}
    assert named == written - {"/metadata.json"}


def test_the_study_is_the_same_with_its_comments_and_runs_in_the_project(tmp_path):
    source = springs(tmp_path / "springs")
    hx.write_designsafe(source, tmp_path / "project")
    found = hx.read_designsafe(tmp_path / "project")
    assert found.study is not None
    assert "# Priors are those of the laboratory." in found.study.read_text(encoding="utf-8")
    study = hx.load_study(found.study)
    assert without_place(study) == without_place(hx.load_study(source / "study.yaml"))
    assert hx.campaign_of(study) == read_campaign(source)


def test_the_commands_write_a_project_and_read_it(tmp_path, capsys):
    source, project = springs(tmp_path / "springs"), tmp_path / "project"
    assert main(["export", str(source), "--designsafe", str(project)]) == 0
    assert "metadata.json" in capsys.readouterr().out
    assert main(["init", str(project)]) == 0
    again = tmp_path / "project_campaign"
    assert f"wrote {again / 'study.yaml'}" in capsys.readouterr().out
    assert read_campaign(again) == spring_campaign(0.0) == hx.campaign_of(hx.load_study(again / "study.yaml"))
    assert without_place(hx.load_study(again / "study.yaml")) == without_place(hx.load_study(source / "study.yaml"))
    assert main(["init", str(project)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_without_a_study_a_new_one_is_written(tmp_path, capsys):
    write_campaign(spring_campaign(0.0), tmp_path / "springs")
    assert main(["export", str(tmp_path / "springs"), "--designsafe", str(tmp_path / "project")]) == 0
    words = ["init", str(tmp_path / "project"), "--output", str(tmp_path / "mine"), "--model", "opensees:SAWS"]
    assert main(words) == 0
    assert hx.load_study(tmp_path / "mine" / "study.yaml").written()["model"]["opensees"] == "SAWS"
    capsys.readouterr()


def test_files_that_the_study_names_come_along(tmp_path):
    source = springs(tmp_path / "springs")
    (source / "mine.py").write_text("class MyLaw: ...\n", encoding="utf-8")
    content = spring_study().written() | {"experiments": {"campaign": "."}}
    content["model"] = {"spring": {"file": "mine.py", "class": "MyLaw"}, "parameters": {"k": {"uniform": [1.0, 2.0]}}}
    (source / "study.yaml").write_text(dump_yaml(content), encoding="utf-8")
    hx.write_designsafe(source, tmp_path / "project")
    study = hx.load_study(tmp_path / "project" / "model" / "study.yaml")
    assert study.code == ["mine.py"]
    assert (tmp_path / "project" / "model" / "mine.py").read_text(encoding="utf-8") == "class MyLaw: ...\n"
    assert str(tmp_path) not in (tmp_path / "project" / "model" / "study.yaml").read_text(encoding="utf-8")


def test_a_laboratory_becomes_the_campaign_that_it_measured(tmp_path):
    run = write_run(tmp_path / "run")
    study = hx.load_study("configs/paper.yaml")
    (run / "study.yaml").write_text(dump_yaml(study.written()), encoding="utf-8")
    hx.write_designsafe(run, tmp_path / "project")
    found = hx.load_study(tmp_path / "project" / "model" / "study.yaml")
    assert found.experiments.campaign == "../campaign" and "design" not in found.steps
    ours, theirs = without_place(found), without_place(study)
    assert {k: v for k, v in ours.items() if k != "steps"} == {k: v for k, v in theirs.items() if k != "steps"}


def _damaged(project, change):
    tree = metadata(project)
    change(tree)
    (project / "metadata.json").write_text(json.dumps(tree), encoding="utf-8")


def test_what_is_no_such_project_is_refused_in_one_message(tmp_path, capsys):
    project = tmp_path / "project"
    source = springs(tmp_path / "springs")
    hx.write_designsafe(source, project)
    with pytest.raises(UserError, match="not empty"):
        hx.write_designsafe(source, project)
    with pytest.raises(UserError, match="is not a project of DesignSafe"):
        hx.read_designsafe(source)
    sensors = "designsafe.project.sensor_list"

    def outside(tree):
        (node,) = [node for node in nodes(tree) if node["name"] == sensors]
        node["value"]["fileObjs"][0]["path"] = "/../springs/campaign.yaml"

    _damaged(project, outside)
    with pytest.raises(UserError, match="is not in"):
        hx.read_designsafe(project)
    _damaged(project, lambda tree: tree["children"].clear())
    with pytest.raises(UserError, match=f"no {sensors} has a file campaign.yaml"):
        hx.read_designsafe(project)
    _damaged(project, lambda tree: tree["value"].update(projectType="simulation"))
    assert main(["init", str(project)]) == 2
    assert "projectType must be one of experimental, hybrid_simulation" in capsys.readouterr().err
    assert main(["export", str(source), "--hybrid", "--table"]) == 2
    assert "--designsafe" in capsys.readouterr().err
