"""Effects that come with what a specimen has gone through: absorbed energy, length of path, largest elongation."""

from typing import ClassVar

from hsed_jax.physics.effects.base import AbstractSpringEffect, SpringPoint
from hsed_jax.physics.effects.forms import DRIVERS, chosen, driven_by
from hsed_jax.physics.parameters import share_parameter
from hsed_jax.physics.scales import Scalar, is_zero
from hsed_jax.physics.states import SharedState


class AbstractDrivenEffect(AbstractSpringEffect):
    """An effect with a choice of drivers; which it is, a form says.

    Attributes:
        driver_1, driver_2: one for the driver that counts in place of the first.
    """

    drivers: ClassVar[tuple[str, ...]] = ("energy", "path", "largest_elongation")

    driver_1: Scalar = share_parameter("w_1", "share of another driver")
    driver_2: Scalar = share_parameter("w_2", "share of another driver")

    @property
    def _shares(self) -> dict[str, Scalar]:
        """What each driver counts for; without those that are known not to."""
        others = {
            name: getattr(self, chosen(number))
            for number, name in enumerate(self.drivers)
            if number and not is_zero(getattr(self, chosen(number)))
        }
        first = 1.0
        for share in others.values():
            first = first - share
        return others if is_zero(first) else {self.drivers[0]: first, **others}

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The states of its drivers."""
        return tuple(state for name in self._shares if (state := DRIVERS[name].state) is not None)

    def driven(self, point: SpringPoint) -> Scalar:
        """What drives it at one instant, of order one."""
        shares = self._shares
        if len(shares) == 1:
            return driven_by(next(iter(shares)), point)
        total = 0.0
        for name, share in shares.items():
            total = total + share * driven_by(name, point)
        return total
