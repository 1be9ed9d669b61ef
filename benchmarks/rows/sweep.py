"""A sweep of small studies on a Dask cluster, one of its workers killed half-way, beside a plain loop in one process."""

import json
import os
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
from case import PAPER
from measure import line

import hsed_jax as hx
from hsed_jax.sweeps.results import scalars

_SMALL = (
    "excitation.duration=4.0",
    "experiments.virtual.noise={relative: 0.02}",
    "steps=[calibrate]",
    "design.initial=4",
    "calibration={chains: 1, warmup: 40, draws: 80, starts: 2}",
)


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row: wall seconds per study, everything counted but the loop's first study, which compiles."""
    studies, looped = (8, 3) if quick else (200, 40)
    study, seeds = hx.load_study(PAPER, _SMALL), list(range(studies))
    with tempfile.TemporaryDirectory() as folder:
        begin, alone = 0.0, []
        for number in range(1 + looped):
            if number == 1:
                begin = time.perf_counter()
            hx.run(_seeded(number), Path(folder) / f"{number}", progress=False, figures=False)
            alone.append(scalars(json.loads((Path(folder) / f"{number}" / "summary.json").read_text(encoding="utf-8"))))
        loop = (time.perf_counter() - begin) / looped
        begin = time.perf_counter()
        with _cluster(Path(folder) / "sweep", studies // 2) as address:
            done = hx.sweep(study, {"seed": seeds}, output=Path(folder) / "sweep", scheduler=address, progress=False)
        taken = (time.perf_counter() - begin) / studies
        expected = pd.DataFrame(alone)
        found = done.table[expected.columns].head(len(alone)).reset_index(drop=True)
        same = (found - expected).abs().max(axis=None)
        ends = sum(_ends(path) for path in sorted((Path(folder) / "sweep" / "runs").iterdir()))
        figures = {"complete": done.count("complete"), "doubled": ends - studies, "difference from the loop": same}
        workers = len(os.sched_getaffinity(0))
        what = f"{studies} studies of 4 experiments on {workers} workers, one of them killed half-way"
        return [line("sweep", what, "s per study", taken, {"loop in one process": loop}, {"ours": figures})]


def _seeded(seed: int):
    return hx.load_study(PAPER, (*_SMALL, f"seed={seed}"))


def _ends(run: Path) -> int:
    """How often a study came to its end."""
    sessions = json.loads((run / "provenance.json").read_text(encoding="utf-8"))["sessions"]
    return sum("end" in session for session in sessions)


@contextmanager
def _cluster(sweep: Path, half: int) -> Iterator[str]:
    """A Dask cluster with a worker for each core; one is killed when half of the studies have ended."""
    from distributed import LocalCluster

    with LocalCluster(threads_per_worker=1, memory_limit=0, dashboard_address="127.0.0.1:0") as cluster:
        victim = cluster.workers[0].process.pid

        def kill():
            while len(list(sweep.glob("outcomes/*.json"))) < half:
                time.sleep(0.05)
            os.kill(victim, signal.SIGKILL)

        threading.Thread(target=kill, daemon=True).start()
        yield cluster.scheduler_address
