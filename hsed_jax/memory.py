"""Arrays that exceed the RAM of this machine are refused before their allocation."""

import math

from hsed_jax.errors import UserError

_UNITS = ("bytes", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB", "ZiB", "YiB")


def check_memory(what: str, needed: int, each: int = 0) -> None:
    """Refuse arrays that need more RAM than this machine has.

    Arguments:
        what: subject of the message, such as `design.candidates: 10000000000 candidates`.
        needed: memory that it takes at least [bytes].
        each: memory of one of them, where a number of something is refused [bytes].

    Raises:
        UserError: with the required and the available memory.
    """
    import psutil

    there = psutil.virtual_memory().total
    if needed > there:
        most = f", enough for {there // each}" if each else ""
        raise UserError(f"{what} would take {_size(needed)} of memory; this machine has {_size(there)}{most}")


def _size(count: int) -> str:
    power = min(int(math.log2(count)) // 10, len(_UNITS) - 1)
    return f"{count / 2 ** (10 * power):.3g} {_UNITS[power]}"
