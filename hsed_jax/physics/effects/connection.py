"""What lies between the specimen and the structure: slack, and flexibility."""

from typing import ClassVar, Literal, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.effects.forms import FREE, Form
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_number, is_zero
from hsed_jax.physics.states import LARGEST_ELONGATION, SharedState

# Of the characteristic force.
_SMALL = 0.02


@register
@final
class Gap(AbstractSpringEffect):
    r"""A slack: no force within $\delta u_c$ to either side of the origin."""

    name: ClassVar[str] = "gap"
    family: ClassVar[str] = "contact"
    reference: ClassVar[str] = "Ibrahim 2009, section 2.4"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("fixed", r"s = \delta u_c"),
        Form(
            "widening",
            r"s = \delta\max|\Delta u|",
            "Baber & Noori 1985 (slip)",
            held={"of_largest": 1.0},
            in_units=False,
        ),
        Form(
            "widening of energy",
            r"s = \delta u_c\,e/E_c",
            "Baber & Noori 1986 (slip)",
            held={"of_energy": 1.0},
            in_units=False,
        ),
        Form(
            FREE,
            r"s = \delta\left(w_u\max|\Delta u| + w_e u_c\,e/E_c + (1 - w_u - w_e)u_c\right)",
            free=("of_largest", "of_energy"),
            in_units=False,
        ),
    )

    delta: Scalar = parameter(
        r"\delta_g",
        "1",
        "slack over characteristic elongation",
        neutral=0.0,
        lower=0.0,
        upper=1.0,
        prior={"half_normal": 0.2},
        physical=PhysicalForm("width", "m", lambda scales: scales.elongation),
    )
    of_largest: Scalar = share_parameter("w", "whether it widens with the largest elongation")
    of_energy: Scalar = share_parameter("w_e", "whether it widens with the absorbed energy")

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation, where it widens with that."""
        return () if is_zero(self.of_largest) else (LARGEST_ELONGATION,)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `slack`."""
        fixed = point.scales.elongation
        width = fixed
        if not is_zero(self.of_largest):
            width = width + self.of_largest * (point.memory["largest_elongation"] - fixed)
        if not is_zero(self.of_energy):
            used = jnp.maximum(point.memory["energy"], 0.0) / point.scales.energy
            width = jnp.maximum(width + self.of_energy * (used - 1) * fixed, 0.0)
        return {"slack": self.delta * width}


@register
@final
class SupportFlexibility(AbstractSpringEffect):
    r"""A linear spring in series with the specimen: compliance $\delta u_c/F_c$."""

    name: ClassVar[str] = "support_flexibility"
    family: ClassVar[str] = "structure"
    reference: ClassVar[str] = "Clough & Penzien 2003, section 2-2"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "structure"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear", r"u = \delta u_c\,F/F_c"),
        Form(
            "power",
            r"u = \delta u_c|F/F_c|^p\,\mathrm{sign}\,F",
            "Hertz 1882; Ramberg & Osgood 1943",
            free=("power",),
            in_units=False,
        ),
    )

    delta: Scalar = parameter(
        r"\delta_s",
        "1",
        "elongation of the support at the characteristic force over the characteristic elongation",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("compliance", "m/N", lambda scales: scales.elongation / scales.force),
    )
    power: Scalar = shape_parameter(
        "p", "power of the force", neutral=1.0, lower=0.3, upper=6.0, prior={"lognormal": [0.0, 0.6]}
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `compliance`."""
        compliance = self.delta * (point.scales.elongation / point.scales.force)
        if not is_number(self.power, 1):
            # A support that gives way at no force at all would hold the element there: the slope ends where the force is small.
            ratio = jnp.maximum(jnp.abs(point.hysteretic / point.scales.force), _SMALL)
            compliance = compliance * self.power * ratio ** (self.power - 1)
        return {"compliance": compliance}
