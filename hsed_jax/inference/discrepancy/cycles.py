r"""The model discrepancy of histories beyond the noise, learned with the parameters: a process over the cycles of the
response.

For experiment e and channel g, in units of the error, with φ the number of cycles of the predicted response so far and s² in
proportion to their amplitude,

$$\delta_{eg} = a_g\,s_{eg}\,\zeta_{eg}(\varphi_{eg}) + \partial_\theta z_{eg}\,b_e,\qquad
  \zeta \sim GP\big(0, k(\cdot\,; f, Q)\big),\qquad b_e\sim N(0, \operatorname{diag}\beta^2).$$

k is the covariance of a damped oscillator with f swings in a cycle and quality Q (Foreman-Mackey et al. 2017).  Its matrices
are quasiseparable, so every operation costs O(n).  The variance grows with the amplitude.  This is a compromise between a
constant error and an error in proportion to the motion, because errors of phase continue after the motion decays.  The second
term is the variation of the best parameters between experiments: with a wrong model, every experiment has its own best
parameters, and a few experiments determine their mean only roughly.

θ are the parameters that predict best over such experiments, in squares of the error.  Over these experiments, δ is on
average orthogonal to the sensitivities J of the parameters (Plumlee 2017).  In the performed experiments it has a random
component along J. Therefore J splits the information in C₀ = N + K, the covariance of noise and discrepancy.  The part along
J determines the parameters.  The part across J, which the parameters do not change, determines the process.  With both parts
independent,

$$z^\top C^{-1}z = z^\top J\,(J^\top C_0 J)^{-1}J^\top z + z^\top Q_0 z,\qquad
  Q_0 = C_0^{-1} - C_0^{-1}J\,(J^\top C_0^{-1}J)^{-1}J^\top C_0^{-1},$$

the estimate is that of least squares, with its covariance $(J^\top J)^{-1}J^\top C_0J\,(J^\top J)^{-1}$ for correlated
errors. Generalised least squares, without the split, would rely on the changes from sample to sample, and its parameters
would not predict best. $Q_0$ has this fault where predictions are nonlinear in the parameters.  Therefore the likelihood of
the parameters has $\kappa^2$ times the square of the part across J instead of $Q_0$, where κ² is the least weight of any
direction along J.  This is a power likelihood with a separate power for each direction (Chandler & Bate 2007).  Its maximum
is the point of least squares.
"""

import math
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Float
from tinygp.kernels.quasisep import SHO
from tinygp.solvers.quasisep.core import DiagQSM, LowerTriQSM, StrictLowerTriQSM, SymmQSM

from hsed_jax.inference.discrepancy.base import AbstractDiscrepancy
from hsed_jax.inference.likelihood import Data, whitened
from hsed_jax.programs import program

# Directions without a sensitivity still need a divisor.
_NONE = 1e-12


@final
class Splitting(eqx.Module):
    """Residuals of histories made independent, as far as the parameters are concerned.

    Attributes:
        along: the sensitivities of the outputs with a discrepancy, (nJ, p).
        factor: of Jᵀ C₀ J, (p, p).
        basis: orthonormal, of the columns of J, (nJ, p).
        across: κ.
        wrong: 1 where a discrepancy is learned, (n, J).
        memory: ρ of the noise of the others, (n, J).
        worth: root of the effective number of their samples, (n, J).
        log_determinant: of C.
    """

    along: Float[Array, "N p"]
    factor: Float[Array, "p p"]
    basis: Float[Array, "N p"]
    across: Float[Array, ""]
    wrong: Float[Array, "n J"]
    memory: Float[Array, "n J"]
    worth: Float[Array, "n J"]
    log_determinant: Float[Array, ""]

    def __call__(self, z: Float[Array, "n J"]) -> Float[Array, " k"]:
        """W z, (nJ + p,)."""
        own = (self.wrong * z).ravel()
        rest = self.across * (own - self.basis @ (self.basis.T @ own)).reshape(z.shape)
        others = (1 - self.wrong) * self.worth * whitened(z, self.memory)
        told = solve_triangular(self.factor, self.along.T @ own, lower=True)
        return jnp.concatenate([(rest + others).ravel(), told])


