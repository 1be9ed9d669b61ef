"""Projects of DesignSafe: the names of their entities, and a project read back as its campaign and its study."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, read_campaign, write_campaign
from hsed_jax.plain import is_file
from hsed_jax.runs.moved import moved_study
from hsed_jax.runs.reading import mapping

METADATA = "metadata.json"
"""The file of the metadata in the folder of a project."""
PROJECT = "designsafe.project"
"""The name of the entity of the project itself."""


class Level(NamedTuple):
    """A kind of entity.

    Attributes:
        name: of it in the metadata.
        below: the field in which entities below it name it.
        tag: of its files; empty without one.
    """

    name: str
    below: str
    tag: str = ""


class Kind(NamedTuple):
    """A type of project.

    Attributes:
        levels: from the tests as a whole to one test; the model and the sensors are between them.
        model, sensors: places of these among the levels.
        analysis, report: names of these.
    """

    levels: tuple[Level, ...]
    model: int
    sensors: int
    analysis: str
    report: str


_HYBRID = f"{PROJECT}.hybrid_simulation"
KINDS = {
    "experimental": Kind(
        (
            Level(f"{PROJECT}.experiment", "experiments"),
            Level(f"{PROJECT}.model_config", "modelConfigs", "Numerical Model"),
            Level(f"{PROJECT}.sensor_list", "sensorLists", "Sensor List"),
            Level(f"{PROJECT}.event", ""),
        ),
        1,
        2,
        f"{PROJECT}.analysis",
        f"{PROJECT}.report",
    ),
    "hybrid_simulation": Kind(
        (
            Level(_HYBRID, "hybridSimulations"),
            Level(f"{_HYBRID}.global_model", "globalModels", "Simulation Model"),
            Level(f"{_HYBRID}.coordinator", "coordinators"),
            Level(f"{_HYBRID}.exp_substructure", "expSubstructures", "Sensor Information"),
            Level(f"{_HYBRID}.exp_output", ""),
        ),
        1,
        3,
        f"{_HYBRID}.analysis",
        f"{_HYBRID}.report",
    ),
}
"""Types of projects, by the value of `projectType`."""


@dataclass(frozen=True)
class Project:
    """A project of DesignSafe.

    Attributes:
        campaign: its measurements.
        study: the file of its study; None without one.
    """

    campaign: Campaign
    study: Path | None


def is_project(folder: Path) -> bool:
    """Whether a folder holds the metadata of a project."""
    return is_file(folder / METADATA)


def read_designsafe(folder: str | Path) -> Project:
    """Read a project that `write_designsafe` wrote.

    Arguments:
        folder: of the project, with its metadata.

    Raises:
        UserError: there are no metadata, no sensors among them, a file that they name is not there, or its content is wrong.

    Example:
        >>> _ = hx.write_designsafe("my_campaign", "shared")
        >>> hx.read_designsafe("shared").campaign == hx.read_campaign("my_campaign")
        True
    """
    folder = Path(folder)
    path = folder / METADATA
    if not is_project(folder):
        raise UserError(f"{folder} is not a project of DesignSafe: {METADATA} is missing")
    tree = mapping(path, "name", "value", "children")
    kind = KINDS.get(str(tree["value"].get("projectType")) if isinstance(tree["value"], dict) else "")
    if kind is None:
        raise UserError(f"{path}: projectType must be one of {', '.join(KINDS)}; other projects hold no tests")
    declaration = _file(folder, tree, kind.levels[kind.sensors].name, "campaign.yaml")
    if declaration is None:
        raise UserError(
            f"{path}: no {kind.levels[kind.sensors].name} has a file campaign.yaml, which declares the channels; give the "
            "files of the records themselves: hsed init FILE"
        )
    study = _file(folder, tree, kind.levels[kind.model].name, "study.yaml")
    return Project(read_campaign(declaration.parent), study)


def unpack(project: Project, folder: Path) -> Path | None:
    """Write the campaign of a project as a separate folder, and its study into it.

    Returns:
        The study; None where the project has none.

    Raises:
        UserError: the study is wrong.
        OSError: the folder cannot be written to.
    """
    write_campaign(project.campaign, folder)
    return None if project.study is None else moved_study(project.study, folder, ".")


def _file(folder: Path, node: Any, entity: str, name: str) -> Path | None:
    """The file of this name of the first entity of a kind that has one.

    Raises:
        UserError: it is not there, or not inside the project.
    """
    for value in _values(node, entity):
        for file in value.get("fileObjs") or []:
            path = str(file.get("path", "")) if isinstance(file, dict) else ""
            if path.rpartition("/")[2] != name:
                continue
            found = folder / path.lstrip("/")
            if not found.resolve().is_relative_to(folder.resolve()) or not is_file(found):
                raise UserError(f"{folder / METADATA}: the file {path} of {entity} is not in {folder}")
            return found
    return None


def _values(node: Any, entity: str) -> list[dict[str, Any]]:
    """The metadata of all entities of a kind."""
    if not isinstance(node, dict):
        return []
    own = [node["value"]] if node.get("name") == entity and isinstance(node.get("value"), dict) else []
    children = node.get("children")
    below = children if isinstance(children, list) else []
    return [*own, *(value for child in below for value in _values(child, entity))]
