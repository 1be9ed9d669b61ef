r"""Effects of what is dragged along and slides: a bristle, bent by the way w of its foot until its force is as large as it gets.

$$\frac{dq}{dw} = 1 - \frac{q}{q_s}\,\mathrm{sign}\,\dot w$$

with w over the length of the bristle, q its force over that at which it slides at rest, and $q_s$ what it slides at now.  Between
reversals that has a solution, which a step takes however short the bristle is.

Source: Dahl 1968.
"""

import equinox as eqx
import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Scalar, SpringPoint
from hsed_jax.physics.scales import is_zero


class AbstractBristledEffect(AbstractSpringEffect):
    """An effect whose force may be that of a bristle.

    Attributes:
        bristle: its length, over the characteristic elongation.
        of_bristle: whether it is.
    """

    bristle: eqx.AbstractVar[Scalar]
    of_bristle: eqx.AbstractVar[Scalar]

    @property
    def states(self) -> tuple[str, ...]:
        """The force of the bristle, over that at which it slides at rest, and where its foot was then [m]."""
        return () if is_zero(self.of_bristle) else (f"{self.name}_bristle", f"{self.name}_foot")

    def settle(self, point: SpringPoint) -> dict[str, Scalar]:
        """The bristle as it is bent now."""
        return dict(zip(self.states, (self.bent(point), self.foot(point)), strict=True)) if self.states else {}

    def foot(self, point: SpringPoint) -> Scalar:
        """Where the foot of the bristle is [m]: it goes with the elongation, unless a subclass says otherwise."""
        return point.elongation

    def slides_at(self, point: SpringPoint) -> Scalar:
        """The force at which it slides now, over that at rest: the same, unless a subclass says otherwise."""
        del point
        return 1.0

    def bent(self, point: SpringPoint) -> Scalar:
        """Its force over that at which it slides at rest, after a way without a reversal."""
        before, foot = (point.memory[name] for name in self.states)
        way = (self.foot(point) - foot) / (self.bristle * point.scales.elongation)
        end = self.slides_at(point)
        return before - jnp.expm1(-jnp.abs(way) / end) * (end * jnp.sign(way) - before)
