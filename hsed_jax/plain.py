"""Reading of the user's texts: YAML, numbers, names of files. A fault causes one message and no traceback."""

import math
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from hsed_jax.errors import UserError

MOST = 1e100
"""Limit of numbers of a structure, a specimen or a record; no number is larger, or closer to zero than its inverse."""
DEPTH = 50
"""Largest depth of nested lists and mappings."""
_PARTS = 1_000_000
_TOO_DEEP = f"lists and mappings are nested more than {DEPTH} deep"

_KINDS = {"int": "a whole number", "float": "a number", "bool": "true or false", "timestamp": "a date"}
_NUMBER = re.compile(r"^[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|\.(inf|nan))$")
_FLOAT, _DATE = "tag:yaml.org,2002:float", "tag:yaml.org,2002:timestamp"


class _Loader(yaml.SafeLoader):
    """Safe YAML in which 2e5 is a number, a date is a text, and keys are unique."""

    _within = 0

    def compose_node(self, parent, index):
        self._within += 1
        if self._within > DEPTH:
            raise yaml.MarkedYAMLError(problem=_TOO_DEEP, problem_mark=self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self._within -= 1
        return node

    def construct_object(self, node, deep=False):
        try:
            return super().construct_object(node, deep)
        except yaml.YAMLError:
            raise
        except Exception:  # PyYAML raises any exception on a text such as !!bool abc
            kind = _KINDS.get(node.tag.rpartition(":")[2], f"what {node.tag} stands for")
            problem = f"{shown(node.value)} is not {kind} that can be read"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from None

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            name, mark = self.construct_object(key, deep=True), key.start_mark
            if not isinstance(name, Hashable):
                problem = "a key must be a word, not a list or a mapping"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
            if name in seen:
                raise yaml.MarkedYAMLError(problem=f"the key {shown(name)} appears twice", problem_mark=mark)
            seen.add(name)
        return super().construct_mapping(node, deep=deep)


class _Dumper(yaml.SafeDumper):
    """Quotes the texts that the loader would take for numbers."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in (_FLOAT, _DATE)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _kind in (_Loader, _Dumper):
    _kind.add_implicit_resolver(_FLOAT, _NUMBER, list("-+0123456789."))


def parse_yaml(text: str, where: str) -> Any:
    """Parse YAML.

    Raises:
        UserError: it is not YAML, is nested without end, or has a value that cannot be read; the message names the place.
    """
    fault = f"{where}: not valid YAML"
    try:
        content = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        place, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        if place is None:
            raise UserError(f"{fault}: {' '.join(str(error).split())}") from None
        line = f"line {place.line + 1}, column {place.column + 1}"
        quote = "; quote a text that begins with a sign" if "cannot start any token" in (problem or "") else ""
        raise UserError(f"{fault}: {line}: {problem or 'it cannot be read'}{quote}") from None
    # An alias may contain itself, or a thousand copies of another.
    parts, waiting = 0, [(content, 1)]
    while waiting:
        node, depth = waiting.pop()
        parts += 1
        if depth > DEPTH:
            raise UserError(f"{fault}: {_TOO_DEEP}")
        if parts > _PARTS:
            raise UserError(f"{fault}: there are more than {_PARTS} values")
        inner = node.values() if isinstance(node, dict) else node if isinstance(node, list | tuple | set) else ()
        waiting += [(value, depth + 1) for value in inner]
    return content


def dump_yaml(content: Any, *, inline_leaves: bool = False) -> str:
    """Write plain values so that `parse_yaml` gives them back; innermost lists and mappings in one line, if requested."""
    style = None if inline_leaves else False
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=style)


def shown(value: Any, most: int = 60) -> str:
    """A value for a message: quoted and shortened."""
    try:
        text = repr(value[: most + 1] if isinstance(value, str | bytes) else value)
    except ValueError:  # Python writes no whole number of thousands of digits
        text = "a number of thousands of digits"
    return text if len(text) <= most else f"{text[: most - 1]}…"


def is_file(path: Path) -> bool:
    """Whether there is such a file; False for an impossible name (with NUL, too long)."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether there is such a folder; False for an impossible name."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def name_fault(name: str) -> str | None:
    """The reason why a text cannot name a folder or the file of an experiment; None if it can."""
    if not name or name != name.strip() or not name.isprintable():
        return "it must be one line of text without blanks around it"
    if name in (".", "..") or Path(name).name != name:
        return "it must name a folder, not a path: no slash, and not . or .."
    # A file system has 255 bytes for a name, and folders, sheets and files add endings.
    if len(name.encode()) > 200:
        return "it is too long; at most 200 bytes"
    return None


def stem_of(name: str) -> str:
    """A name for a folder or an experiment, from the name of a file."""
    stem = "".join(c if c.isalnum() or c in "_-" else "_" for c in Path(name).stem).strip("_-")
    return stem[:60] or "measurements"


def in_range(number: float) -> bool:
    """Whether a number is zero or of a computable size."""
    return number == 0 or 1 / MOST <= abs(number) <= MOST


def _no_truth(kind: str):
    def check(value: Any) -> Any:
        if isinstance(value, bool):
            raise PydanticCustomError(f"{kind}_type", "a number is wanted")  # pyright: ignore[reportArgumentType]
        return value

    return BeforeValidator(check)


def _sized(value: Any) -> Any:
    if math.isfinite(value) and not in_range(value):
        raise ValueError(f"{value:g} is out of range; numbers are 0 or from {1 / MOST:g} to {MOST:g} in size")
    return value


Number = Annotated[float, _no_truth("float"), AfterValidator(_sized)]
"""A number; true is not a number."""
Magnitude = Annotated[float, _no_truth("float"), Field(ge=0, le=MOST)]
"""A size, which may be arbitrarily close to zero."""
Whole = Annotated[int, _no_truth("int"), Field(le=2**63)]
"""A whole number; true is not a number."""
