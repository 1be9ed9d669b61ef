r"""The model discrepancy beyond the noise, learned with the parameters: a Gaussian process over the inputs.

Kennedy & O'Hagan (2001) observe $y_j(x) = f_j(x,\theta) + \delta_j(x) + \epsilon$.  In units of the error (of the logarithm,
for a relative error),

$$\delta_j \sim GP\big(0,\ a_j^2 R(x, x'; \ell)\big),\qquad
  \sum_j\int \delta_j(x)\,\partial_\theta z_j(x)\,\pi(x)\,dx = 0 .$$

Without the second condition, parameters and discrepancy could replace each other.  With it (Plumlee 2017), the parameters are
those with which the model predicts best over the distribution π of the inputs, in squares of the declared error, and the
process is the remaining error.  Conditioned on these p linear functionals, with F their weights at a sample of inputs,

$$K_\perp = K - K F\,(F^\top K F)^{-1} F^\top K .$$

Amplitudes $a_j$ and lengths maximise the marginal likelihood (`hsed_jax.inference.marginal`) times their priors.  As in Kriging
(`hsed_jax.design.kriging`), a variance estimated from n experiments is enlarged by n/(n − 2).
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Bool, Float, PyTree

from hsed_jax.inference.correlation_functions import LENGTH, LENGTH_SPREAD, correlation, log_prior_of_lengths
from hsed_jax.inference.discrepancy.base import AbstractDiscrepancy
from hsed_jax.inference.likelihood import Data, data_of
from hsed_jax.inference.marginal import (
    LEAST_AMPLITUDE,
    beyond_noise,
    linearised,
    log_marginal,
    log_prior_of_amplitudes,
    lowest,
    predictions,
    stiffness,
)
from hsed_jax.inference.posterior import Posterior
from hsed_jax.programs import program

_LENGTHS = (0.02, 20.0)
# A direction of the parameters is ignored if predictions change this much less along it than along the first one.
_FLAT = 1e-6


class Support(NamedTuple):
    """The variables that a discrepancy of quantities depends on.

    Attributes:
        names: of the inputs.
        cube: from inputs by name in SI, each (n,), to points of the unit cube (n, d).
        spread: conditions that represent the distribution of the inputs; None if the model can only predict performed
            experiments, which then represent it.
    """

    names: tuple[str, ...]
    cube: Callable[[Mapping[str, Array]], np.ndarray]
    spread: PyTree | None


@final
class Whitening(eqx.Module):
    """Residuals of all data made independent.

    Attributes:
        factor: W with W C Wᵀ = I, (nJ, nJ).
        log_determinant: of C.
    """

    factor: Float[Array, "N N"]
    log_determinant: Float[Array, ""]

    def __call__(self, z: Float[Array, "n J"]) -> Float[Array, " N"]:
        """W z."""
        return self.factor @ z.ravel()


def none_of(data: Data) -> Whitening:
    """For a correct model: the residuals are already independent."""
    return Whitening(jnp.eye(data.values.size), jnp.zeros(()))


@final
class Process(AbstractDiscrepancy):
    """A discrepancy over the inputs, in units of the error.

    Attributes:
        amplitudes: a_j by column; zero without a discrepancy, (J,).
        lengths: of correlation, in shares of the inputs' distributions, (d,).
        measure: points that the orthogonality is taken over, (M, d).
        across: orthonormal directions there, to which the process is orthogonal, (M, J, r).
        at: points of the experiments, (n, d).
        used: 1 where there is a measurement, (n, J).
    """

    amplitudes: Float[Array, " J"]
    lengths: Float[Array, " d"]
    measure: Float[Array, "M d"]
    across: Float[Array, "M J r"]
    at: Float[Array, "n d"]
    used: Float[Array, "n J"]

    @property
    def settling(self) -> tuple[Array, ...]:
        """The quantities that change with the MAP."""
        return tuple(jax.tree.leaves(self))

    @property
    def whitening(self) -> Whitening:
        """The transformation that makes the residuals of the experiments independent."""
        return _whitening(self)

    def reach(self, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """Its correlation `length` by input, in shares of the distribution of the input."""
        return {"length": dict(zip(names, np.asarray(self.lengths).tolist(), strict=True))}

    def conditional(self, points: Float[Array, "m d"]) -> tuple[Float[Array, "mJ nJ"], Float[Array, "m J"]]:
        """The matrix that gives the mean of δ at other points from the residuals z of the experiments, and the variance
        of δ.
        """
        return _conditional(self, points)


@program
def _whitening(process: Process) -> Whitening:
    factor = _factor(process)
    return Whitening(solve_triangular(factor, jnp.eye(len(factor)), lower=True), 2 * jnp.sum(jnp.log(jnp.diag(factor))))


@program
def _conditional(process: Process, points: Float[Array, "m d"]):
    used = process.used.ravel()
    between = _orthogonal(process, points, process.at) * used
    whitened = solve_triangular(_factor(process), between.T, lower=True)
    variance = _variances(process, points).ravel() - jnp.sum(whitened**2, axis=0)
    # z is predicted minus measured: the model is too small by −z.
    weights = -solve_triangular(_factor(process), whitened, lower=True, trans=1).T
    return weights, jnp.maximum(variance, 0.0).reshape(len(points), -1)


def _factor(process: Process) -> Float[Array, "N N"]:
    """Cholesky factor of C = I + K⊥; rows of the identity without a measurement."""
    used = process.used.ravel()
    covariance = used[:, None] * _orthogonal(process, process.at, process.at) * used
    return jnp.linalg.cholesky(covariance + jnp.eye(len(used)))


def _along_measure(process: Process, points: Float[Array, "m d"]) -> Float[Array, "mJ r"]:
    """K F: covariance of δ at points with the functionals that are to vanish."""
    of_output = process.amplitudes**2
    related = correlation(points, process.measure, process.lengths, "matern52")
    return jnp.einsum("am,j,mjr->ajr", related, of_output, process.across).reshape(-1, process.across.shape[-1])


def _functionals(process: Process) -> Float[Array, "r r"]:
    """Cholesky factor of Fᵀ K F."""
    ours = jnp.einsum("mjr,mjs->rs", process.across, _along_measure(process, process.measure).reshape(
        *process.across.shape))  # fmt: skip
    return jnp.linalg.cholesky(ours + 1e-9 * jnp.trace(ours) * jnp.eye(len(ours)))


def _orthogonal(process: Process, a: Float[Array, "A d"], b: Float[Array, "B d"]) -> Float[Array, "AJ BJ"]:
    """K⊥ between points."""
    related = jnp.kron(correlation(a, b, process.lengths, "matern52"), jnp.diag(process.amplitudes**2))
    one, other = _along_measure(process, a), _along_measure(process, b)
    return related - one @ cho_solve((_functionals(process), True), other.T)


def _variances(process: Process, points: Float[Array, "m d"]) -> Float[Array, "m J"]:
    part = solve_triangular(_functionals(process), _along_measure(process, points).T, lower=True)
    return process.amplitudes**2 - jnp.sum(part**2, axis=0).reshape(len(points), -1)


def learn(
    posterior: Posterior,
    data: Data,
    u: Float[Array, " p"],
    wrong: Bool[np.ndarray, " G"],
    support: Support,
    previous: Process | None = None,
) -> Process:
    """The discrepancy of a calibrated model, its amplitudes and lengths the most probable.

    Arguments:
        posterior: of the study.
        data: measured quantities.
        u: unconstrained coordinates of the MAP.
        wrong: by output, whether its discrepancy is learned.
        support: its variables.
        previous: another start of the search.
    """
    z, along, ok = linearised(posterior, data, u)
    used = ((data.weights > 0) & (ok[:, None] > 0)).astype(float)
    at = _points(support, data)
    measure, across = _measure(posterior, data, u, support)
    across = np.asarray(across) * wrong[posterior.groups][None, :, None]
    columns = jnp.asarray(wrong[posterior.groups], float)
    empty = Process(columns, jnp.ones(at.shape[1]), measure, jnp.asarray(_basis(across)), at, used)
    residual, slopes = (used * z).ravel(), (used[..., None] * along).reshape(-1, along.shape[-1])
    curvature = stiffness(posterior, u)
    numbers = tuple(np.flatnonzero(wrong).tolist())

    def objective(values: Float[Array, " h"]) -> tuple[Array, Array]:
        return _objective(values, empty, numbers, residual, slopes, curvature)

    best = _searched(objective, residual, used, numbers, at.shape[1], previous)
    count = int(np.sum(np.asarray(used).any(axis=1)))
    amplitudes, lengths = _split(jnp.asarray(best), len(wrong), numbers)
    known = np.sqrt(count / max(count - 2, 1))
    return eqx.tree_at(lambda p: (p.amplitudes, p.lengths), empty, (known * amplitudes, lengths))


def _points(support: Support, data: Data) -> Float[Array, "n d"]:
    return jnp.asarray(support.cube(data.conditions.inputs))


def _measure(posterior: Posterior, data: Data, u: Any, support: Support) -> tuple[Array, Array]:
    """Points that the orthogonality is taken over, and the sensitivities there, (M, J, p)."""
    if support.spread is None:
        _, along, ok = linearised(posterior, data, u)
        return _points(support, data), along * (data.weights > 0)[..., None] * ok[:, None, None]
    count = jax.tree.leaves(support.spread)[0].shape[0]
    predicted, ok = predictions(posterior, u, support.spread, jnp.asarray(count))
    values, known = np.asarray(predicted), np.asarray(ok)[:, None] > 0
    made = data_of(support.spread, values, known & (values != 0), np.full(values.shape, np.inf), count)
    _, along, ok = linearised(posterior, made, u)
    return jnp.asarray(support.cube(support.spread.inputs)), along * ok[:, None, None]


def _basis(across: np.ndarray) -> np.ndarray:
    """Orthonormal directions that the columns span, (M, J, r)."""
    left, size, _ = np.linalg.svd(across.reshape(-1, across.shape[-1]), full_matrices=False)
    return left[:, size > _FLAT * max(size.max(initial=0.0), 1e-300)].reshape(*across.shape[:2], -1)


def _searched(
    objective: Callable, residual: Array, used: Array, numbers: tuple[int, ...], d: int, previous: Process | None
) -> np.ndarray:
    """Amplitudes of the outputs and logarithms of the lengths with the least objective."""
    beyond = beyond_noise(np.asarray(residual).reshape(used.shape), np.asarray(used))[list(numbers)]
    middle = np.full(d, np.log(LENGTH * np.sqrt(d)))
    starts = [np.r_[beyond, middle], np.r_[0.3 * beyond, middle + 2 * LENGTH_SPREAD]]
    if previous is not None:
        starts.append(np.r_[np.asarray(previous.amplitudes)[list(numbers)], np.log(np.asarray(previous.lengths))])
    return lowest(objective, starts, [(LEAST_AMPLITUDE, None)] * len(numbers) + [tuple(np.log(_LENGTHS))] * d)


def _split(values: Float[Array, " h"], outputs: int, numbers: tuple[int, ...]) -> tuple[Array, Array]:
    amplitudes = jnp.zeros(outputs).at[jnp.asarray(numbers)].set(values[: len(numbers)])
    return amplitudes, jnp.exp(values[len(numbers) :])


@program
def _objective(values, empty: Process, numbers: tuple[int, ...], residual, slopes, stiffness):
    """Minus the log posterior of amplitudes and lengths, parameters integrated, and its derivative."""

    def log_density(values):
        amplitudes, lengths = _split(values, empty.amplitudes.size, numbers)
        factor = _factor(eqx.tree_at(lambda p: (p.amplitudes, p.lengths), empty, (amplitudes, lengths)))
        whitened = solve_triangular(factor, jnp.column_stack([residual, slopes]), lower=True)
        log_determinant = 2 * jnp.sum(jnp.log(jnp.diag(factor)))
        likelihood = log_marginal(whitened.T @ whitened, log_determinant, stiffness)
        return -likelihood - log_prior_of_lengths(jnp.log(lengths)) - log_prior_of_amplitudes(amplitudes)

    return jax.value_and_grad(log_density)(values)
