"""Figures and tables that could not be made: each is left out with a message, without an effect on other results."""

from collections.abc import Callable

from hsed_jax.interruptions import Interrupted, is_interruption


class LeftOut:
    """The omissions, by name, with their reasons.

    Attributes:
        reasons: of each, in words.
    """

    def __init__(self) -> None:
        self.reasons: dict[str, str] = {}

    def attempt[T](self, name: str, make: Callable[[], T], otherwise: T) -> T:
        """Make one item; if this fails, record the reason and continue.

        Arguments:
            name: of the item, in words.
            make: makes it.
            otherwise: returned if it fails.

        Raises:
            OSError: for example a full disk, which is not a fault of the item.
        """
        try:
            return make()
        except (OSError, Interrupted):
            raise
        except Exception as error:
            if is_interruption(error):
                raise
            self.reasons[name] = f"{type(error).__name__}: {error}".splitlines()[0]
            return otherwise

    @property
    def sentences(self) -> list[str]:
        """The message of each."""
        return [f"the {name} could not be made and is left out ({reason})" for name, reason in self.reasons.items()]
