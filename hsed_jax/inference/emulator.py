r"""The predictions as polynomials of the parameters around a frame: a posterior for NUTS that needs no simulation.

The predictions of every experiment are fitted by $f(\theta) \approx \sum_k \phi_k \sum_{|\alpha|\le d} c_{k\alpha} x^\alpha$.
Here x is the standardised θ, and $\phi_k$ are the principal components of the simulated outputs, in standard deviations of the
error.  Predictions are smooth in θ, also where u goes to infinity at the bound of a prior.

The error of the log density is estimated by leaving out each simulation in turn, which needs no further regression.  The
simulator weights the draws of an emulator (`hsed_jax.inference.chains`).
"""

import math
from itertools import combinations_with_replacement
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.programs import program

# Simulations per coefficient, the least number of them, and the principal components that are kept.
_EACH, _LEAST, _COMPONENTS = 3, 32, 40
# A polynomial of the third degree may have so many coefficients.
_MOST = 300


class Design(NamedTuple):
    """Simulations to which an emulator is fitted.

    Attributes:
        u: where, (N, p).
        outputs, ok: of all experiments, and whether they converged, (N, n, J) and (N, n).
        shares: of the posterior, to estimate the error; zero for simulations that are only fitted, (N,).
    """

    u: Float[Array | np.ndarray, "N p"]
    outputs: Float[Array | np.ndarray, "N n J"]
    ok: Float[Array | np.ndarray, "N n"]
    shares: Float[Array | np.ndarray, " N"]


@final
class Emulator(eqx.Module):
    """Predictions of all experiments, polynomials of the parameters of the model.

    Attributes:
        center, spread: of the parameters, for x = (θ − center)/spread, (m, p), m being 1, or n if each experiment has its own.
        coefficients: of the principal components, (m, q, n/m, K).
        middle, components: predictions are middle + amounts · components, (n, J) and (n, K, J).
        error: sd over the posterior of the log density's error [nats].
    """

    center: Float[Array, "m p"]
    spread: Float[Array, "m p"]
    coefficients: Float[Array, "m q k K"]
    middle: Float[Array, "n J"]
    components: Float[Array, "n K J"]
    error: Float[Array, ""]

    def __call__(self, theta: Float[Array, "m p"]) -> Float[Array, "n J"]:
        """Outputs at parameters of the model, SI, for all experiments or for each its own (`Posterior.by_experiment`)."""
        number, count = theta.shape[1], self.coefficients.shape[1]
        powers = _exponents(number, _degree_of(number, count))
        terms = jax.vmap(lambda x: _terms(x, powers))((theta - self.center) / self.spread)
        amounts = jnp.einsum("mq,mqkc->mkc", terms, self.coefficients).reshape(len(self.middle), -1)
        return self.middle + jnp.einsum("nc,ncj->nj", amounts, self.components)

    def log_density(self, posterior: Posterior, u: Float[Array, " p"], data: Data) -> Float[Array, ""]:
        """Log density in u of the posterior with these predictions instead of those of the simulator."""
        predicted = self(posterior.by_experiment(posterior.constrain(u), data))
        return posterior.log_density_of(u, predicted, jnp.ones(predicted.shape[0]), data)


def simulations(parameters: int, degree: int) -> int:
    """Number of simulations for an emulator of this degree."""
    return max(_LEAST, _EACH * math.comb(parameters + degree, degree))


def degree_for(parameters: int) -> int:
    """The highest affordable degree for a number of parameters."""
    return 3 if math.comb(parameters + 3, 3) <= _MOST else 2


@program
def emulate(posterior: Posterior, data: Data, design: Design, degree: int) -> Emulator:
    """Fit the predictions at the simulations of a design."""
    u, outputs, ok, shares = map(jnp.asarray, design)
    theta = jax.vmap(lambda x: posterior.by_experiment(posterior.constrain(x), data))(u)
    center, spread = jnp.mean(theta, axis=0), jnp.std(theta, axis=0)
    spread = jnp.where(spread > 0, spread, 1.0)
    powers = _exponents(theta.shape[2], degree)
    terms = jax.vmap(jax.vmap(lambda x: _terms(x, powers)), in_axes=1)((theta - center) / spread)
    count, n, size = len(u), outputs.shape[1], theta.shape[1]
    # In standard deviations of the error, so that a component matters equally in every output.
    middle = jnp.mean(outputs, axis=0)
    sigma = posterior.sigma(jnp.mean(jax.vmap(posterior.constrain)(u), axis=0), middle, jnp.ones(n), data)
    tables = jnp.swapaxes((outputs - middle) / sigma, 0, 1) * (data.weights > 0)[:, None]
    along = jnp.linalg.svd(tables, full_matrices=False)[2][:, :_COMPONENTS]
    amounts = jnp.einsum("nsj,ncj->nsc", tables, along)
    by_set = jnp.moveaxis(amounts.reshape(size, n // size, count, -1), 1, 2).reshape(size, count, -1)
    basis, triangle = jax.vmap(jnp.linalg.qr)(terms)
    fitted = basis @ (jnp.swapaxes(basis, 1, 2) @ by_set)
    coefficients = jax.vmap(lambda a, b: jnp.linalg.lstsq(a, b)[0])(triangle, jnp.swapaxes(basis, 1, 2) @ by_set)
    # The prediction of each simulation from all others.
    leverage = jnp.minimum(jnp.sum(basis**2, axis=2), 0.99)[..., None]
    left_out = by_set - (by_set - fitted) / (1 - leverage)
    left_out = jnp.moveaxis(left_out.reshape(size, count, n // size, -1), 1, 2).reshape(n, count, -1)
    emulated = middle + sigma * jnp.swapaxes(jnp.einsum("nsc,ncj->nsj", left_out, along), 0, 1)

    def both(u, outputs, emulated, ok):
        certain = jnp.ones_like(ok)
        return posterior.log_density_of(u, outputs, ok, data), posterior.log_density_of(u, emulated, certain, data)

    exact, approximate = jax.vmap(both)(u, outputs, emulated, ok)
    gap = jnp.where(shares > 0, exact - approximate, 0.0)
    error = jnp.sqrt(shares @ (gap - shares @ gap) ** 2)
    of_experiments = coefficients.reshape(size, -1, n // size, coefficients.shape[-1] // (n // size))
    return Emulator(center, spread, of_experiments, middle, along * sigma[:, None], error)


def _degree_of(parameters: int, coefficients: int) -> int:
    return next(degree for degree in (2, 3) if math.comb(parameters + degree, degree) == coefficients)


def _exponents(parameters: int, degree: int) -> tuple[np.ndarray, ...]:
    """The parameters in the products of each degree, (·, degree)."""
    return tuple(
        np.asarray(list(combinations_with_replacement(range(parameters), d)), dtype=int).reshape(-1, d)
        for d in range(1, degree + 1)
    )


def _terms(x: Float[Array, " p"], factors: tuple[np.ndarray, ...]) -> Float[Array, " q"]:
    return jnp.concatenate([jnp.ones(1), *(jnp.prod(x[of], axis=1) for of in factors)])
