"""The interface of a model discrepancy: its size by output, and the transformation that makes the residuals independent."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float


class AbstractDiscrepancy(eqx.Module):
    """A discrepancy of a model, in units of the error.

    Attributes:
        amplitudes: by output; zero where there is no discrepancy.
    """

    amplitudes: eqx.AbstractVar[Float[Array, " G"]]

    @property
    @abstractmethod
    def settling(self) -> tuple[Array, ...]:
        """What changes as the MAP moves."""

    @property
    @abstractmethod
    def whitening(self) -> Callable[[Float[Array, "n J"]], Any]:
        """What makes the residuals of the experiments independent."""

    @abstractmethod
    def reach(self, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """How far it is correlated, in numbers.

        Arguments:
            names: of the inputs.
        """
