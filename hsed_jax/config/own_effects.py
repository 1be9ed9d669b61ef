"""The catalogue of a study: the effects of the package, and its own in Python files that it names."""

from functools import cache
from pathlib import Path

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS, AbstractEffect, Catalogue, registered
from hsed_jax.plain import is_file
from hsed_jax.python_files import executed


def catalogue_of(study: Study) -> Catalogue:
    """The effects that a study may name.

    Executes the files of `model.own_effects`, once in a process and again after they have changed.

    Raises:
        UserError: a file is missing, fails, or registers no effect; or an effect bears a name that is taken.
    """
    effects = list(study.own_effects)
    for name in study.model.own_effects:
        path, where = study.folder / name, f"model.own_effects: {name}"
        if not is_file(path):
            raise UserError(f"{where}: there is no such file ({path})")
        path = path.resolve()
        try:
            found = _registered(path, path.stat().st_mtime_ns)
        except UserError as error:
            raise UserError(f"{where}: {error}") from None
        if not found:
            raise UserError(
                f"{where}: it registers no effect; decorate a class with hsed_jax.physics.effects.base.register"
            )
        effects += found
    try:
        return EFFECTS.joined(effects)
    except ValueError as error:
        raise UserError(f"model.own_effects: {error}; the catalogue has {', '.join(EFFECTS)}") from None


@cache
def _registered(path: Path, changed: int) -> list[type[AbstractEffect]]:
    """The effects of a file as it was last changed [ns]; those of the package that it imports are not its own."""
    module = executed(path)
    return [effect for effect in registered(module) if effect not in EFFECTS.values()]
