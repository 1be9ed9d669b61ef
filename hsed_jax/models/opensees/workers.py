"""Processes in which OpenSees simulates a material: several at a time; all end with this process.

OpenSees is global to a process, and a material may crash or run for ever.  A worker that dies or takes too long counts as a
failed simulation; the next request gets a new worker.
"""

import atexit
import json
import math
import os
import select
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.laboratories.opensees import INTERPRETER, interpreter

_DRIVER = Path(__file__).with_name("driver.py")
TIMEOUT = 3.0
"""Longest time of one simulation [s]; one along 4000 samples takes some ten milliseconds."""


class Workers:
    """Processes of OpenSees, as many as are asked at a time.

    Arguments:
        python: the Python that has openseespy.
        timeout: of one simulation [s].
    """

    def __init__(self, python: str, timeout: float = TIMEOUT):
        self._python, self._timeout = python, timeout
        self._idle: list[_Worker] = []
        self._lock = threading.Lock()
        atexit.register(self.close)

    def forces(self, material: str, arguments: Sequence[Any], path: np.ndarray) -> np.ndarray:
        """The forces (n,) of a new material along elongations (n,) that begin at zero, SI.

        Raises:
            ExperimentFailed: OpenSees refused the arguments, crashed, was killed, or took too long.
            UserError: openseespy cannot be imported.
        """
        with self._lock:
            worker = self._idle.pop() if self._idle else None
        worker = worker or _Worker(self._python, self._timeout)
        found = worker.forces(material, arguments, path)
        # A worker without an answer is replaced; a worker that reported an error continues.
        with self._lock:
            self._idle.append(worker)
        if isinstance(found, str):
            raise ExperimentFailed(f"OpenSees refused {material}: {found}")
        return found

    def version(self) -> str:
        """The version of OpenSees.

        Raises:
            UserError: openseespy cannot be imported.
        """
        with self._lock:
            if not self._idle:
                self._idle.append(_Worker(self._python, self._timeout))
            return self._idle[-1].version

    def close(self) -> None:
        """End the processes."""
        with self._lock:
            for worker in self._idle:
                worker.end()
            self._idle.clear()


class _Worker:
    """One process of OpenSees; it ends with its standard input, and so with this process."""

    def __init__(self, python: str, timeout: float):
        self._timeout = timeout
        try:
            # A separate session: Ctrl-C at the terminal is ours to handle.
            self._process = subprocess.Popen(
                [python, str(_DRIVER), str(math.ceil(timeout))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
                bufsize=0,
            )
        except OSError:
            raise _without(python) from None
        assert self._process.stdin is not None and self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout
        line = self._answers.readline()
        if not line:
            self.end()
            raise _without(python)
        self.version = str(json.loads(line)["version"])

    def forces(self, material: str, arguments: Sequence[Any], path: np.ndarray) -> np.ndarray | str:
        """The forces, or the error message of OpenSees.

        Raises:
            ExperimentFailed: there is no answer.
        """
        head = {"material": material, "arguments": list(arguments), "points": len(path)}
        until = time.monotonic() + self._timeout
        try:
            self._requests.write(json.dumps(head).encode() + b"\n" + np.asarray(path, dtype=float).tobytes())
            line = self._until(until, lambda said: said.endswith(b"\n"), 1)
            told = json.loads(line)
            if "error" in told:
                return told["error"]
            return np.frombuffer(self._until(until, lambda said: len(said) == 8 * told["points"], 8 * told["points"]))
        except (OSError, EOFError) as error:
            self.end()
            how = f"took longer than {self._timeout:g} s" if isinstance(error, TimeoutError) else "ended"
            raise ExperimentFailed(f"OpenSees {how} while it simulated {material}") from None

    def _until(self, until: float, is_all: Callable[[bytes], bool], most: int) -> bytes:
        """The complete answer of the process.

        Raises:
            TimeoutError: the time is over.
            EOFError: the process ended.
        """
        found = b""
        while not is_all(found):
            if not select.select([self._answers], [], [], max(0.0, until - time.monotonic()))[0]:
                raise TimeoutError
            if not (more := os.read(self._answers.fileno(), most - len(found) if most > 1 else 1)):
                raise EOFError
            found += more
        return found

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            try:
                if stream is not None:
                    stream.close()
            except OSError:  # the unsent part is not needed
                pass


@cache
def workers() -> Workers:
    """The workers of this process."""
    return Workers(interpreter())


def _without(python: str) -> UserError:
    return UserError(
        f"model.opensees: openseespy cannot be imported by {python}; install it with python -m pip install "
        f"'hsed_jax[opensees]', or let {INTERPRETER} name a Python that has it"
    )
