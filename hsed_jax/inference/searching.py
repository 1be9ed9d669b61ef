"""A search for the mode of a posterior without derivatives, for models with a discontinuous response; its result starts the
descents.

Differential evolution (Storn & Price 1997) on shares of the priors: every parameter lies between 0 and 1.
"""

from typing import Any, cast

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.log_densities import log_densities
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.watch import Watch, fingerprint

# Members of a generation: at least so many, and so many for each parameter.
_LEAST, _FOR_EACH = 16, 3
# Shares of the priors between which it searches.
_EDGE = 0.002
# The logarithm of zero density [nats].
_NOTHING = -1e30


def searched(
    posterior: Posterior, data: Data, simulations: int, seed: int, watch: Watch | None = None
) -> Float[Array, " q"] | None:
    """Parameters of the model (SI) at the end of a search; None if the budget is less than two generations.

    Arguments:
        posterior: of a study.
        data: measured outputs.
        simulations: budget; each point takes one for each experiment.
        seed: of the random numbers.
        watch: receives the progress.
    """
    from scipy.optimize import differential_evolution

    count = len(posterior.reported)
    members = max(_LEAST, _FOR_EACH * count)
    generations = simulations // (members * max(1, int(data.count))) - 1
    if generations < 1:
        return None
    watch = watch or Watch()
    name = f"search-{fingerprint(posterior.names, eqx.filter(posterior, eqx.is_array), data, simulations, seed)}"
    if (kept := watch.recall(name)) is not None:
        return jax.device_put(kept[0])
    watch.report("a search without derivatives")

    def depths(shares: np.ndarray) -> np.ndarray:
        points = np.asarray(posterior.at_shares(shares.T.reshape(-1, count)))
        found = log_densities(posterior, data, points)
        return -np.where(np.isfinite(found), found, _NOTHING).reshape(shares.shape[1:])

    found = differential_evolution(
        depths,
        [(_EDGE, 1 - _EDGE)] * count,
        maxiter=generations,
        init=cast("Any", _first(members, count, seed)),
        rng=np.random.default_rng(seed),
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
    )
    best = posterior.of_model(posterior.constrain(posterior.at_shares(found.x[None])[0]))
    watch.keep(name, [np.asarray(best)])
    return best


def _first(members: int, count: int, seed: int) -> np.ndarray:
    """The first generation: a Latin hypercube with the middle of the priors in it."""
    from scipy.stats import qmc

    rows = qmc.LatinHypercube(count, rng=seed).random(members)
    return np.clip(np.vstack([np.full((1, count), 0.5), rows[1:]]), _EDGE, 1 - _EDGE)
