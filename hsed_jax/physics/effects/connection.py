"""What lies between the specimen and the structure: slack, and flexibility."""

from typing import ClassVar, Literal, final

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.effects.forms import Form
from hsed_jax.physics.parameters import PhysicalForm, parameter, share_parameter
from hsed_jax.physics.scales import is_zero
from hsed_jax.physics.states import LARGEST_ELONGATION, SharedState


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

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation, where it widens with that."""
        return () if is_zero(self.of_largest) else (LARGEST_ELONGATION,)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `slack`."""
        width = point.scales.elongation
        if not is_zero(self.of_largest):
            width = width + self.of_largest * (point.memory["largest_elongation"] - width)
        return {"slack": self.delta * width}


@register
@final
class SupportFlexibility(AbstractSpringEffect):
    r"""A linear spring in series with the specimen: compliance $\delta u_c/F_c$."""

    name: ClassVar[str] = "support_flexibility"
    family: ClassVar[str] = "structure"
    reference: ClassVar[str] = "Clough & Penzien 2003, section 2-2"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "structure"

    delta: Scalar = parameter(
        r"\delta_s",
        "1",
        "elongation of the support at the characteristic force over the characteristic elongation",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 0.3},
        physical=PhysicalForm("compliance", "m/N", lambda scales: scales.elongation / scales.force),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `compliance`."""
        return {"compliance": self.delta * (point.scales.elongation / point.scales.force)}
