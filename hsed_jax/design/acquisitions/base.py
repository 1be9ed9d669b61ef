"""The base of every acquisition: a utility of each candidate, from the Kriging model of the discrepancy.

Utilities are logarithms, because the expected improvement falls far below the smallest float before a campaign ends.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.kriging import Kriging

Acquisition = Callable[[Kriging, Float[Array, "M d"], PRNGKeyArray], Float[Array, " M"]]

LEAST_SCALE = 1e-60
"""Floor of a scale, below the rounding of any response; with it (difference/scale)² stays a finite number."""


class AbstractAcquisition(eqx.Module):
    """An acquisition; the documentation shows the first line of a subclass.

    Attributes:
        use: its purpose, for the documentation.
        is_order: whether it only orders the candidates, independently of costs.
        of_rivals: whether a diagnosis computes its utilities; they are then its argument.
    """

    use: ClassVar[str]
    is_order: ClassVar[bool] = False
    of_rivals: ClassVar[bool] = False

    @abstractmethod
    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """Log utilities of the candidates.

        Arguments:
            kriging: the discrepancy of the experiments so far.
            candidates: points of the unit cube.
            key: for an acquisition that draws; equal keys give equal utilities.
        """

    @staticmethod
    def lesson(value: float, discrepancies: Sequence[float | None]) -> str:
        """The expected information of an experiment, in a clause; empty if the choice ignores it.

        Arguments:
            value: the utility of the experiment, no logarithm.
            discrepancies: of the experiments before it; None or NaN if an experiment has none.
        """
        del value, discrepancies
        return ""


def deviation(variance: Float[Array, " M"]) -> Float[Array, " M"]:
    """The square root of a variance, with a finite derivative at zero."""
    return jnp.sqrt(jnp.maximum(variance, LEAST_SCALE**2))
