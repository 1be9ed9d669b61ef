"""Running a program in a folder: with a time limit, its output kept, and all its processes ended."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from hsed_jax.drafts import create
from hsed_jax.laboratories import lifeline
from hsed_jax.laboratories.base import ExperimentFailed

STDOUT, STDERR = "stdout.txt", "stderr.txt"
_LAST_LINES, _LAST_CHARACTERS = 5, 500


def run_program(words: Sequence[str], folder: Path, timeout: float) -> None:
    """Run a program to its end.

    Its output goes to `stdout.txt` and `stderr.txt` in the folder.  When this returns or raises, and when this process is
    killed, the program and its processes have ended (unless they left its process group).

    Arguments:
        words: the program and its arguments; no shell reads them.
        folder: its working folder.
        timeout: [s], after which it is killed.

    Raises:
        ExperimentFailed: it could not be started, ended with another status than 0, or was killed.
    """
    command = [sys.executable, "-I", "-S", str(Path(lifeline.__file__).resolve()), *words]
    with create(folder / STDOUT) as out, create(folder / STDERR) as err:
        # A separate session: Ctrl-C at the terminal is ours to handle.
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.PIPE, stdout=out, stderr=err, start_new_session=True
        )
        try:
            status = process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise ExperimentFailed(f"{words[0]} was stopped after its time limit of {timeout:g} s") from None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            assert process.stdin is not None
            process.stdin.close()
    if status:
        said = _last_lines(folder / STDERR) or _last_lines(folder / STDOUT) or "it said nothing"
        raise ExperimentFailed(f"{words[0]} {_ending(status)}: {said}")


def _ending(status: int) -> str:
    """The end of a program; the lifeline reports a signal like a shell, as 128 plus its number."""
    number = -status if status < 0 else status - 128
    if number in signal.valid_signals():
        return f"was killed by {signal.Signals(number).name}"
    return f"ended with status {status}"


def _last_lines(path: Path) -> str:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:  # the program may clear its folder
        return ""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return " | ".join(lines[-_LAST_LINES:])[-_LAST_CHARACTERS:]
