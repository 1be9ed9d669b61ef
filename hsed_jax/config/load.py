"""Reading a study: YAML, overrides by dotted path, and one clear message for a fault."""

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.plain import DEPTH, is_file, is_folder, parse_yaml, shown
from hsed_jax.sections import MODELS, TAGS, one_distribution, prior_or_default


def load_study(source: str | Path | dict[str, Any], overrides: Sequence[str] = ()) -> Study:
    """Read a study.

    Arguments:
        source: path of a YAML file, or its content as a mapping.
        overrides: `key=value` by dotted path, the value in YAML, such as `design.iterations=10`.

    Raises:
        UserError: the file is missing or not YAML, or a key or value is not allowed; the message has the key and the allowed
            values.

    Example:
        >>> study = hx.load_study("study.yaml", ["design.iterations=10"])
        >>> study.design.iterations
        10
    """
    if isinstance(source, dict):
        content, where = source, "study"
    else:
        path = Path(source)
        where = str(source)
        if is_folder(path):
            raise UserError(f"{where}: this is a folder; name the study in it, such as {path / 'study.yaml'}")
        if not is_file(path):
            raise UserError(f"{where}: there is no such file")
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UserError(f"{where}: cannot be read as text in UTF-8 ({error})") from None
        content = parse_yaml(text, where)
    if not isinstance(content, dict):
        raise UserError(f"{where}: a study is a mapping of keys such as study, model, experiments")
    for override in overrides:
        content = _override(content, override)
    try:
        study = Study.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{where}: {explain(error, Study)}") from None
    if not isinstance(source, dict):
        study._folder, study._file = Path(source).parent, str(source)
    return study


def load_trusted(file: str, overrides: Sequence[str] = (), *, trust: bool) -> Study:
    """Read a study for inspection: its files are not executed, unless the user trusts them.

    Arguments:
        file, overrides: as `load_study`.
        trust: whether the user trusts the files.

    Raises:
        UserError: as `load_study`; it would execute code, and the user does not trust it.
    """
    study = load_study(file, overrides)
    if study.code and not trust:
        raise UserError(
            f"{file}: it names code of its own ({', '.join(map(shown, study.code))}), which this command would execute; "
            "say --trust if you trust this code"
        )
    return study


def _override(content: dict[str, Any], override: str) -> dict[str, Any]:
    path, equals, text = override.partition("=")
    said = _brief(override)
    if not equals or not path:
        raise UserError(f"{said!r}: an override is KEY=VALUE, such as design.iterations=10")
    value = parse_yaml(text, said)

    def put(tree: Any, keys: list[str]) -> Any:
        if not keys:
            return value
        first, *rest = keys
        if isinstance(tree, list):
            if first not in map(str, range(len(tree))):
                raise UserError(f"{said}: {shown(first)} is no position in a list of {len(tree)}")
            return [put(item, rest) if i == int(first) else item for i, item in enumerate(tree)]
        branch = tree if isinstance(tree, dict) else {}
        return {**branch, first: put(branch.get(first), rest)}

    keys = path.split(".")
    if len(keys) > DEPTH:
        raise UserError(f"{said}: no key of a study has so many parts")
    return put(content, keys)


