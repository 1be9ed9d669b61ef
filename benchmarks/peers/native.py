"""The C peer: compiled by gcc when it is needed, called through ctypes."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from case import ETA, GAMMA, NU, Numbers, columns, degrading, lanes, numbers
from measure import seconds

_SOURCE = Path(__file__).with_name("bouc_wen.c")
_FLAGS = ("-O3", "-march=native", "-mprefer-vector-width=512", "-ffast-math", "-fopenmp-simd", "-fPIC", "-shared")
_ARRAY = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")

NOTE = "no gcc here, so no C"


def compiled(lanes: int = 32) -> Callable[..., np.ndarray] | None:
    """`simulate(numbers, V_P, T_P, A, beta, eta)` to quantities (n, 3), in C; None where there is no gcc.

    Arguments:
        lanes: simulations advanced together; 1 for one simulation alone.
    """
    if shutil.which("gcc") is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "bouc_wen.so"
        subprocess.run(["gcc", *_FLAGS, f"-DLANES={lanes}", str(_SOURCE), "-o", str(library), "-lm"], check=True)
        function = ctypes.CDLL(str(library)).simulate  # stays mapped when the file is gone
    function.restype = None
    number, count = ctypes.c_double, ctypes.c_int
    function.argtypes = [count, *[_ARRAY] * 4, number, _ARRAY, _ARRAY, number, count, _ARRAY]
    pulse = np.array([GAMMA, NU])

    def simulate(numbers: Numbers, v_p, t_p, a, beta, eta):
        out = np.empty((len(v_p), 3))
        function(len(v_p), v_p, t_p, a, beta, eta, numbers.packed, pulse, numbers.step, numbers.steps, out)
        return out

    return simulate


def each() -> float | None:
    """CPU seconds of one simulation of a large batch on one core, one effect, quantities alone; None where there is no gcc."""
    simulate = compiled()
    if simulate is None:
        return None
    case = degrading("observe=histories")
    plain, batch = numbers(case), columns(lanes(case, 10_000, seed=8))
    return seconds(lambda: simulate(plain, *batch, ETA)) / 10_000
