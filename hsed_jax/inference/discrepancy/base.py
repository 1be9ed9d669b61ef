"""The interface of a model discrepancy: its size by output, and the transformation that makes the residuals independent."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float


class AbstractDiscrepancy(eqx.Module):
    """A model discrepancy, in units of the error.

    Attributes:
        amplitudes: by output; zero without a discrepancy.
    """

    amplitudes: eqx.AbstractVar[Float[Array, " G"]]

    @property
    @abstractmethod
    def settling(self) -> tuple[Array, ...]:
        """The quantities that change with the MAP."""

    @property
    @abstractmethod
    def whitening(self) -> Callable[[Float[Array, "n J"]], Any]:
        """The transformation that makes the residuals of the experiments independent."""

    @abstractmethod
    def reach(self, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """Its correlation lengths, in numbers.

        Arguments:
            names: of the inputs.
        """
