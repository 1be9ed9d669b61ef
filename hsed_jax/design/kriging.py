"""Universal Kriging: a Gaussian process around a polynomial trend, fitted to few points without overconfidence.

A Kriging model describes the response y at an input x as a trend β·f(x) plus a stationary Gaussian process of variance σ² and
correlation R (Eq. 7 of Abbiati & Marelli, 17WCEE).  Given the correlation lengths and the nugget, everything else has a
closed form (Eqs. 8-11).  These hyper-parameters maximise their posterior: the *restricted* likelihood, with β and σ²
integrated out, times a prior of each.  With few points, maximum likelihood often gives a smooth function without noise, and
its 90 % bands then contain 70 % of the true values.

Experiments arrive one at a time, so the training set is an array of the planned size and a mask of the rows that hold
data.  A padded row is an independent, unit-variance unknown with weight zero: the numbers do not depend on the padding,
and one compiled program serves a campaign from its first step to its last.

Sources: Sacks, Welch, Mitchell & Wynn (1989), Statistical Science 4; for the restricted likelihood and Student's t
Handcock & Stein (1993), Technometrics 35.
"""

from itertools import combinations_with_replacement
from typing import Literal, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.core import Tracer
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from hsed_jax.inference.correlation_functions import KERNELS, KernelName, correlation, log_prior_of_lengths
from hsed_jax.programs import program

TrendName = Literal["constant", "linear", "quadratic"]

# Candidates handled together: their arrays stay in the second-level cache.
_CHUNK = 256
# Columns of L⁻¹ multiplied together.  It is a lower triangle, so each block of columns starts at its first row; the matrix
# product is fastest for multiples of five.  Each block is compiled, so a large matrix has few blocks.
_COLUMNS, _BLOCKS = 15, 8
# Log-normal prior of the nugget: median and spread of the logarithm.  With it and that of the lengths 90 % bands hold
# 85 to 95 % of a Matérn field and of the paper's discrepancy, from 8 to 40 points, with noise and without
# (tests/design/test_kriging.py); longer lengths and a zero nugget need evidence from the data.
_NUGGET, _NUGGET_SPREAD = 0.007, 2.0
# Relative to the responses' own variance, anything smaller is rounding: an exact trend, or constant responses.
_LEAST_VARIANCE = 1e-24


_TREND_DEGREE: dict[str, int] = {"constant": 0, "linear": 1, "quadratic": 2}


def trend_functions(x: Float[Array, "M d"], trend: TrendName) -> Float[Array, "M p"]:
    """The regression functions f(x) of Eq. 7: all monomials up to degree 0, 1 or 2, the constant first."""
    columns = [jnp.ones(x.shape[0], x.dtype)]
    for degree in range(1, _TREND_DEGREE[trend] + 1):
        for factors in combinations_with_replacement(range(x.shape[1]), degree):
            columns.append(jnp.prod(x[:, jnp.array(factors)], axis=1))
    return jnp.stack(columns, axis=1)


