"""Unloading and reloading: self-centring, reloading towards a former peak, buckling."""

from typing import ClassVar, final

import jax
import jax.numpy as jnp

from hsed_jax.physics.effects.base import AbstractSpringEffect, Form, Scalar, SpringPoint, register
from hsed_jax.physics.parameters import parameter, share_parameter
from hsed_jax.physics.scales import is_number, is_zero
from hsed_jax.physics.states import LARGEST_COMPRESSION, LARGEST_TENSION, SharedState

# Over the strength, within which unloading goes over into sliding back; over the characteristic elongation, within which what has
# opened is closed again.
_ROUNDED, _CLOSED = 0.03, 0.02
# What slides back at a tenth of the strength does so as a whole.
_WHOLE = 10.0
# Least rest of the force to the strength, over the strength, and of the elongation to the former peak, over the yield elongation.
_LEFT = 1e-6
# A brace that has lost a quarter of its strength has its whole elongation to straighten.
_AT_ONCE = 4.0


def _virgin(point: SpringPoint, elongation: Scalar, sharp: Scalar = 0.0) -> Scalar:
    """Force of the virgin element at an elongation to one side, over its strength: of a gradual or of a sharp yielding."""
    over_yielding = elongation * point.stiffness / point.strength
    gradual = -jnp.expm1(-over_yielding)
    return gradual if is_zero(sharp) else gradual + sharp * (jnp.minimum(over_yielding, 1.0) - gradual)


def _towards_peak(point: SpringPoint, sharp: Scalar = 0.0) -> Scalar:
    """Slope to the virgin curve at the largest elongation on the side of loading, over the slope of the element, at most 1."""
    tension, compression = point.memory["largest_tension"], point.memory["largest_compression"]
    own, other = jnp.where(point.rate > 0, tension, compression), jnp.where(point.rate > 0, compression, tension)
    yielding, force = point.strength / point.stiffness, jnp.abs(point.hysteretic) / point.strength
    # A side that was hardly reached has the peak of the other side, up to its yield point.
    peak, forth = jnp.maximum(own, jnp.minimum(other, yielding)), jnp.sign(point.rate) * point.elongation
    left = jnp.maximum(1 - force, _LEFT)
    if not is_zero(sharp):
        left = left + sharp * (1 - left)
    aim = _virgin(point, peak, sharp) - force
    slope = aim * yielding / (jnp.maximum(peak - forth, _LEFT * yielding) * left)
    return jnp.where(forth < own, jnp.clip(slope, 0.0, 1.0), 1.0)


@register
@final
class SelfCentering(AbstractSpringEffect):
    r"""A flag-shaped loop: the element slides back and closes its opening before the force is zero.

    $$h = 1 - \min(10\delta, 1)\,\frac{\mathrm{clip}(w\,\mathrm{sign}\,z/0.02u_c,\, 0,\, 1)}{1 + e^{(|z| - \delta z_u)/0.03 z_u}}
      \quad\text{on unloading},\qquad w = \Delta u - z/k_0$$

    with the strength $z_u$ of the element.  It unloads to $\delta z_u$, slides back at this force until the opening w is closed,
    and unloads to the origin.  1 − δ is the β of a flag.

    In the forms with a tendon, the share δ of the element returns the way it came, and the rest has its loop:

    $$f = (1 - \delta)\,z + \delta\,z_u\big(1 - e^{-k_0|\Delta u|/z_u}\big)\,\mathrm{sign}\,\Delta u.$$

    The first loading does not change.  The loop is open at the origin, where the flag is closed.
    """

    name: ClassVar[str] = "self_centering"
    family: ClassVar[str] = "recentring"
    reference: ClassVar[str] = "Christopoulos, Filiatrault & Folz 2002"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("flag"),
        Form("tendon", r"f = (1 - \delta)\,z + \delta\,z_u(1 - e^{-k_0|\Delta u|/z_u})\,\mathrm{sign}\,\Delta u",
             held={"tendon": 1.0}),
        Form("sharp tendon", r"f = (1 - \delta)\,z + \delta\min(k_0|\Delta u|, z_u)\,\mathrm{sign}\,\Delta u",
             held={"tendon": 1.0, "sharp": 1.0}),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_o",
        "1",
        "force of sliding back over strength, or share of the element that returns the way it came",
        neutral=0.0,
        lower=0.0,
        upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )
    tendon: Scalar = share_parameter("w_t", "whether a share of the element is a tendon")
    sharp: Scalar = share_parameter("w", "whether the tendon yields at once")

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `h`, and a force."""
        u, z = point.elongation, point.hysteretic
        found: dict[str, Scalar] = {}
        if not is_number(self.tendon, 1):
            opened = (u - z / point.stiffness) * jnp.sign(z) / (_CLOSED * point.scales.elongation)
            slides = jax.nn.sigmoid((self.delta - jnp.abs(z) / point.strength) / _ROUNDED)
            back = jnp.where(point.rate * z < 0, slides * jnp.clip(opened, 0.0, 1.0), 0.0)
            found["h"] = 1 - (1 - self.tendon) * jnp.minimum(_WHOLE * self.delta, 1.0) * back
        if not is_zero(self.tendon):
            tendon = point.strength * _virgin(point, jnp.abs(u), self.sharp) * jnp.sign(u)
            found["force"] = self.tendon * self.delta * (tendon - z)
        return found


@register
@final
class PeakOriented(AbstractSpringEffect):
    r"""Reloading aims at the former peak, the point of the virgin curve at the largest elongation reached on that side.

    $$h = 1 - \delta(1 - s)\quad\text{on loading},\qquad
      s = \mathrm{clip}\Big(\frac{z_p - |z|}{(u_p - |\Delta u|)\,k_0(1 - |z|/z_u)},\, 0,\, 1\Big),$$
    $$z_p = z_u(1 - e^{-k_0u_p/z_u})$$

    with $u_p$ the largest elongation on the side of $\Delta\dot u$, and $|\Delta u|$ negative on the other side.  Beyond this
    elongation there is no limit.  A side that was hardly reached has the $u_p$ of the other side, at most $z_u/k_0$.

    With δ = 1 reloading is a straight line to the former peak, for a law that yields gradually (n = 1).  For a law that yields
    abruptly (large n), the form `sharp` gives this line.
    """

    name: ClassVar[str] = "peak_oriented"
    family: ClassVar[str] = "stiffness"
    reference: ClassVar[str] = "Clough & Johnston 1966; Ibarra, Medina & Krawinkler 2005"
    forms: ClassVar[tuple[Form, ...]] = (
        Form("gradual"),
        Form("sharp", r"s = \mathrm{clip}\Big(\frac{z_p - |z|}{(u_p - |\Delta u|)\,k_0}, 0, 1\Big),\ z_p = \min(k_0u_p, z_u)",
             held={"sharp": 1.0}),
    )  # fmt: skip

    delta: Scalar = parameter(
        r"\delta_p",
        "1",
        "how far reloading aims at the former peak",
        neutral=0.0,
        lower=0.0,
        upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )
    sharp: Scalar = share_parameter("w", "whether the law yields at once")

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation to each side."""
        return (LARGEST_TENSION, LARGEST_COMPRESSION)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """A factor on `h`."""
        towards = _towards_peak(point, self.sharp)
        return {"h": 1 - self.delta * jnp.where(point.rate * point.hysteretic > 0, 1 - towards, 0.0)}


