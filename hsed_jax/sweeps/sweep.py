"""A sweep from Python: run many studies, across interruptions, and gather the results."""

import traceback
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import xarray as xr
from tqdm import tqdm

from hsed_jax.config.schema import Study
from hsed_jax.drafts import write_netcdf, write_whole
from hsed_jax.errors import UserError
from hsed_jax.reporting.style import Picture, save
from hsed_jax.reporting.sweep_figures import comparison
from hsed_jax.runs.workflow import Interrupted
from hsed_jax.sweeps import results, workers
from hsed_jax.sweeps.folder import SweepFolder, outcomes
from hsed_jax.sweeps.plan import Plan, Point, Range, plan_of
from hsed_jax.tables import Table, Tabular, cell

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True, repr=False)
class Sweep(Tabular):
    """The results of a sweep.

    Attributes:
        path: its folder.
        plan: the study and the points.
        table: a row per study, see `hsed_jax.sweeps.results.table_of`.
    """

    path: Path
    plan: Plan
    table: pd.DataFrame

    @cached_property
    def dataset(self) -> xr.Dataset:
        """The table as a dataset: a dimension per swept key where the points are a grid, else `number`."""
        dataset = results.dataset_of(self.table, self.plan.keys)
        for name, unit in self.units.items():
            for kind in ("map", "mean", "sd", "q05", "q95"):
                if f"{kind}.{name}" in dataset:
                    dataset[f"{kind}.{name}"].attrs["units"] = unit
        dataset["seconds"].attrs["units"] = "s"
        return dataset

    @cached_property
    def units(self) -> dict[str, str]:
        """SI unit of every calibrated parameter."""
        found = {}
        for ended in outcomes(self.path, len(self.plan.points)):
            found |= ended.get("units", {})
        return found

    @cached_property
    def failures(self) -> dict[int, str]:
        """The fault of each study that failed, with its traceback, by number."""
        return {n: f"{about}\n{trace}" for n, about, trace in results.failures(self.path, self.plan)}

    def count(self, status: str) -> int:
        """Numbers of studies that are `complete`, `failed` or `pending`."""
        return sum(found == status for found in self.table["status"])

    def figure(self) -> Picture:
        """Estimates and errors over the swept keys."""
        return comparison(self.table, self.plan.keys, results.is_grid(self.table, self.plan.keys), self.units)

    def _table(self) -> Table:
        shown = [
            c for c in self.table if c.startswith("map.") or c in ("error_train", "error_test", "verdict", "effects")
        ]
        heads = ["number", *self.plan.keys, "status", *shown]
        rows = [
            [cell(value, ".4g") if isinstance(value, float) else str(value) for value in row]
            for row in self.table.reset_index()[heads].itertuples(index=False)
        ]
        told = ", ".join(f"{self.count(status)} {status}" for status in ("failed", "pending") if self.count(status))
        sentence = f"{len(self.table)} studies in {self.path}{': ' + told if told else ', all complete'}"
        notes = [f"{number} failed: {text.splitlines()[0]}" for number, text in list(self.failures.items())[:3]]
        return Table(sentence, heads, rows, notes)


