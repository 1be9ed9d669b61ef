"""A sampler of a test: the Gaussian around the mode, under another name."""

from typing import ClassVar, final

from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers.base import AbstractSampler
from hsed_jax.inference.samplers.laplace import Laplace
from hsed_jax.registry import register


@final
@register
class Renamed(AbstractSampler):
    """The Gaussian at the mode, under another name."""

    state: ClassVar[str] = "draws of the renamed sampler"
    use: ClassVar[str] = "a test"

    @staticmethod
    def draw(asked: Requested) -> Chains:
        return Laplace.draw(asked)._replace(sampler="renamed")
