"""A laboratory of a test: a linear spring on a bench, whose peak force follows from the elongation that is asked for."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from hsed_jax.laboratories.base import Measured
from hsed_jax.laboratories.kinds.base import MeasuredEntry, Site
from hsed_jax.laboratories.request import Programme
from hsed_jax.registry import register
from hsed_jax.sections import Positive


@final
@register
class BenchEntry(MeasuredEntry):
    """A linear spring on a bench."""

    performer: ClassVar[str] = "a bench"
    use: ClassVar[str] = "a test"

    stiffness: Positive
    """Stiffness of the spring on the bench [N/m]."""

    @property
    def described(self) -> str:
        return "a spring on a bench"

    def laboratory(self, site: Site) -> "Bench":
        return Bench(self.stiffness, site.programme)


@dataclass(frozen=True)
class Bench:
    stiffness: float
    programme: Programme

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        elongation = self.programme.request(number, inputs).driver["elongation"]
        return Measured({"peak_force": self.stiffness * float(np.abs(elongation).max())})
