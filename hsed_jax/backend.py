"""Settings of JAX for this package: double precision, XLA options for small loops, a lasting compilation cache, one
BLAS thread, one heap.
"""

import ctypes
import logging
import os
import stat
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# Keeps short loops in one compiled function (a single simulation: about 8 times faster) and uses full vector width.
# Internal options of XLA: an XLA without them would abort, so they are set only for tested releases.
_FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000",
)
_TRIED_FROM, _TRIED_TO = (0, 10), (0, 13)
# The option of `mallopt` for the number of heaps (glibc's malloc.h).
_M_ARENA_MAX = -8


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def prepare() -> None:
    """Prepare this process: called when a study is built, and not by an import. Settings in the environment, and a chosen
    compilation cache, stay unchanged.  XLA reads its flags at a compilation, so the flags also apply in a process that has
    used JAX before.
    """
    import jax

    _limit_heaps()
    if _flags_are_known():
        present = os.environ.get("XLA_FLAGS", "")
        missing = [flag for flag in _FLAGS if flag.split("=")[0] not in present]
        os.environ["XLA_FLAGS"] = " ".join([present, *missing]).strip()
    if "JAX_ENABLE_X64" not in os.environ:
        jax.config.update("jax_enable_x64", True)
    if not jax.config.jax_compilation_cache_dir:
        if (folder := cache_folder()) is not None:
            jax.config.update("jax_compilation_cache_dir", str(folder))
        else:
            print(
                f"{_cache_place()} cannot be written or is open to other users, so that every command compiles its programs "
                "again; delete it, or choose another folder by XDG_CACHE_HOME",
                file=sys.stderr,
            )
            # It has its own folder in the same place, and reports the same fault at length.
            logging.getLogger("matplotlib").setLevel(logging.ERROR)
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        # All programs are stored: a study has many, and compiling the smallest takes ten times as long as reading it.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@cache
def limit_threads() -> None:
    """One thread for BLAS: called before a model computes, because the limited libraries take long to load.

    The matrices here are small. On a machine with other work, threads that wait for one another make a Kriging of 43 points
    forty times slower. A limit in the environment stays unchanged.
    """
    if not {"OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"} & set(os.environ):
        import scipy.linalg  # noqa: F401  (its BLAS is what JAX uses; a limit is one of what is loaded)
        from threadpoolctl import threadpool_limits

        threadpool_limits(1, "blas")


def _limit_heaps() -> None:
    """Let all threads share one heap, where the C library is glibc.

    Otherwise each thread of XLA has a heap, and a heap keeps the memory that its thread has freed.  One heap lowers the peak
    memory of a diagnosis by a quarter at the same CPU time.  A number in the environment stays unchanged.
    """
    if sys.platform == "linux" and "MALLOC_ARENA_MAX" not in os.environ:
        library = ctypes.CDLL(None)
        if hasattr(library, "mallopt"):
            library.mallopt(_M_ARENA_MAX, 1)


def _flags_are_known() -> bool:
    try:
        release = tuple(int(part) for part in version("jaxlib").split(".")[:2])
    except (PackageNotFoundError, ValueError):
        return False
    return _TRIED_FROM <= release < _TRIED_TO


def cache_folder() -> Path | None:
    """The cache folder of the package; None without one."""
    return private(_cache_place())


def private(folder: Path) -> Path | None:
    """A folder whose files may be executed: only this user may write there. A stored program, and a table of pint, is
    executed when it is read.

    Returns:
        The folder, made with mode 0700 where it is missing; None if it cannot be written, belongs to another user, or other
        users may write in it.
    """
    try:
        folder.mkdir(mode=stat.S_IRWXU, parents=True, exist_ok=True)
        # The owner of a link can point it elsewhere.
        known = [folder.lstat(), folder.stat()]
        if any(about.st_uid != os.geteuid() for about in known) or known[1].st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return None
        if stat.S_IMODE(known[1].st_mode) & (stat.S_IRWXG | stat.S_IRWXO):
            folder.chmod(stat.S_IRWXU)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK | os.X_OK) else None


def _cache_place() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hsed_jax"
