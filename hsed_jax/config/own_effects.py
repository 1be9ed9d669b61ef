"""Effects of a user's own: Python files that a study names, whose classes join the catalogue."""

from pathlib import Path

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.plain import is_file
from hsed_jax.python_files import executed

# What each file registered, and when it had been changed last.
_loaded: dict[Path, tuple[float, list[str]]] = {}


def load_own_effects(study: Study) -> None:
    """Execute the files of `model.own_effects` once, and again after they have changed.

    Raises:
        UserError: a file is missing, fails, or registers no effect.
    """
    for name in study.model.own_effects:
        path, where = study.folder / name, f"model.own_effects: {name}"
        if not is_file(path):
            raise UserError(f"{where}: there is no such file ({path})")
        path = path.resolve()
        changed = path.stat().st_mtime
        if path in _loaded and _loaded[path][0] == changed:
            continue
        for effect in _loaded.pop(path, (0.0, []))[1]:
            EFFECTS.pop(effect, None)
        before = set(EFFECTS)
        try:
            executed(path)
        except UserError as error:
            for effect in set(EFFECTS) - before:
                del EFFECTS[effect]
            raise UserError(f"{where}: {error}") from None
        added = [effect for effect in EFFECTS if effect not in before]
        if not added:
            raise UserError(
                f"{where}: it registers no effect; decorate a class with hsed_jax.physics.effects.base.register"
            )
        _loaded[path] = (changed, added)
