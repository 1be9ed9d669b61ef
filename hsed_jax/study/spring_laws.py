"""The spring law that a study names: one of the package, or a class in a Python file of the user's own."""

import inspect
from pathlib import Path

from hsed_jax.config.sections import OwnLawEntry
from hsed_jax.errors import UserError
from hsed_jax.physics.laws import LAWS, AbstractSpringLaw
from hsed_jax.plain import shown
from hsed_jax.python_files import module_of

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
