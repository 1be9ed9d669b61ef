"""Independent draws around a mode, in the shape of chains: of the Gaussian there, or weighted by the posterior."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.importance import Proposal, Weighted, resampled, weigh
from hsed_jax.inference.likelihood import LOG_2PI, Data
from hsed_jax.inference.log_densities import log_densities
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.nuts import Chains, Settings
from hsed_jax.inference.posterior import Posterior, constrained
from hsed_jax.inference.requested import Requested
from hsed_jax.inference.watch import Watch


@dataclass(frozen=True)
class Weighing:
    """Weighted draws around a mode.

    Attributes:
        asked: the request.
        weights: the draws and their weights.
        random: random numbers that chose them, and that choose among them.
    """

    asked: Requested
    weights: Weighted
    random: np.random.Generator

    def chains(self) -> Chains:
        """Draws in proportion to their weights, with a doubt if the weights are unreliable.

        If a few draws have nearly all the weight, the weights are flattened: these draws alone would give intervals without
        width.
        """
        asked = self.asked
        u, log_density = resampled(self.weights.flattened(), asked.number, self.random)
        settings = asked.settings._replace(sampler="importance")
        found = independent(asked.posterior, u, log_density, asked.step_size, settings, self.weights.worth)
        return found._replace(doubt=self.weights.doubt)


def weighed(asked: Requested) -> Weighing:
    """Weighted draws around the mode of a request."""
    random = generator(jax.random.split(asked.key)[0])
    weights = weigh_around(asked.posterior, asked.data, asked.maximum, asked.number, random, asked.watch)
    return Weighing(asked, weights, random)


def weigh_around(
    posterior: Posterior,
    data: Data,
    maximum: Maximum,
    draws: int,
    random: np.random.Generator,
    watch: Watch | None = None,
) -> Weighted:
    """Weighted draws of u around a mode."""
    proposal = Proposal(np.asarray(maximum.start), np.asarray(maximum.whitening))
    return weigh(lambda u: log_densities(posterior, data, u, watch), proposal, draws, random)


def generator(key: PRNGKeyArray) -> np.random.Generator:
    """NumPy's random numbers from a key of JAX."""
    return np.random.default_rng(np.asarray(jax.random.key_data(key)))


def gaussian(
    maximum: Maximum, key: PRNGKeyArray, number: int
) -> tuple[Float[np.ndarray, "N p"], Float[np.ndarray, " N"]]:
    """Draws of u from the Gaussian around a mode, and its log density there."""
    start, whitening = np.asarray(maximum.start), np.asarray(maximum.whitening)
    w = generator(key).standard_normal((number, start.size))
    # The Gaussian has the density of the posterior at the mode, as in the evidence by Laplace's method.
    top = float(maximum.log_evidence) - 0.5 * start.size * LOG_2PI - np.linalg.slogdet(whitening)[1]
    return start + w @ whitening.T, top - 0.5 * np.sum(w**2, axis=1)


def independent(
    posterior: Posterior,
    u: Float[np.ndarray, "N p"],
    log_density: Float[np.ndarray, " N"],
    step_size: Float[Array, ""],
    settings: Settings,
    worth: float,
) -> Chains:
    """Independent draws in the shape of chains.

    Arguments:
        posterior: that they are of.
        u: the draws.
        log_density: log density of each.
        step_size: of NUTS, to begin the next adaptation from.
        settings: the number of chains and draws, and the sampler.
        worth: effective number of draws.
    """
    shape = (settings.chains, settings.draws)
    arrays = (
        np.asarray(constrained(posterior, jax.device_put(u))).reshape(*shape, -1),
        log_density.reshape(shape),
        np.zeros(shape, dtype=bool),
        np.zeros(shape, dtype=int),
        np.full(settings.chains, float(step_size)),
    )
    return Chains(*jax.device_put(arrays), sampler=settings.sampler, worth=worth)
