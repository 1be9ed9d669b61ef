"""The workers of a sweep: processes of this machine, an existing Dask cluster, or jobs of Slurm."""

import logging
import os
import shutil
import signal
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from hsed_jax.backend import cores
from hsed_jax.errors import UserError
from hsed_jax.sweeps.folder import alone, note, outcome, run_folder

if TYPE_CHECKING:
    from distributed import Client

# A worker that dies is replaced and its study goes on; a study that its worker dies of this often has failed.
_DEATHS = 3
_PATIENCE = "8s"
# Equal studies share their programs; those of others stay in memory, 20 MB and more each, until they take this much [bytes].
_PROGRAMS = 2**30
_SLURM = {"cores": 1, "processes": 1, "memory": "4GB"}

_lean: int | None = None
"""Memory of this process without the programs of past studies [bytes]."""


def run_point(path: str, number: int, study: Mapping[str, Any], pin: bool) -> str:
    """Run the study of a point to its end, in the process of a worker, and record its outcome.

    Arguments:
        path: the folder of the sweep.
        number: of the point, from 0.
        study: the point's study.
        pin: keep to one core, so that neither XLA nor a pool of threads takes those of other workers.

    Returns:
        `complete` or `failed`.
    """
    if pin:
        _take_one_core()
    folder = Path(path)
    with alone(folder, number):
        if outcome(folder, number)["status"] != "complete":
            note(folder, number, _ended(run_folder(folder, number), study))
        status = outcome(folder, number)["status"]
    _forget()
    return status


def _forget() -> None:
    """Drop the compiled programs where they have become many."""
    global _lean
    import jax
    import psutil

    taken = psutil.Process().memory_info().rss
    if _lean is not None and taken > _lean + _PROGRAMS:
        jax.clear_caches()
        _lean = None
    elif _lean is None:
        _lean = taken


def _ended(here: Path, study: Mapping[str, Any]) -> dict[str, Any]:
    """Run a study in a folder; returns the outcome."""
    from hsed_jax.config.load import load_study
    from hsed_jax.runs.workflow import run

    begin = time.perf_counter()
    try:
        done = run(load_study(dict(study)), here, resume=here.exists(), progress=False, figures=False)
        ended = {"status": "complete", "units": done.built.mechanics.units}
    except (Exception, SystemExit) as error:  # a laboratory may call exit
        message = " ".join(str(error).split()) or type(error).__name__
        if not isinstance(error, UserError):
            message = f"{type(error).__name__}: {message}"
        ended = {"status": "failed", "message": message, "traceback": traceback.format_exc()}
    return {**ended, "seconds": time.perf_counter() - begin}


def _take_one_core() -> None:
    """Assign a core to every worker of this machine."""
    from distributed import get_worker

    if not hasattr(os, "sched_setaffinity"):
        return
    mine = sorted(os.sched_getaffinity(0))
    if len(mine) > 1:
        os.sched_setaffinity(0, {mine[int(get_worker().name) % len(mine)]})


@contextmanager
def local_client(workers: int | None, tasks: int) -> "Iterator[Client]":
    """Processes of this machine, a core each.

    Arguments:
        workers: how many at most; by default as many as there are cores.
        tasks: how many studies there are for them.
    """
    import dask.config
    from distributed import Client, LocalCluster

    available = cores()
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": _DEATHS,
        # A worker has one study at a time, so its death counts against this study only.
        "distributed.scheduler.worker-saturation": 1.0,
        # Compiling holds the interpreter for longer than a heartbeat.
        "distributed.admin.tick.limit": "1h",
    }
    with ExitStack() as stack:
        # The files of the workers are deleted with them; a last worker may still be writing.
        settings["temporary-directory"] = stack.enter_context(TemporaryDirectory(ignore_cleanup_errors=True))
        stack.enter_context(dask.config.set(settings))
        with _deaf():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=min(workers or available, tasks),
                    threads_per_worker=1,
                    memory_limit=0,
                    # No dashboard; without an address its server would choose a port and print warnings about it.
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    silence_logs=logging.CRITICAL,
                )
            )
        yield stack.enter_context(Client(cluster))


@contextmanager
def _deaf() -> Iterator[None]:
    """Keep Ctrl-C and termination from the threads that are started meanwhile and all processes that these start.

    A terminal sends Ctrl-C to every process, but the sweep itself must end its workers. A cluster that is interrupted during
    its start would leave them running.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def remote_client(address: str) -> "Iterator[Client]":
    """An existing Dask cluster.

    Raises:
        UserError: no scheduler answers at the address.
    """
    from distributed import Client

    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except Exception as error:  # also errors of another server at the address
        raise UserError(f"no Dask scheduler answers at {address} ({error}); start one with: dask scheduler") from None
    with client:
        yield client


@contextmanager
def slurm_client(settings: Mapping[str, Any]) -> "Iterator[Client]":
    """Jobs of Slurm, each one worker with one core unless the settings say otherwise.

    Arguments:
        settings: `jobs`, how many; the rest as `dask_jobqueue.SLURMCluster` has them (queue, account, walltime, memory).

    Raises:
        UserError: dask-jobqueue or Slurm is missing, or a setting is unknown.
    """
    try:
        from dask_jobqueue import SLURMCluster  # pyright: ignore[reportMissingImports] # an extra
    except ImportError:
        raise UserError("Slurm needs the package dask-jobqueue; install hsed_jax[slurm]") from None
    if shutil.which("sbatch") is None:
        raise UserError("slurm: this machine has no sbatch; start the sweep where jobs are submitted")
    from distributed import Client

    given = {**_SLURM, **settings}
    jobs = given.pop("jobs", 1)
    try:
        cluster = SLURMCluster(**given)
    except (TypeError, ValueError) as error:
        raise UserError(f"slurm: {error}") from None
    with cluster, Client(cluster) as client:
        cluster.scale(jobs=jobs)
        yield client
