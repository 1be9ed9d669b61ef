"""A script that runs a program for as long as the process that started it lives.

Standard input is the lifeline: a pipe that the starting process holds open, and that closes when this process ends in any
way. Then the whole process group is killed, because an orphan would continue to compute and write.  Run by path and without
the package, so that it starts in milliseconds.
"""

import os
import signal
import subprocess
import sys
import threading


def _watch() -> None:
    while os.read(0, 1):
        pass
    os.killpg(0, signal.SIGKILL)


def _run(words: list[str]) -> int:
    threading.Thread(target=_watch, daemon=True).start()
    try:
        program = subprocess.Popen(words, stdin=subprocess.DEVNULL)
    except OSError as error:
        print(f"{words[0]} cannot be started: {error.strerror}", file=sys.stderr)
        return 127
    status = program.wait()
    # As in a shell: 128 plus the signal.
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    sys.exit(_run(sys.argv[1:]))
