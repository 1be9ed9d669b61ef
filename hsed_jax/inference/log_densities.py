"""A posterior at many points: computed in blocks on all cores, watched while it runs, and continued after a stop."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from itertools import islice

import jax
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.backend import cores
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.inference.simulations import filled, outputs_at, points_of_a_call
from hsed_jax.inference.watch import Watch
from hsed_jax.programs import program

# Interval at which the blocks are polled and their results saved [s].
_LOOK, _KEEP = 0.2, 5.0


def log_densities(
    posterior: Posterior,
    data: Data,
    points: Float[np.ndarray, "N p"],
    watch: Watch | None = None,
    name: str | None = None,
    seconds: float | None = None,
) -> Float[np.ndarray, " k"]:
    """Log density in u at points, -inf where it has none; of the first k points only, if the budget ends before the last.

    Arguments:
        posterior: of a study.
        data: measured outputs.
        points: u.
        watch: receives the progress.
        name: of the stored results; results that are stored under it are reused.
        seconds: time budget, including earlier sessions.
    """
    watch = watch or Watch()
    spent, found = 0.0, np.full(len(points), np.nan)
    if name is not None and (kept := watch.recall(name)) is not None:
        spent, found = float(kept[0]), np.array(kept[1])
    began = time.perf_counter()

    def one(at: int, block: np.ndarray) -> None:
        found[at : at + len(block)] = _simulated(posterior, data, block)[2]

    def seen() -> None:
        watch.count(int((~np.isnan(found)).sum()), len(points))

    def keep() -> None:
        if name is not None:
            watch.keep(name, [np.asarray(spent + time.perf_counter() - began), found])

    _over(one, points, data, np.isnan(found), seen, keep, None if seconds is None else seconds - spent)
    missing = np.isnan(found)
    return found[: missing.argmax()] if missing.any() else found


def simulated(
    posterior: Posterior, data: Data, points: Float[np.ndarray, "N p"], watch: Watch
) -> tuple[Float[np.ndarray, "N n J"], Float[np.ndarray, "N n"], Float[np.ndarray, " N"]]:
    """Outputs of all experiments at points, whether their simulations converged, and the log density in u."""
    blocks: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def one(at: int, block: np.ndarray) -> None:
        blocks[at] = _simulated(posterior, data, block)

    def seen() -> None:
        watch.count(sum(len(log_density) for *_, log_density in blocks.values()), len(points))

    _over(one, points, data, np.ones(len(points), dtype=bool), seen, lambda: None, None)
    outputs, ok, log_density = zip(*(blocks[at] for at in sorted(blocks)), strict=True)
    return np.concatenate(outputs), np.concatenate(ok), np.concatenate(log_density)


def _over(
    one: Callable[[int, np.ndarray], None],
    points: Float[np.ndarray, "N p"],
    data: Data,
    is_open: np.ndarray,
    seen: Callable[[], None],
    keep: Callable[[], None],
    seconds: float | None,
) -> None:
    """Call `one` with the start of each block and its points."""
    began = looked = time.perf_counter()
    size = points_of_a_call(data)
    todo = iter([at for at in range(0, len(points), size) if is_open[at : at + size].any()])

    def block_of(at: int) -> None:
        one(at, points[at : at + size])

    def next_of(blocks: Iterator[int]) -> list[int]:
        is_spent = seconds is not None and time.perf_counter() - began >= seconds
        return [] if is_spent else list(islice(blocks, 1))

    try:
        # One thread traces and compiles first; otherwise all threads would do this work.  So there is at least one block.
        for at in islice(todo, 1):
            block_of(at)
        with ThreadPoolExecutor(cores()) as threads:
            running = {threads.submit(block_of, at) for _ in range(cores()) for at in next_of(todo)}
            while running:
                ended, running = wait(running, _LOOK, FIRST_COMPLETED)
                for block in ended:
                    block.result()
                    running |= {threads.submit(block_of, at) for at in next_of(todo)}
                seen()
                if time.perf_counter() - looked > _KEEP:
                    looked = time.perf_counter()
                    keep()
    finally:
        keep()


def _simulated(
    posterior: Posterior, data: Data, u: Float[np.ndarray, "k p"]
) -> tuple[Float[np.ndarray, "k n J"], Float[np.ndarray, "k n"], Float[np.ndarray, " k"]]:
    """The output of `simulated` for the points of a call."""
    outputs, ok = outputs_at(posterior, data, u)
    size = points_of_a_call(data)
    density = np.asarray(_densities(posterior, data, *(filled(values, size) for values in (u, outputs, ok))))[: len(u)]
    return outputs, ok, np.where(np.isnan(density), -np.inf, density)


@program
def _densities(
    posterior: Posterior,
    data: Data,
    u: Float[Array | np.ndarray, "S p"],
    outputs: Float[Array | np.ndarray, "S n J"],
    ok: Float[Array | np.ndarray, "S n"],
) -> Float[Array, " S"]:
    return jax.vmap(lambda u, outputs, ok: posterior.log_density_of(u, outputs, ok, data))(u, outputs, ok)
