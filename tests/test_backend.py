"""What the package changes in a user's process, and when: nothing by an import, what is said where work starts."""

import pickle
import platform
import stat
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np
import pytest
from builders.places import ROOT

from hsed_jax.backend import _TRIED_FROM, _TRIED_TO, cache_folder
from hsed_jax.programs import program

STATE = """
import os, warnings
def state():
    import jax
    from threadpoolctl import threadpool_info
    import scipy.linalg
    settings = ("jax_enable_x64", "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    return {
        "environment": dict(os.environ),
        "filters": list(warnings.filters),
        **{name: getattr(jax.config, name) for name in settings},
        "threads": sorted(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"),
    }
"""
ALL = """
import pkgutil, importlib, hsed_jax
for module in pkgutil.walk_packages(hsed_jax.__path__, "hsed_jax."):
    if module.name not in ("hsed_jax.laboratories.opensees_model", "hsed_jax.run"):  # a script and a command
        importlib.import_module(module.name)
# Modules have the names of functions, and the package has the functions.
assert type(hsed_jax.run).__name__ == "function"
from hsed_jax import *
"""
BUILD = """
import hsed_jax as hx
from hsed_jax.study.build import Built
built = Built(hx.load_study("configs/paper.yaml"))
built.simulation.simulator
"""


