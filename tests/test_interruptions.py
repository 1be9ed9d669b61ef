"""Ctrl-C and terminations: answered in time, once, whatever the process is busy with."""

import signal
import subprocess
import sys
import time

import pytest

from hsed_jax.interruptions import Interrupted, answered_by, ended_in_time

# A call that holds the main thread for minutes and returns to no signal, as a compiled one does.
BUSY = """
import hashlib, sys, threading
from hsed_jax.interruptions import Interrupted, answered_by, ended_in_time
try:
    with ended_in_time(), answered_by(lambda: "stopped at the sum"):
        threading.Timer(0.5, lambda: print("busy", flush=True)).start()
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
except Interrupted as stopped:
    print(stopped, file=sys.stderr)
    sys.exit(3)
"""

# Ctrl-C as a module is looked for.
LOADING = """
import os, signal, sys
wanted = sys.argv.pop(1)
class Finder:
    def find_spec(self, name, *_):
        if name == wanted:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from hsed_jax.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    "module", ["hsed_jax.command_line", "argparse", "hsed_jax.interruptions", "hsed_jax.app.command", "pydantic"]
)
def test_one_that_comes_while_the_command_is_loaded_ends_in_one_line(module):
    words = [sys.executable, "-c", LOADING, module, "check", "nowhere.yaml"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3, "stopped before there was anything to keep\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_process_that_is_busy_with_one_call_answers_in_time(number):
    process = subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "busy\n"
    began = time.monotonic()
    for _ in range(9):
        process.send_signal(number)
    try:
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, errors) == (3, "stopped at the sum\n")
    # Two seconds on a machine that has nothing else to do.
    assert time.monotonic() - began < 10


def test_an_interruption_that_can_be_heeded_is_answered_where_it_comes():
    began = time.monotonic()
    with pytest.raises(Interrupted, match="as far as here"), answered_by(lambda: "as far as here"):
        raise KeyboardInterrupt
    assert time.monotonic() - began < 1


def test_what_was_not_interrupted_leaves_the_signals_as_they_were():
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    with ended_in_time():
        assert signal.getsignal(signal.SIGINT) is not before[0]
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
