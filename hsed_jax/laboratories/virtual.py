"""A virtual laboratory: the specimen is a separate simulator, with effects that the model may lack and with noisy sensors."""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from hsed_jax.laboratories.base import ExperimentFailed, Measured, noisy
from hsed_jax.measurements import Noise, Record
from hsed_jax.physics.simulator import Conditions, Simulator


@dataclass(frozen=True)
class VirtualLaboratory:
    """A known specimen.

    Attributes:
        simulator: with the effects of the true specimen.
        parameters: the true parameters (SI).
        quantities: the measured ones, one number per experiment.
        channels: histories that are measured instead, including the excitation, at the samples of the simulator's timeline.
        noise: per quantity; none where absent.
        seed: of the noise; the noise of an experiment depends on its number alone.
    """

    simulator: Simulator
    parameters: Mapping[str, float]
    quantities: tuple[str, ...]
    channels: tuple[str, ...]
    noise: Mapping[str, Noise]
    seed: int

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Simulate the specimen and add the noise of experiment `number`.

        Raises:
            ExperimentFailed: the simulation diverged.
        """
        random = np.random.default_rng([self.seed, number])
        if self.channels:
            return Measured({}, self._record(inputs, random))
        exact = self.exact(inputs)
        return Measured(
            {name: float(noisy(np.asarray(value), self.noise.get(name), random)) for name, value in exact.items()}
        )

    def exact(self, inputs: Mapping[str, float]) -> dict[str, float]:
        """The quantities of the specimen at `inputs` (SI) without noise.

        Raises:
            ExperimentFailed: the simulation diverged.
        """
        values, ok = self.simulator.quantities(self.parameters, _conditions(inputs), self.quantities)
        if not ok:
            raise ExperimentFailed("the simulation of the specimen diverged")
        return dict(zip(self.quantities, np.asarray(values).tolist(), strict=True))

    def _record(self, inputs: Mapping[str, float], random: np.random.Generator) -> Record:
        conditions = _conditions(inputs)
        response = self.simulator.respond(self.parameters, conditions, self.channels)
        if not response.ok:
            raise ExperimentFailed("the simulation of the specimen diverged")
        time = np.asarray(self.simulator.times(conditions.inputs))
        channels = {name: np.asarray(values) for name, values in response.channels.items()}
        return Record(time, {name: noisy(values, self.noise.get(name), random) for name, values in channels.items()})


def _conditions(inputs: Mapping[str, float]) -> Conditions:
    return Conditions({name: jnp.asarray(float(value)) for name, value in inputs.items()})
