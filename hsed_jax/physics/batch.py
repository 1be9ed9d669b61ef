"""A batch of experiments: a flat axis, run in tiles.

A tile of 64 keeps every state component in the first-level cache; memory grows with the tile, not with the batch.  A small
batch is cut into narrow tiles: unrequested simulations fill the last tile.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

TILE, NARROW = 64, 16
# A batch of more simulations than this fills wide tiles.
_SMALL = 2 * TILE


def tile_of(simulations: int) -> int:
    """Number of simulations of a batch that run together."""
    return NARROW if simulations <= _SMALL else TILE


def tiled_map[T, R](many: Callable[[T], R], batch: T, *, count: ArrayLike | None = None, tile: int = TILE) -> R:
    """Apply a batched function to all simulations of a batch, tile by tile.

    Arguments:
        many: from a tile of the batch (leading axis) to a pytree of arrays with the same leading axis; usually a `jax.vmap`.
        batch: pytree of arrays with a common leading axis of length N.
        count: how many simulations count (may be traced); tiles beyond it are not computed, and results beyond it are zero.
            The cost of one compiled program therefore depends on the data, and not on the padding.
        tile: simulations that run together.

    Returns:
        The results, leading axis N.
    """
    size = jax.tree.leaves(batch)[0].shape[0]
    tile = min(tile, size)
    tiles = -(-size // tile)
    padding = tiles * tile - size

    def cut(values: Array) -> Array:
        # Padding repeats the last simulation, so it converges like the data.
        padded = jnp.concatenate([values, jnp.repeat(values[-1:], padding, axis=0)]) if padding else values
        return padded.reshape(tiles, tile, *values.shape[1:])

    cuts = jax.tree.map(cut, batch)
    if count is None:
        results = cast(R, jax.lax.map(many, cuts))
    else:

        def one(i: Any) -> T:
            def at(values: Array) -> Array:
                return values[i]

            return jax.tree.map(at, cuts)

        def no_results(shape: jax.ShapeDtypeStruct) -> Array:
            return jnp.zeros((tiles, *shape.shape), shape.dtype)

        def one_tile(i: Any, filled: R) -> R:
            def put(kept: Array, new: Array) -> Array:
                return kept.at[i].set(new)

            return jax.tree.map(put, filled, many(one(i)))

        empty = jax.tree.map(no_results, jax.eval_shape(many, one(0)))
        results = cast(R, jax.lax.fori_loop(0, (jnp.asarray(count) + tile - 1) // tile, one_tile, empty))

    def joined(values: Array) -> Array:
        return values.reshape(tiles * tile, *values.shape[2:])[:size]

    results = jax.tree.map(joined, results)
    if count is None:
        return results
    matters = jnp.arange(size) < count

    def of_count(values: Array) -> Array:
        return jnp.where(matters.reshape(-1, *[1] * (values.ndim - 1)), values, 0)

    return jax.tree.map(of_count, results)
