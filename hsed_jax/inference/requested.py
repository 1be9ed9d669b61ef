"""The request to a sampler."""

from typing import NamedTuple

from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.nuts import Settings
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.watch import Watch


class Requested(NamedTuple):
    """Draws around one mode of a posterior.

    Attributes:
        posterior: of the study.
        data: measured outputs.
        maximum: the mode and the whitening there.
        step_size: of NUTS, to begin adaptation from.
        key: of the random numbers.
        settings: sizes, and by which sampler.
        watch: follows the sampler.
        seconds: budget of NUTS.
    """

    posterior: Posterior
    data: Data
    maximum: Maximum
    step_size: Float[Array, ""]
    key: PRNGKeyArray
    settings: Settings
    watch: Watch
    seconds: float | None

    @property
    def number(self) -> int:
        """How many draws."""
        return self.settings.chains * self.settings.draws
