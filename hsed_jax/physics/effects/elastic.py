"""Elastic springs beside the hysteretic one: post-yield stiffness of several shapes, and contact."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import PhysicalForm, parameter


@register
@final
class Hardening(AbstractSpringEffect):
    r"""A linear spring in parallel: $\delta\,\frac{F_c}{u_c}\,\Delta u$; negative is P-Δ."""

    name: ClassVar[str] = "hardening"
    family: ClassVar[str] = "post-yield"
    reference: ClassVar[str] = "Wen 1976"

    delta: Scalar = parameter(
        r"\delta_k",
        "1",
        "post-yield stiffness over characteristic stiffness",
        neutral=0.0,
        lower=-1.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        force, elongation = point.scales.force, point.scales.elongation
        return {"force": self.delta * (force / elongation) * point.elongation}


@register
@final
class CubicStiffness(AbstractSpringEffect):
    r"""A cubic spring in parallel (Duffing): $\delta\,F_c\,(\Delta u/u_c)^3$."""

    name: ClassVar[str] = "cubic_stiffness"
    family: ClassVar[str] = "post-yield"
    reference: ClassVar[str] = "Duffing 1918"

    delta: Scalar = parameter(
        r"\delta_3",
        "1",
        "cubic force at the characteristic elongation over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("k3", "N/m^3", lambda scales: scales.force / scales.elongation**3),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.elongation / point.scales.elongation
        return {"force": self.delta * point.scales.force * ratio * ratio * ratio}


@register
@final
class QuadraticStiffness(AbstractSpringEffect):
    r"""A quadratic spring in parallel, which pulls both ways alike: $\delta\,F_c\,(\Delta u/u_c)^2$."""

    name: ClassVar[str] = "quadratic_stiffness"
    family: ClassVar[str] = "asymmetry"
    reference: ClassVar[str] = "Nayfeh & Mook 1979"

    delta: Scalar = parameter(
        r"\delta_2",
        "1",
        "quadratic force at the characteristic elongation over the characteristic force",
        neutral=0.0,
        prior={"normal": [0.0, 0.3]},
        physical=PhysicalForm("k2", "N/m^2", lambda scales: scales.force / scales.elongation**2),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        ratio = point.elongation / point.scales.elongation
        return {"force": self.delta * point.scales.force * ratio * ratio}


@register
@final
class ContactStiffening(AbstractSpringEffect):
    r"""An elastic stop behind a clearance: $\delta\,\frac{F_c}{u_c}\,\mathrm{sign}(\Delta u)\max(|\Delta u| - c\,u_c, 0)$."""

    name: ClassVar[str] = "contact_stiffening"
    family: ClassVar[str] = "contact"
    reference: ClassVar[str] = "Anagnostopoulos 1988 (pounding)"

    delta: Scalar = parameter(
        r"\delta_c",
        "1",
        "stiffness of the stop over characteristic stiffness",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )
    clearance: Scalar = parameter(
        "c",
        "1",
        "clearance over characteristic elongation",
        neutral=0.5,
        lower=0.0,
        prior={"uniform": [0.0, 1.0]},
        physical=PhysicalForm("gap", "m", lambda scales: scales.elongation),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        scales = point.scales
        beyond = jnp.maximum(jnp.abs(point.elongation) - self.clearance * scales.elongation, 0.0)
        return {"force": self.delta * (scales.force / scales.elongation) * jnp.sign(point.elongation) * beyond}
