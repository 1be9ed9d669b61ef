"""Predictions for many pairs of parameters and experiments, by one compiled program of a fixed size.

What differs between two studies of the same kind (masses, scales, data, parameters) is an operand of the program, not a
constant in it, so that a process that looks at a hundred campaigns compiles once.  Chunks go to threads: XLA runs a program of
this kind on one core, and several at a time on several.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hsed_jax.backend import cores
from hsed_jax.inference.observation import Observation, Outputs
from hsed_jax.physics.batch import tiled_map
from hsed_jax.physics.simulator import AbstractModel, Conditions

_CHUNK = 256
_FAR = 1e100


class Lanes:
    """Outputs of a model over lanes, each a parameter vector and the number of an experiment.

    Arguments:
        model: the computational model.
        observation: what of a response is predicted.
        names: of the parameters, in the order of a parameter vector.
        conditions: of the experiments, leading axis n.
    """

    def __init__(self, model: AbstractModel, observation: Observation, names: tuple[str, ...], conditions: Conditions):
        self._run = partial(_outputs, Outputs(model, observation, names), conditions)
        self._threads = ThreadPoolExecutor(cores())

    def __call__(
        self, thetas: Float[np.ndarray, "L P"], experiments: Int[np.ndarray, " L"]
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """Outputs (L, J) and whether each lane converged (L,); outputs of a lane that diverged are zero."""

        def chunk(start: int):
            part = slice(start, start + _CHUNK)
            size = len(experiments[part])
            padding = ((0, _CHUNK - size),)
            outputs, ok = self._run(
                jnp.asarray(np.pad(thetas[part], (*padding, (0, 0)), mode="edge")),
                jnp.asarray(np.pad(experiments[part], padding, mode="edge")),
                jnp.asarray(size),
            )
            return np.asarray(outputs)[:size], np.asarray(ok)[:size]

        parts = list(self._threads.map(chunk, range(0, len(experiments), _CHUNK)))
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


@eqx.filter_jit
def _outputs(respond, conditions, thetas, experiments, count):
    def one(lane):
        theta, experiment = lane
        at_it = jax.tree.map(lambda leaf: leaf[experiment], conditions)
        outputs, ok = respond(theta, at_it)
        # On its way to infinity a diverging simulation passes numbers whose squares are no numbers any more.
        ok = ok & jnp.all(jnp.abs(outputs) < _FAR)
        return jnp.where(ok, outputs, 0.0), ok

    outputs, ok = tiled_map(jax.vmap(one), (thetas, experiments), count=count)
    return outputs, ok.astype(float)
