"""The expected separation of the explanations of a diagnosis, for each candidate."""

from collections.abc import Sequence
from typing import ClassVar, final

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.design.acquisitions.base import AbstractAcquisition
from hsed_jax.design.kriging import Kriging
from hsed_jax.registry import register
from hsed_jax.tables import odds


@final
@register
class Discriminate(AbstractAcquisition):
    """Where the rival explanations of a diagnosis differ most, among the first 512 candidates; a diagnosis at every step.

    Attributes:
        log_utilities: log of the expected log Bayes factor, of the first candidates; the other candidates are not chosen.
    """

    use: ClassVar[str] = "to find the missing effect with few experiments"
    of_rivals: ClassVar[bool] = True

    log_utilities: Float[Array, " m"]

    def __call__(self, kriging: Kriging, candidates: Float[Array, "M d"], key: PRNGKeyArray) -> Float[Array, " M"]:
        """The utilities, padded to the candidates."""
        del kriging, key
        more = candidates.shape[0] - self.log_utilities.shape[0]
        return jnp.pad(self.log_utilities, (0, more), constant_values=-jnp.inf)

    @staticmethod
    def lesson(value: float, discrepancies: Sequence[float | None]) -> str:
        """The expected log Bayes factor, and the corresponding odds."""
        del discrepancies
        return f"a log Bayes factor of {value:.3g} between the remaining explanations: odds of {odds(value)}"
