"""The space of variable inputs: their distributions, units, and the unit cube that designs live in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior

SAME_POINT = 1e-6
"""Two inputs of the unit cube closer than this are the same experiment."""


class Point(NamedTuple):
    """A point of the input space.

    Attributes:
        cube: in the unit cube, (d,).
        declared: inputs by name, in their declared units.
        si: inputs by name, SI.
    """

    cube: np.ndarray
    declared: dict[str, float]
    si: dict[str, float]


@dataclass(frozen=True)
class InputSpace:
    """Variable inputs x, each with a distribution (in its own unit), mapped to the unit cube by their quantiles.

    Attributes:
        priors: distribution by name, in the declared unit.
        units: declared unit by name.
        factors: one declared unit in SI, by name.
    """

    priors: Mapping[str, Prior]
    units: Mapping[str, str]
    factors: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(self.priors)

    def declared(self, cube: Float[np.ndarray, "n d"] | Float[Array, "n d"]) -> np.ndarray:
        """Points of the unit cube (n, d) as inputs in their declared units (n, d)."""
        columns = [
            np.asarray(p.quantile(column)) for p, column in zip(self.priors.values(), np.asarray(cube).T, strict=True)
        ]
        return np.stack(columns, axis=1)

    def cube(self, declared: np.ndarray) -> np.ndarray:
        """Inputs in their declared units (n, d) as points of the unit cube (n, d)."""
        columns = [
            np.asarray(p.distribution.cdf(jnp.asarray(column)))
            for p, column in zip(self.priors.values(), np.asarray(declared).T, strict=True)
        ]
        return np.stack(columns, axis=1)

    def point(self, cube: Float[np.ndarray, " d"]) -> Point:
        """A point of the unit cube with its inputs."""
        return self._point(cube, self.declared(cube[None])[0])

    def located(self, declared: Mapping[str, float]) -> Point:
        """Inputs by name, in their declared units, with their point of the unit cube.

        Raises:
            UserError: they are not the inputs of this space, or are outside.
        """
        if declared.keys() != set(self.names):
            raise UserError(f"its inputs are {', '.join(self.names)}; given are {', '.join(declared)}")
        row = np.asarray([float(declared[name]) for name in self.names])
        cube = self.cube(row[None])[0]
        if not (np.isfinite(cube).all() and np.all((cube > 0) & (cube < 1))):
            ranges = "; ".join(
                f"{n} from {low:g} to {high:g}" for n, (low, high) in zip(self.names, self.bounds(), strict=True)
            )
            raise UserError(f"the inputs {row.tolist()} lie outside those of the study ({ranges})")
        return self._point(cube, row)

    def _point(self, cube: np.ndarray, declared: np.ndarray) -> Point:
        named = dict(zip(self.names, declared.tolist(), strict=True))
        return Point(cube, named, {name: value * self.factors[name] for name, value in named.items()})

    def si(self, declared: np.ndarray) -> dict[str, np.ndarray]:
        """Inputs in their declared units (n, d) by name in SI, each (n,)."""
        return {name: declared[:, i] * self.factors[name] for i, name in enumerate(self.names)}

    def inputs(self, point: Float[Array, " d"]) -> dict[str, Array]:
        """One point of the unit cube as inputs by name in SI; may be traced."""
        return {
            name: prior.quantile(point[i]) * self.factors[name] for i, (name, prior) in enumerate(self.priors.items())
        }

    def middle(self) -> dict[str, Array]:
        """The inputs in the middle of their distributions by name in SI."""
        si = self.si(self.declared(np.full((1, len(self.names)), 0.5)))
        return jax.device_put({name: values[0] for name, values in si.items()})

    def bounds(self) -> np.ndarray:
        """The range of the design, in declared units, shape (d, 2)."""
        d = len(self.names)
        low, high = self.declared(np.array([np.full(d, 1e-9), np.full(d, 1 - 1e-9)]))
        digits = 6 - np.floor(np.log10(high - low)).astype(int)
        return np.asarray([[round(float(x), int(n)) for x in pair] for *pair, n in zip(low, high, digits, strict=True)])

    def initial_design(self, count: int) -> np.ndarray:
        """The first points of the Sobol' sequence (Sobol' 1967) without its corner point, in the unit cube (count, d)."""
        # scipy.stats takes half a second to load, and a check of a study needs no points.
        from scipy.stats import qmc

        d = len(self.names)
        sequence = qmc.Sobol(d, scramble=False).random_base2(int(count).bit_length())
        return sequence[1 : count + 1]

    def spread(self, count: int) -> np.ndarray:
        """Points that represent the inputs' distribution, in the unit cube (count, d); count a power of two."""
        from scipy.stats import qmc

        return qmc.Sobol(len(self.names), scramble=True, rng=7).random_base2(int(count - 1).bit_length())[:count]
