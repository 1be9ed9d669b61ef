"""Predictions of all experiments at one value of the parameters, with their Jacobian, as one flat batch.

The parameters are few, so derivatives use forward mode: the tangents of a simulation travel with its values through the
integration.  Several parameter values at once (chains of NUTS, starts of the MAP) are more simulations on the same batch axis,
because nested batch axes cost several times as much.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int, PyTree

from hsed_jax.physics.batch import tile_of, tiled_map
from hsed_jax.physics.simulator import Conditions

# A simulation with derivatives has several times the state of one without, so fewer of them run together.
_WITH_DERIVATIVES = 2

Respond = Callable[[Float[Array, " p"], PyTree], tuple[Float[Array, " J"], Array]]


@final
class Predictor(eqx.Module):
    """One experiment's response turned into the predictions of all, differentiable once.

    Arguments:
        respond: from parameters (p,) and the conditions of one experiment to its outputs (J,) and whether it converged.
            Where it is an `eqx.Module`, its arrays are operands of the compiled programs, and equal objects share these
            programs.
    """

    respond: Respond

    def __call__(
        self, theta: Float[Array, "*m p"], conditions: PyTree, count: Int[Array, ""]
    ) -> tuple[Float[Array, "n J"], Float[Array, " n"]]:
        """Outputs (n, J) of the experiments and flags (n,): 1 where the simulation converged, else 0.

        Experiments beyond the count are not computed, and zero.  A diverged experiment has zero outputs and zero derivatives.

        Arguments:
            theta: parameters, (p,), or of each experiment its own, (n, p).
            conditions: of the experiments, leading axis n.
            count: how many experiments matter.
        """
        arrays, rest = eqx.partition(self.respond, eqx.is_array)
        return _predict(rest, arrays, jnp.atleast_2d(theta), conditions, jnp.asarray(count))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _predict(rest, arrays, theta, conditions, count):
    outputs, ok = _over_all(partial(_values, rest))(arrays, theta[None], conditions, count[None])
    return outputs[0], ok[0]


@_predict.defjvp
def _(rest, primals, tangents):
    arrays, theta, conditions, count = primals
    over_all = _over_all(partial(_values_and_jacobian, rest), _WITH_DERIVATIVES)
    outputs, ok, jacobian = over_all(arrays, theta[None], conditions, count[None])
    along = tangents[1]
    moved = jacobian[0] @ along[0] if len(along) == 1 else jnp.einsum("njp,np->nj", jacobian[0], along)
    return (outputs[0], ok[0]), (moved, jnp.zeros_like(ok[0]))


# Compiled separately, so that all programs of equal studies share one trace: tracing costs more than compiling.


@eqx.filter_jit
def _values(rest, arrays, batch):
    thetas, conditions = batch
    stop = None
    if isinstance(conditions, Conditions) and conditions.stop is not None:
        # One number for all simulations: otherwise the loop would check each of them at every step.
        stop, conditions = jnp.max(conditions.stop), conditions.until(None)

    def one(theta, own):
        outputs, ok = eqx.combine(rest, arrays)(theta, own if stop is None else own.until(stop))
        ok = ok & jnp.all(jnp.isfinite(outputs))
        return jnp.where(ok, outputs, 0.0), ok

    outputs, ok = jax.vmap(one)(thetas, conditions)
    return outputs, ok.astype(float)


@eqx.filter_jit
def _values_and_jacobian(rest, arrays, batch):
    thetas, conditions = batch

    def push(direction):
        tangent = jnp.broadcast_to(direction, thetas.shape)
        return jax.jvp(lambda t: _values(rest, arrays, (t, conditions)), (thetas,), (tangent,))

    (outputs, ok), (tangents, _) = jax.vmap(push, out_axes=((None, None), (-1, None)))(jnp.eye(thetas.shape[1]))
    tangents = jnp.where(jnp.isfinite(tangents), tangents, 0.0) * ok.reshape(-1, 1, 1)
    return outputs, ok, tangents


def _over_all(tile_function: Callable, fewer: int = 1) -> Callable:
    """Convert a function of a tile into one of parameters (C, 1 or n, p), conditions (n, …) and the number of relevant
    conditions for each of the C. Its batch is flat for any use of `vmap`.  Its tiles have so many times fewer
    simulations.
    """

    @custom_vmap
    def run(arrays, thetas, conditions, counts):
        size, chains = jax.tree.leaves(conditions)[0].shape[0], thetas.shape[0]
        tile = tile_of(chains * size) // fewer
        by_experiment = jnp.broadcast_to(thetas, (chains, size, thetas.shape[-1]))
        # Simulations that count come first, for every chain; the last tile is filled by repeating one of them.
        ends = jnp.cumsum(counts)
        simulation = jnp.minimum(jnp.arange(chains * size), jnp.maximum(ends[-1] - 1, 0))
        chain = jnp.minimum(jnp.sum(simulation[:, None] >= ends, axis=1), chains - 1)
        experiment = jnp.minimum(simulation - (ends - counts)[chain], size - 1)

        def of_tile(batch):
            # A tile selects its own conditions: those of all simulations would take more time than a few simulations.
            thetas, experiments = batch
            return tile_function(arrays, (thetas, jax.tree.map(lambda values: values[experiments], conditions)))

        results = tiled_map(of_tile, (by_experiment[chain, experiment], experiment), count=ends[-1], tile=tile)
        at = jnp.arange(size)
        where = jnp.minimum((ends - counts)[:, None] + at, chains * size - 1)
        matters = at < counts[:, None]

        def back(values):
            return jnp.where(matters.reshape(chains, size, *[1] * (values.ndim - 1)), values[where], 0)

        return jax.tree.map(back, results)

    @run.def_vmap
    def _(axis_size, in_batched, *operands: Any):
        batched_arrays, _, batched_conditions, _ = in_batched
        if any(jax.tree.leaves((batched_arrays, batched_conditions))):
            results = jax.lax.map(
                lambda i: run(
                    *(
                        jax.tree.map(lambda value, is_batched: value[i] if is_batched else value, tree, flags)
                        for tree, flags in zip(operands, in_batched, strict=True)
                    )
                ),
                jnp.arange(axis_size),
            )
            return results, jax.tree.map(lambda _: True, results)
        arrays, thetas, conditions, counts = operands
        thetas, counts = (
            values if is_batched else jnp.broadcast_to(values, (axis_size, *values.shape))
            for values, is_batched in ((thetas, in_batched[1]), (counts, in_batched[3]))
        )
        chains = thetas.shape[1]
        results = run(arrays, thetas.reshape(-1, *thetas.shape[2:]), conditions, counts.reshape(-1))
        return (
            jax.tree.map(lambda r: r.reshape(axis_size, chains, *r.shape[1:]), results),
            jax.tree.map(lambda _: True, results),
        )

    return run
