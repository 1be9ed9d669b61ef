"""Plasticity: yielding of a spring that was assumed linear, and a back-stress in parallel to the law."""

# A property stands for an abstract variable of equinox here.
# pyright: reportIncompatibleVariableOverride=false

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.effects.bristles import AbstractBristledEffect
from hsed_jax.physics.effects.forms import FREE, raised
from hsed_jax.physics.parameters import PhysicalForm, parameter, shape_parameter, share_parameter
from hsed_jax.physics.scales import is_zero


@register
@final
class Yielding(AbstractSpringEffect):
    r"""A linear spring yields: $f = k\,\epsilon$ with the elastic elongation $\epsilon = \Delta u - \delta q$.

    $\dot q = (1 - \phi + \phi\,\mathrm{sign}\,\epsilon\Delta\dot u)\,|\epsilon|\,\Delta\dot u/u_c$: the force tends to its bound
    at $\epsilon = u_c/\delta$, as in a Bouc–Wen law with n = 1 and φ = β/(β + γ).  Unloading is elastic for φ = 1/2.

    A share ρ of the stiffness may stay elastic, $f = k[\rho\,\Delta u + (1 - \rho)\,\epsilon]$; this is the Bouc–Wen law with the
    ratio α = ρ.  The form `free` has any exponent n and any γ: $\dot q = (\mathrm{sign}\,\epsilon\Delta\dot u - \chi)
    |\epsilon/u_c|^n\Delta\dot u$.  χ > 1 means β + γ < 0, a loop that hardens.
    """

    name: ClassVar[str] = "yielding"
    family: ClassVar[str] = "hysteresis"
    reference: ClassVar[str] = "Wen 1976"
    linear_only: ClassVar[bool] = True
    forms: ClassVar[tuple[Form, ...]] = (
        Form("to a bound"),
        Form("beside a spring", r"f = k[\rho\,\Delta u + (1-\rho)\,\epsilon]", "Bouc 1967; Wen 1976", free=("elastic",)),
        Form(FREE, r"f = k[\rho\,\Delta u + (1-\rho)\,\epsilon],\ \dot q = (\mathrm{sign}\,\epsilon\Delta\dot u - \chi)"
             r"|\epsilon/u_c|^n\Delta\dot u", "Wen 1976; Ismail, Ikhouane & Rodellar 2009 (its classes)",
             held={"phi": 1.0}, free=("elastic", "turned", "sharpness"), in_units=False),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_y",
        "1",
        "characteristic elongation over that at which the spring yields",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("inverse_yield_elongation", "1/m", lambda scales: 1 / scales.elongation),
    )

    phi: Scalar = parameter(
        r"\phi_y", "1", "fullness of the loop, β/(β + γ)", neutral=0.5, lower=0.0, prior={"uniform": [0.5, 1.0]}
    )
    elastic: Scalar = share_parameter(r"\rho", "share of the stiffness that stays elastic")
    turned: Scalar = shape_parameter(
        r"\chi", "reduction of yielding, equal in both directions of motion", neutral=0.0, prior={"normal": [0.0, 1.0]}
    )
    sharpness: Scalar = shape_parameter(
        "n", "sharpness of yielding", neutral=1.0, lower=0.5, upper=6.0, prior={"lognormal": [0.0, 0.4]}
    )

    @property
    def states(self) -> tuple[str, ...]:
        """The plastic elongation."""
        return ("plastic",)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `plastic`."""
        plastic = self.delta * point.memory["plastic"]
        return {"plastic": plastic if is_zero(self.elastic) else (1 - self.elastic) * plastic}

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Rate of the plastic elongation over δ."""
        elastic = point.elongation - self.delta * point.memory["plastic"]
        share = 1 - self.phi - self.turned + self.phi * jnp.sign(point.rate * elastic)
        size = jnp.abs(elastic) / point.scales.elongation
        return {"plastic": share * raised(size, self.sharpness) * point.rate}


@register
@final
class KinematicHardening(AbstractBristledEffect):
    r"""A back-stress in parallel, which follows the plastic elongation $u_p = \Delta u - z/k_0$ and recovers from it.

    $$\delta F_c\alpha,\qquad u_c\,\frac{d\alpha}{du_p} = 1 - \frac{\alpha}{\ell}\,\mathrm{sign}\,\dot u_p$$

    Its initial modulus is $\delta F_c/u_c$ and its bound is $\delta\ell F_c$.
    """

    name: ClassVar[str] = "kinematic_hardening"
    family: ClassVar[str] = "hardening"
    reference: ClassVar[str] = "Armstrong & Frederick 1966; Chaboche 1986"

    delta: Scalar = parameter(
        r"\delta_\alpha",
        "1",
        "modulus of the back-stress over characteristic stiffness",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("k", "N/m", lambda scales: scales.force / scales.elongation),
    )
    bristle: Scalar = parameter(
        r"\ell",
        "1",
        "plastic elongation of recovery, over characteristic elongation",
        neutral=0.5,
        lower=0.02,
        upper=5.0,
        prior={"lognormal": [-0.7, 0.8]},
    )

    @property
    def of_bristle(self) -> Scalar:
        """Always 1."""
        return 1.0

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `force`."""
        return {"force": self.delta * point.scales.force * self.bristle * self.bent(point)}

    def foot(self, point: SpringPoint) -> Scalar:
        """The plastic elongation [m]."""
        return point.elongation - point.hysteretic / point.stiffness
