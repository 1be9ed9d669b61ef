"""The specimens of a study, and the effects that it may name: of all specimens, of each one, and of linear springs."""

from collections.abc import Sequence

from hsed_jax.config.schema import Study
from hsed_jax.errors import UserError
from hsed_jax.physics.effects import AbstractSpringEffect, Catalogue
from hsed_jax.physics.effects.base import AbstractEffect
from hsed_jax.physics.effects.forms import is_of_sensors
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.names import OWNER, SPECIMEN, named, number_of_spring, spring_name
from hsed_jax.plain import shown
from hsed_jax.study.own_parts import law_of


def elements_of(study: Study, shared: type[AbstractSpringLaw]) -> tuple[Element, ...]:
    """The specimens of a study; this executes files with the user's laws.

    Arguments:
        study: the study.
        shared: the law of specimens without their own model.

    Raises:
        UserError: a name is not allowed, or a file has no law.
    """
    several = {} if study.structure is None else study.structure.specimens or {}
    if not several:
        return (Element("", shared),)
    elements: list[Element] = []
    for name, entry in several.items():
        where = f"structure.specimens.{name}"
        if not SPECIMEN.fullmatch(name) or name in (OWNER, "ground") or number_of_spring(name) is not None:
            raise UserError(
                f"structure.specimens: {shown(name)} can be no specimen's name; letters, digits and _ are allowed, and not "
                f"{OWNER}, ground or spring_1"
            )
        if entry.model is None:
            elements.append(Element(name, shared))
        else:
            law = law_of(f"{where}.model.spring", entry.model.spring, study.folder)
            elements.append(Element(name, law, is_apart=True))
    return tuple(elements)


def placed(catalogue: Catalogue, elements: Sequence[Element], springs: int) -> Catalogue:
    """The effects that may be named: those of the study's catalogue, at each of several specimens, and at linear springs.

    Arguments:
        catalogue: by their own names.
        elements: the specimens.
        springs: number of linear springs.

    Raises:
        UserError: a specimen has the name of an effect.
    """
    entries = list(catalogue.entries)
    for element in elements:
        if element.name in catalogue:
            raise UserError(
                f"structure.specimens: {element.name} is the name of an effect; give the specimen another one"
            )
        if element.name:
            entries += [(named(element.name, name), e) for name, e in catalogue.entries if is_of_specimen(e)]
    for i in range(springs):
        entries += [(named(spring_name(i), name), e) for name, e in catalogue.entries if is_of_linear(e)]
    return Catalogue(tuple(entries))


def is_of_linear(effect: type[AbstractEffect]) -> bool:
    """Whether an effect is one of linear springs."""
    return issubclass(effect, AbstractSpringEffect) and effect.linear_only


def is_of_specimen(effect: type[AbstractEffect]) -> bool:
    """Whether each specimen has its own effect of this kind."""
    return issubclass(effect, AbstractSpringEffect) or is_of_sensors(effect)
