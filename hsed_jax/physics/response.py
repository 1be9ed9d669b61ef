"""The response of one experiment, or of a batch of experiments."""

from typing import NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from hsed_jax.physics.outputs import output
from hsed_jax.tables import Table, cell


class Response(NamedTuple):
    """The response of one experiment.

    Attributes:
        quantities: by name, SI (`hsed_jax.physics.outputs`).
        channels: histories by name, SI, shape (samples,), the first at t = 0; empty where none were asked for.
        ok: False where the integration diverged; its numbers are then meaningless.
    """

    quantities: dict[str, Float[Array, "..."]]
    channels: dict[str, Float[Array, "..."]]
    ok: Bool[Array, "..."]

    def _table(self) -> Table:
        arrays = {**self.quantities, **self.channels}
        batch = self.ok.ndim == 1
        largest = {name: np.abs(values).reshape(*self.ok.shape, -1).max(axis=-1) for name, values in arrays.items()}
        rows = [
            (
                name,
                f"{arrays[name].shape[-1]} samples" if name in self.channels else "",
                *(cell(float(value), ".4g") for value in ((sizes.min(), sizes.max()) if batch else (sizes,))),
                output(name).unit,
            )
            for name, sizes in largest.items()
        ]
        failed = int(self.ok.size - np.sum(self.ok))
        sentence = f"response of {self.ok.size} experiments" if batch else "response of one experiment"
        heads = ("", "", *(("least peak", "greatest peak") if batch else ("peak",)), "unit")
        return Table(sentence + (f"; {failed} diverged and have no meaning" if failed else ""), heads, rows)

    def __repr__(self) -> str:
        leaves = jax.tree.leaves(tuple(self))
        if any(isinstance(leaf, Tracer) or not isinstance(leaf, jax.Array | np.ndarray) for leaf in leaves):
            return f"Response{tuple(self)!r}"  # inside a transformation, or not of numbers
        return str(self._table())

    def _repr_html_(self) -> str:
        return self._table().html()
