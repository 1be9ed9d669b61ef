r"""The predictions as polynomials of the parameters near the mode: a gradient for NUTS that costs no simulation.

The predictions of every experiment are fitted by $f(\theta) \approx \sum_{|\alpha|\le2} c_\alpha x^\alpha$, x the standardised θ:
in θ they are smooth, also where u runs into the bound of a prior.
Only gradients are taken from it.  The density itself is always that of the simulator, so that the chain is exact whatever the
emulator's error: leapfrog with another force is still reversible and keeps volumes, and what the force misses is paid for by
acceptance (Neal 2011, section 5.5).  The error says whether it is worth while.
"""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import Maximum
from hsed_jax.inference.posterior import Posterior
from hsed_jax.physics.batch import TILE
from hsed_jax.programs import program

# Draws per coefficient, the least number of them, and how far they spread beyond the Gaussian at the mode.
_DRAWS, _LEAST, _SPREAD = 4, 32, 1.3


@final
class Emulator(eqx.Module):
    """Predictions of all experiments, quadratic in the parameters of the model.

    Attributes:
        center, spread: of the parameters, for x = (θ − center)/spread, (m, p), m being 1, or n where each experiment has its own.
        coefficients: (m, q, n/m, J), q = (p + 1)(p + 2)/2.
        error: sd over the posterior of the log density's error [nats].
    """

    center: Float[Array, "m p"]
    spread: Float[Array, "m p"]
    coefficients: Float[Array, "m q k J"]
    error: Float[Array, ""]

    def __call__(self, theta: Float[Array, "m p"]) -> Float[Array, "n J"]:
        """Outputs at parameters of the model, SI, for all experiments or of each its own (`Posterior.by_experiment`)."""
        terms = jax.vmap(_terms)((theta - self.center) / self.spread)
        found = jnp.einsum("mq,mqkj->mkj", terms, self.coefficients)
        return found.reshape(-1, found.shape[-1])


@program
def emulate(posterior: Posterior, data: Data, maximum: Maximum, key: PRNGKeyArray) -> Emulator:
    """Fit the predictions around the mode, at draws somewhat wider than the Gaussian there."""
    p = len(posterior.model_names)
    count = max(_LEAST, _DRAWS * (p + 1) * (p + 2) // 2)
    w = _SPREAD * jax.random.normal(key, (count, maximum.start.size))
    u = maximum.start + w @ maximum.whitening.T
    theta = jax.vmap(lambda x: posterior.by_experiment(posterior.constrain(x), data))(u)
    center, spread = jnp.mean(theta, axis=0), jnp.std(theta, axis=0)
    spread = jnp.where(spread > 0, spread, 1.0)
    outputs, ok = jax.lax.map(lambda x: posterior.predictions(x, data), u, batch_size=TILE)
    terms = jax.vmap(jax.vmap(_terms), out_axes=1)((theta - center) / spread)
    size, (n, J) = theta.shape[1], outputs.shape[1:]
    tables = jnp.swapaxes(outputs.reshape(count, size, -1), 0, 1)
    coefficients = jax.vmap(lambda a, b: jnp.linalg.lstsq(a, b)[0])(terms, tables)
    emulated = jnp.swapaxes(terms @ coefficients, 0, 1).reshape(count, n, J)

    def both(u, outputs, emulated, ok):
        certain = jnp.ones_like(ok)
        return posterior.log_density_of(u, outputs, ok, data), posterior.log_density_of(u, emulated, certain, data)

    exact, approximate = jax.vmap(both)(u, outputs, emulated, ok)
    log_weight = exact + 0.5 * jnp.sum((w / _SPREAD) ** 2, axis=1)
    share = jax.nn.softmax(jnp.where(jnp.isfinite(log_weight), log_weight, -jnp.inf))
    gap = jnp.where(share > 0, exact - approximate, 0.0)
    error = jnp.sqrt(share @ (gap - share @ gap) ** 2)
    # As many coefficients as were fitted are missing from the draws' own error.
    coefficients = coefficients.reshape(size, -1, n // size, J)
    return Emulator(center, spread, coefficients, error * jnp.sqrt(count / (count - terms.shape[2])))


def _terms(x: Float[Array, " p"]) -> Float[Array, " q"]:
    rows, columns = jnp.triu_indices(x.size)
    return jnp.concatenate([jnp.ones(1), x, x[rows] * x[columns]])
