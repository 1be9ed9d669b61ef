"""The catalogue of physical effects: one file per family, each effect a small final class."""

from hsed_jax.physics.effects import connection as connection
from hsed_jax.physics.effects import degradation as degradation
from hsed_jax.physics.effects import dissipation as dissipation
from hsed_jax.physics.effects import elastic as elastic
from hsed_jax.physics.effects import history as history
from hsed_jax.physics.effects import loop as loop
from hsed_jax.physics.effects import rig as rig
from hsed_jax.physics.effects import structure as structure
from hsed_jax.physics.effects.base import EFFECTS as EFFECTS
from hsed_jax.physics.effects.base import AbstractEffect as AbstractEffect
from hsed_jax.physics.effects.base import AbstractSetupEffect as AbstractSetupEffect
from hsed_jax.physics.effects.base import AbstractSpringEffect as AbstractSpringEffect
