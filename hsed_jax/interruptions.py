"""Stopping from outside: Ctrl-C and a termination end a command in the same orderly way."""

import os
import signal
import sys
import threading
from typing import Any


def heed_interruptions() -> None:
    """Let a termination interrupt like Ctrl-C, and neither be lost.

    One that comes during a callback of the garbage collector, of which JAX has one, Python reports and forgets.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)

    def hook(unraisable: Any) -> None:
        if unraisable.exc_type is KeyboardInterrupt:
            # Again as a termination, which is heeded also where a shell lets its background processes ignore Ctrl-C.
            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
        else:
            sys.__unraisablehook__(unraisable)

    sys.unraisablehook = hook
