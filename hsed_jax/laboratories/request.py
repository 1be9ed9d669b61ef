"""The request to a laboratory outside this program: the inputs of an experiment, its excitation, and the times of the samples.

`request.json` has the inputs with their units and in SI, and the required columns and units. The excitation is in a file
beside it: `ground_motion.csv` and `.AT2`, `applied_force.csv`, or `imposed_elongation.csv`.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.drafts import write_whole
from hsed_jax.laboratories.base import experiment_id
from hsed_jax.measurements import Channel, parse_unit, write_at2
from hsed_jax.physics.declared import Kind
from hsed_jax.physics.excitations import AbstractExcitation, channels_of
from hsed_jax.physics.outputs import output
from hsed_jax.physics.simulator import Parametrised
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.programs import program

# Between samples a motion is linear. With this number of samples to a step of the integration (some 190 to the shortest
# period), a peak is too small by 1.3e-4.
_SAMPLES_PER_STEP = 8


@dataclass(frozen=True)
class Request:
    """An experiment to be performed.

    Attributes:
        id: its name, such as E07.
        number: its number, from 0.
        inputs: the variable inputs by name, in the units of the study.
        units: those units.
        si: the inputs in SI.
        kind: its excitation.
        time: times of its excitation [s], shape (n,), from 0; at equal steps for a ground motion or a force.
        driver: the excitation by its channel, SI, shape (n,), linear between the samples.
        sample_times: times at which the study compares histories [s], shape (m,); a record at these times need not be
            interpolated.
    """

    id: str
    number: int
    inputs: dict[str, float]
    units: dict[str, str]
    si: dict[str, float]
    kind: Kind
    time: np.ndarray
    driver: dict[str, np.ndarray]
    sample_times: np.ndarray

    @property
    def ground_acceleration(self) -> np.ndarray:
        """The ground motion [m/s²], shape (n,)."""
        return self.driver["ground_acceleration"]

    def write(
        self,
        folder: Path,
        channels: Mapping[str, Channel],
        quantities: Mapping[str, Channel],
        more: Mapping[str, Any] | None = None,
    ) -> None:
        """Write `request.json` and the file of the excitation into a folder.

        Arguments:
            folder: of the files.
            channels: of the required record.
            quantities: the required numbers.
            more: further entries of `request.json`.
        """

        def wanted(declared: Mapping[str, Channel]) -> dict[str, dict[str, str]]:
            return {name: {"column": channel.column, "unit": channel.unit} for name, channel in declared.items()}

        ((channel, values),) = self.driver.items()
        content = {
            "id": self.id,
            "inputs": {
                name: {"value": value, "unit": self.units[name], "si": self.si[name]}
                for name, value in self.inputs.items()
            },
            self.kind.file: _grid(self.time) | {"channel": channel},
            "record": _grid(self.sample_times),
            "channels": wanted(channels),
            "quantities": wanted(quantities),
            **(more or {}),
        }
        rows = zip(self.time.tolist(), values.tolist(), strict=True)
        lines = [f"t [s],{self.kind.column} [{output(channel).unit}]", *(f"{t!r},{value!r}" for t, value in rows)]
        write_whole(folder / f"{self.kind.file}.csv", "\n".join(lines) + "\n")
        for name in self.kind.files[1:]:
            write_at2(folder / name, float(self.time[1]), values, f"experiment {self.id}")
        write_whole(folder / "request.json", json.dumps(content, indent=2, ensure_ascii=False) + "\n")


@dataclass(frozen=True)
class Programme:
    """The common properties of the experiments of a study, from which requests are made.

    Attributes:
        units: of the inputs.
        excitation: from inputs (SI) to the excitation of an experiment.
        timeline: of the study's simulator.
    """

    units: Mapping[str, str]
    excitation: Parametrised[AbstractExcitation]
    timeline: Timeline

    def request(self, number: int, inputs: Mapping[str, float]) -> Request:
        """The request for experiment `number` (from 0) at `inputs` (SI)."""
        si = {name: float(value) for name, value in inputs.items()}
        time, driver, sample_times = _driven(self.excitation, self.timeline, jax.device_put(si))
        return Request(
            experiment_id(number),
            number,
            {name: float(parse_unit(self.units[name]).from_si(value)) for name, value in si.items()},
            {name: self.units[name] for name in si},
            si,
            cast("type[AbstractExcitation]", self.excitation.constructor).declared.kind,
            np.asarray(time),
            {name: np.asarray(values) for name, values in driver.items()},
            np.asarray(sample_times),
        )


@program
def _driven(
    excitation: Parametrised[AbstractExcitation], timeline: Timeline, inputs: Mapping[str, Float[Array, ""]]
) -> tuple[Array, dict[str, Array], Array]:
    """Times and samples of the excitation of an experiment, and the times of its record."""
    step, steps, every = timeline
    fine = Timeline(None if step is None else step / _SAMPLES_PER_STEP, steps * _SAMPLES_PER_STEP)
    driver = excitation(inputs)
    time, length = times(driver.step_length(fine), 1, fine.samples), driver.step_length(timeline)
    return time, channels_of(jax.vmap(driver.sample)(time)), times(length, every, timeline.samples)


def _grid(time: np.ndarray) -> dict[str, Any]:
    """The number of samples and their step, or the times of an uneven sampling."""
    steps = np.diff(time)
    is_even = bool(np.ptp(steps) < 1e-6 * steps.mean())
    return ({"step": float(time[1])} if is_even else {"times": time.tolist()}) | {"samples": time.size}
