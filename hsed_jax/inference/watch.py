"""Progress of a long calculation: its reports, and the state that it stores in order to continue.

A calculation gets a `Watch` and knows of no bars and no files.
"""

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

if TYPE_CHECKING:
    from hsed_jax.inference.likelihood import Data


class Watch:
    """Follows a calculation; this class neither shows nor stores anything."""

    def report(self, what: str) -> None:
        """Receive the current activity of the calculation."""

    def count(self, done: int, total: int) -> None:
        """Receive the completed share."""

    def lead(self, content: dict[str, Any]) -> None:
        """Receive the best result so far, in the words of `summary.json`."""

    def fitted(self, predicted: np.ndarray, data: "Data", groups: np.ndarray) -> None:
        """Receive the predictions (n, J) of the most probable parameters before the sampling; `groups`: the output of
        each column.
        """

    def keep(self, name: str, arrays: Sequence[np.ndarray]) -> None:
        """Store a state under a name, instead of an earlier one."""

    def recall(self, name: str) -> list[np.ndarray] | None:
        """The state that is stored under a name; None without one."""
        return None


def fingerprint(*parts: Any) -> str:
    """A short name of the inputs of a calculation: of all numbers and words in them, to the last bit."""
    digest = hashlib.blake2b(digest_size=10)
    for leaf in jax.tree.leaves(parts):
        if isinstance(leaf, str):
            digest.update(leaf.encode())
        elif eqx.is_array_like(leaf):
            values = np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)
            digest.update(f"{values.dtype}{values.shape}".encode() + values.tobytes())
    return digest.hexdigest()


def arrays_of(tree: PyTree) -> list[np.ndarray]:
    """The leaves of a tree of arrays, keys of random numbers as their data."""
    return [np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf) for leaf in jax.tree.leaves(tree)]


def tree_like(template: PyTree, arrays: Sequence[np.ndarray]) -> PyTree:
    """The tree of the leaves that `arrays_of` gave, in the shape of another one."""
    leaves, structure = jax.tree.flatten(template)
    found = [
        jax.random.wrap_key_data(values) if _is_key(leaf) else values
        for leaf, values in zip(leaves, jax.device_put(list(arrays)), strict=True)
    ]
    return jax.tree.unflatten(structure, found)


def _is_key(leaf: object) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
