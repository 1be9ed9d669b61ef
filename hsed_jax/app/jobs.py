"""Commands of `hsed` in separate processes, followed and stopped from the page."""

import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import threading
from collections.abc import Sequence
from pathlib import Path

# tqdm writes a bar over the line before it; a terminal this wide never breaks it.
_TERMINAL = struct.pack("HHHH", 24, 240, 0, 0)
_BAR = re.compile(r"\[\d+:\d\d")
_SHARE = re.compile(r"(\d+)%\|[^|]*\|\s*")
_CODE = "import sys; from hsed_jax.command_line import main; sys.exit(main())"


class Job:
    """One command; it continues without a page.

    Arguments:
        arguments: of `hsed`.
        folder: in which it runs.

    Attributes:
        said: the lines on its standard output.
        doing: its current activity, from its progress.
        share: completed share in percent; None if unknown.
    """

    def __init__(self, arguments: Sequence[str], folder: Path):
        self.arguments = tuple(arguments)
        self.said: list[str] = []
        self.doing = "starting"
        self.share: int | None = None
        self.was_stopped = False
        self._complaints: list[str] = []
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, _TERMINAL)
        # A terminal for its progress, which is then written several times a second.
        self._process = subprocess.Popen(
            [sys.executable, "-c", _CODE, *arguments],
            cwd=folder,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=theirs,
            text=True,
            encoding="utf-8",
            start_new_session=True,
        )
        os.close(theirs)
        self._readers = [
            threading.Thread(target=self._listen, daemon=True),
            threading.Thread(target=self._watch, args=(ours,), daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def status(self) -> int | None:
        """The exit status; None while it runs, or while its output is not read completely."""
        if any(reader.is_alive() for reader in self._readers):
            return None
        return self._process.wait()

    @property
    def complaint(self) -> str:
        """Its standard error without the progress."""
        return "\n".join(self._complaints)

    def stop(self) -> None:
        """Stop it regularly; this takes at most two seconds."""
        if self._process.poll() is None:
            self.was_stopped = True
            self._process.send_signal(signal.SIGTERM)

    def wait(self, seconds: float) -> int:
        """Wait for its end."""
        status = self._process.wait(seconds)
        for reader in self._readers:
            reader.join(seconds)
        return status

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self.said.append(line.rstrip("\n"))

    def _watch(self, terminal: int) -> None:
        left = b""
        with open(terminal, "rb", buffering=0) as file:
            while True:
                try:
                    read = file.read(4096)
                except OSError:  # the error of Linux if the other end is closed
                    return
                if not read:
                    return
                *lines, left = re.split(rb"[\r\n]+", left + read)
                for line in lines:
                    self._take(line.decode(errors="replace").strip())
                if _BAR.search(bar := left.decode(errors="replace")):
                    self._take(bar)

    def _take(self, line: str) -> None:
        if not _BAR.search(line):
            if line:
                self._complaints.append(line)
            return
        share = _SHARE.search(line)
        self.share = None if share is None else int(share[1])
        self.doing = _SHARE.sub("", line)


class Jobs:
    """The commands of a server, by the run folder that they work in."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._jobs: dict[str, Job] = {}

    def start(self, run: str, arguments: Sequence[str]) -> Job:
        """Start a command that works in a run folder."""
        self._jobs[run] = Job(arguments, self._folder)
        return self._jobs[run]

    def of(self, run: str) -> Job | None:
        """The command that works, or last worked, in a run folder."""
        return self._jobs.get(run)

    def stop(self) -> int:
        """Stop all; returns how many were running."""
        running = [job for job in self._jobs.values() if job.status is None]
        for job in running:
            job.stop()
        for job in running:
            job.wait(10)
        return len(running)
