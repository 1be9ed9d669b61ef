"""Figures and tables that could not be made: each is left out and said, and costs nothing else."""

from collections.abc import Callable

from hsed_jax.interruptions import Interrupted, is_interruption


class LeftOut:
    """What was left out, by name, and why.

    Attributes:
        reasons: of each, in words.
    """

    def __init__(self) -> None:
        self.reasons: dict[str, str] = {}

    def attempt[T](self, name: str, make: Callable[[], T], otherwise: T) -> T:
        """Make one thing; where that fails, note why and go on.

        Arguments:
            name: what it is, in words.
            make: makes it.
            otherwise: returned where it fails.

        Raises:
            OSError: the disk is full, say, which is no fault of the thing.
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
        """What to say of each."""
        return [f"the {name} could not be made and is left out ({reason})" for name, reason in self.reasons.items()]
