"""Predictions of all experiments at one value of the parameters, with their Jacobian, as one flat batch.

Few parameters call for forward mode: the tangents of a lane travel with its values through the integration.  Several
parameter values at once (chains of NUTS, starts of the MAP) are not a second batch axis but more lanes on the same one, since
nested batch axes cost several times as much.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int, PyTree

from hsed_jax.physics.batch import tiled_map

Respond = Callable[[Float[Array, " p"], PyTree], tuple[Float[Array, " J"], Array]]
Predict = Callable[[Float[Array, " p"], PyTree, Int[Array, ""]], tuple[Float[Array, "n J"], Float[Array, " n"]]]


def predictor(respond: Respond) -> Predict:
    """Turn one experiment's response into the predictions of all, differentiable once.

    Arguments:
        respond: from parameters (p,) and the conditions of one experiment to its outputs (J,) and whether it converged.

    Returns:
        A function of parameters (p,), stacked conditions (leading axis n) and the count of experiments that matter, to the
        outputs (n, J) and flags (n,): 1 where the simulation converged, else 0.  Experiments beyond the count are not
        computed, and zero.  A diverged experiment has zero outputs and zero derivatives.
    """

    def one(lane):
        outputs, ok = respond(*lane)
        ok = ok & jnp.all(jnp.isfinite(outputs))
        return jnp.where(ok, outputs, 0.0), ok

    def values(lanes):
        outputs, ok = jax.vmap(one)(lanes)
        return outputs, ok.astype(float)

    def values_and_jacobian(lanes):
        thetas, conditions = lanes

        def many(t):
            return values((t, conditions))

        def push(direction):
            return jax.jvp(many, (thetas,), (jnp.broadcast_to(direction, thetas.shape),))

        (outputs, ok), (tangents, _) = jax.vmap(push, out_axes=((None, None), (-1, None)))(jnp.eye(thetas.shape[1]))
        tangents = jnp.where(jnp.isfinite(tangents), tangents, 0.0) * ok.reshape(-1, 1, 1)
        return outputs, ok, tangents

    values_of_all = _over_all(values)
    jacobian_of_all = _over_all(values_and_jacobian)

    @jax.custom_jvp
    def predict(theta, conditions, count):
        outputs, ok = values_of_all(theta[None], conditions, count)
        return outputs[0], ok[0]

    @predict.defjvp
    def _(primals, tangents):
        theta, conditions, count = primals
        outputs, ok, jacobian = jacobian_of_all(theta[None], conditions, count)
        return (outputs[0], ok[0]), (jacobian[0] @ tangents[0], jnp.zeros_like(ok[0]))

    return predict


def _over_all(tile_function: Callable) -> Callable:
    """From a function of a tile of lanes to one of parameters (C, p) and conditions (n, …), flat whatever is vmapped."""

    @custom_vmap
    def run(thetas, conditions, count):
        size, chains = jax.tree.leaves(conditions)[0].shape[0], thetas.shape[0]
        lanes = (
            jnp.tile(thetas, (size, 1)),
            jax.tree.map(lambda values: jnp.repeat(values, chains, axis=0), conditions),
        )
        # Experiments vary slowest, so those that matter stay a prefix.
        results = tiled_map(tile_function, lanes, count=count * chains)
        return jax.tree.map(lambda r: jnp.moveaxis(r.reshape(size, chains, *r.shape[1:]), 0, 1), results)

    @run.def_vmap
    def _(axis_size, in_batched, thetas, conditions, count):
        batched_thetas, batched_conditions, batched_count = in_batched
        if any(jax.tree.leaves(batched_conditions)) or batched_count:
            results = jax.lax.map(
                lambda i: run(
                    *(
                        jax.tree.map(lambda value, is_batched: value[i] if is_batched else value, tree, flags)
                        for tree, flags in zip((thetas, conditions, count), in_batched, strict=True)
                    )
                ),
                jnp.arange(axis_size),
            )
            return results, jax.tree.map(lambda _: True, results)
        assert batched_thetas
        chains = thetas.shape[1]
        results = run(thetas.reshape(axis_size * chains, -1), conditions, count)
        return (
            jax.tree.map(lambda r: r.reshape(axis_size, chains, *r.shape[1:]), results),
            jax.tree.map(lambda _: True, results),
        )

    return run
