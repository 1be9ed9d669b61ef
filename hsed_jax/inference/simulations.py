r"""Simulations of all experiments at many points of u, and their derivatives: one compiled program for all callers.

Derivatives are central differences along the parameters of the model,
$\partial f/\partial\theta_k \approx [f(\theta + h_k e_k) - f(\theta - h_k e_k)]/2h_k$, with $h_k = h\,|d\theta_k/du_k|$ and u
the unconstrained coordinates, which are of order one.  Therefore no second program with tangents is compiled. The parameters
of errors and the offsets of a population cost no simulation.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from hsed_jax.backend import cores
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.predict import Predictor
from hsed_jax.physics.batch import NARROW, TILE
from hsed_jax.programs import program

# A call of the program has so many simulations, or so many points if there are many experiments: with fewer points, Python takes
# longer than the simulations.  The last number limits the output numbers: a call always writes all of them.
_LANES, _POINTS, _NUMBERS = 2 * TILE, 32, 2**18
# h: outputs of an external program have about six correct digits.  The truncation error is about a millionth.
_DIFFERENCE = 1e-3


def points_of_a_call(data: Data) -> int:
    """Number of points that are simulated together."""
    experiments = len(_distinct(data)[0])
    lanes = min(max(_LANES, _POINTS * experiments), max(_NUMBERS // data.values.shape[1], NARROW))
    return max(1, lanes // experiments)


def _distinct(data: Data) -> tuple[Int[np.ndarray, " r"], Int[np.ndarray, " n"]]:
    """The r experiments that are simulated, and of each experiment its place among them: the windows of one record have one
    simulation, unless their specimens have parameters of their own.
    """
    if data.members.shape[1]:
        every = np.arange(len(data.values))
        return every, every
    return np.unique(np.asarray(data.first), return_inverse=True)


def outputs_at(
    posterior: Posterior, data: Data, points: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N n J"], Float[np.ndarray, "N n"]]:
    """Outputs of all experiments at the points of a call, and 1 where their simulations converged, else 0."""
    thetas = np.asarray(_parameters(posterior, data, filled(points, points_of_a_call(data))))
    return _called(posterior, data, thetas[: len(points)])


def linearised_at(
    posterior: Posterior, data: Data, points: Float[np.ndarray, "N p"], size: int
) -> tuple[Float[np.ndarray, "N n J"], Float[np.ndarray, "N n"], Float[np.ndarray, "N n J p"]]:
    """As `outputs_at`, and the derivatives of the outputs along u; zero if the middle or both sides diverged.

    Arguments:
        posterior: of the study.
        data: measured outputs.
        points: of u.
        size: the most points of a call, for which the programs are made.
    """
    stencils = _stencils(posterior, data, filled(points, size))
    theta, steps, along = (np.asarray(values)[: len(points)] for values in stencils)
    offsets = steps[:, :, None, None] * np.eye(steps.shape[1])[:, None, :]
    stencil = np.concatenate([theta[:, None], theta[:, None] + offsets, theta[:, None] - offsets], axis=1)
    thetas = stencil.reshape(-1, *stencil.shape[2:])
    simulated = outputs_of(posterior, data, thetas)
    outputs, ok = (values.reshape(*stencil.shape[:2], *values.shape[1:]) for values in simulated)
    ahead, behind = np.split(np.arange(1, stencil.shape[1]), 2)
    # If one side diverged, the difference uses the other side and the middle.
    here = outputs[:, :1]
    sides = [np.where(ok[:, side, :, None] > 0, outputs[:, side], here) for side in (ahead, behind)]
    lengths = steps[:, :, None] * (ok[:, ahead] + ok[:, behind]) * ok[:, :1]
    slopes = (sides[0] - sides[1]) / np.where(lengths > 0, lengths, np.inf)[..., None]
    return (
        outputs[:, 0],
        ok[:, 0],
        np.einsum("sknj,snkp->snjp", slopes, np.broadcast_to(along, (len(along), slopes.shape[2], *along.shape[2:]))),
    )


def outputs_of(
    posterior: Posterior, data: Data, thetas: Float[np.ndarray, "N m q"]
) -> tuple[Float[np.ndarray, "N n J"], Float[np.ndarray, "N n"]]:
    """As `outputs_at`, of any number of parameter vectors of the model: for all experiments, or of each experiment its own."""
    # A call keeps one core busy.
    each = min(-(-len(thetas) // cores()), points_of_a_call(data))
    with ThreadPoolExecutor(cores()) as threads:
        calls = threads.map(lambda at: _called(posterior, data, thetas[at : at + each]), range(0, len(thetas), each))
        outputs, ok = (np.concatenate(values) for values in zip(*calls, strict=True))
    return outputs, ok


def filled(block: Float[np.ndarray, "k ..."], size: int) -> Float[np.ndarray, "size ..."]:
    """As many rows as a program has room for: the last one repeats."""
    return np.concatenate([block, np.repeat(block[-1:], size - len(block), axis=0)])


def _called(
    posterior: Posterior, data: Data, thetas: Float[np.ndarray, "N m q"]
) -> tuple[Float[np.ndarray, "N n J"], Float[np.ndarray, "N n"]]:
    """Outputs at parameters of the model, for all experiments or of each its own: one call of the program."""
    size, (rows, places) = points_of_a_call(data), _distinct(data)
    counts = np.where(np.arange(size) < len(thetas), np.count_nonzero(rows < np.asarray(data.count)), 0)
    # Without windows of one record, the conditions are passed as they are: selecting their rows copies them.
    conditions = data.conditions if len(rows) == len(places) else jax.tree.map(lambda leaf: leaf[rows], data.conditions)
    outputs, ok = _predictions(posterior.predict, filled(thetas, size), conditions, counts)
    return np.asarray(outputs)[: len(thetas), places], np.asarray(ok)[: len(thetas), places]


@program
def _predictions(
    predict: Predictor,
    thetas: Float[Array | np.ndarray, "S m q"],
    conditions: PyTree,
    counts: Int[Array | np.ndarray, " S"],
) -> tuple[Array, Array]:
    return jax.vmap(lambda theta, count: predict(theta, conditions, count))(thetas, counts)


@program
def _parameters(posterior: Posterior, data: Data, points: Float[Array | np.ndarray, "S p"]) -> Float[Array, "S m q"]:
    return jax.vmap(lambda u: posterior.by_experiment(posterior.constrain(u), data))(jnp.asarray(points))


@program
def _stencils(posterior: Posterior, data: Data, points: Float[Array | np.ndarray, "S p"]) -> tuple[Any, Any, Any]:
    """Parameters of the model (S, m, q), the lengths of differences along each (S, q), and derivatives along u (S, m, q, p)."""

    def own(u: Float[Array, " p"]) -> Float[Array, "m q"]:
        return posterior.by_experiment(posterior.constrain(u), data)

    def one(u: Float[Array, " p"]) -> tuple[Array, Array, Array]:
        center = jax.jacfwd(lambda x: posterior.of_model(posterior.constrain(x)))(u)
        steps = _DIFFERENCE * jnp.abs(jnp.diagonal(center[:, : center.shape[0]]))
        return own(u), jnp.maximum(steps, jnp.finfo(float).tiny), jax.jacfwd(own)(u)

    return jax.vmap(one)(jnp.asarray(points))
