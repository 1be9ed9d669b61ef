"""A spring that was taken for linear yields."""

from typing import ClassVar, final

import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import PhysicalForm, parameter


@register
@final
class Yielding(AbstractSpringEffect):
    r"""A linear spring yields: $f = k\,\epsilon$ with the elastic elongation $\epsilon = \Delta u - \delta q$.

    $\dot q = (1 - \phi + \phi\,\mathrm{sign}\,\epsilon\Delta\dot u)\,|\epsilon|\,\Delta\dot u/u_c$: the force comes to its bound
    at $\epsilon = u_c/\delta$, as that of Bouc–Wen with n = 1 and φ = β/(β + γ), whose unloading is elastic at φ = 1/2.
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
        return {"plastic": self.delta * point.memory["plastic"]}

    def flow(self, point: SpringPoint) -> dict[str, Scalar]:
        """Rate of the plastic elongation over δ."""
        elastic = point.elongation - self.delta * point.memory["plastic"]
        share = (1 - self.phi + self.phi * jnp.sign(point.rate * elastic)) * jnp.abs(elastic)
        return {"plastic": share * point.rate / point.scales.elongation}
