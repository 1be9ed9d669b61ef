r"""The likelihood: errors with a declared or inferred standard deviation per output, which may be autocorrelated.

$$\log L = -\tfrac12\sum_{ij}\Big[w_{ij}^2+\log 2\pi\sigma_{ij}^2(1-\rho_{ij}^2)\Big],\qquad
  w_{ij} = \frac{z_{ij}-\rho_{ij}z_{i,j-1}}{\sqrt{1-\rho_{ij}^2}},\qquad z_{ij} = \frac{f_{ij}(\theta)-y_{ij}}{\sigma_{ij}}$$

(Abbiati & Marelli, Eqs. 3–4, with σ a standard deviation.) For an absolute error, σ is s, declared or a parameter. ρ is the
correlation of the noise of a sample with that of the sample before (a first-order autoregression; Box & Jenkins 1976).  It is
zero for white noise and for quantities.

By default the relative error of a *history* is relative to its RMS, which many samples determine well.  The RMS is the measured
one without the contribution of the noise: $\sigma = s\,\mathrm{RMS}(y)/\sqrt{1+s^2}$.  The relative error of a *quantity* is an
error of its logarithm,

$$z = \frac{\log f(\theta) - \log y + \mathrm E\log|1+s\varepsilon|}{\mathrm{sd}\log|1+s\varepsilon|},
  \qquad \varepsilon\sim N(0,1),$$

with the mean and variance of y = f·(1 + sε).  With σ = s·y of the noisy datum, errors that happen to be small would count for
more than large ones, which biases every estimate.  With σ = s·f, a wrong model would move towards larger predictions, where
errors are larger.

If the error is relative to the measurement (`Error.of_measured`), its scale is given, as in the paper: σ = s·|y| for a quantity
and s·RMS(y) for a history, and z is Gaussian.

If the discrepancy of the model is learned (`hsed_jax.inference.discrepancy`), the errors of all data are correlated with one
another: $\operatorname{cov} z = C$ replaces the white or autoregressive noise.
"""

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Union

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

if TYPE_CHECKING:
    # Reports read fits and need no distribution.
    from hsed_jax.inference.priors import Prior

LOG_2PI = 1.8378770664093453
# A prediction smaller than this share of the measurement gives no reference for a relative error.
_LEAST = 1e-9
# Quadrature over a standard normal; the logarithm is cut off where it has its pole.
_NODES, _SHARES = np.polynomial.hermite_e.hermegauss(40)
_SHARES, _SINGULAR = _SHARES / _SHARES.sum(), 1e-2


class Error(NamedTuple):
    """The error of one output: s in σ = s·c.

    Attributes:
        size: s, declared (a number) or inferred (its prior).
        is_relative: whether c is the size of the quantity or the RMS of the history; else 1, and s is in SI.
        correlated: whether the noise of a history is autocorrelated; None: only if its size is declared.
        inflate: whether a residual beyond the declared error counts as error, too.
        discrepancy: whether the model discrepancy beyond the error is learned.
        of_measured: whether the measurement gives c of a relative error (Gaussian); otherwise a quantity has an error of the
            logarithm of the prediction.
    """

    size: Union[float, "Prior"]
    is_relative: bool = False
    correlated: bool | None = None
    inflate: bool = False
    discrepancy: bool = False
    of_measured: bool = False

    @property
    def is_declared(self) -> bool:
        """Whether the size is known."""
        return isinstance(self.size, int | float)


class Columns(NamedTuple):
    """The reference of the errors, by column of the data.

    Attributes:
        is_relative: whether the error of a column is relative, (J,).
        of_measured: whether it is relative to the measurement, (J,).
        members: 1 where a column belongs to an output, (J, G).
    """

    is_relative: Bool[np.ndarray, " J"]
    of_measured: Bool[np.ndarray, " J"]
    members: Float[np.ndarray, "J G"]

    @property
    def is_quantity(self) -> Bool[np.ndarray, " J"]:
        """The columns that are quantities instead of samples of a history."""
        return self.members.sum(axis=0)[self.members.argmax(axis=1)] == 1

    @property
    def is_logarithmic(self) -> Bool[np.ndarray, " J"]:
        """The columns with an error of the logarithm."""
        return self.is_relative & self.is_quantity & ~self.of_measured


