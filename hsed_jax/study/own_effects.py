"""The catalogue of a study: the effects of the package, and its own in Python files that it names."""

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS, Catalogue, registered
from hsed_jax.python_files import module_of


def catalogue_of(study: Study) -> Catalogue:
    """The effects that a study may name.

    Executes the files of `model.own_effects`, once in a process and again after they have changed.

    Raises:
        UserError: a file is missing, fails, or registers no effect; or an effect bears a name that is taken.
    """
    effects = list(study.own_effects)
    for name in study.model.own_effects:
        where = f"model.own_effects: {name}"
        try:
            module = module_of(study.folder / name)
        except UserError as error:
            raise UserError(f"{where}: {error}") from None
        # Effects of the package that it imports are not its own.
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
