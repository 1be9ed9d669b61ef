"""A campaign or a run as a project of DesignSafe: its files, and the metadata that give each file its category.

The metadata are a tree: each node is an entity with `uuid`, `name` and `value`, and the entities below it are in `children`.
Names of entities and fields are those of the portal of DesignSafe (github.com/DesignSafe-CI/portal, folder
designsafe/apps/api/projects_v2, `constants.py` and `schema_models`).  The portal itself gives the number of the project, its
storage and its authors; these are empty.
"""

import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_URL, uuid5

from hsed_jax.config.load import load_study
from hsed_jax.drafts import first_link, write_whole
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, Experiment, read_campaign, write_campaign
from hsed_jax.plain import is_file, is_folder
from hsed_jax.runs.moved import moved_study
from hsed_jax.runs.projects import KINDS, METADATA, PROJECT

# Parts of a run folder that are the analysis.
_ANALYSIS = (
    "summary.json",
    "results.nc",
    "cycles.csv",
    "backbones.csv",
    "provenance.json",
    "learned_effect.py",
    "figures",
    "export",
)
_TAGS = {".csv": "Table", ".svg": "Graph", ".png": "Graph", ".py": "Script", ".tcl": "Script"}


@dataclass
class _Entity:
    """A node of the metadata."""

    name: str
    value: dict[str, Any]
    files: list[tuple[str, str]] = field(default_factory=list)
    children: "list[_Entity]" = field(default_factory=list)


def write_designsafe(source: str | Path, folder: str | Path, *, hybrid: bool = False) -> list[Path]:
    """Write a campaign or a run as a project of DesignSafe.

    The files are `campaign/` (a campaign as `read_campaign` reads it: sensors and events), `model/study.yaml` (the study, on this
    campaign) with the files that it names, and of a run `model/improved.yaml`, `analysis/` and `report/report.html`;
    `metadata.json` gives each its category.

    Arguments:
        source: folder of a campaign, with or without the study that `hsed init` writes into it, or a run folder.
        folder: of the project; it is new or empty.
        hybrid: the project is of the type hybrid simulation; otherwise experimental.

    Returns:
        The files written.

    Raises:
        UserError: there is neither campaign nor run, a study names files that are not there, or the folder has files or cannot
            be written to.

    Example:
        >>> _ = hx.write_designsafe("my_campaign", "project")
        >>> len(hx.read_designsafe("project").campaign)
        1
    """
    source, folder = Path(source), Path(folder)
    is_run = is_folder(source / "campaign")
    campaign = read_campaign(source / "campaign" if is_run else source)
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UserError(f"{folder} exists and is not empty; choose another folder")
        if is_run and (link := first_link(source, [*_ANALYSIS, "report.html"])) is not None:
            raise UserError(f"{link} is a symbolic link, whose file may be another one; replace it by its target")
        write_campaign(campaign, folder / "campaign")
        models = [moved_study(path, folder / "model", "../campaign") for path in _studies(source, is_run)]
        for name in (*_ANALYSIS, "report.html") if is_run else ():
            _copied(source / name, folder / ("report" if name == "report.html" else "analysis") / name)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        names = [path.relative_to(folder).as_posix() for path in files]
        described = _described(folder / "model" / "study.yaml") if models else ""
        tree = _node(_entities(campaign, names, described, "hybrid_simulation" if hybrid else "experimental"), {}, [])
        write_whole(folder / METADATA, json.dumps(tree, indent=2, ensure_ascii=False) + "\n")
    except OSError as error:
        raise UserError(f"{folder} cannot be written to ({error.strerror}); choose another folder") from None
    return [*files, folder / METADATA]


def _studies(source: Path, is_run: bool) -> list[Path]:
    """The study of a campaign or a run, and the improved one, if they exist."""
    found = [path for path in (source / "study.yaml", source / "improved.yaml") if is_file(path)]
    return found if is_run else found[:1]


def _copied(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target)
    elif source.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def _described(study: Path) -> str:
    """The model of a study in words."""
    model = load_study(study).model
    effects = ", ".join(model.effects)
    return f"The {' '.join(model.described)}{f' with {effects}' if effects else ''}."


