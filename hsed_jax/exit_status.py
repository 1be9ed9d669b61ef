"""The end of a command: its exit status, and one message if it is not 0.

0 complete; 1 a defect of the package; 2 the input of the user is wrong; 3 incomplete, can be resumed.
"""

import argparse
import atexit
import errno
import gc
import os
import sys
from collections.abc import Callable, Sequence
from io import TextIOWrapper

from hsed_jax.errors import UserError
from hsed_jax.interruptions import answer, is_interruption

# Errors of a full disk.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


def ended(parser: Callable[[], argparse.ArgumentParser], arguments: Sequence[str] | None) -> int:
    """Parse a command line and carry out the `command` of its options.

    Arguments:
        parser: makes the parser; called here, so that a Ctrl-C during its loading is handled.
        arguments: the words of the command line; None for those of this process.

    Returns:
        The exit status; a message that explains it is on the standard error.
    """
    if arguments is None:  # this process belongs to the command
        _look_for_garbage_seldom()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a letter that the terminal cannot show must not end a run
    try:
        return _carried_out(_parsed(parser(), arguments))
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # The reader has closed the pipe, as `| head` has; the remaining output is dropped.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 3
    except OSError as error:
        if error.errno not in _FULL:
            raise
        return _told(f"error: {error.filename or 'what was made'} cannot be written ({error.strerror}); free some space, "
                     "and continue a run with --resume", 3)  # fmt: skip
    except BaseException as error:
        if not is_interruption(error):
            raise
        return _interrupted()


def _parsed(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    # argparse gives sub-commands no intermixed arguments: an override behind an option is left over.
    options, rest = parser.parse_known_args(arguments)
    if rest and (not hasattr(options, "overrides") or any(word.startswith("-") for word in rest)):
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    if rest:
        options.overrides = [*options.overrides, *rest]
    if getattr(options, "output", None) == "":  # for example of an unset variable
        parser.error("argument --output: it is empty")
    return options


def _carried_out(options: argparse.Namespace) -> int:
    try:
        status = options.command(options)
        print(end="", flush=True)
        return status
    except UserError as error:
        return _told(f"error: {error}", 2)
    except SystemExit as left:  # for example an effect, which is code of the user
        return _told(f"error: code that the study names called sys.exit({left.code!r})", 2)


def _look_for_garbage_seldom() -> None:
    """Nearly all objects that a command loads and traces live until the end of its process. Repeated garbage collection of
    these objects takes a third of the time of a short command.
    """
    gc.set_threshold(100_000, 20, 100)
    atexit.register(gc.freeze)


def _interrupted() -> int:
    return _told(answer(), 3)


def _told(words: str | None, status: int) -> int:
    if words:
        print(words, file=sys.stderr)
    return status
