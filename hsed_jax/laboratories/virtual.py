"""A virtual laboratory: the specimen is a simulator of its own, with effects the model may lack and noisy sensors."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.laboratories.base import ExperimentFailed, Measured
from hsed_jax.physics.simulator import Conditions, Simulator


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of one output: standard deviation relative to its magnitude, or absolute (SI)."""

    size: float
    relative: bool


@dataclass(frozen=True)
class VirtualLaboratory:
    """A specimen that is known.

    Attributes:
        simulator: with the effects of the true specimen.
        parameters: the true parameters (SI).
        quantities: what is measured.
        noise: per quantity; none where absent.
        seed: of the noise; the noise of an experiment depends on its number alone.
    """

    simulator: Simulator
    parameters: Mapping[str, float]
    quantities: tuple[str, ...]
    noise: Mapping[str, Noise]
    seed: int

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Simulate the specimen and add the noise of experiment `number`.

        Raises:
            ExperimentFailed: the simulation diverged.
        """
        draws = np.random.default_rng([self.seed, number]).standard_normal(len(self.quantities))
        measured = {}
        for (name, value), draw in zip(self.exact(inputs).items(), draws, strict=True):
            noise = self.noise.get(name)
            sd = 0.0 if noise is None else noise.size * (abs(value) if noise.relative else 1.0)
            measured[name] = float(value + sd * draw)
        return Measured(measured)

    def exact(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """The quantities of the specimen at `inputs` (SI) without noise.

        Raises:
            ExperimentFailed: the simulation diverged.
        """
        conditions = Conditions({name: jnp.asarray(float(value)) for name, value in inputs.items()})
        values, ok = self._simulate(conditions)
        if not ok:
            raise ExperimentFailed("the simulation of the specimen diverged")
        return dict(zip(self.quantities, np.asarray(values).tolist(), strict=True))

    @cached_property
    def _simulate(self):
        parameters = {name: float(value) for name, value in self.parameters.items()}
        return jax.jit(lambda conditions: self.simulator.quantities(parameters, conditions, self.quantities))
