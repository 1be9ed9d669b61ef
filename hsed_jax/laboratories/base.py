"""What every laboratory offers: it performs an experiment at given inputs, or says why it could not."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from hsed_jax.measurements import Record


class ExperimentFailed(Exception):
    """The experiment was tried and gave nothing to use; the message is the reason."""


class Measured(NamedTuple):
    """What a laboratory hands over: quantities (SI) by name and, where it has one, the record."""

    quantities: dict[str, float]
    record: Record | None = None


class Laboratory(Protocol):
    """Performs experiments."""

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Perform experiment `number` (from 0) at `inputs` (SI).

        Raises:
            ExperimentFailed: there is nothing to use, and why.
        """
        ...