class Decorrelation(Protocol):
    """The transformation that makes the residuals of all data independent with unit variance, if a discrepancy is learned."""

    @property
    def log_determinant(self) -> Float[Array, ""]:
        """Log determinant of the covariance C of z."""
        ...

    def __call__(self, z: Float[Array, "n J"]) -> Float[Array, " k"]:
        """W z with $z^\\top C^{-1} z = |W z|^2$; linear in z."""
        ...


class Data(NamedTuple):
    """Measured outputs of n experiments (padded), and the conditions that predict them.

    Attributes:
        conditions: conditions of the experiments, leading axis n.
        values: measured outputs, SI, shape (n, J).
        weights: 1 where measured and used, 0 where missing or padding, shape (n, J); between 0 and 1 for correlated samples,
            so that they count for their effective number.
        gaps: time since the previous sample of the same history [s], infinite without one, shape (n, J).
        memory: ρ, correlation of the noise with that of the sample before, shape (n, J).
        count: how many experiments there are; rows beyond are padding.
        members: of each experiment its member of every level of a population, shape (n, L).
        first: of each experiment the first one with the same conditions, such as another window of its record, shape (n,).
        decorrelation: of the residuals where the model's discrepancy is learned, instead of memory and weights.
    """

    conditions: PyTree
    values: Float[Array, "n J"]
    weights: Float[Array, "n J"]
    gaps: Float[Array, "n J"]
    memory: Float[Array, "n J"]
    count: Int[Array, ""]
    members: Int[Array, "n L"]
    first: Int[Array, " n"]
    decorrelation: Decorrelation | None = None


def data_of(conditions: PyTree, measured: np.ndarray, used: np.ndarray, gaps: np.ndarray, count: int) -> Data:
    """Data from measured numbers; the only place.  The noise is white until more is known, and each experiment is simulated.

    Arguments:
        conditions: of the experiments, leading axis n.
        measured: SI, (n, J); anything where not used.
        used: where there is a measurement to use, (n, J) bool.
        gaps: time since the previous sample of the same history [s], (n, J); infinite without one.
        count: how many experiments there are; rows beyond are padding.
    """
    used = used & (np.arange(len(measured)) < count)[:, None]
    before = np.pad(used[:, :-1], ((0, 0), (1, 0)))
    known = (
        np.where(used, measured, 1.0),
        used.astype(float),
        np.where(used & before, gaps, np.inf),
        np.zeros(measured.shape),
        np.asarray(count),
        np.zeros((len(measured), 0), dtype=int),
        np.arange(len(measured)),
    )
    return Data(conditions, *jax.device_put(known))


def magnitudes(values: Any, used: Any, members: Float[np.ndarray, "J G"]) -> Any:
    """The reference of a relative error, (n, J): the size of a quantity, or the RMS of the used samples of a history.

    Arguments:
        values: predicted or measured outputs, (n, J), an array of NumPy or of JAX.
        used: 1 where they count, else 0, (n, J).
        members: 1 where a column belongs to an output.
    """
    xp = values.__array_namespace__()
    if members.shape[0] == members.shape[1]:
        return xp.abs(values)
    squares = (used * values**2) @ members / xp.maximum(used @ members, 1.0)
    positive = squares > 0
    return xp.where(positive, xp.sqrt(xp.where(positive, squares, 1.0)), 0.0) @ members.T


def sigma_of(
    errors: Float[Array, " J"],
    columns: Columns,
    predicted: Float[Array, "n J"],
    ok: Float[Array, " n"],
    data: Data,
) -> Float[Array, "n J"]:
    """σ = s·c of every column, SI; one without a used sample, and for a diverged simulation."""
    used = (data.weights > 0).astype(float)
    counts = (used > 0) & (ok[:, None] > 0)
    if not columns.is_relative.any():
        return jnp.where(counts, errors, 1.0)
    measured = magnitudes(data.values, used, columns.members)
    of_quantity = jnp.maximum(jnp.abs(predicted), _LEAST * measured)
    told = jnp.where(columns.is_quantity, of_quantity, measured / jnp.sqrt(1 + errors**2))
    size = jnp.where(columns.of_measured, measured, told)
    return jnp.where(counts, errors * jnp.where(columns.is_relative, size, 1.0), 1.0)