def ran(code: str, **environment: str) -> str:
    """What a program of a user's prints, in a process with nothing set but this."""
    settings = {"PATH": "/usr/bin:/bin", "HOME": str(Path.home()), "PYTHONPATH": str(ROOT), **environment}
    done = subprocess.run([sys.executable, "-c", STATE + code], cwd=ROOT, env=settings, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


HEAPS = """
import ctypes, os, re, sys, threading
def heaps():
    libc, read, write = ctypes.CDLL(None), *os.pipe()
    libc.fdopen.restype = ctypes.c_void_p
    stream = libc.fdopen(write, b"w")
    libc.malloc_info(0, ctypes.c_void_p(stream))
    libc.fclose(ctypes.c_void_p(stream))
    return len(re.findall("<heap nr=", os.read(read, 1 << 20).decode()))
def allocate():
    list(map(bytearray, [100] * 1000))
    barrier.wait()
barrier = threading.Barrier(9)
def heaps_of_threads():
    threads = [threading.Thread(target=allocate) for _ in range(8)]
    [thread.start() for thread in threads]
    barrier.wait()
    return heaps()
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the number of heaps is a setting of glibc")
def test_threads_share_one_heap_once_work_has_started_unless_the_environment_says_otherwise():
    work = HEAPS + "from hsed_jax.backend import prepare\nprepare()\nprint(heaps_of_threads())"
    assert int(ran(HEAPS + "print(heaps_of_threads())")) > 1
    assert int(ran(work)) == 1
    assert int(ran(work, MALLOC_ARENA_MAX="4")) > 1


@pytest.mark.whole
def test_importing_changes_nothing():
    # The imports of numpy, numpyro and so on come first: what they change is theirs.
    theirs = "import numpy, scipy.stats, jax, equinox, diffrax, numpyro, tinygp, arviz, xarray, pandas, distributed\n"
    theirs += "import matplotlib.pyplot, optimistix, pydantic, pint, panel, openpyxl\n"
    changed = "\nafter = state()\nprint([name for name in before if before[name] != after[name]])"
    assert ran(f"{theirs}before = state()\n{ALL}{changed}") == "[]"


@pytest.mark.whole
def test_building_a_study_prepares_the_process():
    printed = ran(BUILD + """
now = state()
print(now["jax_enable_x64"], now["jax_compilation_cache_dir"], now["threads"])
print("small_while_loop" in now["environment"].get("XLA_FLAGS", ""))
print([name for name in ("JAX_ENABLE_X64", "OPENBLAS_NUM_THREADS") if name in now["environment"]])
""", XDG_CACHE_HOME="/tmp/somewhere")  # fmt: skip
    first, second, third = printed.splitlines()
    known = _TRIED_FROM <= tuple(int(part) for part in version("jaxlib").split(".")[:2]) < _TRIED_TO
    assert first == "True /tmp/somewhere/hsed_jax [1, 1]"
    assert (second, third) == (str(known), "[]")


@pytest.mark.whole
@pytest.mark.parametrize(
    ("environment", "code", "expected"),
    [
        (
            {
                "JAX_ENABLE_X64": "0",
                "JAX_COMPILATION_CACHE_DIR": "/tmp/mine",
                "XLA_FLAGS": "--xla_cpu_prefer_vector_width=256",
                "OPENBLAS_NUM_THREADS": "2",
            },
            "now, flags = state(), os.environ['XLA_FLAGS']\n"
            "print(now['jax_enable_x64'], now['jax_compilation_cache_dir'])\n"
            "print(flags.count('xla_cpu_prefer_vector_width'), flags.split()[0][-3:])\n"
            "print(1 in now['threads'])",
            "False /tmp/mine\n1 256\nFalse",
        ),
        ({"OMP_NUM_THREADS": "2"}, "print(1 in state()['threads'])", "False"),
    ],
    ids=["precision, cache, flags and threads of OpenBLAS", "threads"],
)
def test_what_the_user_set_stays(environment, code, expected):
    assert ran(BUILD + code, **environment) == expected


@pytest.mark.whole
@pytest.mark.parametrize("name", ["HOME", "XDG_CACHE_HOME"])
def test_without_a_cache_one_line_says_where_and_which_variable_sets_it(name):
    code = BUILD + "import matplotlib\nassert hx.simulate(built.study, {'V_P': 2.25, 'T_P': 1.0}).ok\n"
    settings = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), "HOME": str(Path.home()), name: "/dev/null"}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=settings, capture_output=True, text=True)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 0 and line.startswith("/dev/null/") and "XDG_CACHE_HOME" in line


@pytest.mark.whole
def test_a_process_that_has_used_jax_keeps_the_cache_it_chose_and_simulates_in_double_precision(tmp_path):
    code = f"import jax\njax.config.update('jax_compilation_cache_dir', {str(tmp_path)!r})\n"
    code += "assert jax.numpy.zeros(3).dtype == 'float32'\n" + BUILD
    code += "print(state()['jax_compilation_cache_dir'])\n"
    code += "print(hx.simulate(built.study, {'V_P': 2.25, 'T_P': 1.0}).quantities['peak_force'].dtype)"
    assert ran(code).splitlines() == [str(tmp_path), "float64"]


def test_what_is_kept_is_this_users_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "hsed_jax"
    assert cache_folder() == folder and stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o755)  # as earlier versions made it: others could read and not write
    assert cache_folder() == folder and stat.S_IMODE(folder.stat().st_mode) == 0o700
    for mode in (0o770, 0o707):  # what lies in it may be somebody else's
        folder.chmod(mode)
        assert cache_folder() is None
    folder.chmod(0o700)
    monkeypatch.setattr("os.geteuid", lambda: folder.stat().st_uid + 1)
    assert cache_folder() is None


class Planted:
    """Done when it is read from a pickle."""

    done = False

    def __reduce__(self):
        return setattr, (Planted, "done", True)


def test_a_planted_table_of_units_is_not_executed(tmp_path, monkeypatch):
    from hsed_jax.measurements import units

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    units._registry.cache_clear()
    units._registry()
    kept = list(tmp_path.rglob("*.pickle"))
    assert kept
    for file in kept:
        file.write_bytes(pickle.dumps(Planted()))
    (tmp_path / "hsed_jax").chmod(0o777)
    units._registry.cache_clear()
    assert units.parse_unit("kip*inch") and not Planted.done


def test_a_planted_program_is_not_executed(tmp_path, monkeypatch):
    monkeypatch.setattr("hsed_jax.programs._KNOWN", {"builtins", "jax", __name__})
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    try:
        assert program(twice)(np.arange(3.0))[2] == 4
        (file,) = [path for path in (tmp_path / "programs").rglob("*") if path.is_file()]
        file.write_bytes(pickle.dumps(Planted()))
        (tmp_path / "programs").chmod(0o777)
        assert program(twice)(np.arange(3.0))[2] == 4 and not Planted.done
        assert file.read_bytes() == pickle.dumps(Planted())
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def twice(x):
    return 2 * x
