"""The law of Giuffrè, Menegotto and Pinto with isotropic hardening, as OpenSees' Steel02 has it."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import ClassVar, NamedTuple, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractYieldingLaw, Memory, Scalar, Slots, still
from hsed_jax.physics.parameters import parameter
from hsed_jax.registry import register

# Bounds of the ratio x in powers: below, a logarithm of zero would make derivatives NaN; above, |x|^R would overflow.
_LEAST, _MOST = 1e-12, 1e6


class _Branch(NamedTuple):
    """The curve from the last reversal (u_r, f_r) towards the corner of its asymptotes (u_0, f_0); furthest points; its way."""

    u_r: Scalar
    f_r: Scalar
    u_0: Scalar
    f_0: Scalar
    aim: Scalar
    highest: Scalar
    lowest: Scalar
    way: Scalar


@final
@register
class MenegottoPinto(AbstractYieldingLaw):
    r"""Steel: curves from each reversal to the next asymptote.  A larger previous excursion gives a rounder curve.

    $$\frac{f-f_r}{f_0-f_r} = b\,x + \frac{(1-b)\,x}{(1+|x|^R)^{1/R}},\qquad x = \frac{\Delta u-u_r}{u_0-u_r},\qquad
      R = R_0\Big(1-\frac{c_{R1}\xi}{c_{R2}+\xi}\Big),\quad \xi = \frac{|u_m-u_0|}{u_y}$$

    from the last reversal $(u_r, f_r)$ to the intersection $(u_0, f_0)$ of the elastic line through the reversal and the
    hardening line $f = \pm s F_y + bk\,(\Delta u \mp s u_y)$.  $u_m$ is the furthest elongation on the loaded side, and
    $u_y = F_y/k$.  Isotropic hardening shifts the line of the side that is loaded next by
    $s = 1 + a_1\big[(u_{max}-u_{min})/(2 a_2 u_y)\big]^{0.8}$ on the negative side, with $a_3, a_4$ on the positive one.
    A step commits its end, and at a reversal the start of the new curve.
    """

    name: ClassVar[str] = "menegotto_pinto"
    title: ClassVar[str] = "the steel of Giuffrè, Menegotto and Pinto"
    reference: ClassVar[str] = "Menegotto & Pinto 1973; Filippou, Popov & Bertero 1983 (Steel02 of OpenSees)"

    b: Scalar = parameter(
        "b", "1", "stiffness after yielding over initial stiffness", neutral=0.0, lower=0.0, upper=0.95,
        prior={"uniform": [0.0, 0.1]},
    )  # fmt: skip
    R0: Scalar = parameter(
        "R_0", "1", "sharpness of the first yielding", neutral=20.0, lower=1.0, prior={"uniform": [5.0, 25.0]}
    )
    cR1: Scalar = parameter(
        "c_{R1}", "1", "share of the sharpness that plastic excursions take", neutral=0.925, lower=0.0, upper=0.99,
        prior={"uniform": [0.8, 0.97]},
    )  # fmt: skip
    cR2: Scalar = parameter(
        "c_{R2}", "1", "plastic excursion that takes half of this share, over yield elongation", neutral=0.15, lower=0.01,
        prior={"lognormal": [-1.9, 0.5]},
    )  # fmt: skip
    a1: Scalar = parameter(
        "a_1", "1", "isotropic hardening in compression", neutral=0.0, lower=0.0, prior={"half_normal": 0.1}
    )
    a2: Scalar = parameter("a_2", "1", "excursion that sets its growth, over yield elongation", neutral=1.0, lower=0.01)
    a3: Scalar = parameter(
        "a_3", "1", "isotropic hardening in tension", neutral=0.0, lower=0.0, prior={"half_normal": 0.1}
    )
    a4: Scalar = parameter("a_4", "1", "excursion that sets its growth, over yield elongation", neutral=1.0, lower=0.01)

    def start(self) -> Memory:
        """At rest, with no way yet; the furthest points of a virgin element are those of yielding."""
        u_y = jnp.asarray(self.yield_elongation)
        rest = still("hysteretic", "elongation", "u_r", "f_r", "u_0", "f_0", "aim", "way")
        return {**rest, "highest": u_y, "lowest": -u_y}

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """On the curve of the way from what is committed [N]."""
        return self._on(self._branch(elongation, memory), elongation)

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The point, and the curve it is on."""
        branch = self._branch(elongation, memory)
        is_still = elongation == memory["elongation"]
        kept = {name: jnp.where(is_still, memory[name], value) for name, value in branch._asdict().items()}
        return {"hysteretic": self._on(branch, elongation), "elongation": elongation, **kept}

    def _branch(self, elongation: Scalar, memory: Memory) -> _Branch:
        """The curve: that of the last step, or a new one where the way changes."""
        u, f, way = memory["elongation"], memory["hysteretic"], memory["way"]
        goes_up = elongation > u
        # Without motion the direction stays; that of a virgin element is positive.
        goes_up = jnp.where(elongation == u, way >= 0, goes_up)
        sign = jnp.where(goes_up, 1.0, -1.0)
        is_virgin = way == 0
        is_new = sign != way
        u_y, hardening = self.yield_elongation, self.b * self.k
        highest = jnp.where(is_new & ~goes_up, jnp.maximum(memory["highest"], u), memory["highest"])
        lowest = jnp.where(is_new & goes_up, jnp.minimum(memory["lowest"], u), memory["lowest"])
        growth, after = jnp.where(goes_up, self.a3, self.a1), jnp.where(goes_up, self.a4, self.a2)
        s = 1 + growth * ((highest - lowest) / (2 * after * u_y)) ** 0.8
        s = sign * jnp.where(is_virgin, 1.0, s)
        u_0 = (s * (self.F_y - hardening * u_y) - f + self.k * u) / (self.k - hardening)
        f_0 = s * self.F_y + hardening * (u_0 - s * u_y)
        fresh = _Branch(u, f, u_0, f_0, jnp.where(goes_up, highest, lowest), highest, lowest, sign)
        return _Branch(*(jnp.where(is_new, new, memory[name]) for name, new in fresh._asdict().items()))

    def _on(self, branch: _Branch, elongation: Scalar) -> Scalar:
        """Force on a curve [N]."""
        xi = jnp.abs(branch.aim - branch.u_0) / self.yield_elongation
        R = self.R0 * (1 - self.cR1 * xi / (self.cR2 + xi))
        span = branch.u_0 - branch.u_r
        # A curve that starts on its own asymptote has no length, and equals that asymptote.
        tiny = 1e-12 * self.yield_elongation
        x = (elongation - branch.u_r) / jnp.where(jnp.abs(span) > tiny, span, jnp.copysign(tiny, branch.way))
        power = jnp.exp(R * jnp.log(jnp.clip(jnp.abs(x), _LEAST, _MOST)))
        ratio = self.b * x + (1 - self.b) * x * jnp.exp(-jnp.log1p(power) / R)
        return branch.f_r + ratio * (branch.f_0 - branch.f_r)
