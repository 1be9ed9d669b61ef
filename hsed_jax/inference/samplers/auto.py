"""Importance sampling if it is reliable, otherwise NUTS within a budget of time."""

from typing import ClassVar, final

from hsed_jax.inference.independent import weighed
from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers.base import AbstractSampler
from hsed_jax.inference.samplers.nuts import within_budget
from hsed_jax.registry import register


@final
@register
class Auto(AbstractSampler):
    """`importance` if its weights are reliable or the budget ends before `nuts` has draws; otherwise `nuts`."""

    use: ClassVar[str] = "there is no reason for another one (the default)"

    @staticmethod
    def draw(asked: Requested) -> Chains:
        """Draws by the sampler that is chosen in this way."""
        weighing = weighed(asked)
        chains = None if weighing.weights.reliable else within_budget(asked)
        return chains or weighing.chains()
