"""The no-U-turn sampler (Hoffman & Gelman 2014), within a budget of time."""

from typing import ClassVar, final

import jax

from hsed_jax.inference.chains import by_nuts
from hsed_jax.inference.nuts import Chains
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.samplers.base import AbstractSampler
from hsed_jax.inference.samplers.laplace import Laplace
from hsed_jax.registry import register

# Least number of draws of each chain that represent a posterior.
_TELLING = 10


@final
@register
class Nuts(AbstractSampler):
    """Markov chains by the no-U-turn sampler; an emulator makes the draws, and the simulator weights them."""

    state: ClassVar[str] = "converged, no divergences"
    use: ClassVar[str] = "only chains are acceptable"

    @staticmethod
    def draw(asked: Requested) -> Chains:
        """Draws by NUTS; draws of the Gaussian around the mode if the budget ends before there are enough."""
        instead = f"{_ended(asked)} before there were draws of the posterior: these draws are from the Gaussian around the MAP"
        return within_budget(asked) or Laplace.draw(asked)._replace(doubt=instead)


def within_budget(asked: Requested) -> Chains | None:
    """Draws by NUTS; None if the budget ends before there are enough."""
    # Settings are normalised so that the compiled program is shared.
    settings = asked.settings._replace(sampler="nuts")
    key, planned = jax.random.split(asked.key)[1], asked.settings.draws
    found = by_nuts(
        asked.posterior, asked.data, asked.maximum, asked.step_size, key, settings, asked.watch, asked.seconds
    )
    made = found.theta.shape[1]
    if made == planned:
        return found
    enough = made >= min(_TELLING, planned)
    return found._replace(doubt=f"{_ended(asked)} after {made} of {planned} draws") if enough else None


def _ended(asked: Requested) -> str:
    return f"stopped by the budget of {asked.seconds} s (calibration.seconds)"