def _entities(campaign: Campaign, names: Sequence[str], model: str, kind: str) -> _Entity:
    """The project with all entities below it."""
    levels, at_model, at_sensors, of_analysis, of_report = KINDS[kind]
    is_hybrid, title = kind == "hybrid_simulation", campaign.name
    test = {"id": "Earthquake", "name": "Earthquake"}
    about: dict[str, Any] = {"simulationType": test}
    if not is_hybrid:
        types = {"displacement": ("qstatic", "Quasi-Static"), "ground_motion": ("shake", "Shake")}
        about = {"experimentType": dict(zip(("id", "name"), types[campaign.protocol], strict=True))}
    chain = [_Entity(level.name, {"title": title, "description": ""}) for level in levels[:-1]]
    chain[0].value |= about | {"description": _protocol(campaign)}
    chain[at_model].value["description"] = model or "No numerical model is part of this project."
    chain[at_model].files = [(name, levels[at_model].tag) for name in names if name.startswith("model/")]
    tables = [name for name in names if name in ("campaign/campaign.yaml", "campaign/experiments.csv")]
    chain[at_sensors].value["description"] = _sensors(campaign)
    chain[at_sensors].files = [(name, levels[at_sensors].tag if name.endswith(".yaml") else "") for name in tables]
    for upper, lower in pairwise(chain):
        upper.children.append(lower)
    for experiment in campaign:
        if experiment.status in ("completed", "failed"):
            chain[-1].children.append(_event(campaign, experiment, levels[-1].name, names, is_hybrid))
    for name, folder, words in (
        (of_analysis, "analysis/", "Results of hsed_jax: calibration, comparison, diagnosis."),
        (of_report, "report/", "The report of hsed_jax."),
    ):
        own = [(n, "" if is_hybrid else _tag(n)) for n in names if n.startswith(folder)]
        if own:
            chain[0].children.append(_Entity(name, {"title": title, "description": words}, own))
    project = {
        "projectId": "",
        "projectType": kind,
        "title": title,
        "description": _protocol(campaign),
        "pi": "None",
        "nhTypes": [{"id": "earthquake", "name": "Earthquake"}],
    }
    return _Entity(PROJECT, project, [], [chain[0]])


def _protocol(campaign: Campaign) -> str:
    """The kind of test, and the number of tests."""
    pair, count = campaign.pair, len(campaign)
    tests = {
        "displacement": f"The {pair.elongation} was imposed and the {pair.force} measured.",
        "ground_motion": "The structure was driven by a ground motion.",
    }
    return f"{tests[campaign.protocol]} {count} experiment{'' if count == 1 else 's'}."


def _sensors(campaign: Campaign) -> str:
    """Channels and quantities with columns, units and noise, a line each."""
    lines = []
    for name, channel in (*campaign.channels.items(), *campaign.quantities.items()):
        noise = ""
        if channel.noise is not None and channel.noise.relative is not None:
            noise = f", noise {100 * channel.noise.relative:g} %"
        elif channel.noise is not None:
            noise = f", noise {float(campaign.unit(name).from_si(channel.noise.absolute)):g} {channel.unit}"
        lines.append(f"{name}: column {channel.column} [{channel.unit}]{noise}")
    return "\n".join(lines)


def _event(campaign: Campaign, experiment: Experiment, name: str, names: Sequence[str], is_hybrid: bool) -> _Entity:
    """One test; a shared record belongs to the first of its experiments."""
    told = [f"{k} = {campaign.unit(k).from_si(v):.6g} {campaign.inputs[k]}" for k, v in experiment.inputs.items()]
    told += [f"split {experiment.split}", f"status {experiment.status}"]
    told += [experiment.reason] if experiment.reason else []
    value: dict[str, Any] = {"title": experiment.id, "description": ", ".join(told)}
    if not is_hybrid:
        value["eventType"] = "ground motion" if campaign.protocol == "ground_motion" else "imposed displacement"
    file = f"campaign/records/{experiment.id}.csv"
    return _Entity(name, value, [(file, "")] if file in names else [])


def _tag(name: str) -> str:
    """The tag of a file of the analysis or the report of an experiment."""
    return "Data Report" if name == "report/report.html" else _TAGS.get(Path(name).suffix, "")


def _node(entity: _Entity, above: Mapping[str, list[str]], path: Iterable[str], order: int = 0) -> dict[str, Any]:
    """An entity as DesignSafe writes it, with the entities that it belongs to."""
    path = [*path, f"{entity.name} {order}"]
    uuid, value = str(uuid5(NAMESPACE_URL, "/".join(path))), {**entity.value, **above}
    if entity.files:
        files = [(name, tag, str(uuid5(NAMESPACE_URL, name))) for name, tag in entity.files]
        value["fileObjs"] = [
            {"system": "", "name": Path(name).name, "path": f"/{name}", "type": "file", "uuid": id}
            for name, _, id in files
        ]
        value["fileTags"] = [{"fileUuid": id, "tagName": tag, "path": f"/{name}"} for name, tag, id in files if tag]
    fields = {level.name: level.below for kind in KINDS.values() for level in kind.levels} | {PROJECT: "project"}
    below = {**above, fields[entity.name]: [uuid]} if entity.children else above
    children = [_node(child, below, path, number) for number, child in enumerate(entity.children)]
    return {"uuid": uuid, "name": entity.name, "value": value, "order": order, "children": children}
