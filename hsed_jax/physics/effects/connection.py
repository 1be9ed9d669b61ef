"""The connection between specimen and structure: slack and flexibility."""

from typing import ClassVar, Literal, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.driven import AbstractWornEffect, heating
from hsed_jax.physics.effects.forms import FREE, near_no_force, raised
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_number, is_zero
from hsed_jax.physics.states import LARGEST_ELONGATION, SharedState

# Of the characteristic force.
_SMALL = 0.02


@register
@final
class Gap(AbstractSpringEffect):
    r"""A slack: no force within $\delta u_c$ to either side of the origin.

    In series it is the play of a connection, which moves with the element and opens at every reversal.  While the force stays
    below $w_z z_u$, the element passes through $\delta u_c$ to either side of zero force.
    """

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
        Form(
            "in series",
            r"c(z) \propto \delta u_c\,e^{-|z/\sigma|^m/m},\ \sigma = w_z F_c",
            "Nordin & Gutman 2002 (backlash)",
            held={"in_series": 1.0},
            free=("play", "abruptness"),
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
    of_largest: Scalar = share_parameter("w", "whether the slack grows with the largest elongation")
    of_energy: Scalar = share_parameter("w_e", "whether the slack grows with the absorbed energy")
    in_series: Scalar = share_parameter("w_s", "whether the slack moves with the element")
    play: Scalar = shape_parameter(
        "w_z",
        "force that closes the slack, over characteristic force",
        neutral=0.05,
        lower=0.01,
        # One that takes more force to close is no play, but a support that has yet to bed.
        upper=0.2,
        prior={"lognormal": [-3.0, 0.7]},
    )
    abruptness: Scalar = shape_parameter(
        "m", "how abruptly the slack closes", neutral=2.0, lower=1.0, upper=6.0, prior={"lognormal": [0.7, 0.3]}
    )

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation, if the slack widens with it."""
        return () if is_zero(self.of_largest) else (LARGEST_ELONGATION,)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `slack`, or to `compliance`."""
        fixed = point.scales.elongation
        width = fixed
        if not is_zero(self.of_largest):
            width = width + self.of_largest * (point.memory["largest_elongation"] - fixed)
        if not is_zero(self.of_energy):
            used = jnp.maximum(point.memory["energy"], 0.0) / point.scales.energy
            width = jnp.maximum(width + self.of_energy * (used - 1) * fixed, 0.0)
        found: dict[str, Scalar] = {}
        if not is_number(self.in_series, 1):
            found["slack"] = (1 - self.in_series) * self.delta * width
        if not is_zero(self.in_series):
            profile = near_no_force(point.hysteretic, self.play * point.scales.force, self.abruptness)
            found["compliance"] = self.in_series * self.delta * fixed * profile
        return found


@register
@final
class SupportFlexibility(AbstractWornEffect):
    r"""A spring in series with the specimen, u its elongation: linear with the compliance $\delta u_c/F_c$, or nonlinear.

    The formula of a nonlinear or loosening form is that of the compliance $du/dF$.  A support that has loosened stays softer, and
    a constant force moves nothing.
    """

    name: ClassVar[str] = "support_flexibility"
    family: ClassVar[str] = "structure"
    reference: ClassVar[str] = "Clough & Penzien 2003, section 2-2"
    place: ClassVar[Literal["spring", "structure", "test rig"]] = "structure"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("linear", r"u = \delta u_c\,F/F_c"),
        Form(
            "power",
            r"\frac{du}{dF} = \delta\frac{u_c}{F_c}\,p\max(|F/F_c|, 0.02)^{p-1}",
            "Hertz 1882; Ramberg & Osgood 1943",
            free=("power",),
            in_units=False,
        ),
        heating(r"\frac{du}{dF} = \delta\frac{u_c}{F_c}\,", "Ibrahim & Pettit 2005 (joints that loosen)", "loosening"),
        Form(
            FREE,
            r"\frac{du}{dF} = \delta\frac{u_c}{F_c}\left(p\max(|F/F_c|, 0.02)^{p-1} + b\,e^{-|F/wF_c|^m}\right)",
            free=("power", "bedding", "bedded", "abruptness"),
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
    bedding: Scalar = shape_parameter(
        "b",
        "how much softer the support is before bedding",
        neutral=0.0,
        lower=0.0,
        upper=50.0,
        prior={"half_normal": 3.0},
    )
    bedded: Scalar = shape_parameter(
        "w",
        "force of bedding over characteristic force",
        neutral=0.4,
        # One that is bedded by less force is play, which the gap in series is.
        lower=0.2,
        prior={"lognormal": [-0.9, 0.5]},
    )
    abruptness: Scalar = shape_parameter(
        "m", "how abruptly the support beds", neutral=1.0, lower=1.0, upper=6.0, prior={"uniform": [1.0, 6.0]}
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `compliance`."""
        slope, force = 1.0, jnp.abs(point.hysteretic / point.scales.force)
        if not is_number(self.power, 1):
            # A support that gives way at no force at all would hold the element there: the slope ends where the force is small.
            slope = self.power * jnp.maximum(force, _SMALL) ** (self.power - 1)
        if not is_zero(self.bedding):
            slope = slope + self.bedding * jnp.exp(-raised(force / self.bedded, self.abruptness))
        flexibility = self.delta * (point.scales.elongation / point.scales.force)
        return {"compliance": flexibility * slope * self.lasting(point)}
