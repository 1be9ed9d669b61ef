"""The samplers that a study may name.

A further sampler is one entry: what is said of its draws, and the function that makes them.  The function is imported when it is
first asked, so that a fault of a study is told before JAX is loaded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hsed_jax.inference.nuts import Chains
    from hsed_jax.inference.requested import Requested


@dataclass(frozen=True)
class Sampler:
    """A way to draw from a posterior around one of its modes.

    Attributes:
        state: what a report says of draws about which there is no warning.
        home: the function, as `module:name`; it takes a `Requested` and returns `Chains`.
    """

    state: str
    home: str

    @property
    def draw(self) -> "Callable[[Requested], Chains]":
        """The function."""
        module, _, name = self.home.partition(":")
        return getattr(import_module(module), name)


SAMPLERS = {
    "nuts": Sampler("converged, no divergences", "hsed_jax.inference.sampling:by_nuts_or_gaussian"),
    "importance": Sampler("draws by importance sampling", "hsed_jax.inference.sampling:by_importance"),
    "laplace": Sampler(
        "draws of the Gaussian around the MAP, not of the posterior", "hsed_jax.inference.sampling:of_gaussian"
    ),
}


def known_sampler(name: str) -> str:
    """The name of a sampler, or `auto`.

    Raises:
        ValueError: there is no such sampler.
    """
    if name not in ("auto", *SAMPLERS):
        raise ValueError(f"there is no sampler {name!r}; samplers are auto, {', '.join(SAMPLERS)}")
    return name
