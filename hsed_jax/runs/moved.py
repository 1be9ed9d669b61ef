"""A study that moves into another folder, with the files that it names, so that it runs there."""

import re
import shutil
from pathlib import Path
from typing import Any

from hsed_jax.config.load import load_study
from hsed_jax.config.schema import Study
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.plain import dump_yaml, is_file, parse_yaml

_CAMPAIGN = re.compile(r"(?m)^((?:experiments:\s*\{\s*|[ ]+)campaign:\s*)([^\s#}][^#}\n]*?)(\s*(?:[#}].*)?)$")


def moved_study(file: Path, folder: Path, campaign: str) -> Path:
    """Write a study into another folder, on a campaign, with the files that it names beside it.

    Comments stay if the study names no file besides its campaign.  A study on a laboratory becomes one on the campaign, without
    the step design.

    Arguments:
        file: of the study.
        folder: where to.
        campaign: path of the campaign from there.

    Returns:
        The file written, of the same name.

    Raises:
        UserError: the study is wrong, or names a file that is not there or a folder.
        OSError: the folder cannot be written to.
    """
    study = load_study(file)
    folder.mkdir(parents=True, exist_ok=True)
    text = file.read_text(encoding="utf-8")
    named: dict[str, Path] = {}
    content = _relative({k: v for k, v in study.written().items() if k != "experiments"}, str(file), named)
    target = folder / file.name
    if not named and (kept := _with_comments(text, str(file), campaign)) is not None:
        write_whole(target, kept)
        return target
    for name, path in named.items():
        shutil.copyfile(path, folder / name)
    write_whole(target, dump_yaml(_on_campaign(study, content, campaign)))
    return target


def _on_campaign(study: Study, content: dict[str, Any], campaign: str) -> dict[str, Any]:
    steps = [step for step in study.steps if step != "design"] if study.experiments.campaign is None else study.steps
    return content | {"experiments": {"campaign": campaign}, "steps": steps or ["calibrate"]}


def _with_comments(text: str, where: str, campaign: str) -> str | None:
    """The text with the path of its campaign replaced; None if this changes anything else."""
    before = parse_yaml(text, where)
    if not isinstance(before, dict) or "campaign" not in (before.get("experiments") or {}):
        return None
    kept, count = _CAMPAIGN.subn(rf"\g<1>{campaign}\g<3>", text)
    expected = before | {"experiments": {"campaign": campaign}}
    return kept if count == 1 and parse_yaml(kept, where) == expected else None


def _relative(value: Any, where: str, named: dict[str, Path]) -> Any:
    """A value of a study with names of files instead of absolute paths; the files by these names."""
    if isinstance(value, dict):
        return {key: _relative(item, where, named) for key, item in value.items()}
    if isinstance(value, list):
        return [_relative(item, where, named) for item in value]
    if not isinstance(value, str) or not value.startswith("/"):
        return value
    path, colon, part = (value, "", "") if is_file(Path(value)) else value.rpartition(":")
    if not is_file(Path(path)):
        raise UserError(f"{where}: it names {value}, which is no file; only files move with a study")
    file = Path(path)
    if named.setdefault(file.name, file) != file:
        raise UserError(f"{where}: {named[file.name]} and {file} have the same name; rename one of them")
    return f"{file.name}{colon}{part}"
