"""The catalogue of physical effects: one file per family, each effect a small final class."""

from hsed_jax.physics.effects import degradation as degradation
from hsed_jax.physics.effects.base import EFFECTS as EFFECTS
from hsed_jax.physics.effects.base import AbstractEffect as AbstractEffect
