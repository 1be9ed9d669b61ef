"""Priors computed by families: the same numbers as each prior alone, derivatives, and programs that other numbers share."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hsed_jax.inference.likelihood import Error
from hsed_jax.inference.population import Level, Varying
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.inference.prior_groups import PriorGroups
from hsed_jax.inference.priors import Prior
from hsed_jax.programs import _spelled

PRIORS = [
    Prior("lognormal", [1.0, 0.5]),
    Prior("uniform", [0, 1]),
    Prior("lognormal", [14.0, 0.1]),
    Prior("truncated_normal", {"loc": 1, "scale": 2, "low": 0}),
    Prior("half_normal", 1.0),
    Prior("uniform", [2, 5]),
    Prior("truncated_normal", {"loc": 3, "scale": 2, "low": 1, "high": 4}),
    Prior("gamma", [2.0, 3.0]),
]
U = jnp.linspace(-1.3, 1.2, len(PRIORS))


@pytest.fixture(scope="module")
def groups():
    return PriorGroups(PRIORS, [prior.scaling for prior in PRIORS])


@pytest.mark.whole
def test_every_prior_has_the_numbers_that_it_has_alone(groups):
    theta = groups.supported(U)
    alone = [(prior, float(u), prior.to_support(u)) for prior, u in zip(PRIORS, U, strict=True)]
    np.testing.assert_allclose(theta, [x for *_, x in alone], rtol=1e-14)
    np.testing.assert_allclose(groups.unsupported(theta), U, rtol=1e-12)
    np.testing.assert_allclose(groups.log_density(theta), [prior.log_density(x) for prior, _, x in alone], rtol=1e-13)
    slopes = [prior.to_support.log_abs_det_jacobian(u, x) for prior, u, x in alone]
    np.testing.assert_allclose(groups.log_jacobian(U), slopes, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(jnp.exp(groups.log_jacobian(U)), jnp.diag(jax.jacfwd(groups.supported)(U)), rtol=1e-12)
    below = [prior.mode[1] - prior.log_density(x) for prior, _, x in alone]
    np.testing.assert_allclose(groups.residuals(theta) ** 2 / 2, below, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def posteriors():
    """Two posteriors whose priors differ in their numbers; the second kind has a level of three bars."""

    def made(shift, levels=()):
        priors = {"a": Prior("lognormal", [1.0 + shift, 0.5]), "b": Prior("uniform", [0, 2 + shift]),
                  "c": Prior("lognormal", [3.0, 0.5 + shift])}  # fmt: skip
        errors = [Error(Prior("half_normal", 1.0 + shift))]
        return Posterior(Predictor(line), priors, errors, ["y"], np.arange(1), levels)

    bars = Level("bar", ("x", "y", "z"), (Varying("a", 0, True, Prior("half_normal", 0.3)),))
    return {"alone": (made(0.0), made(0.25)), "population": (made(0.0, [bars]), made(0.25, [bars]))}


def line(theta, conditions):
    return theta[:1] + theta[1] * conditions["x"], jnp.asarray(True)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["alone", "population"])
def test_the_derivatives_are_those_of_the_density_in_either_coordinates(posteriors, kind):
    posterior, _ = posteriors[kind]
    u = jnp.asarray(posterior.starts(3)[2]) + jnp.linspace(-0.2, 0.3, len(posterior.names))

    def in_theta(u):
        return posterior.log_prior(posterior.constrain(u))

    def in_u(u):
        return in_theta(u) + jnp.linalg.slogdet(jax.jacfwd(posterior.constrain)(u))[1]

    values, slopes, of_residuals, hessian = posterior.prior_expansion(u)
    np.testing.assert_allclose(values, [in_theta(u), in_u(u)], rtol=1e-12)
    np.testing.assert_allclose(slopes, [jax.jacfwd(in_theta)(u), jax.jacfwd(in_u)(u)], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(of_residuals, jax.jacfwd(posterior.prior_residuals)(u), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(hessian, jax.hessian(in_u)(u), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("kind", ["alone", "population"])
def test_posteriors_with_other_numbers_share_their_programs(posteriors, kind):
    one, other = posteriors[kind]
    assert jax.tree.structure(one) == jax.tree.structure(other)
    arrays = [jax.tree.leaves(posterior) for posterior in (one, other)]
    assert [np.shape(a) for a in arrays[0]] == [np.shape(a) for a in arrays[1]]
    assert not all(np.array_equal(a, b) for a, b in zip(*arrays, strict=True))
    assert one.priors != other.priors
    # The name of a stored program.
    spelled = [_spelled(jax.tree.map(lambda _: None, posterior._known)) for posterior in (one, other)]
    assert spelled[0] == spelled[1]


USUAL = [
    Prior("uniform", [2, 5]),
    Prior("normal", [-3.0, 0.2]),
    Prior("lognormal", [16.0, 0.7]),
    Prior("half_normal", 0.3),
    Prior("truncated_normal", {"loc": 0.0, "scale": 0.5, "low": -0.95, "high": 5.0}),
    Prior("truncated_normal", {"loc": 0.0, "scale": 1.0, "low": 3.0, "high": 4.0}),
    Prior("truncated_normal", {"loc": 2.0, "scale": 0.5, "low": -0.3, "high": 0.4}),
]


@pytest.mark.parametrize("prior", USUAL, ids=repr)
def test_quantiles_and_modes_in_closed_form_are_those_of_numpyro(prior):
    shares = np.linspace(0.001, 0.999, 41)
    values = np.asarray(prior.distribution.icdf(jnp.asarray(shares)))
    np.testing.assert_allclose(prior.quantile(shares), values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose([prior.quantile(float(share)) for share in shares], values, rtol=1e-9, atol=1e-12)
    mode, highest = prior.mode
    inside = np.nextafter(mode, prior.quantile(0.5))
    assert highest == pytest.approx(float(prior.distribution.log_prob(inside)), rel=1e-9)
    assert highest >= float(np.max(prior.distribution.log_prob(jnp.asarray(values))))
