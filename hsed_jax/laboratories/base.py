"""The interface of every laboratory: it performs an experiment at given inputs, or gives the reason for a failure."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from hsed_jax.measurements import Noise, Record


class ExperimentFailed(Exception):
    """The experiment failed without a usable result; the message is the reason."""


class Awaited(Exception):
    """The experiment is requested, and not measured yet: people or a controller perform it."""


class Measured(NamedTuple):
    """The result of a laboratory: quantities (SI) by name and the record, if there is one."""

    quantities: dict[str, float]
    record: Record | None = None


@runtime_checkable
class Laboratory(Protocol):
    """Performs experiments."""

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Perform experiment `number` (from 0) at `inputs` (SI).

        Raises:
            ExperimentFailed: there is no usable result, with the reason.
        """
        ...


def experiment_id(number: int) -> str:
    """The name of experiment `number` (from 0): E01 is the first."""
    return f"E{number + 1:02d}"


def noisy(values: np.ndarray, noise: Noise | None, random: np.random.Generator) -> np.ndarray:
    """Values of one output, any shape, with Gaussian noise.

    Random numbers are drawn also without noise, so that the noise of one output does not depend on the noise of another.
    """
    draw = random.standard_normal(values.shape)
    if noise is None:
        return values
    # A sum of arrays without dimensions is a scalar and no array any more.
    return np.asarray(values + noise.standard_deviation(values) * draw)
