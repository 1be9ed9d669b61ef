"""Stopping from outside: Ctrl-C and a termination end a command in the same orderly way, and in time.

Python heeds a signal only when a compiled call returns, and one call, or the compilation of one, may take long.  What counts is
on the disk at any moment, so what does not answer in time is ended where it is.
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

# Seconds after an interruption in which a further one is the same wish: it must not cut short what is being kept.
_SAME = 10.0
# Seconds for an orderly end.
_PATIENCE = 1.0

_answering = threading.Lock()
_stop: Callable[[], str] | None = None
_is_answered = False


class Interrupted(Exception):
    """A command stopped part-way and can be resumed; the message says where."""


def is_interruption(error: BaseException | None) -> bool:
    """Whether an error comes from Ctrl-C: an extension that is being loaded when that comes makes an error of its own of it,
    and one in Rust no Exception."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt) or "KeyboardInterrupt" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def heed_interruptions() -> None:
    """Let a termination interrupt like Ctrl-C, and neither be lost.

    One that comes during a callback of the garbage collector, of which JAX has one, Python reports and forgets.
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
            # Again as a termination, which is heeded also where a shell lets its background processes ignore Ctrl-C.
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
    """Within, the first interruption raises KeyboardInterrupt, and ends the process with status 3 if that takes too long.

    Further ones are ignored, so that nothing interrupts what puts in order what there is.
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
    # Told as a signal comes, whatever the main thread is doing.
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
            # The main thread is on its way out.
            time.sleep(_PATIENCE)
    finally:
        os._exit(3)


@contextmanager
def answered_by(stop: Callable[[], str]) -> Iterator[None]:
    """Let an interruption be answered.

    Arguments:
        stop: puts in order what there is and says where it stopped; called on another thread where the main one is busy.

    Raises:
        Interrupted: it was interrupted; the message is what `stop` said.
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
    """Answer an interruption: what there is to say, None where it was said already."""
    global _is_answered
    with _answering:
        if _is_answered:
            return None
        _is_answered = True
        return "stopped before there was anything to keep" if _stop is None else _stop()
