"""Importance sampling: weighted draws of a Student t around the mode."""

from typing import ClassVar, final

from hsed_jax.inference.independent import weighed
from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers.base import AbstractSampler
from hsed_jax.registry import register


@final
@register
class Importance(AbstractSampler):
    """Weighted draws of a Student t around the mode: as exact as chains if the weights are reliable, and faster.

    The Pareto shape and the effective number of draws show whether they are reliable; otherwise the result has a warning.
    """

    state: ClassVar[str] = "draws by importance sampling"
    use: ClassVar[str] = "the posterior has a shape like a Gaussian, and a calibration must be fast"

    @staticmethod
    def draw(asked: Requested) -> Chains:
        """Draws by importance sampling, with a doubt if the weights are unreliable."""
        return weighed(asked).chains()
