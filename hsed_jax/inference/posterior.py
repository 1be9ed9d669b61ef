r"""The posterior of one study as pure functions of unconstrained coordinates and data.

Coordinates u are unconstrained; θ(u) maps them into the support of the priors.  Parameters of the model come first, inferred
errors after them.  Nothing here depends on how many experiments there are: the data are padded and counted.
"""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from hsed_jax.inference.likelihood import Data, log_likelihood, standardised_residual
from hsed_jax.inference.predict import Predict
from hsed_jax.inference.priors import Prior

# Beyond this the logistic and the exponential are at their bounds to double precision.
_FAR = 30.0


class Posterior:
    """Prior and likelihood of a study.

    Arguments:
        predict: predictions of all experiments (`hsed_jax.inference.predict.predictor`).
        priors: of the model's free parameters, by name, in the order `predict` takes them.
        errors: per output either a declared error (a number) or a `Prior` for an inferred one.
        outputs: names of the outputs, in the order of `errors`.
        groups: the output that each column of the data belongs to, (J,).
    """

    def __init__(
        self,
        predict: Predict,
        priors: Mapping[str, Prior],
        errors: Sequence[float | Prior],
        outputs: Sequence[str],
        groups: np.ndarray,
    ):
        self.predict = predict
        self.model_names = tuple(priors)
        inferred = {f"error.{output}": e for output, e in zip(outputs, errors, strict=True) if isinstance(e, Prior)}
        self.priors = {**priors, **inferred}
        self.names = tuple(self.priors)
        self.outputs, self.groups = tuple(outputs), np.asarray(groups)
        self._declared = jnp.asarray([1.0 if isinstance(e, Prior) else e for e in errors])
        positions = [
            self.names.index(f"error.{o}") for o, e in zip(outputs, errors, strict=True) if isinstance(e, Prior)
        ]
        self._inferred = (np.flatnonzero([isinstance(e, Prior) for e in errors]), np.asarray(positions, dtype=int))

    def constrain(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """θ(u)."""
        return jnp.stack([prior.to_support(x) for prior, x in zip(self.priors.values(), u, strict=True)])

    def unconstrain(self, theta: Float[Array, " p"]) -> Float[Array, " p"]:
        """u(θ), kept finite at the bounds."""
        u = jnp.stack([prior.to_support.inv(x) for prior, x in zip(self.priors.values(), theta, strict=True)])
        return jnp.clip(jnp.nan_to_num(u, nan=0.0, posinf=_FAR, neginf=-_FAR), -_FAR, _FAR)

    def starts(self, count: int) -> Float[Array, "count p"]:
        """Well-spread starting points: the middle of the prior, then Sobol' points of its central 80 %."""
        sequence = qmc.Sobol(len(self.names), scramble=True, rng=0)
        spread = 0.1 + 0.8 * sequence.random_base2(count.bit_length())[: max(count - 1, 1)]
        shares = np.vstack([np.full((1, len(self.names)), 0.5), spread])[:count]
        theta = np.stack(
            [np.asarray(prior.quantile(share)) for prior, share in zip(self.priors.values(), shares.T, strict=True)],
            axis=1,
        )
        return jnp.stack([self.unconstrain(row) for row in jnp.asarray(theta)])

    def errors(self, theta: Float[Array, " p"]) -> Float[Array, " J"]:
        """s of every column: declared or taken from θ."""
        outputs, positions = self._inferred
        by_output = self._declared.at[outputs].set(theta[positions]) if len(outputs) else self._declared
        return by_output[self.groups]

    def log_density(self, u: Float[Array, " p"], data: Data) -> Float[Array, ""]:
        """Log posterior density *in u*, unnormalised: what a sampler of u needs."""
        theta = self.constrain(u)
        return self._log_likelihood(theta, data) + self.log_prior(theta) + self._log_jacobian(u)

    def log_posterior(self, u: Float[Array, " p"], data: Data) -> Float[Array, ""]:
        """Log posterior density *in θ*, unnormalised (Eq. 5): what the MAP maximises."""
        theta = self.constrain(u)
        return self._log_likelihood(theta, data) + self.log_prior(theta)

    def log_prior(self, theta: Float[Array, " p"]) -> Float[Array, ""]:
        """Log density of the prior."""
        return sum(
            (prior.log_density(x) for prior, x in zip(self.priors.values(), theta, strict=True)), start=jnp.zeros(())
        )

    def residuals(self, u: Float[Array, " p"], data: Data) -> Float[Array, " r"]:
        r"""ρ with ½ρᵀρ = −log posterior + constant, for a least-squares solver.

        Besides the standardised residuals there is one for each prior, $\pm\sqrt{2(\log p_{max}-\log p)}$ with the sign of
        θ − mode, and one for each inferred error, $\sqrt{2N\log(s/s_{min})}$.
        """
        theta = self.constrain(u)
        errors = self.errors(theta)
        predicted, ok = self.predict(self._of_model(theta), data.conditions, data.count)
        parts = [standardised_residual(predicted, ok, errors, data).ravel()]
        for prior, x in zip(self.priors.values(), theta, strict=True):
            mode, highest = prior.mode
            parts.append(jnp.sign(x - mode)[None] * _root(2 * (highest - prior.log_density(x)))[None])
        for output, position in zip(*self._inferred, strict=True):
            number = jnp.sum(data.weights[:, self.groups == output])
            parts.append(_root(2 * number * (jnp.log(theta[position]) + 12))[None])
        return jnp.concatenate(parts)

    def information(self, u: Float[Array, " p"], data: Data) -> Float[Array, "p p"]:
        r"""Gauss–Newton (expected Fisher) information of θ(u) in u, without the prior.

        $F = \sum \frac{\partial f\,\partial f^\top}{\sigma^2} + 2\,\partial\log\sigma\,\partial\log\sigma^\top$
        """

        def scaled(u):
            theta = self.constrain(u)
            predicted, ok = self.predict(self._of_model(theta), data.conditions, data.count)
            return predicted * ok[:, None], jnp.log(self.errors(theta))

        by_mean, by_log_error = jax.jacfwd(scaled)(u)
        sigma = jnp.where(data.weights > 0, self.errors(self.constrain(u)) * data.scales, 1.0)
        g = (jnp.sqrt(data.weights) / sigma)[..., None] * by_mean
        number = jnp.sum(data.weights, axis=0)
        return jnp.einsum("njp,njq->pq", g, g) + 2 * jnp.einsum("j,jp,jq->pq", number, by_log_error, by_log_error)

    def curvature(self, u: Float[Array, " p"], data: Data) -> Float[Array, "p p"]:
        """Information plus the curvature of prior and transformation: minus the Hessian of `log_density`, made positive."""
        log_prior = jax.hessian(lambda v: self.log_prior(self.constrain(v)) + self._log_jacobian(v))(u)
        prior = jnp.diag(jnp.maximum(-jnp.diag(log_prior), 1e-3))
        return self.information(u, data) + prior

    def _of_model(self, theta: Float[Array, " p"]) -> Float[Array, " q"]:
        return theta[: len(self.model_names)]

    def _log_likelihood(self, theta: Float[Array, " p"], data: Data) -> Float[Array, ""]:
        predicted, ok = self.predict(self._of_model(theta), data.conditions, data.count)
        return log_likelihood(predicted, ok, self.errors(theta), data)

    def _log_jacobian(self, u: Float[Array, " p"]) -> Float[Array, ""]:
        terms = [
            p.to_support.log_abs_det_jacobian(x, p.to_support(x)) for p, x in zip(self.priors.values(), u, strict=True)
        ]
        return sum(terms, start=jnp.zeros(()))


def _root(value: Float[Array, ""]) -> Float[Array, ""]:
    positive = value > 1e-12
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)
