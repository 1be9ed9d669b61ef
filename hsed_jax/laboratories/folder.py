"""A laboratory of people or a controller: what is asked lies in a folder, and what was measured is left there, days later."""

from collections.abc import Mapping
from dataclasses import dataclass

from hsed_jax.laboratories.base import Measured


class Awaited(Exception):
    """The experiment is asked, and nothing was measured yet."""


@dataclass(frozen=True)
class FolderLaboratory:
    """Performs nothing by itself; `hsed_jax.runs.ask_tell` writes its requests and takes its answers."""

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Say that it takes a while.

        Raises:
            Awaited: always.
        """
        raise Awaited
