"""Effects that depend on the past of a test: absorbed energy, length of the path, largest elongation."""

from typing import Any, ClassVar

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, SpringPoint
from hsed_jax.physics.effects.forms import DRIVERS, chosen
from hsed_jax.physics.parameters import shape_parameter, share_parameter
from hsed_jax.physics.scales import Scalar, is_number, is_zero
from hsed_jax.physics.states import TRAVEL, SharedState


def index_share() -> Any:
    """The parameter that weighs the two measures of a combined driver."""
    return share_parameter("w_d", "share of the largest elongation in the driver", neutral=0.5)


def power_of(symbol: str, of: str) -> Any:
    """The parameter that is the power of a measure in a combined driver."""
    return shape_parameter(symbol, f"power of {of} in the driver", neutral=1.0, lower=0.2, upper=4.0,
                           prior={"lognormal": [0.0, 0.7]})  # fmt: skip


class AbstractDrivenEffect(AbstractSpringEffect):
    """An effect with a choice of drivers; the form determines the driver.

    Attributes:
        driver_1, driver_2: 1 selects this driver instead of the default one.
    """

    drivers: ClassVar[tuple[str, ...]] = ("energy", "path", "largest_elongation")

    driver_1: Scalar = share_parameter("w_1", "share of another driver")
    driver_2: Scalar = share_parameter("w_2", "share of another driver")

    @property
    def _shares(self) -> dict[str, Scalar]:
        """The share of each driver, without those that are known to be zero."""
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
        return tuple(state for name in self._shares for state in DRIVERS[name].states)

    def driven(self, point: SpringPoint) -> Scalar:
        """The value of the driver at one instant, of order one."""
        shares = self._shares
        if len(shares) == 1:
            return self._driver(next(iter(shares)), point)
        total = 0.0
        for name, share in shares.items():
            total = total + share * self._driver(name, point)
        return total

    def _driver(self, name: str, point: SpringPoint) -> Scalar:
        driver = DRIVERS[name]
        return driver.value(point, *(getattr(self, own) for own in driver.free))


class AbstractDamagedEffect(AbstractDrivenEffect):
    """An effect of damage, which has further drivers.

    Attributes:
        driver_3, driver_4, driver_5, driver_6, driver_7: 1 selects this driver instead of the default one.
        driver_share: share of the largest elongation in a combined driver.
        driver_power, driver_other: powers of the path and of the largest elongation in it.
    """

    drivers: ClassVar[tuple[str, ...]] = (
        *AbstractDrivenEffect.drivers,
        *("hysteretic_energy", "reversals", "damage_index", "path_and_elongation", "excursion"),
    )

    driver_3: Scalar = share_parameter("w_3", "share of another driver")
    driver_4: Scalar = share_parameter("w_4", "share of another driver")
    driver_5: Scalar = share_parameter("w_5", "share of another driver")
    driver_6: Scalar = share_parameter("w_6", "share of another driver")
    driver_7: Scalar = share_parameter("w_7", "share of another driver")
    driver_share: Scalar = index_share()
    driver_power: Scalar = power_of("p_s", "the path")
    driver_other: Scalar = power_of("p_u", "the largest elongation")


class AbstractWornEffect(AbstractSpringEffect):
    r"""An effect that changes during a test by the factor $1 + \rho(1 - e^{-x/x_w})$; x is the path (wear) or the absorbed
    energy (heat).

    Attributes:
        worn: ρ, the final relative change.
        wears: x_w, at which two thirds of this change are reached.
        heats: whether x is the absorbed energy.
    """

    worn: Scalar = shape_parameter(
        r"\rho", "final change over the initial value", neutral=0.0, lower=-0.95, upper=5.0,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.5, "low": -0.95, "high": 5.0}},
    )  # fmt: skip
    wears: Scalar = shape_parameter(
        "x_w", "path, or energy, at which two thirds of this change are reached", neutral=0.5, lower=0.02,
        prior={"lognormal": [-0.7, 1.0]},
    )  # fmt: skip
    heats: Scalar = share_parameter("w_h", "whether the change depends on absorbed energy instead of the path")

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The path, if the effect wears."""
        return () if is_zero(self.worn) or is_number(self.heats, 1) else (TRAVEL,)

    def lasting(self, point: SpringPoint) -> Scalar:
        """The factor at one instant."""
        if is_zero(self.worn):
            return 1.0
        x = 0.0
        if not is_zero(self.heats):
            x = self.heats * DRIVERS["energy"].value(point)
        if not is_number(self.heats, 1):
            # Only then does the spring integrate its path (`needs`).
            x = x + (1 - self.heats) * DRIVERS["path"].value(point)
        return 1 - self.worn * jnp.expm1(-jnp.maximum(x, 0.0) / self.wears)


_FACTOR = r"\left[1 + \rho(1 - e^{-x/x_w})\right]"


def wearing(equation: str, reference: str) -> Form:
    """The form of a force that changes along the path."""
    return Form("wearing", rf"{equation}{_FACTOR},\ x = sF_c/E_c", reference, free=("worn", "wears"))


def heating(equation: str, reference: str, name: str = "heating") -> Form:
    """The form of a force that changes with the absorbed energy."""
    return Form(name, rf"{equation}{_FACTOR},\ x = e/E_c", reference, held={"heats": 1.0}, free=("worn", "wears"))
