"""Chains of NUTS in blocks, side by side: they can be watched, stopped after a block, and continued later.

The state of a chain includes its random numbers, so no draw depends on where a block ends.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from threading import Event

import jax
import numpy as np

from hsed_jax.inference.nuts import ChainState
from hsed_jax.inference.watch import Watch, arrays_of, tree_like

# Length of a block [s], and leapfrog steps of the first one, whose duration is unknown.
_BLOCK, _FIRST = 0.4, 4
# Intervals at which the chains are polled, and at which they are saved [s].
_LOOK, _KEEP = 0.2, 5.0


def follow(
    advance: Callable[[ChainState, int], ChainState],
    chain_states: Sequence[ChainState],
    watch: Watch,
    name: str,
    seconds: float | None = None,
) -> list[ChainState]:
    """Let chains go to their end, each chain_state on a separate thread.

    Arguments:
        advance: advances a chain_state by a number of leapfrog steps.
        chain_states: their initial states.
        watch: receives the progress and stores them.
        name: of the stored states; they continue from states that are stored under it.
        seconds: time budget, including earlier sessions; the chains stop when it ends.

    Returns:
        The chain_states at their end, or at the end of the budget.
    """
    spent, reached = 0.0, list(chain_states)
    if (kept := watch.recall(name)) is not None:
        spent, reached = float(kept[0]), tree_like(reached, kept[1:])
    began, halt = time.perf_counter() - spent, Event()
    planned = [int(chain_state.planned) for chain_state in reached]

    def is_unfinished(which: int) -> bool:
        return int(reached[which].done) < planned[which]

    def is_spent() -> bool:
        return seconds is not None and time.perf_counter() - began >= seconds

    def go(which: int) -> None:
        most = _FIRST
        while is_unfinished(which) and not halt.is_set():
            before, start = int(reached[which].work), time.perf_counter()
            reached[which] = jax.block_until_ready(advance(reached[which], most))
            pace = (int(reached[which].work) - before) / (time.perf_counter() - start)
            most = max(1, min(int(_BLOCK * pace), 8 * most))

    def keep() -> None:
        watch.keep(name, [np.asarray(time.perf_counter() - began), *arrays_of(list(reached))])

    if is_spent() or not any(map(is_unfinished, range(len(reached)))):
        return reached
    watch.report("draws of the posterior")
    # One thread traces and compiles first; otherwise all threads would do this work.
    reached[0] = advance(reached[0], 1)
    try:
        with ThreadPoolExecutor(len(reached)) as threads:
            running = [threads.submit(go, which) for which in range(len(reached))]
            try:
                looked = time.perf_counter()
                while wait(running, _LOOK).not_done and not is_spent():
                    watch.count(sum(int(chain_state.done) for chain_state in reached), sum(planned))
                    if time.perf_counter() - looked > _KEEP:
                        looked = time.perf_counter()
                        keep()
            finally:
                halt.set()
        for one in running:
            one.result()
    finally:
        keep()
    return reached
