"""Ask and tell: a design with experiments that people or a controller perform, over days.

The run folder is locked only between opening and closing, so that a laptop may sleep between two tests.
"""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import Any, get_args

import numpy as np

from hsed_jax.config.load import load_study
from hsed_jax.config.schema import Study
from hsed_jax.design.acquisitions import ACQUISITIONS
from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.measurements import Campaign, Experiment, parse_unit
from hsed_jax.measurements.experiment import Status
from hsed_jax.runs.conduct import Asked, Conduct
from hsed_jax.runs.folder import RunFolder, laboratory_folder
from hsed_jax.runs.requests import Columns, Expected, Requests
from hsed_jax.study.build import Built
from hsed_jax.tables import Table, Tabular


class AskTell(Tabular):
    """A design in a run folder with `ask` and `tell`; a context manager, because it locks the folder.

    Arguments:
        study: with the step `design`; None: that of the run in the folder.
        output: the run folder; by default `runs/<study>`. An existing run continues.

    Raises:
        UserError: the study or the folder is wrong, or another process has the folder.
    """

    def __init__(self, study: Study | None = None, output: str | Path | None = None):
        if study is None:
            if output is None:
                raise UserError("give a study, or the folder of a run")
            study = load_study(Path(output) / "study.yaml")
        if "design" not in study.steps:
            raise UserError(f"steps: they are {', '.join(study.steps)}; hsed ask and hsed tell need the step design")
        self.path = Path(output) if output is not None else Path("runs") / study.study
        self.built = Built(study, workspace=laboratory_folder(self.path))
        self.built.check(performs=False)
        self._store = RunFolder(self.path, study.written(), resume=self.path.exists())
        try:
            self.conduct = Conduct(self.built, self._store)
            self._requests = Requests(self.conduct)
        except BaseException:
            self._store.close()
            raise

    def __enter__(self) -> "AskTell":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let another process have the folder."""
        self._store.close()

    @property
    def campaign(self) -> Campaign:
        """The experiments so far."""
        return self.conduct.campaign

    @property
    def stop_reason(self) -> str | None:
        """The reason why the design is complete; None if it is not."""
        return self.conduct.stop_reason

    def ask(self, count: int = 1) -> list[Asked]:
        """Request experiments until this number is pending. A second call changes nothing until a result is reported.

        Arguments:
            count: number of experiments to perform before the next report.

        Returns:
            All pending experiments; fewer than `count` where the design is complete.

        Raises:
            UserError: so many experiments cannot be pending, or the design cannot continue, see `Conduct.ask`.
        """
        if count < 1:
            raise UserError(f"{count} experiments cannot be requested; ask for at least 1")
        if (most := self.conduct.most_out) is not None and count > most:
            raise UserError(
                f"{count} experiments cannot be pending now: the first {most} are those of design.initial, and their results "
                f"choose the next ones; ask for at most {most}"
            )
        while len(self.conduct.pending) < count:
            self.conduct.choose()
            if self.conduct.stop_reason is not None:
                break
            self.conduct.ask()
        out = [self.conduct.request(id) for id in self.conduct.pending]
        for asked in out:
            self._requests.write(asked)
        return out

    def ask_again(self, id: str) -> Asked:
        """Request a failed experiment again.

        Raises:
            UserError: there is no such experiment, or it did not fail.
        """
        asked = self.conduct.ask_again(id)
        self._requests.write(asked)
        return asked

    def tell(
        self,
        id: str,
        *,
        record: str | Path | Columns | None = None,
        quantities: Mapping[str, float] | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        """Report the measurements of an experiment.

        Arguments:
            id: of the experiment; an unrequested one needs `inputs` and is welcome.
            record: a file, or a table of columns, as `experiments` declares channels; by default the files in the folder.
            quantities: numbers in their declared units; by default the files in the folder.
            inputs: as tested, in their declared units, if they differ from the requested ones.

        Raises:
            UserError: nothing was measured, the measurements differ from the declaration of the study, or the experiment is
                already completed or abandoned.
        """
        self.conduct.settling(id, inputs)
        self.conduct.tell(id, self._requests.measured(id, record, quantities, inputs), inputs)

    def failed(
        self,
        id: str,
        reason: str,
        *,
        record: str | Path | Columns | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        """Report a failed experiment, which may be requested again; a record until then is kept, and not fitted.

        Raises:
            UserError: the record cannot be read, or the experiment is unknown or settled already.
        """
        self._give_up(id, reason, record, inputs, abandon=False)

    def abandoned(
        self,
        id: str,
        reason: str,
        *,
        record: str | Path | Columns | None = None,
        inputs: Mapping[str, float] | None = None,
    ) -> None:
        """Abandon an experiment: it is never requested again; a record until then is kept, and not fitted.

        Raises:
            UserError: the record cannot be read, or the experiment is unknown or settled already.
        """
        self._give_up(id, reason, record, inputs, abandon=True)

    def take(self, campaign: Campaign) -> list[str]:
        """Add earlier experiments: completed, failed and abandoned ones, each only once.

        Returns:
            The ids of the added experiments.

        Raises:
            UserError: an experiment does not fit the study; those before it are added.
        """
        factors, taken = self.built.experiments.space.factors, []
        for experiment in campaign:
            id = experiment.id
            if experiment.status == "pending" or (
                id in self.campaign and self.campaign[id].status == experiment.status
            ):
                continue
            if experiment.inputs.keys() != factors.keys():
                raise UserError(
                    f"{campaign.source or campaign.name}: experiment {id} has the inputs "
                    f"{', '.join(experiment.inputs) or 'none'}; the study has {', '.join(factors)}"
                )
            inputs = {name: value / factors[name] for name, value in experiment.inputs.items()}
            if experiment.status == "completed":
                quantities = self._in_units(experiment.quantities) if self.built.observed.sensors.quantities else None
                self.tell(id, record=self._columns(experiment), quantities=quantities, inputs=inputs)
            else:
                abandon = experiment.status == "abandoned"
                self.conduct.give_up(id, experiment.reason or "no reason given", abandon=abandon, inputs=inputs)
            taken.append(id)
        return taken

    def folder(self, id: str) -> Path:
        """The folder of the request and the measurements of an experiment."""
        return self._requests.folder(id)

    def told(self, asked: Asked) -> str:
        """A request in a few lines."""
        units, folder = self.built.experiments.space.units, self.folder(asked.id)
        again = "" if asked.attempt == 1 else f", attempt {asked.attempt}"
        lines = [f"{asked.id}{again}: {', '.join(f'{n} {v:.4g} {units[n]}' for n, v in asked.inputs.items())}"]
        for name, (low, middle, high) in self.expected(asked).quantities.items():
            unit = self.built.mechanics.pair.output(name).unit
            lines.append(f"  {name} expected {middle:.4g} {unit} ({low:.4g} to {high:.4g})")
        if (limits := self.built.study.design.limits) is not None:
            most = limits.model_dump(exclude_none=True, exclude={"probability"})
            lines.append(f"  limits: {', '.join(f'{name} {value:g}' for name, value in most.items())} (SI)")
        here = 1.0
        if (cost := self.built.design.sequential.cost) is not None:
            (here,) = cost(np.asarray([list(asked.inputs.values())]))
            lines.append(f"  costs {here:.3g}; the most expensive experiment would cost {cost.bounds[1]:.3g}")
        if (step := self._step_of(asked)) is not None:
            # A step knows the value over the cost.
            value, of = here * step["acquisition"], self.built.study.design.acquisition
            if teaches := ACQUISITIONS[of].lesson(value, step["discrepancy"]):
                lines.append(f"  expected to teach {teaches}")
        assert self.built.experiments.excitation is not None
        files = ", ".join(
            ["request.json", *self.built.experiments.excitation.constructor.declared.kind.files, "expected.csv"]
        )
        return "\n".join(
            [*lines, f"  request in {folder}: {files}", f"  then: hsed tell {quote(str(self.path))} {quote(asked.id)}"]
        )

    def _step_of(self, asked: Asked) -> Mapping[str, Any] | None:
        """The step of the design that chose an experiment; None without one."""
        for step in reversed(self.conduct.steps):
            if self.built.experiments.space.point(np.asarray(step["cube"])).si == asked.si:
                return step
        return None

    def expected(self, asked: Asked) -> Expected:
        """The expected response of the model, for the current knowledge of its parameters."""
        return self._requests.expected(asked)

    def _give_up(
        self,
        id: str,
        reason: str,
        record: str | Path | Columns | None,
        inputs: Mapping[str, float] | None,
        *,
        abandon: bool,
    ) -> None:
        if not reason.strip():
            raise UserError(f"experiment {id}: say why")
        self.conduct.settling(id, inputs)
        try:
            kept = None if record is None else self._requests.record(id, record, inputs, partial=True)
        except ExperimentFailed as failure:
            raise UserError(str(failure)) from None
        self.conduct.give_up(id, reason, abandon=abandon, record=kept, inputs=inputs)

    def _in_units(self, quantities: Mapping[str, float]) -> dict[str, float]:
        declared = self.built.observed.sensors.quantities
        return {n: float(parse_unit(declared[n].unit).from_si(v)) for n, v in quantities.items() if n in declared}

    def _columns(self, experiment: Experiment) -> dict[str, np.ndarray] | None:
        """The record of an experiment from elsewhere, in the columns and units of this study."""
        sensors, record = self.built.observed.sensors, experiment.record
        if record is None or not sensors.channels:
            return None
        known = {"time": record.time, **record.channels}
        return {c.column: parse_unit(c.unit).from_si(known[n]) for n, c in sensors.channels.items() if n in known}

    def _table(self) -> Table:
        space, rows = self.built.experiments.space, []
        for experiment in self.campaign:
            inputs = [f"{experiment.inputs[name] / space.factors[name]:.4g}" for name in space.names]
            rows.append([experiment.id, *inputs, experiment.status, experiment.reason or ""])
        found = Counter(experiment.status for experiment in self.campaign)
        counts = [f"{found[s]} {s}" for s in get_args(Status) if s in found] or ["no experiments yet"]
        why = f"; the design is complete: {self.stop_reason}" if self.stop_reason else ""
        heads = ["experiment", *(f"{name} [{space.units[name]}]" for name in space.names), "status", "reason"]
        return Table(f"{self.path}: {', '.join(counts)}{why}", heads, rows)