@final
class OverCycles(AbstractDiscrepancy):
    """A discrepancy of histories, in units of the error.

    Attributes:
        amplitudes: a_g, the RMS of a_g s ζ over the samples that were fitted; zero without a discrepancy, (G,).
        swings, quality: f and Q.
        spread: β, of the parameters between experiments, along u, (p,).
        reference: amplitude of a cycle, in units of the error, of which s is one, (G,).
        unit: σ of the histories, SI, (n, G).
        size, cycles: s and φ of the samples of the experiments, (n, G, m).
        along: J at all samples; zero of an output without a discrepancy, (n, G, m, p).
        used: 1 where there is a measurement, (n, G, m).
        memory: ρ of the noise, (n, G, m).
        worth: root of the effective number of samples without a learned discrepancy, (n, G, m).
    """

    amplitudes: Float[Array, " G"]
    swings: Float[Array, ""]
    quality: Float[Array, ""]
    spread: Float[Array, " p"]
    reference: Float[Array, " G"]
    unit: Float[Array, "n G"]
    size: Float[Array, "n G m"]
    cycles: Float[Array, "n G m"]
    along: Float[Array, "n G m p"]
    used: Float[Array, "n G m"]
    memory: Float[Array, "n G m"]
    worth: Float[Array, "n G m"]

    def of_others(self, amplitude: Float[Array, "m G k"], along: Float[Array, "m G k p"]) -> Float[Array, "m G k"]:
        """Variance of δ in other experiments.

        Arguments:
            amplitude: of the cycles there, in units of the error.
            along: the sensitivities there, in these units along u.
        """
        own = jnp.sum((along * self.spread) ** 2, axis=-1)
        return (self.amplitudes > 0)[:, None] * (
            self.amplitudes[:, None] ** 2 * amplitude / self.reference[:, None] + own
        )

    @property
    def settling(self) -> tuple[Array, ...]:
        """The quantities that change while the MAP moves."""
        return self.amplitudes, self.swings, self.quality, self.spread

    @property
    def whitening(self) -> Splitting:
        """The transformation that makes the residuals of the experiments independent, for the parameters."""
        return _splitting(self)

    def reach(self, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
        """Duration of a `swing` and of the `memory` (the correlation length), in `cycles` of the response."""
        swings, quality = float(self.swings), float(self.quality)
        return {"cycles": {"swing": 1 / swings, "memory": quality / (math.pi * swings)}}

    def conditional(self, z: Float[Array, "n J"]) -> tuple[Float[Array, "n J"], Float[Array, "n J"]]:
        """Mean error of predictions of the same experiments at the MAP, given their residuals z, and its variance.

        The variance includes the discrepancy and the parameters, which the measurements of these experiments cannot
        distinguish.
        """
        return _conditional(self, z)


def none_of(data: Data, parameters: int) -> Splitting:
    """The transformation for a correct model: the residuals are independent as they are."""
    along, one = jnp.zeros((data.values.size, parameters)), jnp.ones(())
    every = jnp.ones(data.values.shape)
    return Splitting(along, jnp.eye(parameters), along, one, every, 0 * every, every, jnp.zeros(()))


def _oscillation(process: OverCycles) -> SymmQSM:
    """Covariance of ζ of each history, nG of (m, m)."""
    kernel = SHO(omega=2 * jnp.pi * process.swings, quality=process.quality)
    return jax.vmap(kernel.to_symm_qsm)(_each(process.cycles))


def _each(table: Float[Array, "n G m"]) -> Float[Array, "nG m"]:
    return table.reshape(-1, table.shape[-1])


def _scaled(matrix: SymmQSM, by: Float[Array, "nG m"]) -> SymmQSM:
    """The matrix with scaled rows and columns."""
    lower = matrix.lower
    rows = by[..., None]
    return SymmQSM(DiagQSM(matrix.diag.d * by**2), StrictLowerTriQSM(rows * lower.p, rows * lower.q, lower.a))


def _of_histories(process: OverCycles) -> tuple[SymmQSM, SymmQSM, Float[Array, "nG m"]]:
    """Covariances of each history of the measurements, and of ζ; and the size of the latter, measured or not."""
    size = _each(process.amplitudes[:, None] * process.size)
    memory = _each(process.memory)[..., None]
    noise = SymmQSM(DiagQSM(jnp.ones_like(size)), StrictLowerTriQSM(memory, jnp.ones_like(memory), memory[..., None]))
    oscillation = _oscillation(process)
    measured = _scaled(oscillation, _each(process.used) * size)
    return jax.vmap(lambda one, other: one + other)(measured, noise), oscillation, size


class Products:
    """[z, J]ᵀ C⁻¹ [z, J] and what it takes.

    Attributes:
        factor: of each history.
        whitened: the columns, by that, (n, Gm, k).
        held: factor of I + GᵀG, with G the whitened contribution of b, (n, p, p).
        across: [z, J]ᵀ C₀⁻¹ [z, J].
        along: factor of Jᵀ C₀ J.
        products: as asked for.
        log_determinant: of C.
    """

    def __init__(self, process: OverCycles, columns: Float[Array, "n G m k"]):
        n, outputs, m, k = columns.shape
        covariance, _, _ = _of_histories(process)
        self.factor = jax.vmap(SymmQSM.cholesky)(covariance)
        each, plain = columns.reshape(n * outputs, m, k), columns.reshape(n, -1, k)
        self.whitened = jax.vmap(LowerTriQSM.solve)(self.factor, each).reshape(n, -1, k)
        own = self.whitened[..., 1:] * process.spread
        size = own.shape[-1]
        self.held = jnp.linalg.cholesky(jnp.eye(size) + jnp.einsum("nkp,nkq->npq", own, own))
        taken = jax.vmap(lambda factor, x: solve_triangular(factor, x, lower=True))(
            self.held, jnp.einsum("nkp,nkc->npc", own, self.whitened)
        )
        self.across = jnp.einsum("nkc,nkd->cd", self.whitened, self.whitened) - jnp.einsum("npc,npd->cd", taken, taken)
        # Log determinant of C₀ itself.
        spread = jax.vmap(SymmQSM.matmul)(covariance, each[..., 1:]).reshape(n, -1, size)
        gram = jnp.einsum("nkp,nkq->npq", plain[..., 1:], plain[..., 1:])
        inner = jnp.einsum("nkp,nkq->pq", plain[..., 1:], spread)
        inner = inner + jnp.einsum("npr,nqr->pq", gram * process.spread, gram * process.spread)
        self.along = _factor(inner)
        told = solve_triangular(self.along, jnp.einsum("nkp,nkc->pc", plain[..., 1:], plain), lower=True)
        rest = solve_triangular(_factor(self.across[1:, 1:]), self.across[1:], lower=True)
        self.products = told.T @ told + self.across - rest.T @ rest
        of_histories = jnp.sum(jnp.log(self.factor.diag.d)) + jnp.sum(
            jnp.log(jnp.diagonal(self.held, axis1=1, axis2=2))
        )
        of_split = _half_log(self.along) + _half_log(_factor(self.across[1:, 1:])) - 2 * _half_log(_factor(gram.sum(0)))
        self.log_determinant = 2 * (of_histories + of_split)


def _factor(matrix: Float[Array, "p p"]) -> Float[Array, "p p"]:
    return jnp.linalg.cholesky(matrix + _NONE * (1 + jnp.trace(matrix)) * jnp.eye(len(matrix)))


def _half_log(factor: Float[Array, "p p"]) -> Float[Array, ""]:
    return jnp.sum(jnp.log(jnp.diag(factor)))


@program
def _splitting(process: OverCycles) -> Splitting:
    along = process.used[..., None] * process.along
    n, p = len(along), along.shape[-1]
    found = Products(process, jnp.concatenate([jnp.zeros_like(along[..., :1]), along], axis=-1))
    along = along.reshape(-1, p)
    gram = _factor(along.T @ along)
    basis = solve_triangular(gram, along.T, lower=True).T
    sizes = jnp.linalg.svd(solve_triangular(gram, found.along, lower=True), compute_uv=False) ** 2
    wrong = jnp.broadcast_to((process.amplitudes > 0)[:, None], process.used.shape).astype(float)
    many = jnp.sum(wrong * process.used) - p
    log_determinant = jnp.sum(jnp.log(sizes)) + many * jnp.log(sizes[0])
    wrong, memory, worth = (table.reshape(n, -1) for table in (wrong, process.memory, process.worth))
    return Splitting(along, found.along, basis, sizes[0] ** -0.5, wrong, memory, worth, log_determinant)


@program
def _conditional(process: OverCycles, z: Float[Array, "n J"]):
    n, outputs, m = process.used.shape
    covariance, oscillation, size = _of_histories(process)
    used, everywhere = process.used[..., None] * process.along, process.along.reshape(n, -1, process.along.shape[-1])
    columns = jnp.concatenate([(process.used.ravel() * z.ravel()).reshape(n, outputs, m, 1), used], axis=-1)
    found = Products(process, columns)
    on = _each(process.used) * size

    def of_history(factor, oscillation, covariance, size, on, whitened):
        weighed = factor.transpose().solve(whitened)
        told = size[:, None] * oscillation.matmul(on[:, None] * weighed)
        lower = oscillation.lower
        back = StrictLowerTriQSM(lower.p, on[:, None] * lower.q, lower.a)
        rest = StrictLowerTriQSM(on[:, None] * lower.p, lower.q, lower.a)
        between = DiagQSM(oscillation.diag.d * on) + back + rest.transpose()
        left = oscillation.diag.d - (between @ covariance.inv() @ between.transpose()).diag.d
        return told, size**2 * jnp.maximum(left, 0.0)

    each = found.whitened.reshape(n * outputs, m, -1)
    told, left = jax.vmap(of_history)(found.factor, oscillation, covariance, size, on, each)
    told = told.reshape(n, outputs * m, -1)
    # The part of the sensitivities that ζ does not explain, and the part of the columns that b does not explain.
    open_along = everywhere - told[..., 1:]
    own = found.whitened[..., 1:] * process.spread
    amounts = jax.vmap(lambda factor, x: cho_solve((factor, True), x))(
        found.held, jnp.einsum("nkp,nkc->npc", own, found.whitened)
    )
    taken = told + jnp.einsum("nkp,npc->nkc", open_along * process.spread, amounts)
    common = _factor(found.across[1:, 1:])
    move = cho_solve((common, True), found.across[1:, 0])
    rest = everywhere - taken[..., 1:]
    mean = taken[..., 0] + rest @ move
    of_own = jax.vmap(lambda factor, x: solve_triangular(factor, x.T, lower=True))(
        found.held, open_along * process.spread
    )
    of_common = jax.vmap(lambda x: solve_triangular(common, x.T, lower=True))(rest)
    variance = left.reshape(n, -1) + jnp.sum(of_own**2, axis=1) + jnp.sum(of_common**2, axis=1)
    # z is predicted minus measured: the model is too small by −z.
    return -mean, variance
