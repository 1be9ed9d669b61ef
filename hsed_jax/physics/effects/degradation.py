"""Degradation with absorbed energy: the loop loses stiffness, or strength."""

from typing import ClassVar, final

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import PhysicalForm, parameter


@register
@final
class StiffnessDegradation(AbstractSpringEffect):
    r"""Stiffness falls with absorbed energy: $\eta = 1 + \delta\,e/E_c$, and $\dot z \propto 1/\eta$.

    In the paper's form $\eta_{ref} = \delta/E_c$ [1/J] (Eq. 15), with e = ∫ r dΔu, the total work of the spring.
    """

    name: ClassVar[str] = "stiffness_degradation"
    family: ClassVar[str] = "stiffness"
    reference: ClassVar[str] = "Baber & Wen 1981; Abbiati & Marelli, Eq. 15"

    delta: Scalar = parameter(
        r"\delta_\eta",
        "1",
        "relative loss of stiffness at the characteristic energy",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("eta", "1/J", lambda scales: 1 / scales.energy),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `eta`."""
        return {"eta": 1 + self.delta / point.scales.energy * point.memory["energy"]}


@register
@final
class StrengthDegradation(AbstractSpringEffect):
    r"""Strength falls with absorbed energy: $\nu = 1 + \delta\,e/E_c$ multiplies β and γ.

    The ultimate force of the element is $[A/(\nu(\beta+\gamma))]^{1/n}$.
    """

    name: ClassVar[str] = "strength_degradation"
    family: ClassVar[str] = "strength"
    reference: ClassVar[str] = "Baber & Wen 1981"

    delta: Scalar = parameter(
        r"\delta_\nu",
        "1",
        "relative growth of β and γ at the characteristic energy",
        neutral=0.0,
        lower=0.0,
        prior={"half_normal": 1.0},
        physical=PhysicalForm("nu", "1/J", lambda scales: 1 / scales.energy),
    )

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `nu`."""
        return {"nu": 1 + self.delta / point.scales.energy * point.memory["energy"]}
