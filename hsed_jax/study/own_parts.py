"""The law and the effects that a study names: those of the package, and the user's own in Python files."""

import inspect
from pathlib import Path

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS, Catalogue, registered
from hsed_jax.physics.laws import LAWS, AbstractSpringLaw
from hsed_jax.plain import shown
from hsed_jax.python_files import module_of
from hsed_jax.sections import OwnLawEntry

_DECLARED = ("name", "title", "reference", "steepest")


def law_of(where: str, entry: str | OwnLawEntry, folder: Path) -> type[AbstractSpringLaw]:
    """The spring law.

    Executes the file of an own law, once in a process and again after it has changed.

    Arguments:
        where: the key of the entry.
        entry: the name of a law, or a file and a class.
        folder: of the study.

    Raises:
        UserError: a file is missing or fails, or has no such law in it.
    """
    if isinstance(entry, str):
        return LAWS[entry]
    path, where = folder / entry.file, f"{where}: {entry.file}"
    try:
        module = module_of(path)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None
    law = getattr(module, entry.law, None)
    if law is None:
        raise UserError(f"{where}: it has no class {shown(entry.law)}")
    if not (isinstance(law, type) and issubclass(law, AbstractSpringLaw)):
        raise UserError(f"{where}: {entry.law} is no hsed_jax.physics.laws.AbstractSpringLaw")
    missing = [name for name in _DECLARED if not hasattr(law, name)]
    if inspect.isabstract(law):
        missing += sorted(law.__abstractmethods__)
    if missing:
        raise UserError(f"{where}: {entry.law} lacks {', '.join(missing)}")
    return law


def catalogue_of(study: Study) -> Catalogue:
    """The effects that a study may name.

    Executes the files of `model.own_effects`, once in a process and again after they have changed.

    Raises:
        UserError: a file is missing, fails, or registers no effect; or the name of an effect is already used.
    """
    effects = list(study.own_effects)
    for name in study.model.own_effects:
        where = f"model.own_effects: {name}"
        try:
            module = module_of(study.folder / name)
        except UserError as error:
            raise UserError(f"{where}: {error}") from None
        # Effects that the file imports from the package are not its own.
        found = [effect for effect in registered(module) if effect not in EFFECTS.values()]
        if not found:
            raise UserError(
                f"{where}: it registers no effect; decorate a class with hsed_jax.physics.effects.base.register"
            )
        effects += found
    try:
        return EFFECTS.joined(effects)
    except ValueError as error:
        raise UserError(f"model.own_effects: {error}; the catalogue has {', '.join(EFFECTS)}") from None
