"""The exception for mistakes of the user, and the place in front of its message."""

from collections.abc import Callable
from typing import Any


class UserError(Exception):
    """A mistake in a study, a campaign or a command: one message with the fault, its place, and the allowed values.

    The command line prints the message alone and exits with status 2; Python raises it unchanged.
    """


def at(where: str, make: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function, and put the place in front of the message if it raises a `UserError`."""
    try:
        return make(*arguments)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None