def _brief(text: str) -> str:
    """A text without its end, if it is long."""
    return text if len(text) <= 60 else f"{text[:59]}…"


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """The first fault of a validation in one sentence: key, fault, allowed values."""
    faults = error.errors(include_url=False)
    # The branch of a union with the deepest fault has the best message.
    fault = max(
        faults, key=lambda f: (len([k for k in f["loc"] if f["type"] != "float_type"]), f["type"] == "extra_forbidden")
    )
    keys = [str(k) for k in fault["loc"] if not _is_branch(str(k))]
    if fault["type"] == "extra_forbidden" and keys[-1:] != [str(fault["loc"][-1])]:
        keys.append(str(fault["loc"][-1]))  # a key of the user's that is called like a branch
    path = ".".join(map(_brief, keys)) or "study"
    given = fault["input"]
    if fault["type"] == "extra_forbidden":
        allowed = _allowed(model, [str(k) for k in fault["loc"][:-1]])
        close = difflib.get_close_matches(keys[-1], allowed, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        return f"{path}: there is no such key{hint}; allowed here are {', '.join(allowed)}"
    if fault["type"] == "missing":
        return f"{path}: this key is required"
    if fault["type"] == "value_error":
        message = fault["msg"].removeprefix("Value error, ")
        return f"{path}: {message[0].lower()}{message[1:]}"
    seen = shown(given) if not isinstance(given, dict | list) or len(repr(given)) < 60 else "something else"
    first, *others = dict.fromkeys(_wanted(f) for f in faults if _same_place(f, fault))
    wanted = " or ".join([first, *(other.removeprefix("this must be ") for other in others)])
    return f"{path}: {wanted}, but it is {seen}"


_WANTED = {
    "float_type": "this must be a number",
    "float_parsing": "this must be a number",
    "int_type": "this must be a whole number",
    "int_parsing": "this must be a whole number",
    "int_from_float": "this must be a whole number",
    "string_type": "this must be a text",
    "list_type": "this must be a list, such as [1.0, 2.0]",
    "tuple_type": "this must be a list, such as [ground, 1]",
    "dict_type": "this must be a mapping of keys to values",
    "model_type": "this must be a mapping of keys to values",
    "finite_number": "this must be a finite number",
    "too_long": "there are too many values here",
}
# Validators of mappings that are priors, as locations of errors name them.
_OF_PRIORS = (one_distribution.__name__, prior_or_default.__name__)


def _wanted(fault: Any) -> str:
    """The required form of a value, in the words of a study rather than of the validator."""
    kind, context = fault["type"], fault.get("ctx", {})
    if kind == "dict_type" and any(reader in str(key) for reader in _OF_PRIORS for key in fault["loc"]):
        return "this must be a prior, such as {uniform: [1.0, 2.0]}"
    if kind in _WANTED:
        return _WANTED[kind]
    if kind == "literal_error":
        return f"this must be {context['expected']}"
    if kind == "too_short":
        return "this must not be empty" if context["min_length"] == 1 else f"this needs {context['min_length']} values"
    message = fault["msg"].removeprefix("Input should be ")
    return f"this must be {message[0].lower()}{message[1:]}"


def _same_place(one: Any, other: Any) -> bool:
    """Whether two faults concern the same key of the user: failed branches of one union."""
    keys = [[str(k) for k in f["loc"] if not _is_branch(str(k))] for f in (one, other)]
    return keys[0] == keys[1]


def _is_branch(key: str) -> bool:
    """Whether a part of an error's location names a branch of a union and not a key of the user's."""
    return (
        key
        in (
            "float",
            "int",
            "str",
            "list[float]",
            "constrained-float",
            "literal['ground']",
            "literal['model']",
            *TAGS,
            *MODELS,
        )
        or any(c in key for c in "[(")
        or (key[:1].isupper() and key.endswith("Entry"))
    )


def _allowed(model: type[BaseModel], place: list[str]) -> list[str]:
    """Keys allowed at a place, the location of an error, walking the fields of the schema."""
    current: list[Any] = [model]
    for key in place:
        if key in MODELS[1:]:
            # Another shape of a model; without its keys, any shape may be meant.
            at = MODELS.index(key)
            current = current[at : at + 1]
        elif not _is_branch(key):
            fields = [found for one in current if (found := one.model_fields.get(key)) is not None]
            if not (inner := [found for field in fields for found in _models(field.annotation)]):
                break
            current = inner
    return list(dict.fromkeys(key for one in current for key in _keys(one)))


def _keys(model: Any) -> list[str]:
    """Keys of a section as they are written."""
    return [field.alias or name for name, field in getattr(model, "model_fields", {}).items()]


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in getattr(annotation, "__args__", ()) for found in _models(part)]
