"""Errors of the numerical substructure: its masses, its supports, its damping."""

from typing import Any, ClassVar, Literal, final

import numpy as np

from hsed_jax.physics.effects.base import AbstractSetupEffect, Scalar, Setup, register
from hsed_jax.physics.parameters import parameter


@register
@final
class DampingError(AbstractSetupEffect):
    r"""Damping of the structure differs from the assumed one: $(1+\delta)\,C$."""

    name: ClassVar[str] = "damping_error"
    family: ClassVar[str] = "structure"
    reference: ClassVar[str] = "Chopra 2017, section 11.2"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "structure"
    needs_time: ClassVar[bool] = True
    shaken_only: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_C", "1", "relative error of damping", neutral=0.0, lower=-1.0, prior={"normal": [0.0, 0.3]}
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """A factor on `damping`."""
        return {"damping": 1 + self.delta}


@register
@final
class MassError(AbstractSetupEffect):
    r"""Masses differ from the assumed ones: $m_i\,(1 + \delta + \tau x_i)$.

    $x_i$ runs evenly from −1 at the first mass to 1 at the last one (0 for a single mass); C does not change.
    """

    name: ClassVar[str] = "mass_error"
    family: ClassVar[str] = "structure"
    reference: ClassVar[str] = "Friswell & Mottershead 1995"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "structure"
    needs_time: ClassVar[bool] = True
    shaken_only: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_M", "1", "relative error of all masses", neutral=0.0, lower=-0.5, prior={"normal": [0.0, 0.1]}
    )
    tilt: Scalar = parameter(
        r"\tau_M",
        "1",
        "relative error of the last mass, opposite at the first",
        neutral=0.0,
        lower=-0.49,
        upper=0.49,
        prior={"normal": [0.0, 0.1]},
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """Factors on `mass`."""
        return {"mass": 1 + self.delta + self.tilt * _places(setup.masses)}


@register
@final
class SupportStiffnessError(AbstractSetupEffect):
    r"""Springs to the ground differ from the assumed ones: $k_i\,(1 + \delta + \tau x_i)$.

    $x_i$ runs evenly from −1 at the first such spring to 1 at the last one (0 for a single spring); C does not change.
    """

    name: ClassVar[str] = "support_stiffness_error"
    family: ClassVar[str] = "structure"
    reference: ClassVar[str] = "Friswell & Mottershead 1995"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "structure"
    shaken_only: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_K", "1", "relative error of all supports", neutral=0.0, lower=-0.5, prior={"normal": [0.0, 0.2]}
    )
    tilt: Scalar = parameter(
        r"\tau_K",
        "1",
        "relative error of the last support, opposite at the first",
        neutral=0.0,
        lower=-0.49,
        upper=0.49,
        prior={"normal": [0.0, 0.2]},
    )

    def contribute(self, setup: Setup) -> dict[str, Any]:
        """Factors on `support`."""
        return {"support": 1 + self.delta + self.tilt * _places(setup.supports)}


def _places(count: int) -> np.ndarray:
    """Evenly from −1 to 1."""
    return np.linspace(-1, 1, count) if count > 1 else np.zeros(count)
