"""Importance sampling where it can be trusted, otherwise NUTS."""

from typing import ClassVar, final

from hsed_jax.inference.independent import weighed
from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers.base import AbstractSampler
from hsed_jax.inference.samplers.nuts import Nuts
from hsed_jax.registry import register


@final
@register
class Auto(AbstractSampler):
    """`importance` where its weights can be trusted, otherwise `nuts`; the result says which of them it was."""

    use: ClassVar[str] = "there is no reason for another one (the default)"

    @staticmethod
    def draw(asked: Requested) -> Chains:
        """Draws by importance sampling if they can be trusted, otherwise by NUTS."""
        weighing = weighed(asked)
        return weighing.chains() if weighing.weights.reliable else Nuts.draw(asked)
