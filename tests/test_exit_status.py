"""A command ends with the exit status that the manual promises, and with one message, whatever happens to it."""

import argparse
import errno
import os
import subprocess
import sys

import pytest

from hsed_jax import interruptions
from hsed_jax.command_line import main
from hsed_jax.errors import UserError
from hsed_jax.exit_status import ended


@pytest.fixture(autouse=True)
def in_a_new_process(monkeypatch):
    """A process is interrupted once."""
    monkeypatch.setattr(interruptions, "_is_answered", False)


def status_of(command) -> int:
    def parser() -> argparse.ArgumentParser:
        made = argparse.ArgumentParser()
        made.set_defaults(command=command)
        return made

    return ended(parser, [])


def stopped_while_loading(options):
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt as stop:
        raise ImportError("an extension could not be initialised") from stop


def failing(error):
    def command(options):
        raise error

    return command


@pytest.mark.parametrize(
    ("command", "status", "words"),
    [
        (lambda options: 0, 0, ""),
        (failing(UserError("no such key")), 2, "error: no such key"),
        (failing(SystemExit(7)), 2, "sys.exit(7)"),
        (failing(KeyboardInterrupt()), 3, "stopped"),
        (stopped_while_loading, 3, "stopped"),
        (failing(OSError(errno.ENOSPC, "No space left on device", "run/results.nc")), 3, "run/results.nc"),
        (failing(OSError(errno.ENOSPC, "No space left on device")), 3, "free some space"),
    ],
)
def test_every_end_has_its_status_and_one_line(command, status, words, capsys):
    assert status_of(command) == status
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == bool(words)


@pytest.mark.parametrize("defect", [ValueError("ours"), OSError(errno.ENOENT, "no such file"), ImportError("broken")])
def test_a_defect_keeps_its_traceback(defect):
    with pytest.raises(type(defect)):
        status_of(failing(defect))


def test_an_output_without_a_name_is_refused(capsys):
    with pytest.raises(SystemExit) as exit:
        main(["run", "study.yaml", "--output", ""])
    assert exit.value.code == 2 and "--output" in capsys.readouterr().err


CODE = """
import argparse, sys
from hsed_jax.exit_status import ended
def parser():
    made = argparse.ArgumentParser()
    made.set_defaults(command=lambda options: print("ζ ± " * 100_000) or 0)
    return made
sys.exit(ended(parser, []))
"""


def test_a_reader_who_has_seen_enough_is_no_fault():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-c", CODE], stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (3, "")


def test_a_terminal_without_the_letters_is_no_fault():
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith("? ? ?")


def test_no_output_at_all_is_no_fault():
    done = subprocess.run(
        [sys.executable, "-c", "import sys; sys.stdout = None\n" + CODE], stderr=subprocess.PIPE, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
