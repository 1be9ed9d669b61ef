"""A batch of experiments: a flat axis, run in tiles.

A tile of 64 keeps every state component in the first-level cache; memory grows with the tile, not with the batch.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import PyTree

TILE = 64


def tiled_map(
    many: Callable[[PyTree], PyTree], lanes: PyTree, *, count: ArrayLike | None = None, tile: int = TILE
) -> PyTree:
    """Apply a batched function to all lanes, tile by tile.

    Arguments:
        many: from a tile of lanes (leading axis) to a pytree of arrays with the same leading axis; usually a `jax.vmap`.
        lanes: pytree of arrays with a common leading axis of length N.
        count: how many lanes matter (may be traced); tiles beyond it are not computed, and the results of lanes beyond
            it are zero.  With it, one compiled program costs what the data need, whatever they are padded to.
        tile: lanes that run together.

    Returns:
        The results, leading axis N.
    """
    size = jax.tree.leaves(lanes)[0].shape[0]
    tile = min(tile, size)
    tiles = -(-size // tile)
    padding = tiles * tile - size

    def cut(values):
        # Padding repeats the last lane, so that it is as well behaved as the data.
        padded = jnp.concatenate([values, jnp.repeat(values[-1:], padding, axis=0)]) if padding else values
        return padded.reshape(tiles, tile, *values.shape[1:])

    cuts = jax.tree.map(cut, lanes)
    if count is None:
        results = jax.lax.map(many, cuts)
    else:
        shapes = jax.eval_shape(many, jax.tree.map(lambda values: values[0], cuts))
        empty = jax.tree.map(lambda s: jnp.zeros((tiles, *s.shape), s.dtype), shapes)

        def one_tile(i, filled):
            result = many(jax.tree.map(lambda values: values[i], cuts))
            return jax.tree.map(lambda kept, new: kept.at[i].set(new), filled, result)

        results = jax.lax.fori_loop(0, (jnp.asarray(count) + tile - 1) // tile, one_tile, empty)
    results = jax.tree.map(lambda values: values.reshape(tiles * tile, *values.shape[2:])[:size], results)
    if count is None:
        return results
    matters = jnp.arange(size) < count
    return jax.tree.map(lambda values: jnp.where(matters.reshape(-1, *[1] * (values.ndim - 1)), values, 0), results)
