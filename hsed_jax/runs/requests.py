"""Requests on the disk: requests for people or a controller are written, and their measurements are read.

The folder of a request is `laboratory/E07-1` for the first attempt at E07; where it is missing it is made again.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.laboratories.answer import QUANTITIES, RECORD, is_answered, left, read_quantities, read_record
from hsed_jax.laboratories.base import ExperimentFailed, Measured
from hsed_jax.laboratories.request import Request
from hsed_jax.measurements import Record, parse_unit
from hsed_jax.physics.names import of_each
from hsed_jax.physics.outputs import EQ_18, further, is_driver
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.programs import program
from hsed_jax.runs.conduct import Asked, Conduct
from hsed_jax.study.build import Built

BAND = (0.05, 0.5, 0.95)
"""Quantiles of the expected response over the draws of the parameters."""

Columns = Mapping[str, Any] | pd.DataFrame


class Expected(NamedTuple):
    """The response that the calibrated model expects of an experiment: quantiles `BAND`, over the parameters alone.

    Attributes:
        time: [s], shape (n,).
        channels: SI, by name, each (3, n).
        quantities: SI, by name, each (3,).
    """

    time: np.ndarray
    channels: dict[str, np.ndarray]
    quantities: dict[str, np.ndarray]


@program
def _responses(
    model: AbstractModel,
    names: tuple[str, ...],
    channels: tuple[str, ...],
    quantities: tuple[str, ...],
    more: tuple[str, ...],
    inputs: Mapping[str, Float[Array, ""]],
    draws: Float[Array | np.ndarray, "N p"],
) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """These channels and quantities of the model at draws of its named parameters, and whether it converged."""

    def one(theta):
        response = model.respond(dict(zip(names, theta, strict=False)), Conditions(inputs), channels, more)
        given = {name: response.channels[name] for name in channels}
        return given, {name: response.quantities[name] for name in quantities}, response.ok

    return jax.vmap(one)(draws)


@dataclass(frozen=True)
class Requests:
    """Requests and answers of a design.

    Attributes:
        conduct: the design in progress.
    """

    conduct: Conduct

    @property
    def built(self) -> Built:
        """The study."""
        return self.conduct.built

    def folder(self, id: str) -> Path:
        """The folder of the request and the measurements of an experiment."""
        return self.conduct.store.laboratory / f"{id}-{self.conduct.request(id).attempt}"

    def expected(self, asked: Asked) -> Expected:
        """The expected response of the model, for the current knowledge of its parameters.

        Raises:
            UserError: every simulation diverges.
        """
        inputs = jax.device_put({name: float(value) for name, value in asked.si.items()})
        channels, quantities, ok = self._respond(inputs, self.conduct.draws)
        good = np.asarray(ok) > 0
        if not good.any():
            raise UserError(f"experiment {asked.id}: every simulation of the expected response diverges")

        def band(values: Any) -> np.ndarray:
            return np.quantile(np.asarray(values)[good], BAND, axis=0)

        return Expected(
            np.asarray(self.built.simulation.planned_simulator.times(inputs)),
            {name: band(values) for name, values in channels.items()},
            {name: band(values) for name, values in quantities.items()},
        )

    @cached_property
    def _respond(self):
        names = tuple(self.built.mechanics.parameters[0])
        model, more = self.built.simulation.planned_simulator, further(tuple(self.built.study.quantities))
        measured = [name for name in self.built.observed.sensors.channels if not is_driver(name)]
        wanted = [*measured, *of_each(model.owners, ("elongation", "force"))]
        wanted = [name for name in dict.fromkeys(wanted) if model.gives(name)]
        peaks = [name for name in dict.fromkeys((*of_each(model.owners, EQ_18), *more)) if model.gives(name)]
        return partial(_responses, model, names, tuple(wanted), tuple(peaks), more)

    def _request(self, id: str, si: Mapping[str, float], number: int = 0) -> Request:
        return replace(self.built.site.programme.request(number, si), id=id)

    def write(self, asked: Asked) -> None:
        """Write a request, unless it exists."""
        folder = self.folder(asked.id)
        if (folder / "request.json").is_file():
            return
        folder.mkdir(parents=True, exist_ok=True)
        output = self.built.mechanics.pair.output
        expected, sensors = self.expected(asked), self.built.observed.sensors
        columns = {"t [s]": expected.time}
        for name, band in expected.channels.items():
            declared = sensors.channels.get(name)
            unit = output(name).unit if declared is None else declared.unit
            for share, values in zip(BAND, band, strict=True):
                columns[f"{name} {share:.0%} [{unit}]"] = parse_unit(unit).from_si(values)
        write_whole(folder / "expected.csv", pd.DataFrame(columns).to_csv(index=False))
        peaks = {
            name: {"unit": output(name).unit, **{f"{s:.0%}": float(v) for s, v in zip(BAND, values, strict=True)}}
            for name, values in expected.quantities.items()
        }
        more: dict[str, Any] = {"attempt": asked.attempt, "expected": peaks}
        if (limits := self.built.study.design.limits) is not None:
            more["limits"] = limits.model_dump(exclude_none=True)
        self._request(asked.id, asked.si, asked.number).write(folder, sensors.channels, sensors.quantities, more)

    def answered(self, asked: Asked) -> Measured | None:
        """The measurements in the folder of a request; None without them.

        Raises:
            UserError: they differ from the declaration of the study.
        """
        return self.measured(asked.id, None, None, None) if is_answered(self.folder(asked.id)) else None

    def measured(
        self,
        id: str,
        record: str | Path | Columns | None,
        quantities: Mapping[str, float] | None,
        inputs: Mapping[str, float] | None,
    ) -> Measured:
        """The measurements of an experiment.

        Arguments:
            id: of the experiment.
            record: a file or a table of columns; None: the files in the folder.
            quantities: in declared units; None: the files in the folder.
            inputs: as tested, in declared units; None: as asked.

        Raises:
            UserError: something is missing, or differs from the declaration of the study.
        """
        sensors, history, numbers = self.built.observed.sensors, None, {}
        if record is not None and not sensors.channels:
            raise UserError(f"experiment {id}: the study declares no channels of a record; see experiments")
        if quantities is not None:
            for name in quantities:
                if name not in sensors.quantities:
                    known = ", ".join(sensors.quantities) or "none"
                    raise UserError(f"experiment {id}: there is no quantity {name!r}; the study declares {known}")
        try:
            if sensors.channels:
                given = self._left(id, RECORD) if record is None else record
                history = self.record(id, given, inputs, partial=False)
            if quantities is not None:
                numbers = sensors.numbers(quantities, f"experiment {id}")
            elif sensors.quantities:
                numbers = read_quantities(self._left(id, QUANTITIES), sensors)
        except ExperimentFailed as failure:
            raise UserError(str(failure)) from None
        return Measured(numbers, history)

    def _left(self, id: str, names: tuple[str, ...]) -> Path:
        if id not in self.conduct.campaign:
            raise UserError(f"experiment {id!r} was not requested; give its measurements and its inputs")
        return left(self.folder(id), names)

    def record(
        self, id: str, given: str | Path | Columns, inputs: Mapping[str, float] | None, *, partial: bool
    ) -> Record:
        """The record of an experiment, in SI, from a file or a table of columns.

        Raises:
            ExperimentFailed: it differs from the declaration of the study.
            UserError: the experiment is unknown, and its inputs were not given.
        """
        sensors, space = self.built.observed.sensors, self.built.experiments.space
        if inputs is not None and inputs.keys() == space.factors.keys():
            si = {name: float(value) * space.factors[name] for name, value in inputs.items()}
        else:
            si = self.conduct.request(id).si
        request = self._request(id, si)
        if isinstance(given, str | Path):
            return read_record(Path(given), request, sensors, partial=partial)
        columns = {name: given[c.column] for name, c in sensors.channels.items() if c.column in given}
        return sensors.record(request, columns, f"experiment {id}", partial=partial)
