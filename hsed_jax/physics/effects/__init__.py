"""The catalogue of physical effects: one file per family, each effect a small final class."""

from collections.abc import Mapping

from hsed_jax.physics.effects import (
    connection,
    degradation,
    dissipation,
    elastic,
    history,
    loop,
    reloading,
    rig,
    structure,
    yielding,
)
from hsed_jax.physics.effects.base import AbstractEffect as AbstractEffect
from hsed_jax.physics.effects.base import AbstractSetupEffect as AbstractSetupEffect
from hsed_jax.physics.effects.base import AbstractSpringEffect as AbstractSpringEffect
from hsed_jax.physics.effects.base import Catalogue, registered
from hsed_jax.physics.names import own_name
from hsed_jax.physics.parameters import parameters_of

_FAMILIES = (connection, degradation, dissipation, elastic, history, loop, reloading, rig, structure, yielding)

EFFECTS = Catalogue.of(effect for family in _FAMILIES for effect in registered(family))
"""The effects that come with the package; a study may have its own besides."""


def called(name: str, values: Mapping[str, float], catalogue: Mapping[str, type[AbstractEffect]] = EFFECTS) -> str:
    """The name of an effect, and what it is where its amplitude is negative, such as `hardening (softening, as by P-Delta)`.

    Arguments:
        name: of the effect, with that of its specimen in front where there are several.
        values: parameters of the effect by their own names, or of a model with the effect's in front; SI or dimensionless.
        catalogue: that the effect is looked up in; nothing is known of one that is not there.
    """
    effect = catalogue.get(name, catalogue.get(own_name(name)))
    if effect is None or not effect.negative:
        return name
    amplitude = next(iter(parameters_of(effect).values()))
    own = (amplitude.name, *([] if amplitude.physical is None else [amplitude.physical.name]))
    found = [values[key] for one in own for key in (one, f"{name}.{one}") if key in values]
    return f"{name} ({effect.negative})" if any(value < 0 for value in found) else name