@register
@final
class Buckling(AbstractSpringEffect):
    r"""The strength of one side falls at once and with its largest elongation; reloading of the other side is softer.

    $$\nu = \frac{1 + \kappa|\delta|\max(\mp\Delta u)/u_c}{1 - |\delta|}\ \text{in compression},\qquad
      h = 1 - \theta\min(4|\delta|, 1)(1 - s)\ \text{on loading in tension}$$

    with s as for `peak_oriented`.  δ > 0 buckles at negative elongations, δ < 0 at positive ones.
    """

    name: ClassVar[str] = "buckling"
    family: ClassVar[str] = "asymmetry"
    reference: ClassVar[str] = "Black, Wenger & Popov 1980; Ikeda & Mahin 1986"

    delta: Scalar = parameter(
        r"\delta_x",
        "1",
        "share of the strength that is lost at once in compression",
        neutral=0.0,
        lower=-0.95,
        upper=0.95,
        prior={"truncated_normal": {"loc": 0.0, "scale": 0.5, "low": -0.95, "high": 0.95}},
    )
    growth: Scalar = parameter(
        r"\kappa", "1", "how fast the loss grows, per characteristic elongation", neutral=1.0, lower=0.0, upper=50.0,
        prior={"lognormal": [0.0, 1.0]},
    )  # fmt: skip
    late: Scalar = parameter(
        r"\theta", "1", "how far loading in tension aims at the former peak", neutral=0.5, lower=0.0, upper=1.0,
        prior={"uniform": [0.0, 1.0]},
    )  # fmt: skip

    @property
    def needs(self) -> tuple[SharedState, ...]:
        """The largest elongation to each side."""
        return (LARGEST_TENSION, LARGEST_COMPRESSION)

    def contribute(self, point: SpringPoint) -> dict[str, Scalar]:
        """Factors on `nu` and `h`."""
        lost, side = jnp.abs(self.delta), jnp.sign(self.delta)
        tension, compression = point.memory["largest_tension"], point.memory["largest_compression"]
        reached = jnp.where(side > 0, compression, tension) / point.scales.elongation
        weaker = (1 + self.growth * lost * reached) / (1 - lost)
        found: dict[str, Scalar] = {"nu": jnp.where(point.hysteretic * side < 0, weaker, 1.0)}
        if not is_zero(self.late):
            loads = (point.hysteretic * side > 0) & (point.rate * side > 0)
            later = self.late * jnp.minimum(_AT_ONCE * lost, 1.0)
            found["h"] = 1 - later * jnp.where(loads, 1 - _towards_peak(point), 0.0)
        return found
