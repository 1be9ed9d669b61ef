"""A spring that was taken for linear yields."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import PhysicalForm, parameter


@register
@final
class Yielding(AbstractSpringEffect):
    r"""A linear spring yields: $f = k(\Delta u - p)$, $\dot p = (1 - \phi + \phi\,\mathrm{sign}(x\Delta\dot u))|x|\Delta\dot u$.

    $x = \delta(\Delta u - p)/u_c$ is the elastic elongation over that at which the force comes to its bound, $u_c/\delta$:
    Bouc–Wen with n = 1 and φ = β/(β + γ), whose unloading is elastic at φ = 1/2.  At δ = 0 the bound is infinite.
    """

    name: ClassVar[str] = "yielding"
    family: ClassVar[str] = "hysteresis"
    reference: ClassVar[str] = "Wen 1976"
    states: ClassVar[tuple[str, ...]] = ("plastic",)
    linear_only: ClassVar[bool] = True

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

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """An addend to `plastic`."""
        return {"plastic": point.memory["plastic"]}

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Rate of the plastic elongation."""
        x = self.delta * (point.elongation - point.memory["plastic"]) / point.scales.elongation
        share = (1 - self.phi + self.phi * jnp.sign(point.rate * x)) * jnp.abs(x)
        return {"plastic": share * point.rate}
