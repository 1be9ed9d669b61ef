"""Errors of the test rig: in the imposed motion and in the measured signals."""

from typing import Any, ClassVar, Literal, final

from hsed_jax.physics.effects.base import AbstractSetupEffect, Form, Scalar, Setup, register
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter
from hsed_jax.physics.scales import Scales, is_zero

# The amplitude of a drift is its change over so many characteristic times.
_DRIFTING = 100.0


def _time(scales: Scales) -> Scalar:
    """Characteristic time u_c/v_c [s]."""
    return scales.elongation / scales.rate


class _AbstractRigEffect(AbstractSetupEffect):
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "test rig"


@register
@final
class GroundMotionGain(_AbstractRigEffect):
    r"""The ground motion has a wrong scale: $(1+\delta)\,a_g$."""

    name: ClassVar[str] = "ground_motion_gain"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "Conte & Trombetti 2000 (shaking tables)"
    shaken_only: ClassVar[bool] = True
    ground_only: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_g", "1", "relative error of the ground motion", neutral=0.0, lower=-0.9, prior={"normal": [0.0, 0.1]}
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """A factor on `ground_motion`."""
        return {"ground_motion": 1 + self.delta}


@register
@final
class ForceGain(_AbstractRigEffect):
    r"""The calibration factor of the load cell is wrong: $(1+\delta)\,r$, in histories and quantities, also in energy."""

    name: ClassVar[str] = "force_gain"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "JCGM 100:2008 (GUM)"

    delta: Scalar = parameter(
        r"\delta_F", "1", "relative error of the measured force", neutral=0.0, lower=-0.9, prior={"normal": [0.0, 0.1]}
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """A factor on `force_gain`."""
        return {"force_gain": 1 + self.delta}


@register
@final
class ElongationGain(_AbstractRigEffect):
    r"""The calibration factor of the elongation is wrong: $(1+\delta)\,\Delta u$, in histories, quantities and energy.

    In a component test the imposed elongation is the measured one: the specimen has the elongation $\Delta u/(1+\delta)$.
    """

    name: ClassVar[str] = "elongation_gain"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "JCGM 100:2008 (GUM)"

    delta: Scalar = parameter(
        r"\delta_u",
        "1",
        "relative error of the measured elongation",
        neutral=0.0,
        lower=-0.9,
        prior={"normal": [0.0, 0.1]},
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """A factor on `elongation_gain`."""
        return {"elongation_gain": 1 + self.delta}


@register
@final
class ForceOffset(_AbstractRigEffect):
    r"""The zero of the load cell is wrong: $r + \delta\,F_c$."""

    name: ClassVar[str] = "force_offset"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "JCGM 100:2008 (GUM)"
    histories_only: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("constant", r"\delta F_c"),
        Form("settling", r"\delta F_c\left[1 - \rho e^{-x/x_w}\right],\ x = \frac{t}{100\,u_c/v_c}",
             free=("settling", "settles")),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_0",
        "1",
        "zero shift over characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.1]},
        physical=PhysicalForm("offset", "N", lambda scales: scales.force),
    )
    settling: Scalar = shape_parameter(
        r"\rho", "initial difference from the final shift, over the final shift", neutral=0.0, lower=-1.0, upper=1.0,
        prior={"uniform": [-1.0, 1.0]},
    )  # fmt: skip
    settles: Scalar = shape_parameter(
        "x_w", "time at which two thirds of it are over, over 100 characteristic times", neutral=0.03, lower=0.005,
        # What takes longer is a drift.
        upper=0.1, prior={"lognormal": [-3.5, 0.7]},
    )  # fmt: skip

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """An addend to `force_offset`, and to what it lacks at first."""
        offset = self.delta * setup.scales.force
        if is_zero(self.settling):
            return {"force_offset": offset}
        rate = 1 / (self.settles * _DRIFTING * _time(setup.scales))
        return {"force_offset": offset, "settling_offset": -self.settling * offset, "settling_rate": rate}


@register
@final
class ForceDrift(_AbstractRigEffect):
    r"""The zero of the load cell drifts: $r + \delta\,F_c\,x$, $x = \frac{t}{100\,u_c/v_c}$.

    In a record without a time, one row counts as one second.
    """

    name: ClassVar[str] = "force_drift"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "JCGM 100:2008 (GUM)"
    histories_only: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("steady", r"\delta F_c\,x"),
        Form("late", r"\delta F_c\max(x - x_0, 0)", free=("onset",)),
        Form("slowing", r"\delta F_c\ln(1 + sx)/s", free=("slowing",)),
    )

    delta: Scalar = parameter(
        r"\delta_{\dot 0}",
        "1",
        "zero shift after 100 characteristic times, over characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.1]},
        physical=PhysicalForm("drift", "N/s", lambda scales: scales.force / (_DRIFTING * _time(scales))),
    )
    onset: Scalar = shape_parameter(
        "x_0", "start of the drift, over 100 characteristic times", neutral=0.0, lower=0.0, prior={"half_normal": 0.3}
    )

    slowing: Scalar = shape_parameter(
        "s", "inverse of the time in which the drift slows down, over 100 characteristic times", neutral=0.0, lower=0.0,
        prior={"half_normal": 30.0},
    )  # fmt: skip

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """An addend to `force_drift`, to when that begins, and to how it slows down."""
        span = _DRIFTING * _time(setup.scales)
        found = {"force_drift": self.delta * setup.scales.force / span}
        if not is_zero(self.onset):
            found["drift_onset"] = self.onset * span
        if not is_zero(self.slowing):
            found["drift_slowing"] = self.slowing / span
        return found


@register
@final
class ActuatorDelay(_AbstractRigEffect):
    r"""The measured elongation lags: $\Delta u(t-\tau)$, $\tau = \delta\,u_c/v_c$.

    In a component test the elongation is imposed as it was measured, and the force leads by τ instead.
    """

    name: ClassVar[str] = "actuator_delay"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "Horiuchi, Inoue, Konno & Namita 1999"
    needs_time: ClassVar[bool] = True
    histories_only: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_\tau",
        "1",
        "delay over characteristic time (elongation over rate)",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.1},
        physical=PhysicalForm("tau", "s", _time),
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """An addend to `elongation_delay`."""
        return {"elongation_delay": self.delta * _time(setup.scales)}


@register
@final
class TimeOffset(_AbstractRigEffect):
    r"""The clock of the force differs from that of the elongation: $r(t-\tau)$, $\tau = \delta\,u_c/v_c$, either sign.

    In a record without a time, one row counts as one second.
    """

    name: ClassVar[str] = "time_offset"
    family: ClassVar[str] = "test rig"
    reference: ClassVar[str] = "Horiuchi, Inoue, Konno & Namita 1999"
    histories_only: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_t",
        "1",
        "how late the force is, over characteristic time (elongation over rate)",
        neutral=0.0,
        prior={"normal": [0.0, 0.1]},
        physical=PhysicalForm("tau", "s", _time),
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """An addend to `force_delay`."""
        return {"force_delay": self.delta * _time(setup.scales)}
