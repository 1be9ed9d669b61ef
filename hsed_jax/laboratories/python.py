"""A laboratory that is a Python function: it takes a request and returns the measurements."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed, Measured
from hsed_jax.laboratories.request import Programme, Request
from hsed_jax.laboratories.sensors import Sensors
from hsed_jax.python_files import executed


@dataclass(frozen=True)
class PythonLaboratory:
    """Calls a function per experiment, in this process.

    Attributes:
        function: of a `Request`; it returns a mapping of quantities to numbers and, where records are wanted, of channels
            (with `time`) to arrays (n,), by their columns and in their units as declared (SI unless said otherwise).
        programme: common properties of the experiments.
        sensors: its measurements.
    """

    function: Callable[[Request], Mapping[str, Any]]
    programme: Programme
    sensors: Sensors

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Call the function for experiment `number` (from 0) at `inputs` (SI).

        Raises:
            ExperimentFailed: the function raised an exception, or its output differs from the declaration.
        """
        request = self.programme.request(number, inputs)
        source = getattr(self.function, "__name__", repr(self.function))
        try:
            returned = self.function(request)
        except ExperimentFailed:
            raise
        except (Exception, SystemExit) as error:
            raise ExperimentFailed(f"{source} failed with {type(error).__name__}: {error}") from error
        if not isinstance(returned, Mapping):
            raise ExperimentFailed(
                f"{source} returned {returned!r:.60}; a mapping of names to numbers or arrays is wanted"
            )
        sensors, record = self.sensors, None
        quantities = sensors.numbers(_by_name(returned, sensors.quantities), source)
        if sensors.channels:
            record = sensors.record(request, _by_name(returned, sensors.channels), source)
        return Measured(quantities, record)


def _by_name(returned: Mapping[str, Any], declared: Mapping[str, Any]) -> dict[str, Any]:
    return {name: returned[c.column] for name, c in declared.items() if c.column in returned}


def function_of(path: Path, name: str) -> Callable[[Request], Mapping[str, Any]]:
    """A function from a Python file.

    Raises:
        UserError: there is no such file or function, or the file fails.
    """
    function = getattr(executed(path), name, None)
    if not callable(function):
        raise UserError(f"{path} has no function {name!r}")
    return cast("Callable[[Request], Mapping[str, Any]]", function)