def sweep(
    study: Study,
    values: Mapping[str, Sequence[Any]] | None = None,
    *,
    points: Sequence[Point] = (),
    ranges: Mapping[str, Range] | None = None,
    samples: int | None = None,
    output: str | Path | None = None,
    resume: bool = False,
    force: bool = False,
    n_workers: int | None = None,
    scheduler: str | None = None,
    slurm: Mapping[str, Any] | None = None,
    progress: bool = True,
) -> Sweep:
    """Run a study many times with some of its keys changed.

    Studies run in processes of this machine, a core each, unless a Dask cluster is named. A process that dies is replaced,
    and its study continues from its journal. A study that fails is listed with its traceback, and the sweep continues. A
    script must call this below `if __name__ == "__main__":`, like all code that starts processes in Python.

    Arguments:
        study: common to all points.
        values: lists of values by dotted path, such as `{"seed": [0, 1, 2]}`; every combination is run.
        points: points as they are, such as `[{"seed": 0}, {"seed": 3}]`.
        ranges: low and high, or a distribution, by dotted path, from which `samples` points are drawn.
        samples: how many, by Latin hypercube.
        output: the folder of the sweep; by default `runs/<study>_sweep`.
        resume: continue the sweep in the folder: run the studies that have not completed. The points need not be given again.
        force: replace the sweep in the folder.
        n_workers: processes of this machine; by default as many as cores.
        scheduler: address of a Dask scheduler whose workers see the same file system; give them a thread each.
        slurm: settings of a cluster of Slurm jobs: `jobs` and the arguments of `dask_jobqueue.SLURMCluster`.
        progress: show a progress bar.

    Raises:
        UserError: a point, the folder or the cluster is wrong; nothing has run.
        Interrupted: the user stopped it; it can be resumed.
    """
    if scheduler is not None and slurm is not None:
        raise UserError("give either a scheduler or slurm")
    if n_workers is not None and n_workers < 1:
        raise UserError(f"{n_workers} workers cannot do anything; give at least 1")
    plan = None
    if not resume or values or points or ranges or samples is not None:
        plan = plan_of(study, values or {}, points, ranges or {}, samples)
        plan.check()
    output = Path(output) if output is not None else Path("runs") / f"{study.study}_sweep"
    distant = nullcontext()
    if scheduler is not None:
        distant = workers.remote_client(scheduler)
    elif slurm is not None:
        distant = workers.slurm_client(slurm)
    # A cluster without an answer is refused before anything is written.
    with distant as client, closing(SweepFolder(output, plan, resume=resume, force=force)) as folder:
        if plan is None and folder.plan.study != study.written():
            raise UserError(f"{output} holds a sweep of another study; resume with the study it was started with")
        try:
            if pending := folder.pending():
                with workers.local_client(n_workers, len(pending)) if client is None else nullcontext(client) as there:
                    _run(folder, pending, there, client is None, progress)
            return gather(folder)
        except (KeyboardInterrupt, Interrupted) as stop:
            gathered = gather(folder)
            raise Interrupted(
                f"{str(stop) or 'stopped'} after {gathered.count('complete')} of {len(gathered.table)} studies; "
                "nothing is lost: say --resume to go on"
            ) from None


def gather(folder: SweepFolder) -> Sweep:
    """Make table, dataset, failures and figure from the outcomes so far, and write them."""
    made = Sweep(folder.path, folder.plan, results.table_of(folder.path, folder.plan))
    write_whole(folder.path / "table.parquet", made.table.to_parquet())
    write_netcdf(folder.path / "results.nc", made.dataset)
    listed = "\n".join(f"{number}  {text}" for number, text in made.failures.items())
    write_whole(folder.path / "failures.txt", listed or "none\n")
    if made.count("complete"):
        save(made.figure(), folder.path / "figures", "comparison")
    return made


def _run(folder: SweepFolder, pending: list[int], client: "Client", pin: bool, progress: bool) -> None:
    """Run the studies of these points on a cluster."""
    from distributed import KilledWorker, as_completed

    studies, failed = folder.plan.studies(), 0
    bar = tqdm(
        total=len(studies), initial=len(studies) - len(pending), disable=not progress, unit="study", desc="sweep"
    )
    with bar:
        if not client.scheduler_info()["workers"]:
            bar.set_postfix_str("the cluster has no workers yet")
        futures = {
            client.submit(
                workers.run_point, str(folder.path), number, studies[number].written(), pin, pure=False
            ): number
            for number in pending
        }
        # An existing client is not the default one, so its loop is passed.
        for future in as_completed(list(futures), loop=client.loop):
            number = futures.pop(future)
            if future.status == "error":
                error = future.exception()
                assert isinstance(error, BaseException)
                message = f"{type(error).__name__}: {error}"
                if isinstance(error, KilledWorker):
                    message = "its process died again and again: out of memory?"
                folder.note_failure(number, message, "".join(traceback.format_exception(error)))
            elif future.status != "finished":
                raise Interrupted("the Dask scheduler went away")
            failed += future.status == "error" or future.result() == "failed"
            # A released result is not computed again when its worker dies.
            future.release()
            bar.set_postfix_str(f"{failed} failed" if failed else "")
            bar.update()
