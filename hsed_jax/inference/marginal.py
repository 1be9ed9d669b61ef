r"""The marginal likelihood of the linearised model with its parameters integrated out. A discrepancy is learned by maximising
it.

With z the residuals at the MAP, J their derivatives along u, Λ the curvature of the prior there, and C the covariance of z from
noise and discrepancy,

$$-\tfrac12 z^\top Q z - \tfrac12\log|C| - \tfrac12\log|J^\top C^{-1}J + \Lambda|,\qquad
  Q = C^{-1} - C^{-1}J\,(J^\top C^{-1}J + \Lambda)^{-1}J^\top C^{-1}.$$

It needs only the determinant of C and $[z, J]^\top C^{-1}[z, J]$, for a discrepancy of any variables.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float, PyTree

from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.programs import program

LEAST_AMPLITUDE = 1e-3
# The prior of an amplitude falls as 1/(1 + a/10)²: it is highest at zero, and still allows a model that is wrong by a hundred
# times the noise.
_AMPLITUDE = 10.0


def log_marginal(
    products: Float[Array, "k k"], log_determinant: Float[Array, ""], stiffness: Float[Array, " p"]
) -> Float[Array, ""]:
    """Log of the marginal likelihood, without its constant.

    Arguments:
        products: [z, J]ᵀ C⁻¹ [z, J], k being 1 + p.
        log_determinant: of C.
        stiffness: the diagonal of Λ.
    """
    held = jnp.linalg.cholesky(products[1:, 1:] + jnp.diag(stiffness))
    absorbed = solve_triangular(held, products[1:, 0], lower=True)
    volume = 0.5 * log_determinant + jnp.sum(jnp.log(jnp.diag(held)))
    return -0.5 * (products[0, 0] - absorbed @ absorbed) - volume


def log_prior_of_amplitudes(amplitudes: Float[Array, " J"]) -> Float[Array, ""]:
    """Log density of amplitudes in units of the error, without its constant."""
    return -2 * jnp.sum(jnp.log1p(amplitudes / _AMPLITUDE))


def beyond_noise(z: np.ndarray, used: np.ndarray) -> np.ndarray:
    """By column, the RMS of residuals (n, J) in units of the error, without the contribution of the noise."""
    squares = np.sum(used * z**2, axis=0) / np.maximum(np.sum(used, axis=0), 1)
    return np.sqrt(np.maximum(squares - 1, 0.05))


def lowest(
    objective: Callable[[Float[Array, " h"]], tuple[Array, Array]],
    starts: Sequence[np.ndarray],
    bounds: Sequence[tuple[float, float | None]],
) -> np.ndarray:
    """The minimum of an objective, which gives its value and its slope, from several starts."""
    # Imported here: it takes half a second, and only a discrepancy needs it.
    from scipy.optimize import minimize

    def of_numbers(values: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = objective(jnp.asarray(values))
        return float(value), np.asarray(slope, dtype=float)

    ends = [minimize(of_numbers, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in starts]
    return min(ends, key=lambda end: float(end.fun)).x


@program
def linearised(posterior: Posterior, data: Data, u: Float[Array, " p"]):
    """z, its derivatives along u, (n, J, p), and 1 where the simulation converged."""
    predicted, ok, along = posterior.sensitivities(u, data)
    z, _, z_along, _ = posterior.compared_along(u, predicted, ok, along, data)
    return z, jnp.moveaxis(z_along, 0, -1), ok


@program
def predictions(posterior: Posterior, u: Float[Array, " p"], conditions: PyTree, count: Array):
    """Outputs of experiments at u, and 1 where the simulation converged."""
    return posterior.predict(posterior.of_model(posterior.constrain(u)), conditions, count)


@program
def stiffness(posterior: Posterior, u: Float[Array, " p"]) -> Float[Array, " p"]:
    """Curvature of the prior in u."""
    return posterior.stiffness(u)
