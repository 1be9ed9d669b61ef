"""JAX as this package needs it: double precision, XLA options for small loops, a persistent compilation cache, one BLAS thread.

Everything here must stand in the environment before JAX computes for the first time, so `hsed_jax/__init__.py` calls
`configure` before anything imports JAX.  Whatever the user has already set wins.
"""

import os
import sys
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# Keeps short loops in one compiled function (a single simulation: about 8 times faster) and uses full vector width.
# Internal options of XLA: an XLA that does not know them would abort, so they are set only for the releases they were
# tried with.
_FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000",
)
_TRIED_FROM, _TRIED_TO = (0, 10), (0, 13)


def configure() -> None:
    """Prepare the environment for JAX; call before the first JAX computation."""
    if _flags_are_known():
        present = os.environ.get("XLA_FLAGS", "")
        missing = [flag for flag in _FLAGS if flag.split("=")[0] not in present]
        os.environ["XLA_FLAGS"] = " ".join([present, *missing]).strip()
    # numpyro loads tqdm's bar for notebooks, which without widgets is one for text and warns of it.
    warnings.filterwarnings("ignore", "IProgress not found")
    settings = {
        "JAX_ENABLE_X64": "1",
        "JAX_COMPILATION_CACHE_DIR": str(cache_folder()),
        # Everything is worth keeping: a study is many programs of half a second each.
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        # The matrices here are small; on a machine that does other work as well, threads that wait for one another made a
        # Kriging of 43 points forty times slower.
        "OPENBLAS_NUM_THREADS": "1",
    }
    for name, value in settings.items():
        os.environ.setdefault(name, value)
    if "jax" in sys.modules:
        # JAX reads its environment on import, so a notebook that imported it first needs to be told.
        import jax

        jax.config.update("jax_enable_x64", os.environ["JAX_ENABLE_X64"].lower() in ("1", "true"))
        if not jax.config.jax_compilation_cache_dir:
            jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])


def _flags_are_known() -> bool:
    try:
        release = tuple(int(part) for part in version("jaxlib").split(".")[:2])
    except (PackageNotFoundError, ValueError):
        return False
    return _TRIED_FROM <= release < _TRIED_TO


def cache_folder() -> Path:
    """Where the package keeps what takes long to make and can be made again."""
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hsed_jax"
