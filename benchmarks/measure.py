"""Timing, and one line of the table."""

import time
from collections.abc import Callable, Mapping
from typing import Any


def seconds(work: Callable[[], Any], *, repeats: int = 5, at_least: float = 0.2) -> float:
    """Best CPU time of `work` [s], after a warm-up that is not counted.

    The rows run pinned to one core, where CPU time is what a quiet machine would take by the clock; unlike the clock it does
    not count what other processes took.  Of the repeats, which go on for `at_least` [s], the best is the least disturbed.
    """
    work()
    best, total, count = float("inf"), 0.0, 0
    while count < repeats or total < at_least:
        begin = time.process_time()
        work()
        taken = time.process_time() - begin
        best, total, count = min(best, taken), total + taken, count + 1
    return best


def line(
    row: str,
    work: str,
    unit: str,
    ours: float,
    peers: Mapping[str, float],
    accuracy: Mapping[str, Mapping[str, float]] | None = None,
    notes: tuple[str, ...] = (),
) -> dict[str, Any]:
    """One measurement.  Every figure is a cost, so that lower is better; a ratio is our cost in units of the peer's.

    Arguments:
        row: name of the row it belongs to.
        work: what was done.
        unit: of the costs.
        ours: our cost.
        peers: the cost of others at the same work, by name; also of our own simpler work, to compare with.
        accuracy: figures of accuracy by implementation ("ours" is one), measured in the same run.
        notes: what a reader must know.
    """
    return {
        "row": row,
        "work": work,
        "ratios": {name: ours / cost for name, cost in peers.items()},
        "unit": unit,
        "ours": ours,
        "peers": dict(peers),
        "accuracy": {name: dict(figures) for name, figures in (accuracy or {}).items()},
        "notes": list(notes),
    }
