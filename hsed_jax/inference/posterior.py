"""The posterior of one study as pure functions of unconstrained coordinates and data.

Coordinates u are unconstrained; θ(u) maps them into the support of the priors.  The parameters of the model come first, then
inferred errors, then the parameters of a population (`hsed_jax.inference.population`).  Nothing here depends on the number of
experiments: the data are padded and counted.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.likelihood import (
    Columns,
    Data,
    Error,
    compared,
    log_likelihood,
    magnitudes,
    sd_of_logarithm,
    sigma_of,
    standardised_residual,
)
from hsed_jax.inference.population import Level, Population, spread_scaling
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.prior_groups import Described, PriorGroups, root
from hsed_jax.inference.priors import Prior
from hsed_jax.programs import program

# Beyond this, the logistic and the exponential equal their bounds in double precision.
_FAR = 30.0
# log(σ/σ_min) of an error that is as large as the measurement.
_ROOM = 12.0
_LEAST_CURVATURE = 1e-3


@final
class Posterior(eqx.Module):
    """Prior and likelihood of a study.

    Its names are static, and the numbers of its priors are arrays: programs are compiled once for all posteriors that differ in
    arrays only.

    Arguments:
        predict: predictions of all experiments.
        priors: of the model's free parameters, by name, in the order `predict` takes them.
        errors: per output.
        outputs: names of the outputs, in the order of `errors`.
        groups: the output that each column of the data belongs to, (J,).
        levels: of the specimens, where parameters vary between them.

    Attributes:
        declared: sizes of the errors, one where it is inferred, (G,).
        inferred: of each inferred error the number of its output, and its place in θ.
        population: the parameters that vary between specimens.
    """

    predict: Predictor
    model_names: tuple[str, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    _described: Described = eqx.field(static=True)
    _known: PriorGroups
    _columns: tuple[int, ...] = eqx.field(static=True)
    _relative: tuple[bool, ...] = eqx.field(static=True)
    _of_measured: tuple[bool, ...] = eqx.field(static=True)
    inferred: tuple[tuple[int, int], ...] = eqx.field(static=True)
    declared: Float[Array, " outputs"]
    population: Population

    def __init__(
        self,
        predict: Predictor,
        priors: Mapping[str, Prior],
        errors: Sequence[Error],
        outputs: Sequence[str],
        groups: np.ndarray,
        levels: Sequence[Level] = (),
    ):
        sizes = [error.size for error in errors]
        inferred = {f"error.{output}": s for output, s in zip(outputs, sizes, strict=True) if isinstance(s, Prior)}
        self.predict = predict
        self.model_names, self.outputs = tuple(priors), tuple(outputs)
        self.population = Population(levels, len(priors) + len(inferred))
        known = {**priors, **inferred, **self.population.spreads}
        self.names, self._described = (*known, *self.population.offsets), Described(tuple(known.values()))
        spreads = self.population.spreads
        scalings = [spread_scaling(p) if name in spreads else p.scaling for name, p in known.items()]
        self._known = PriorGroups(self._described.priors, scalings)
        self._columns = tuple(np.asarray(groups).tolist())
        self._relative = tuple(error.is_relative for error in errors)
        self._of_measured = tuple(error.of_measured for error in errors)
        self.declared = jax.device_put(np.asarray([1.0 if isinstance(s, Prior) else s for s in sizes], dtype=float))
        self.inferred = tuple(
            (i, self.names.index(f"error.{name}")) for i, name in enumerate(self.outputs) if isinstance(sizes[i], Prior)
        )

    @property
    def priors(self) -> dict[str, Prior]:
        """Names of the reported parameters."""
        return dict(zip(self.reported, self._described.priors, strict=True))

    @property
    def reported(self) -> tuple[str, ...]:
        """The names of the first parameters, which have a physical meaning; the standardised offsets after them have none."""
        return self.names[: len(self.names) - len(self.population.offsets)]

    @property
    def fitted(self) -> int:
        """Number of parameters by which predictions are fitted."""
        return len(self.model_names) + len(self.population.offsets)

    @property
    def groups(self) -> np.ndarray:
        """The output that each column of the data belongs to, (J,)."""
        return np.asarray(self._columns)

    @property
    def is_declared(self) -> np.ndarray:
        """Whether the size of the error is declared, for each output."""
        return ~np.isin(np.arange(len(self.outputs)), [output for output, _ in self.inferred])

    def inflated(self, factors: np.ndarray) -> "Posterior":
        """The same with the declared errors larger by these factors, one per output."""
        return eqx.tree_at(lambda p: p.declared, self, self.declared * factors)

    @property
    def _errors(self) -> Columns:
        """The references of the errors of the columns."""
        members = (self.groups[:, None] == np.arange(len(self.outputs))).astype(float)
        relative, of_measured = (
            np.asarray(each, dtype=bool)[self.groups] for each in (self._relative, self._of_measured)
        )
        return Columns(relative, of_measured, members)

    def constrain(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """θ(u)."""
        return self.population.released(self._supported(u))

    def _supported(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        first, offsets = self._split(u)
        return jnp.concatenate([self._known.supported(first), offsets])

    def unconstrain(self, theta: Float[Array, " p"]) -> Float[Array, " p"]:
        """u(θ), kept finite at the bounds."""
        first, offsets = self._split(self.population.held(theta))
        u = jnp.concatenate([self._known.unsupported(first), offsets])
        return jnp.clip(jnp.nan_to_num(u, nan=0.0, posinf=_FAR, neginf=-_FAR), -_FAR, _FAR)

    def _split(self, values: Float[Array, " p"]) -> tuple[Array, Array]:
        """Coordinates with a prior of their own, and the offsets of a population."""
        size = len(self.reported)
        return values[:size], values[size:]

    def starts(self, count: int) -> Float[Array, "count p"]:
        """Well-spread starting points: the middle of the prior, then as many parts of its central 80 % along every parameter, a
        point in the middle of each (Latin hypercube; McKay, Beckman & Conover 1979)."""
        from scipy.stats import qmc

        # Even a few starts cover both sides of every prior, because a second mode may lie there.
        parts = qmc.LatinHypercube(len(self.reported), scramble=False, rng=0).random(max(count - 1, 1))
        shares = np.vstack([np.full((1, len(self.reported)), 0.5), 0.1 + 0.8 * parts])[:count]
        return self.at_shares(shares)

    def at_shares(self, shares: Float[np.ndarray, "s q"]) -> Float[Array, "s p"]:
        """Points of u at these quantiles of the priors."""
        columns = [
            np.asarray(prior.quantile(share)) for prior, share in zip(self._described.priors, shares.T, strict=True)
        ]
        theta = np.stack(columns, axis=1)
        # Offsets start at zero, because their sign is unknown.
        theta = np.pad(theta, ((0, 0), (0, len(self.population.offsets))))
        return unconstrained(self, jax.device_put(theta))

    def errors(self, theta: Float[Array, " p"]) -> Float[Array, " J"]:
        """s of every column: declared or taken from θ."""
        by_output = self.declared
        for output, position in self.inferred:
            by_output = by_output.at[output].set(theta[position])
        return by_output[self.groups]

    def sigma(
        self, theta: Float[Array, " p"], predicted: Float[Array, "n J"], ok: Float[Array, " n"], data: Data
    ) -> Float[Array, "n J"]:
        """σ of every datum, SI; one without a used sample, and for a diverged simulation."""
        return sigma_of(self.errors(theta), self._errors, predicted, ok, data)

    def _compared(
        self, theta: Float[Array, " p"], predicted: Float[Array, "n J"], ok: Float[Array, " n"], data: Data
    ) -> tuple[Float[Array, "n J"], Float[Array, "n J"]]:
        """z and log σ of every datum, as the likelihood has them."""
        return compared(self.errors(theta), self._errors, predicted, ok, data)

    def expected_sigma(
        self, theta: Float[Array, " p"], predicted: Float[Array, "n J"], data: Data
    ) -> Float[Array, "n J"]:
        """σ of a future measurement of the prediction, SI; a band uses it, since it has no measurement."""
        columns = self._errors
        size = magnitudes(predicted, (data.weights > 0).astype(float), columns.members)
        return self.errors(theta) * jnp.where(columns.is_relative, size, 1.0)

    def standardised(
        self, theta: Float[Array, " p"], predicted: Float[Array, "n J"], ok: Float[Array, " n"], data: Data
    ) -> Float[Array, "n J"]:
        """(f − y)/σ of predictions at parameters, neither weighted nor whitened; zero without data."""
        return (data.weights > 0) * (predicted - data.values) / self.sigma(theta, predicted, ok, data)

    def compared(self, theta: Float[Array, " p"], data: Data) -> Float[Array, "n J"]:
        """z at parameters, neither weighted nor whitened; zero without data and where the simulation diverged."""
        predicted, ok = self.predict(self.by_experiment(theta, data), data.conditions, data.count)
        return self._compared(theta, predicted, ok, data)[0]

    def log_density(self, u: Float[Array, " p"], data: Data) -> Float[Array, ""]:
        """Log posterior density *in u*, unnormalised, for samplers of u."""
        return self.log_density_of(u, *self.predictions(u, data), data)

    def predictions(self, u: Float[Array, " p"], data: Data) -> tuple[Float[Array, "n J"], Float[Array, " n"]]:
        """Outputs of the experiments, and 1 where the simulation converged, else 0."""
        return self.predict(self.by_experiment(self.constrain(u), data), data.conditions, data.count)

    def log_density_of(
        self, u: Float[Array, " p"], predicted: Float[Array, "n J"], ok: Float[Array, " n"], data: Data
    ) -> Float[Array, ""]:
        """`log_density` from known predictions."""
        theta = self.constrain(u)
        likelihood = log_likelihood(*self._compared(theta, predicted, ok, data), ok, data)
        return likelihood + self.log_prior(theta) + self._log_jacobian(u)

    def log_posterior(self, u: Float[Array, " p"], data: Data) -> Float[Array, ""]:
        """Log posterior density *in θ*, unnormalised (Eq. 5), which the MAP maximises."""
        theta = self.constrain(u)
        predicted, ok = self.predictions(u, data)
        return log_likelihood(*self._compared(theta, predicted, ok, data), ok, data) + self.log_prior(theta)

    def log_prior(self, theta: Float[Array, " p"]) -> Float[Array, ""]:
        """Log density of the prior."""
        return jnp.sum(self._known.log_density(self._split(theta)[0])) + self.population.log_prior(theta)

    def residuals(self, u: Float[Array, " p"], data: Data) -> Float[Array, " r"]:
        r"""ρ with ½ρᵀρ = −log posterior + constant, for a least-squares solver.

        Besides the standardised residuals there is one for each prior, $\pm\sqrt{2(\log p_{max}-\log p)}$ with the sign of
        θ − mode, and one for each inferred error, of one output of one experiment: $\sqrt{2N\log(\sigma/\sigma_{min})}$.
        """
        theta = self.constrain(u)
        predicted, ok = self.predictions(u, data)
        z, log_sigma = self._compared(theta, predicted, ok, data)
        parts = [standardised_residual(z, ok, data), self.prior_residuals(u)]
        inferred, columns = ~self.is_declared, self._errors
        if inferred.any():
            used = (data.weights > 0).astype(float)
            # Any fixed reference of the same order will do.
            size = jnp.where(columns.is_relative, magnitudes(data.values, used, columns.members), 1.0)
            excess = data.weights * (log_sigma - jnp.log(jnp.where(used > 0, size, 1.0)) + _ROOM)
            parts.append(root(2 * excess @ columns.members[:, inferred]).ravel())
        return jnp.concatenate(parts)

    def prior_residuals(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """The part of `residuals` that comes from the priors."""
        first, offsets = self._split(self.constrain(u))
        return jnp.concatenate([self._known.residuals(first), offsets])

    def stiffness(self, u: Float[Array, " p"]) -> Float[Array, " p"]:
        """Positive part of the curvature of prior and transformation in u."""
        return positive_part(self.prior_expansion(u)[-1])

    def prior_expansion(self, u: Float[Array, " p"]) -> tuple[Array, Array, Array, Array]:
        """Log density of the prior in θ and in u, (2,), their derivatives along u, (2, p), those of `prior_residuals`, (p, p),
        and the Hessian of the density in u, (p, p).

        The parameters are independent but for a population, so that one direction gives the derivatives of all.
        """
        first, ones = self._split(u)[0], jnp.ones(len(self.reported))

        def separate(first: Array) -> Array:
            theta = self._known.supported(first)
            density = self._known.log_density(theta)
            return jnp.stack([density, density + self._known.log_jacobian(first), self._known.residuals(theta)])

        def along(first: Array) -> tuple[Array, Array]:
            return jax.jvp(separate, (first,), (ones,))

        def common(u: Array) -> tuple[Array, Array]:
            theta = self.constrain(u)
            prior = self.population.log_prior(theta)
            return jnp.stack([prior, prior + self.population.log_jacobian(self._supported(u))]), self._split(theta)[1]

        (values, slopes), (_, curvatures) = jax.jvp(along, (first,), (ones,))
        (more, _), (more_slopes, offsets) = common(u), jax.jacfwd(common)(u)
        own = jnp.eye(len(first), len(u))
        return (
            jnp.sum(values[:2], axis=1) + more,
            slopes[:2] @ own + more_slopes,
            jnp.concatenate([slopes[2][:, None] * own, offsets]),
            own.T @ (curvatures[1][:, None] * own) + jax.hessian(lambda u: common(u)[0][1])(u),
        )

    def compared_along(
        self,
        u: Float[Array, " p"],
        predicted: Float[Array, "n J"],
        ok: Float[Array, " n"],
        along: Float[Array, "n J p"],
        data: Data,
    ) -> tuple[Any, Any, Any, Any]:
        """z and log σ, and the derivatives of both along u, (p, n, J), from the known derivatives of the outputs."""

        def comparison(u, predicted):
            return self._compared(self.constrain(u), predicted, ok, data)

        def moved(direction, of_outputs):
            return jax.jvp(comparison, (u, predicted), (direction, of_outputs))[1]

        z, log_sigma = comparison(u, predicted)
        return z, log_sigma, *jax.vmap(moved, in_axes=(0, -1))(jnp.eye(u.size), along)

    def sensitivities(
        self, u: Float[Array, " p"], data: Data
    ) -> tuple[Float[Array, "n J"], Float[Array, " n"], Float[Array, "n J p"]]:
        """Outputs, SI, 1 where the simulation converged, and the derivatives of the outputs along u, measured or not."""

        def outputs(u):
            predicted, ok = self.predictions(u, data)
            return predicted * ok[:, None], ok

        predicted, along, ok = _value_and_jacobian(outputs, u)
        return predicted, ok, along

    def displaced(
        self, theta: Float[Array, " p"], predicted: Float[Array, "n J"], by: Float[Array, "n J"], data: Data
    ) -> tuple[Float[Array, "n J"], Float[Array, "n J"]]:
        """Predictions moved by so many standard deviations of the error, SI, and the change by one more.

        If the error of a quantity is one of its logarithm, the logarithm is moved.
        """
        errors = self.errors(theta)
        of_logarithm, sd = self._errors.is_logarithmic, sd_of_logarithm(errors)
        moved = jnp.where(of_logarithm, predicted * jnp.exp(sd * by), 0.0)
        sigma = self.expected_sigma(theta, predicted, data)
        slope = jnp.where(of_logarithm, sd * jnp.abs(moved), sigma)
        return jnp.where(of_logarithm, moved, predicted + sigma * by), slope

    def of_model(self, theta: Float[Array, " p"]) -> Float[Array, " q"]:
        """The parameters of the model, without inferred errors; for a population, those at its centre."""
        return theta[: len(self.model_names)]

    def by_experiment(
        self, theta: Float[Array, " p"], data: Data, strangers: tuple[Float[Array, "_ _"], ...] = ()
    ) -> Float[Array, "m q"]:
        """The parameters of the model for all experiments, (1, q), or of each with its members, (n, q).

        Arguments:
            theta: all parameters.
            data: the experiments.
            strangers: standardised offsets of members that the population does not know, (K, ·) a level.
        """
        center = self.of_model(theta)
        if not self.population.levels:
            return center[None]
        return self.population.own(theta, center, data.members, strangers)

    def _log_jacobian(self, u: Float[Array, " p"]) -> Float[Array, ""]:
        of_priors = jnp.sum(self._known.log_jacobian(self._split(u)[0]))
        return of_priors + self.population.log_jacobian(self._supported(u))


def positive_part(hessian: Float[Array, "p p"]) -> Float[Array, " p"]:
    """The diagonal of minus a Hessian, made positive."""
    return jnp.maximum(-jnp.diag(hessian), _LEAST_CURVATURE)


def _value_and_jacobian(function: Callable, u: Float[Array, " p"]) -> tuple[Any, Any, Any]:
    """Value, derivative along u, and the other outputs of the function."""

    def twice(u):
        value, more = function(u)
        return value, (value, more)

    derivative, (value, more) = jax.jacfwd(twice, has_aux=True)(u)
    return value, derivative, more


@program
def constrained(posterior: Posterior, u: Float[Array, "N p"]) -> Float[Array, "N p"]:
    """θ of many points."""
    return jax.vmap(posterior.constrain)(u)


@program
def unconstrained(posterior: Posterior, theta: Float[Array, "N p"]) -> Float[Array, "N p"]:
    """u of many points."""
    return jax.vmap(posterior.unconstrain)(theta)
