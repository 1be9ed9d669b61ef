"""The interface of samplers: draws from a posterior around one of its modes."""

from abc import ABC, abstractmethod
from typing import ClassVar

from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested


class AbstractSampler(ABC):
    """A method of drawing from a posterior around one of its modes; the documentation shows the first line of a subclass.

    Attributes:
        state: the sentence of a report on draws without a warning.  A sampler that leaves the draws to others has none:
            `Chains` name the sampler that made them.
        use: when to choose it, for the documentation.
    """

    state: ClassVar[str] = ""
    use: ClassVar[str]

    @staticmethod
    @abstractmethod
    def draw(asked: Requested) -> Chains:
        """Draws of the posterior, SI, (chains, draws, p).

        Arguments:
            asked: the posterior, its mode and the size of the sample.
        """
