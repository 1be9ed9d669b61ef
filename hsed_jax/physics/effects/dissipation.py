"""Forces against the motion: dampers and friction beside the hysteretic spring."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import PhysicalForm, parameter

# Friction turns over within this share of the characteristic rate: a jump would stall any integrator.
_STICKING = 0.02


@register
@final
class ViscousDamping(AbstractSpringEffect):
    r"""A linear dashpot in parallel: $\delta\,F_c\,\Delta\dot u/v_c$."""

    name: ClassVar[str] = "viscous_damping"
    family: ClassVar[str] = "damping"
    reference: ClassVar[str] = "Chopra 2017, section 1.4"
    needs_time: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_v",
        "1",
        "viscous force at the characteristic rate over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("c", "N*s/m", lambda scales: scales.force / scales.rate),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        return {"force": self.delta * point.scales.force * (point.rate / point.scales.rate)}


@register
@final
class QuadraticDamping(AbstractSpringEffect):
    r"""Drag, quadratic in the rate: $\delta\,F_c\,|\Delta\dot u|\Delta\dot u/v_c^2$."""

    name: ClassVar[str] = "quadratic_damping"
    family: ClassVar[str] = "damping"
    reference: ClassVar[str] = "Nayfeh & Mook 1979"
    needs_time: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_d",
        "1",
        "drag at the characteristic rate over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("c2", "N*s^2/m^2", lambda scales: scales.force / scales.rate**2),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.rate / point.scales.rate
        return {"force": self.delta * point.scales.force * jnp.abs(ratio) * ratio}


@register
@final
class PowerDamping(AbstractSpringEffect):
    r"""A fluid damper in parallel: $\delta\,F_c\,|\Delta\dot u/v_c|^\alpha\,\mathrm{sign}\,\Delta\dot u$."""

    name: ClassVar[str] = "power_damping"
    family: ClassVar[str] = "damping"
    reference: ClassVar[str] = "Symans & Constantinou 1998"
    needs_time: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_\alpha",
        "1",
        "force at the characteristic rate over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )
    alpha: Scalar = parameter(
        r"\alpha", "1", "exponent of the rate", neutral=0.5, lower=0.1, upper=2.0, prior={"uniform": [0.1, 1.0]}
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.rate / point.scales.rate
        # |v|^α has no derivative at rest; below this rate it is linear.
        size = jnp.maximum(jnp.abs(ratio), 1e-3)
        return {"force": self.delta * point.scales.force * jnp.exp((self.alpha - 1) * jnp.log(size)) * ratio}


@register
@final
class CoulombFriction(AbstractSpringEffect):
    r"""Dry friction in parallel: $\delta\,F_c\,\tanh(\Delta\dot u/v_s)$, $v_s = 0.02\,v_c$."""

    name: ClassVar[str] = "coulomb_friction"
    family: ClassVar[str] = "friction"
    reference: ClassVar[str] = "Coulomb 1785"

    delta: Scalar = parameter(
        r"\delta_f",
        "1",
        "friction force over characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        return {"force": self.delta * point.scales.force * jnp.tanh(point.rate / (_STICKING * point.scales.rate))}


@register
@final
class StribeckFriction(AbstractSpringEffect):
    r"""Friction that falls with speed: $\delta\,F_c\,[\mu + (1-\mu)e^{-|\Delta\dot u|/v_r}]\tanh(\Delta\dot u/v_s)$.

    $v_s = 0.02\,v_c$; the share μ remains at high speed, $v_r = 0.2\,v_c$.
    """

    name: ClassVar[str] = "stribeck_friction"
    family: ClassVar[str] = "friction"
    reference: ClassVar[str] = "Constantinou, Mokha & Reinhorn 1990"
    needs_time: ClassVar[bool] = True

    delta: Scalar = parameter(
        r"\delta_s",
        "1",
        "friction force at low speed over characteristic force",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("force", "N", lambda scales: scales.force),
    )
    remaining: Scalar = parameter(
        r"\mu",
        "1",
        "share that remains at high speed",
        neutral=0.5,
        lower=0.0,
        upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.rate / point.scales.rate
        share = self.remaining + (1 - self.remaining) * jnp.exp(-jnp.abs(ratio) / 0.2)
        return {"force": self.delta * point.scales.force * share * jnp.tanh(ratio / _STICKING)}
