"""Work in a process of its own, as a user's script does it: nothing imported yet, the compilation cache where we say."""

import compileall
import os
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

HSED = ("-c", "import sys; from hsed_jax.command_line import main; sys.exit(main())")
"""What makes a Python the `hsed` command."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def alone(work: Callable[..., Any], *arguments: Any, cache: Path | None = None, cores: Iterable[int] = ()) -> Any:
    """What `work` returns in a new process.

    Arguments:
        work: a function of a module, which is imported there, with all that it imports itself.
        arguments: of the function.
        cache: folder of the compilation cache; by default the user's.
        cores: to run on, as many threads of a library as there are; by default those of this process.
    """
    with ProcessPoolExecutor(1, get_context("spawn"), _prepare, (cache, tuple(cores))) as process:
        return process.submit(work, *arguments).result()


def taken(cache: Path, *arguments: str, status: int = 0) -> tuple[float, float]:
    """Wall and CPU seconds of a Python of its own.

    Arguments:
        cache: folder of the compilation cache.
        arguments: of Python.
        status: that it has to end with.
    """
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(cache)}
    # A user's Python keeps its byte code.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = os.times()
    done = subprocess.run([sys.executable, *arguments], check=False, capture_output=True, env=environment)
    after = os.times()
    if done.returncode != status:
        raise RuntimeError(f"{arguments} ended with {done.returncode}: {done.stderr.decode(errors='replace')}")
    cpu = sum(after[2:4]) - sum(before[2:4])  # of children, user and system
    return after.elapsed - before.elapsed, cpu


def soonest(cache: Path, *arguments: str, status: int = 0) -> tuple[float, float]:
    """`taken`, the least disturbed of three."""
    return min(taken(cache, *arguments, status=status) for _ in range(3))


def _prepare(cache: Path | None, cores: tuple[int, ...]) -> None:
    if cache is not None:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(cache)
    if cores:
        os.sched_setaffinity(0, cores)
        for variable in _THREADS:
            os.environ[variable] = str(len(cores))


def write_byte_code() -> None:
    """Compile what Python imports, as an installer or the first start does, so that no measurement pays for it."""
    package = find_spec("hsed_jax")
    assert package is not None
    assert package.origin is not None
    for folder in (Path(package.origin).parent, sysconfig.get_path("purelib")):
        compileall.compile_dir(folder, quiet=2, workers=0)