@final
class Kriging(eqx.Module):
    """A fitted universal Kriging model: all that `predict` and a report need.

    Shapes: N rows of (padded) training data, d inputs, p trend functions.  Inputs live in the unit cube, `lengths` are in its
    units; `process_variance` (σ², Eq. 9) and `trend_coefficients` (β, Eq. 8) are in the response's units. `nugget` is
    relative to σ².  `log_posterior` is that of lengths and nugget (of their logarithms), the objective of `fit_kriging`:
    restricted likelihood times prior, without constants that depend on the inputs alone.
    """

    lengths: Float[Array, " d"]
    nugget: Float[Array, ""]
    process_variance: Float[Array, ""]
    trend_coefficients: Float[Array, " p"]
    log_posterior: Float[Array, ""]
    inputs: Float[Array, "N d"]
    responses: Float[Array, " N"]
    mask: Bool[Array, " N"]
    weights: Float[Array, " N"]  # R⁻¹(Y − Fβ)
    whitening: Float[Array, "N N"]  # L⁻¹ where R = LLᵀ
    trend_whitening: Float[Array, "p p"]  # S⁻¹ where FᵀR⁻¹F = SSᵀ
    trend_projection: Float[Array, "p N"]  # S⁻¹FᵀR⁻¹
    kernel: KernelName = eqx.field(static=True)
    trend: TrendName = eqx.field(static=True)

    @program
    def predict(self, x: Float[Array, "M d"]) -> tuple[Float[Array, " M"], Float[Array, " M"]]:
        """Mean (Eq. 10) and variance (Eq. 11) of the response at new points, in chunks of bounded memory.

        The variance is that of the underlying response, without the nugget's scatter, and includes the uncertainty of the
        trend, σ²uᵀ(FᵀR⁻¹F)⁻¹u.  σ² is estimated and not known, so the prediction is a Student t of N − p degrees of freedom
        and its variance N/(N − p − 2) times that of Eq. 11 (N/1 if N − p − 2 is not positive).

        **Arguments:** `x`: points in the unit cube, (M, d).

        **Returns:** mean (M,) and variance (M,), the latter never negative.
        """
        points = x.shape[0]
        size = min(_CHUNK, points)
        # One input after the other, in the order of their storage.
        coordinates = jnp.pad(x.T, ((0, 0), (0, -points % size)), mode="edge")

        def at(first: Int[Array, ""]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
            return self._predict_block(jax.lax.dynamic_slice_in_dim(coordinates, first, size, axis=1))

        mean, variance = jax.lax.map(at, jnp.arange(0, points, size))
        return mean.reshape(-1)[:points], variance.reshape(-1)[:points]

    def _predict_block(self, coordinates: Float[Array, "d m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        # Matrix products give L⁻¹r, S⁻¹FᵀR⁻¹r and r·R⁻¹(Y − Fβ); points run along the contiguous axis.  Without the
        # barrier XLA fuses the block's slicing into the kernel, which is slower (52 against 13 ms for 100 000 points).
        n, p = self.inputs.shape[0], self.trend_whitening.shape[0]
        x = jax.lax.optimization_barrier(coordinates).T
        f = trend_functions(x, self.trend).T
        rows = jnp.concatenate([self.whitening, self.trend_projection, self.weights[None]])
        explained, product = jnp.zeros(()), jnp.zeros(())
        columns = max(_COLUMNS, n // _BLOCKS)
        for i in range(0, n, columns):
            some = slice(i, i + columns)
            product = product + rows[i:, some] @ correlation(self.inputs[some], x, self.lengths, self.kernel)
            # Rows of L⁻¹ that end in these columns.
            done, product = jnp.split(product, [min(columns, n - i)])
            explained = explained + jnp.sum(jnp.square(done), axis=0)
        trend_part = jnp.sum(jnp.square(product[:-1] - self.trend_whitening @ f), axis=0)
        known = jnp.sum(self.mask)
        variance = self.process_variance * (known / jnp.maximum(known - p - 2, 1)) * (1.0 - explained + trend_part)
        return self.trend_coefficients @ f + product[-1], jnp.maximum(variance, 0.0)

    @property
    def degrees(self) -> Float[Array, ""]:
        """Degrees of freedom of the Student t of a prediction, N − p, and at least two, because its mean may not exist
        below two.
        """
        return jnp.maximum(jnp.sum(self.mask) - self.trend_whitening.shape[0], 2.0)

    @property
    def scale_share(self) -> Float[Array, ""]:
        """Scale of the Student t of a prediction over the standard deviation that `predict` gives."""
        left = jnp.sum(self.mask) - self.trend_whitening.shape[0]
        return jnp.sqrt(jnp.maximum(left - 2.0, 1.0) / jnp.maximum(left, 1.0))

    def tested_means(self) -> Float[Array, " N"]:
        """Kriging mean at each training point, Eq. 10 (padded rows: −∞, so that a maximum passes over them).

        There R⁻¹r is a unit vector minus the share of the nugget, which gives Y − (nugget)R⁻¹(Y − Fβ).
        """
        return jnp.where(self.mask, self.responses - self.nugget * self.weights, -jnp.inf)


@program
def condition(
    inputs: Float[Array, "N d"],
    responses: Float[Array, " N"],
    mask: Bool[Array, " N"],
    lengths: Float[Array, " d"],
    nugget: Float[Array, ""],
    *,
    kernel: KernelName = "matern52",
    trend: TrendName = "constant",
) -> Kriging:
    """Kriging model with given hyper-parameters: Eqs. 8 and 9, and the factors that Eqs. 10 and 11 need.

    `nugget` is added to the diagonal of the correlation matrix.  Rows with a false `mask` may hold anything.  The other
    arguments are as in `fit_kriging`.
    """
    inputs, responses = jnp.where(mask[:, None], inputs, 0.0), jnp.where(mask, responses, 0.0)
    centred, centre, scale = _standardise(responses, mask)
    basis = _masked_trend(inputs, mask, trend)
    matrix = _masked_correlation(inputs, mask, lengths, nugget, kernel)
    objective, parts = _restricted(matrix, basis, centred, jnp.sum(mask))
    return Kriging(
        lengths=lengths,
        nugget=nugget,
        process_variance=scale**2 * parts.variance,
        # The constant is the first trend function: the subtracted mean of the responses is added to it.
        trend_coefficients=(scale * parts.coefficients).at[0].add(centre),
        log_posterior=_log_prior(jnp.log(lengths), jnp.log(nugget)) - objective,
        inputs=inputs,
        responses=responses,
        mask=mask,
        weights=scale * parts.weights,
        whitening=parts.whitening * mask,
        trend_whitening=parts.trend_whitening,
        trend_projection=parts.trend_whitening @ (parts.whitened_basis.T @ parts.whitening),
        kernel=kernel,
        trend=trend,
    )


def fit_kriging(
    inputs: Float[Array, "N d"],
    responses: Float[Array, " N"],
    mask: Bool[Array, " N"],
    *,
    kernel: KernelName = "matern52",
    trend: TrendName = "constant",
    starts: int = 10,
    key: PRNGKeyArray,
    previous: tuple[Float[Array, " d"], Float[Array, ""]] | None = None,
    length_bounds: tuple[float, float] = (0.02, 20.0),
    nugget_bounds: tuple[float, float] = (1e-10, 1.0),
    max_steps: int = 50,
) -> Kriging:
    """Universal Kriging with the likeliest hyper-parameters a posteriori (Eqs. 7-11 of Abbiati & Marelli, 17WCEE).

    Maximises the restricted log-likelihood −(N − p)/2·log(σ²) − ½·log|R| − ½·log|FᵀR⁻¹F| plus the log-normal priors over
    the logarithms of the lengths and of the nugget by BFGS from several starts at once, and keeps the best.  The bounds
    enter through a sine, so an optimum on a bound is reached exactly and is an ordinary minimum for the optimiser.

    **Arguments:**

    - `inputs`: training inputs in the unit cube, (N, d).
    - `responses`: training responses, (N,).
    - `mask`: true for the rows that hold data, (N,); the others may hold anything.
    - `kernel`: correlation function, "matern32", "matern52" or "gaussian".
    - `trend`: "constant", "linear" or "quadratic" (1, 1 + d or (d + 1)(d + 2)/2 functions).
    - `starts`: number of starts, a Latin hypercube drawn from `key`.
    - `key`: fixes the starts; equal keys give equal models.
    - `previous`: lengths and nugget of an earlier fit, one more start.
    - `length_bounds`, `nugget_bounds`: search range; lengths in units of the cube, nugget relative to σ².
    - `max_steps`: most BFGS steps from each start.

    **Returns:** a `Kriging`.  Constant responses give σ² = 0: the mean is that constant, the variance zero.

    **Raises:** `ValueError` for unknown names, reversed bounds and, where the data are known (outside `jit`), for
    responses that are not finite and for points that do not determine the trend.
    """
    if kernel not in KERNELS:
        raise ValueError(f"Argument `kernel` must be one of {', '.join(KERNELS)}, but is {kernel!r}.")
    if trend not in _TREND_DEGREE:
        raise ValueError(f"Argument `trend` must be one of {', '.join(_TREND_DEGREE)}, but is {trend!r}.")
    for name, (low, high) in {"length_bounds": length_bounds, "nugget_bounds": nugget_bounds}.items():
        if not 0.0 < low < high:
            raise ValueError(f"Argument `{name}` must satisfy 0 < lower < upper, but is ({low}, {high}).")
    if starts < 1:
        raise ValueError(f"Argument `starts` must be at least 1, but is {starts}.")
    if not any(isinstance(array, Tracer) for array in (inputs, responses, mask)):
        _check_training_set(np.asarray(inputs), np.asarray(responses), np.asarray(mask), trend)
    lower, upper = np.log([length_bounds] * inputs.shape[1] + [nugget_bounds]).T
    best = _likeliest(inputs, responses, mask, key, previous, lower, upper, kernel, trend, starts, max_steps)
    return condition(inputs, responses, mask, *best, kernel=kernel, trend=trend)


@program
def _likeliest(
    inputs, responses, mask, key, previous, lower, upper, kernel, trend, starts, max_steps
) -> tuple[Float[Array, " d"], Float[Array, ""]]:
    x, y = jnp.where(mask[:, None], inputs, 0.0), jnp.where(mask, responses, 0.0)
    y, basis, count = _standardise(y, mask)[0], _masked_trend(x, mask, trend), jnp.sum(mask)

    def bounded(angles):
        return lower + (upper - lower) * 0.5 * (1.0 + jnp.sin(angles))

    def objective(angles, _):
        logs = bounded(angles)
        matrix = _masked_correlation(x, mask, jnp.exp(logs[:-1]), jnp.exp(logs[-1]), kernel)
        # Per point, because BFGS begins with a curvature of one, and the sum over many points has a much larger one.
        return (_restricted_objective(matrix, basis, y, count) - _log_prior(logs[:-1], logs[-1])) / count

    def descend(angles):
        solver = optx.BFGS(rtol=1e-7, atol=1e-7)
        angles = optx.minimise(objective, solver, angles, max_steps=max_steps, throw=False).value
        return angles, objective(angles, None)

    fractions = 0.1 + 0.8 * _latin_hypercube(key, starts, lower.shape[0])
    if previous is not None:
        logs = jnp.log(jnp.append(previous[0], previous[1]))
        # Exactly on a bound the sine is flat, and no descent could leave it.
        fractions = jnp.concatenate([fractions, jnp.clip((logs - lower) / (upper - lower), 0.01, 0.99)[None]])
    # One after the other: side by side, all starts would run until the slowest has ended.
    ends, values = jax.lax.map(descend, jnp.arcsin(2.0 * fractions - 1.0))
    best = jnp.exp(bounded(ends[jnp.nanargmin(values)]))
    return best[:-1], best[-1]


@final
class _Parts(eqx.Module):
    """Intermediate results of the restricted likelihood."""

    variance: Float[Array, ""]
    coefficients: Float[Array, " p"]
    weights: Float[Array, " N"]
    whitening: Float[Array, "N N"]
    whitened_basis: Float[Array, "N p"]
    trend_whitening: Float[Array, "p p"]


def _log_prior(log_lengths: Float[Array, " d"], log_nugget: Float[Array, ""]) -> Float[Array, ""]:
    return log_prior_of_lengths(log_lengths) - 0.5 * ((log_nugget - np.log(_NUGGET)) / _NUGGET_SPREAD) ** 2


def _restricted(matrix, basis, y, count) -> tuple[Float[Array, ""], _Parts]:
    """½(N − p)·log σ² + ½·log|R| + ½·log|FᵀR⁻¹F| with β and σ² of Eqs. 8 and 9, and the parts."""
    factor = jnp.linalg.cholesky(matrix, symmetrize_input=False)
    whitening = solve_triangular(factor, jnp.eye(len(y)), lower=True)
    whitened_basis, whitened_y = whitening @ basis, whitening @ y
    trend_factor = jnp.linalg.cholesky(whitened_basis.T @ whitened_basis)
    trend_whitening = solve_triangular(trend_factor, jnp.eye(basis.shape[1]), lower=True)
    coefficients = trend_whitening.T @ (trend_whitening @ (whitened_basis.T @ whitened_y))
    residual = whitened_y - whitened_basis @ coefficients
    variance = residual @ residual / count
    objective = 0.5 * (count - basis.shape[1]) * jnp.log(jnp.maximum(variance, _LEAST_VARIANCE))
    objective += jnp.sum(jnp.log(jnp.diag(factor))) + jnp.sum(jnp.log(jnp.diag(trend_factor)))
    return objective, _Parts(variance, coefficients, whitening.T @ residual, whitening, whitened_basis, trend_whitening)


@jax.custom_vjp
def _restricted_objective(matrix, basis, y, count) -> Float[Array, ""]:
    return _restricted(matrix, basis, y, count)[0]


def _objective_forward(matrix, basis, y, count):
    objective, parts = _restricted(matrix, basis, y, count)
    share = (count - basis.shape[1]) / (count * jnp.maximum(parts.variance, _LEAST_VARIANCE))
    projection = parts.trend_whitening @ (parts.whitened_basis.T @ parts.whitening)
    precision = parts.whitening.T @ parts.whitening - projection.T @ projection
    return objective, 0.5 * (precision - share * jnp.outer(parts.weights, parts.weights))


def _objective_backward(gradient, cotangent):
    return cotangent * gradient, None, None, None


# β minimises the sum of squares in σ², so only R's own derivative remains: half the trace of (Q − ααᵀ(N − p)/Nσ²)·dR
# with Q = R⁻¹ − R⁻¹F(FᵀR⁻¹F)⁻¹FᵀR⁻¹.
_restricted_objective.defvjp(_objective_forward, _objective_backward)


def _masked_correlation(x, mask, lengths, nugget, kernel) -> Float[Array, "N N"]:
    """R with the nugget on its diagonal, and rows of the identity without data."""
    matrix = jnp.where(mask[:, None] & mask, correlation(x, x, lengths, kernel), 0.0)
    return matrix + jnp.diag(jnp.where(mask, nugget, 1.0))


def _masked_trend(x, mask, trend) -> Float[Array, "N p"]:
    return jnp.where(mask[:, None], trend_functions(x, trend), 0.0)


def _standardise(responses, mask) -> tuple[Float[Array, " N"], Float[Array, ""], Float[Array, ""]]:
    """Responses with mean zero and variance one, their mean and standard deviation (one if they are constant)."""
    count = jnp.sum(mask)
    centre = jnp.sum(responses) / count
    centred = jnp.where(mask, responses - centre, 0.0)
    deviation = jnp.sqrt(jnp.sum(jnp.square(centred)) / count)
    constant = deviation <= 1e-14 * jnp.max(jnp.abs(responses))
    scale = jnp.where(constant, 1.0, deviation)
    return jnp.where(constant, 0.0, centred / scale), centre, scale


def _latin_hypercube(key: PRNGKeyArray, points: int, dimensions: int) -> Float[Array, "points dimensions"]:
    among, within = jax.random.uniform(key, (2, points, dimensions))
    # By their ranks: a sort has much more to compile.
    return (jnp.sum(among[:, None] > among, axis=1) + within) / points


def _check_training_set(inputs: np.ndarray, responses: np.ndarray, mask: np.ndarray, trend: TrendName) -> None:
    x, y = inputs[mask], responses[mask]
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("Arguments `inputs` and `responses` must be finite where `mask` is true, but are not.")
    # For all rows: an array that grows with the data would need a new compilation at each step.
    functions = np.asarray(trend_functions(jnp.asarray(inputs), trend))[mask]
    n, p = functions.shape
    if n < p + 1:
        raise ValueError(
            f"A {trend} trend in {x.shape[1]} inputs needs at least {p + 1} points, but argument `inputs` holds {n}."
            " Perform more experiments first or choose a simpler trend."
        )
    if np.linalg.matrix_rank(functions) < p:
        raise ValueError(
            f"Argument `inputs` must determine a {trend} trend, but its {n} points lie so that they do not"
            " (repeated, or on one line or curve). Spread the experiments or choose a simpler trend."
        )
