"""Writes `docs/parts.md`: laboratories with their settings, acquisitions and samplers, from the code alone."""

import ast
import inspect
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel

from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.inference.samplers import SAMPLERS
from hsed_jax.laboratories.kinds import KINDS
from hsed_jax.laboratories.kinds.base import MeasuredEntry
from hsed_jax.measurements.declaration import ChannelEntry, NoiseEntry

PAGE = Path(__file__).parent / "parts.md"

HEAD = """# Laboratories, acquisitions and samplers

*Written by `python docs/parts.py` from the code; not to be edited by hand.*

Each of these parts is one file of the package, and the name of the file is the name of the part in a study. A new file
adds a part, with its settings, its messages and its entry on this page
([what a new part touches](design.md#what-a-new-part-touches)).
"""
LABORATORIES = """
## Laboratories

A study names one laboratory in `experiments`, instead of a `campaign`. [Laboratories](laboratories.md) describes their
requests and answers.
"""
DECLARED = """
### Channels and quantities

The laboratories {names} declare their measurements as [campaign.yaml](measurements.md) does. Without `channels` and
`quantities`, the answer has the observed outputs of the study, under their own names and in SI. Each channel and each
quantity has these keys:
"""
ACQUISITION = """
## Acquisitions

`design.acquisition` selects the criterion for the next experiment.
"""
SAMPLER = """
## Samplers

`calibration.sampler` selects the method of drawing from the posterior.
"""


def page() -> str:
    """The text of `docs/parts.md`."""
    lines = [HEAD, LABORATORIES, *_index("laboratory", "how it performs an experiment", "use it for", KINDS)]
    for name, section in KINDS.items():
        lines += [f"\n### {name}\n", _paragraph(section), "", *_table(settings(section, f"experiments.{name}"))]
    declaring = [f"`{name}`" for name, section in KINDS.items() if issubclass(section, MeasuredEntry)]
    rows = [*settings(ChannelEntry, "", {"noise"}), *settings(NoiseEntry, "noise")]
    lines += [DECLARED.format(names=", ".join(declaring)), *_table(rows)]
    lines += [ACQUISITION, *_index("acquisition", "chooses the experiment", "use it for", ACQUISITIONS)]
    lines += [SAMPLER, *_index("sampler", "draws", "use it where", SAMPLERS)]
    return "\n".join(lines) + "\n"


def settings(section: type[BaseModel], path: str, without: set[str] | None = None) -> Iterator[tuple[str, str, str]]:
    """Key, default and meaning of the settings of a section.

    Arguments:
        section: its fields are the settings.
        path: of the section in a study.
        without: fields that are left out.

    Raises:
        ValueError: a field has no docstring.
    """
    said = meanings(section)
    for name, field in section.model_fields.items():
        key = f"{path}.{field.alias or name}".lstrip(".")
        if name in (without or ()):
            continue
        if name not in said:
            raise ValueError(f"{section.__name__}.{name} has no docstring below it, and so no meaning on the page")
        yield key, _default(field.is_required(), field.default), said[name]
        for inner in _sections(field.annotation):
            if inner.__module__ == section.__module__ and inner is not NoiseEntry:
                yield from settings(inner, key)


def meanings(section: type[BaseModel]) -> dict[str, str]:
    """By field, the docstring below it, as one line."""
    found: dict[str, str] = {}
    for cls in reversed(section.__mro__):
        if not (issubclass(cls, BaseModel) and cls.__module__.startswith("hsed_jax.")):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        assert isinstance(tree, ast.ClassDef)
        for field, text in zip(tree.body, tree.body[1:], strict=False):
            is_text = isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and is_text:
                found[field.target.id] = " ".join(str(text.value.value).split()).removesuffix(".")
    return found


def _default(is_required: bool, value: Any) -> str:
    if is_required:
        return "required"
    return "none" if value is None else f"`{yaml.safe_dump(value, default_flow_style=True).split('\n')[0]}`"


def _sections(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in _sections(part)]


def _index(noun: str, what: str, use: str, parts: Mapping[str, Any]) -> list[str]:
    rows = [f"| `{name}` | {_first(part)} | {part.use} |" for name, part in parts.items()]
    return [f"| {noun} | {what} | {use} |", "|---|---|---|", *rows]


def _first(part: type) -> str:
    return (inspect.getdoc(part) or "").partition("\n")[0].removesuffix(".")


def _paragraph(part: type) -> str:
    return " ".join((inspect.getdoc(part) or "").partition("\n\n")[0].split())


def _table(rows: Any) -> list[str]:
    return ["| key | default | meaning |", "|---|---|---|", *(f"| `{k}` | {d} | {m} |" for k, d, m in rows)]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
