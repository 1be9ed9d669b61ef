"""Python files of the user that a study names: they are executed, and a fault causes one message."""

import importlib.util
from functools import cache
from pathlib import Path
from types import ModuleType

from hsed_jax.errors import UserError
from hsed_jax.plain import is_file


def module_of(path: Path) -> ModuleType:
    """The module that a file makes, executed once in a process and again after it has changed.

    Raises:
        UserError: as of `executed`.
    """
    if not is_file(path):
        raise UserError(f"there is no such file ({path})")
    path = path.resolve()
    return _as_changed(path, path.stat().st_mtime_ns)


@cache
def _as_changed(path: Path, changed: int) -> ModuleType:
    """The module of a file with this time of the last change [ns]."""
    return executed(path)


def executed(path: Path) -> ModuleType:
    """The module that a file makes.

    Raises:
        UserError: there is no such file, it is not Python, or it fails or calls exit.
    """
    if not is_file(path):
        raise UserError(f"there is no such file ({path})")
    if path.suffix != ".py":
        raise UserError(f"{path.name} must be a Python file (.py)")
    spec = importlib.util.spec_from_file_location(f"users_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise UserError(f"{path.name} fails with {type(error).__name__}: {error}") from None
    return module
