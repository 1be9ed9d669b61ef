"""Predictions of histories with a discrepancy: of experiments that were fitted, and of others."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.discrepancy.cycles import OverCycles
from hsed_jax.inference.discrepancy.learning import cycle_history, sensitivities
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.programs import program


def shortfall(
    process: OverCycles, posterior: Posterior, fitted: Data, u: Float[Array, " p"], data: Data
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean error of predictions at the MAP, SI.

    The measurements of an experiment predict its continuation. For another experiment the discrepancy is a new draw of the
    process.

    Arguments:
        process: the discrepancy.
        posterior: of the study.
        fitted: the experiments that it was learned from.
        u: unconstrained coordinates of the MAP.
        data: the experiments to predict.

    Returns:
        1 where an output with a discrepancy is that of an experiment that was fitted; the mean, and the variance, each (n, J).
    """
    predicted, _, along, _ = map(np.asarray, sensitivities(posterior, data, u))
    theta, shape = posterior.constrain(u), (len(predicted), len(posterior.outputs), -1)
    sigma = np.asarray(_expected_sigma(posterior, theta, jnp.asarray(predicted), data))
    sigma = np.where(sigma > 0, sigma, 1.0)
    amplitude = cycle_history(predicted.reshape(shape)).amplitude / sigma.reshape(shape)
    in_units = (along / sigma[..., None]).reshape(*shape, along.shape[-1])
    open_there = process.of_others(jnp.asarray(amplitude), jnp.asarray(in_units))
    variance = np.asarray(open_there).reshape(sigma.shape) * sigma**2
    mean, rows = np.zeros_like(sigma), _fitted_rows(fitted, data)
    if (own := rows >= 0).any():
        short, left = process.conditional(_residuals(posterior, theta, fitted))
        unit = np.repeat(np.asarray(process.unit), sigma.shape[1] // shape[1], axis=1)
        mean[own], variance[own] = (unit * short)[rows[own]], (unit**2 * left)[rows[own]]
    wrong = np.repeat(np.asarray(process.amplitudes) > 0, sigma.shape[1] // shape[1])
    return (own[:, None] & wrong).astype(float), mean, variance


@program
def _expected_sigma(posterior: Posterior, theta: Array, predicted: Array, data: Data) -> Array:
    return posterior.expected_sigma(theta, predicted, data)


@program
def _residuals(posterior: Posterior, theta: Array, data: Data) -> Array:
    return posterior.compared(theta, data)


def _fitted_rows(fitted: Data, data: Data) -> np.ndarray:
    """For each experiment, the row of the fitted experiment that it is or continues; -1 for others, (n,)."""
    ours = [np.asarray(leaf) for leaf in jax.tree.leaves(data.conditions)]
    theirs = [np.asarray(leaf)[: int(fitted.count)] for leaf in jax.tree.leaves(fitted.conditions)]
    rows = np.full(len(data.values), -1)
    if len(ours) != len(theirs) or any(a.shape[1:] != b.shape[1:] for a, b in zip(ours, theirs, strict=True)):
        return rows
    measured, known = np.asarray(data.values), np.asarray(data.weights) > 0
    before, was_known = np.asarray(fitted.values), np.asarray(fitted.weights) > 0
    for row in range(len(rows)):
        alike = np.all(
            [(a[row] == b).reshape(len(b), -1).all(axis=1) for a, b in zip(ours, theirs, strict=True)], axis=0
        )
        both = known[row] & was_known[: len(alike)]
        alike &= np.all((measured[row] == before[: len(alike)]) | ~both, axis=1)
        # If it may continue several experiments, the right one is unknown.
        if alike.sum() == 1:
            rows[row] = int(alike.argmax())
    return rows
