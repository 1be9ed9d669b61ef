"""The cost of an experiment: a sum that grows with its inputs, in any unit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError


@dataclass(frozen=True)
class Cost:
    r"""Costs $c(x) = c_0 + \sum_i c_i x_i$ of experiments.

    Attributes:
        fixed: $c_0$, of every experiment.
        per: $c_i$, for each unit of an input as declared, by name.
        space: of the inputs.

    Raises:
        UserError: an input is unknown, or an experiment would cost nothing or less.
    """

    fixed: float
    per: Mapping[str, float]
    space: InputSpace

    def __post_init__(self):
        names = self.space.names
        if unknown := [name for name in self.per if name not in names]:
            raise UserError(f"design.cost.per: there is no input {unknown[0]!r}; the study has {', '.join(names)}")
        if not self.bounds[0] > 0:
            raise UserError(
                f"design.cost: the cost of every experiment must be positive, but the smallest would be {self.bounds[0]:.3g}"
            )

    def __call__(self, declared: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
        """Costs of experiments by their inputs in declared units."""
        return self.fixed + declared @ self._rates

    @property
    def bounds(self) -> tuple[float, float]:
        """Costs of the cheapest and of the most expensive experiment."""
        ends = self.space.bounds() * self._rates[:, None]
        return float(self.fixed + ends.min(axis=1).sum()), float(self.fixed + ends.max(axis=1).sum())

    @property
    def _rates(self) -> np.ndarray:
        return np.asarray([self.per.get(name, 0.0) for name in self.space.names])
