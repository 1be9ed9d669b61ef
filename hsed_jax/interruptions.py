"""Stopping from outside: Ctrl-C and a termination end a command in the same regular way, and in time.

Python handles a signal only when a compiled call returns, and one call, or its compilation, may take long. All results are on
the disk at any moment, so a call that does not return in time is abandoned.
"""

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# Seconds after an interruption in which a further one is ignored: it must not interrupt the storage.
_SAME = 10.0
# Seconds for a regular end.
_PATIENCE = 1.0

_answering = threading.Lock()
_stop: Callable[[], str] | None = None
_is_answered = False


class Interrupted(Exception):
    """An incomplete command that can be resumed; the message has its position."""


def is_interruption(error: BaseException | None) -> bool:
    """Whether an error comes from Ctrl-C: an extension that is being loaded raises its own error, and one in Rust
    raises an error that is not an Exception.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt) or "KeyboardInterrupt" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def heed_interruptions() -> None:
    """Let a termination interrupt like Ctrl-C, and neither be lost.

    Python only prints an interruption during a callback of the garbage collector (JAX has one), and then ignores it.
    """
    heeded = -_SAME

    def interrupt(number: int, frame: Any) -> None:
        nonlocal heeded
        if (now := time.monotonic()) >= heeded + _SAME:
            heeded = now
            signal.default_int_handler(number, frame)

    def hook(unraisable: Any) -> None:
        nonlocal heeded
        if unraisable.exc_type is KeyboardInterrupt:
            heeded = -_SAME
            # Again as a termination, which also works if a shell lets its background processes ignore Ctrl-C.
            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        else:
            sys.__unraisablehook__(unraisable)

    for number in (signal.SIGINT, signal.SIGTERM):
        # A shell lets its background processes ignore Ctrl-C.
        if signal.getsignal(number) is not signal.SIG_IGN or number == signal.SIGTERM:
            signal.signal(number, interrupt)
    sys.unraisablehook = hook


@contextmanager
def ended_in_time() -> Iterator[None]:
    """A context in which the first interruption raises KeyboardInterrupt, and ends the process with status 3 if this takes
    too long. Further ones are ignored, so that they do not disturb the storage of the results.
    """
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    heed_interruptions()
    came = threading.Event()

    def interrupt(number: int, frame: Any) -> None:
        if not came.is_set():
            came.set()
            raise KeyboardInterrupt

    for number, handler in before.items():
        # A shell lets its background processes ignore Ctrl-C.
        if handler is not signal.SIG_IGN or number == signal.SIGTERM:
            signal.signal(number, interrupt)
    hears, tells = socket.socketpair()
    tells.setblocking(False)
    # Called at a signal, for any state of the main thread.
    told_before = signal.set_wakeup_fd(tells.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_see_to_the_end, args=(hears,), daemon=True).start()
    try:
        yield
    finally:
        if not came.is_set():
            signal.set_wakeup_fd(told_before)
            for number, handler in before.items():
                signal.signal(number, handler)
            tells.close()


def _see_to_the_end(hears: socket.socket) -> None:
    with hears:
        if not hears.recv(1):
            return
    time.sleep(_PATIENCE)
    try:
        if words := answer():
            print(words, file=sys.stderr, flush=True)
        else:
            # The main thread is ending.
            time.sleep(_PATIENCE)
    finally:
        os._exit(3)


@contextmanager
def answered_by(stop: Callable[[], str]) -> Iterator[None]:
    """Let an interruption be answered.

    Arguments:
        stop: stores the results and returns the position of the stop; called on another thread if the main one is busy.

    Raises:
        Interrupted: it was interrupted; with the message of `stop`.
    """
    global _stop, _is_answered
    _stop, _is_answered = stop, False
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(answer()) from None
    finally:
        _stop = None


def answer() -> str | None:
    """Handle an interruption: the message, None if it is already printed."""
    global _is_answered
    with _answering:
        if _is_answered:
            return None
        _is_answered = True
        return "stopped before there was anything to keep" if _stop is None else _stop()