def whitened(standardised: Any, memory: Any) -> Any:
    """The innovation of every sample, (z_k − ρ z_{k−1})/√(1 − ρ²): white if ρ is right.

    Arguments:
        standardised: residuals, (…, n, J), an array of NumPy or of JAX.
        memory: ρ, (n, J).
    """
    # The first column has no sample before it: its ρ is zero, so the value that the roll brings there does not count.
    before = (jnp if isinstance(standardised, jax.Array) else np).roll(standardised, 1, axis=-1)
    return (standardised - memory * before) / (1 - memory**2) ** 0.5


def compared(
    errors: Float[Array, " J"],
    columns: Columns,
    predicted: Float[Array, "n J"],
    ok: Float[Array, " n"],
    data: Data,
) -> tuple[Float[Array, "n J"], Float[Array, "n J"]]:
    """z, and log σ of the density of y; both zero without a used sample, and where the simulation diverged."""
    counts = (data.weights > 0) & (ok[:, None] > 0)
    sigma = sigma_of(errors, columns, predicted, ok, data)
    z, log_sigma = (predicted - data.values) / sigma, jnp.log(sigma)
    of_logarithm = columns.is_logarithmic
    if of_logarithm.any():
        mean, sd = _moments(errors)
        measured = jnp.where(counts, data.values, 1.0)
        share = jnp.maximum(jnp.where(counts, predicted, 1.0) / measured, _LEAST)
        z = jnp.where(of_logarithm, (jnp.log(share) + mean) / sd, z)
        log_sigma = jnp.where(of_logarithm, jnp.log(sd) + jnp.log(jnp.abs(measured)), log_sigma)
    return jnp.where(counts, z, 0.0), jnp.where(counts, log_sigma, 0.0)


def sd_of_logarithm(errors: Float[Array, " J"]) -> Float[Array, " J"]:
    """Standard deviation of the logarithm of a measurement with relative error s."""
    return _moments(errors)[1]


def _moments(s: Float[Array, " J"]) -> tuple[Float[Array, " J"], Float[Array, " J"]]:
    """Mean and standard deviation of log|1 + sε|, ε standard normal, by Gauss–Hermite quadrature."""
    values = jnp.log(jnp.maximum(jnp.abs(1 + s[:, None] * _NODES), _SINGULAR))
    mean = values @ _SHARES
    return mean, jnp.sqrt((values - mean[:, None]) ** 2 @ _SHARES)


def decorrelated(z: Float[Array, "n J"], data: Data) -> Float[Array, " k"]:
    """The innovation of every residual, weighted: independent with unit variance if the likelihood is right; linear in z."""
    if data.decorrelation is not None:
        return data.decorrelation(z)
    return (jnp.sqrt(data.weights) * whitened(z, data.memory)).ravel()


def standardised_residual(z: Float[Array, "n J"], ok: Float[Array, " n"], data: Data) -> Float[Array, " k"]:
    """The innovation of z, zero without data; a diverged experiment counts as a thousand σ."""
    if data.decorrelation is not None:
        return data.decorrelation(jnp.where(ok[:, None] > 0, z, 1e3 * (data.weights > 0)))
    return (jnp.sqrt(data.weights) * jnp.where(ok[:, None] > 0, whitened(z, data.memory), 1e3)).ravel()


def log_likelihood(
    z: Float[Array, "n J"], log_sigma: Float[Array, "n J"], ok: Float[Array, " n"], data: Data
) -> Float[Array, ""]:
    """Log of Eq. 4, the normalising constant included."""
    residual = standardised_residual(z, ok, data)
    if data.decorrelation is None:
        of_correlation = jnp.sum(data.weights * 0.5 * jnp.log1p(-(data.memory**2)))
    else:
        of_correlation = 0.5 * data.decorrelation.log_determinant
    return -0.5 * jnp.sum(residual**2) - jnp.sum(data.weights * (0.5 * LOG_2PI + log_sigma)) - of_correlation
