"""The Gaussian around the mode (Laplace's method)."""

from typing import ClassVar, final

import jax

from hsed_jax.inference.independent import gaussian, independent
from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers.base import AbstractSampler
from hsed_jax.registry import register


@final
@register
class Laplace(AbstractSampler):
    """The Gaussian at the mode, without any further simulation."""

    state: ClassVar[str] = "draws of the Gaussian around the MAP, not of the posterior"
    use: ClassVar[str] = "only the MAP matters, or one simulation takes long"

    @staticmethod
    def draw(asked: Requested) -> Chains:
        """Draws of the Gaussian around the mode."""
        u, log_density = gaussian(asked.maximum, jax.random.split(asked.key)[0], asked.number)
        settings = asked.settings._replace(sampler="laplace")
        return independent(asked.posterior, u, log_density, asked.step_size, settings, asked.number)
