"""The space of variable inputs: their distributions, units, and the unit cube that designs live in."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.priors import Prior


@dataclass(frozen=True)
class InputSpace:
    """Variable inputs x, each with a distribution (in its own unit), mapped to the unit cube by their quantiles.

    Attributes:
        priors: distribution by name, in the declared unit.
        units: declared unit by name.
        factors: what one declared unit is in SI, by name.
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
        return self.inputs(jnp.full(len(self.names), 0.5))

    def bounds(self) -> np.ndarray:
        """What the design may reach, in declared units, shape (d, 2)."""
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
