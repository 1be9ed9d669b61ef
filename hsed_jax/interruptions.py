"""Stopping from outside: Ctrl-C and a termination end a command in the same orderly way."""

import os
import signal
import sys
import threading
import time
from typing import Any

# Seconds after an interruption in which a further one is the same wish: it must not cut short what is being kept.
_SAME = 10.0


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
