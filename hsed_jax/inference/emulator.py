r"""The predictions as polynomials of the parameters near the mode: a gradient for NUTS that costs no simulation.

In whitened coordinates w the predictions of every experiment are fitted by $f(w) \approx \sum_{|\alpha|\le2} c_\alpha w^\alpha$.
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

# Draws per coefficient, the least number of them, and how far they spread beyond the Gaussian at the mode.
_DRAWS, _LEAST, _SPREAD = 4, 32, 1.3
_TOGETHER = 64


@final
class Emulator(eqx.Module):
    """Predictions of all experiments, quadratic in w.

    Attributes:
        coefficients: (q, n, J), q = (p + 1)(p + 2)/2.
        error: sd over the posterior of the log density's error [nats].
    """

    coefficients: Float[Array, "q n J"]
    error: Float[Array, ""]

    def __call__(self, w: Float[Array, " p"]) -> Float[Array, "n J"]:
        """Outputs at whitened coordinates."""
        return jnp.tensordot(_terms(w), self.coefficients, 1)


@eqx.filter_jit
def emulate(posterior: Posterior, data: Data, maximum: Maximum, key: PRNGKeyArray) -> Emulator:
    """Fit the predictions around the mode, at draws somewhat wider than the Gaussian there."""
    p = maximum.start.size
    count = max(_LEAST, _DRAWS * (p + 1) * (p + 2) // 2)
    w = _SPREAD * jax.random.normal(key, (count, p))
    u = maximum.start + w @ maximum.whitening.T
    outputs, ok = jax.lax.map(lambda x: posterior.predictions(x, data), u, batch_size=_TOGETHER)
    terms = jax.vmap(_terms)(w)
    coefficients = jnp.linalg.lstsq(terms, outputs.reshape(count, -1))[0].reshape(-1, *outputs.shape[1:])

    def both(u, w, outputs, ok):
        emulated = jnp.tensordot(_terms(w), coefficients, 1)
        return posterior.log_density_of(u, outputs, ok, data), posterior.log_density_of(
            u, emulated, jnp.ones_like(ok), data
        )

    exact, emulated = jax.vmap(both)(u, w, outputs, ok)
    log_weight = exact + 0.5 * jnp.sum((w / _SPREAD) ** 2, axis=1)
    share = jax.nn.softmax(jnp.where(jnp.isfinite(log_weight), log_weight, -jnp.inf))
    gap = jnp.where(share > 0, exact - emulated, 0.0)
    error = jnp.sqrt(share @ (gap - share @ gap) ** 2)
    # As many coefficients as were fitted are missing from the draws' own error.
    return Emulator(coefficients, error * jnp.sqrt(count / (count - terms.shape[1])))


def _terms(w: Float[Array, " p"]) -> Float[Array, " q"]:
    rows, columns = jnp.triu_indices(w.size)
    return jnp.concatenate([jnp.ones(1), w, w[rows] * w[columns]])
