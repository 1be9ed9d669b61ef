"""What a laboratory outside this program is told: the inputs of an experiment, its ground motion, and when to sample.

`request.json` has the inputs with their units and in SI, and the columns and units of what is wanted back;
`ground_motion.csv` and `ground_motion.AT2` have the motion.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.laboratories.base import experiment_id
from hsed_jax.measurements import Channel, parse_unit, write_at2
from hsed_jax.physics.simulator import Parametrised, Timeline

# Between samples a motion is read as a line; with so many samples to a step of the integration (some 190 to the shortest
# period) that cuts 1.3e-4 off a peak.
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
        time: times of the ground motion [s], shape (n,), from 0 at equal steps.
        ground_acceleration: the ground motion [m/s²], shape (n,), linear between the samples.
        sample_times: when the study compares histories [s], shape (m,); a record at these times need not be interpolated.
    """

    id: str
    number: int
    inputs: dict[str, float]
    units: dict[str, str]
    si: dict[str, float]
    time: np.ndarray
    ground_acceleration: np.ndarray
    sample_times: np.ndarray

    def write(
        self,
        folder: Path,
        channels: Mapping[str, Channel],
        quantities: Mapping[str, Channel],
        more: Mapping[str, Any] | None = None,
    ) -> None:
        """Write `request.json`, `ground_motion.csv` and `ground_motion.AT2` into a folder.

        Arguments:
            folder: where to.
            channels: what the record is to hold.
            quantities: the numbers that are wanted.
            more: what else stands in `request.json`.
        """

        def wanted(declared: Mapping[str, Channel]) -> dict[str, dict[str, str]]:
            return {name: {"column": channel.column, "unit": channel.unit} for name, channel in declared.items()}

        content = {
            "id": self.id,
            "inputs": {
                name: {"value": value, "unit": self.units[name], "si": self.si[name]}
                for name, value in self.inputs.items()
            },
            "ground_motion": {"step": float(self.time[1]), "samples": self.time.size},
            "record": {"step": float(self.sample_times[1]), "samples": self.sample_times.size},
            "channels": wanted(channels),
            "quantities": wanted(quantities),
            **(more or {}),
        }
        rows = zip(self.time.tolist(), self.ground_acceleration.tolist(), strict=True)
        lines = ["t [s],ag [m/s^2]", *(f"{t!r},{a!r}" for t, a in rows)]
        (folder / "ground_motion.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        write_at2(folder / "ground_motion.AT2", float(self.time[1]), self.ground_acceleration, f"experiment {self.id}")
        (folder / "request.json").write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Programme:
    """What the experiments of a study have in common, to make requests of.

    Attributes:
        units: of the inputs.
        excitation: from inputs (SI) to a ground motion.
        timeline: of the study's simulator.
    """

    units: Mapping[str, str]
    excitation: Parametrised
    timeline: Timeline

    def request(self, number: int, inputs: Mapping[str, float]) -> Request:
        """The request for experiment `number` (from 0) at `inputs` (SI)."""
        si = {name: float(value) for name, value in inputs.items()}
        step, steps, every = self.timeline
        return Request(
            experiment_id(number),
            number,
            {name: float(parse_unit(self.units[name]).from_si(value)) for name, value in si.items()},
            {name: self.units[name] for name in si},
            si,
            self._time,
            np.asarray(self._motion({name: jnp.asarray(value) for name, value in si.items()})),
            step * every * np.arange(steps // every + 1),
        )

    @property
    def _time(self) -> np.ndarray:
        return self.timeline.step / _SAMPLES_PER_STEP * np.arange(self.timeline.steps * _SAMPLES_PER_STEP + 1)

    @cached_property
    def _motion(self):
        time = jnp.asarray(self._time)
        return jax.jit(lambda inputs: jax.vmap(self.excitation(inputs).acceleration)(time))
