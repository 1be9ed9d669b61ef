"""Outputs that demand different parameters: against closed forms of linear models, and agreement where there is one set."""

import jax.numpy as jnp
import numpy as np
import pytest
from builders.posteriors import find, measured_at, posterior_of
from scipy import stats

import hsed_jax as hx
from hsed_jax.inference.disagreement import disagreement
from hsed_jax.inference.priors import Prior

X = np.linspace(0.0, 2.0, 12)
SIGMA = np.array([0.2, 0.5])
WIDE = 10.0
# What each output is of a and b.
OF = np.stack([np.stack([np.ones(12), X], axis=1), np.stack([np.sin(3 * X), X**2], axis=1)])
UNITS = {"a": "N/m", "b": "1"}


def line_and_wave(theta, conditions):
    a, b = theta
    x = conditions.inputs["x"]
    return jnp.stack([a + b * x, a * jnp.sin(3 * x) + b * x**2]), jnp.asarray(True)


POSTERIOR = posterior_of(
    line_and_wave, {name: Prior("normal", [0.0, WIDE]) for name in ("a", "b")}, [float(s) for s in SIGMA]
)


def measured(first, second, seed=0, noise=0.5):
    """Both outputs, each with its own parameters; the noise is less than declared, so that no misfit counts as noise."""
    values = np.stack([of @ np.asarray(theta) for of, theta in zip(OF, (first, second), strict=True)], axis=1)
    draws = np.random.default_rng(seed).standard_normal(values.shape)
    return measured_at(X, values + noise * SIGMA * draws)


def judged(data):
    return disagreement(POSTERIOR, data, np.asarray(find(POSTERIOR, data).u), UNITS)


@pytest.mark.whole
def test_the_difference_is_that_of_two_least_squares_fits():
    data = measured((1.0, 2.0), (1.0, 2.6))
    found = judged(data)
    assert found is not None
    one = ("y0", "y1").index(found.output)
    fits = []
    for g in (one, 1 - one):
        information = OF[g].T @ OF[g] / SIGMA[g] ** 2 + (0.0 if g == one else np.eye(2) / WIDE**2)
        values = np.asarray(data.values)[:, g]
        fits.append((np.linalg.solve(information, OF[g].T @ values / SIGMA[g] ** 2), np.linalg.inv(information)))
    apart = fits[0][0] - fits[1][0]
    exact = apart @ np.linalg.solve(fits[0][1] + fits[1][1], apart)
    assert found.statistic == pytest.approx(exact, rel=1e-3) and found.freedom == 2
    assert found.p_value == pytest.approx(stats.chi2(2).sf(exact), rel=1e-2) and found.p_value < 1e-3
    # The estimates have the priors, and the errors of Gaussian posteriors.
    for who, g in (("alone", one), ("others", 1 - one)):
        information = OF[g].T @ OF[g] / SIGMA[g] ** 2 + np.eye(2) / WIDE**2
        center = np.linalg.solve(information, OF[g].T @ np.asarray(data.values)[:, g] / SIGMA[g] ** 2)
        for k, name in enumerate(("a", "b")):
            assert found.parameters[name][who].value == pytest.approx(center[k], abs=2e-3)
            assert found.parameters[name][who].sd == pytest.approx(np.sqrt(np.linalg.inv(information)[k, k]), rel=1e-3)
    sizes = [abs(apart[k]) / np.sqrt(fits[0][1][k, k] + fits[1][1][k, k]) for k in range(2)]
    assert list(found.parameters) == (["a", "b"] if sizes[0] > sizes[1] else ["b", "a"])
    assert f"{found.output} demands other parameters than {found.others[0]}" in found.sentence
    summary = found.summary()
    assert summary["parameters"]["b"]["alone"]["value"] == found.parameters["b"]["alone"].value
    assert summary["p_value"] == found.p_value and summary["sentence"] == found.sentence


@pytest.mark.whole
def test_outputs_with_one_set_of_parameters_agree():
    assert not any(judged(measured((1.0, 2.0), (1.0, 2.0), seed, noise=1.0)) for seed in range(40))


def test_the_larger_the_difference_the_larger_the_statistic():
    found = [judged(measured((1.0, 2.0), (1.0, 2.0 + d))) for d in (0.4, 0.6, 0.9)]
    sizes = [one.statistic for one in found if one is not None]
    assert len(sizes) == 3 and sizes == sorted(sizes) and sizes[0] > stats.chi2(2).isf(1e-3)


def test_a_general_misfit_is_no_disagreement():
    # A curve that no parameter makes: the residual of one on the columns of the second output.
    left = np.ones(12) - OF[1] @ np.linalg.lstsq(OF[1], np.ones(12), rcond=None)[0]
    bent = measured((1.0, 2.0), (1.0, 2.0))
    values = np.asarray(bent.values) + np.stack([np.zeros(12), 5.0 * left], axis=1)
    assert judged(measured_at(X, values)) is None


def test_one_output_disagrees_with_nothing():
    data = measured((1.0, 2.0), (1.0, 2.6))
    values = np.array(data.values)
    values[:, 1] = np.nan
    assert judged(measured_at(X, values)) is None


@pytest.mark.whole
@pytest.mark.parametrize("is_missing", [True, False])
def test_an_effect_that_the_model_lacks_sets_elongation_and_force_apart(is_missing):
    changes = ["calibration.sampler=laplace", "calibration.starts=2"]
    changes += [] if is_missing else ["experiments.virtual.effects={}"]
    study = hx.load_study("configs/hidden_effect.yaml", changes)
    calibration = hx.calibrate(study)
    found = calibration.fit.disagreement
    assert (found is not None) == is_missing
    assert ("demands other parameters than" in str(calibration)) == is_missing
