"""The catalogue of physical effects: one file per family, each effect a small final class."""

from hsed_jax.physics.effects import (
    connection,
    degradation,
    dissipation,
    elastic,
    history,
    loop,
    rig,
    structure,
    yielding,
)
from hsed_jax.physics.effects.base import AbstractEffect as AbstractEffect
from hsed_jax.physics.effects.base import AbstractSetupEffect as AbstractSetupEffect
from hsed_jax.physics.effects.base import AbstractSpringEffect as AbstractSpringEffect
from hsed_jax.physics.effects.base import Catalogue, registered

_FAMILIES = (connection, degradation, dissipation, elastic, history, loop, rig, structure, yielding)

EFFECTS = Catalogue.of(effect for family in _FAMILIES for effect in registered(family))
"""The effects that come with the package; a study may have its own besides."""
