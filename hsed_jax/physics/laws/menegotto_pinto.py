"""The law of Giuffrè, Menegotto and Pinto with isotropic hardening, as in Steel02 of OpenSees."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from typing import ClassVar, NamedTuple, final

import jax.numpy as jnp

from hsed_jax.physics.laws.base import AbstractYieldingLaw, Memory, Scalar, Slots, still
from hsed_jax.physics.parameters import parameter
from hsed_jax.physics.powers import power
from hsed_jax.registry import register

# Bounds of the ratio x in powers: below, a logarithm of zero would make derivatives NaN; above, |x|^R would overflow.
_LEAST, _MOST = 1e-12, 1e6


class _Branch(NamedTuple):
    """The curve from the last reversal (u_r, f_r).

    `side` is the strength that the curve tends to, over F_y and with its sign; it is zero in a virgin element.  `aim` is the
    furthest elongation on the loaded side.  `highest` and `lowest` are the furthest elongations of all reversals.
    """

    u_r: Scalar
    f_r: Scalar
    side: Scalar
    aim: Scalar
    highest: Scalar
    lowest: Scalar


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

    Effects change stiffness and strength as in a Bouc–Wen law: $k a/\eta$ stands for k and $F_y a/\nu$ for F_y.  Roundness ξ is
    measured by the virgin $u_y$.
    """

    name: ClassVar[str] = "menegotto_pinto"
    title: ClassVar[str] = "the steel of Giuffrè, Menegotto and Pinto"
    reference: ClassVar[str] = "Menegotto & Pinto 1973; Filippou, Popov & Bertero 1983 (Steel02 of OpenSees)"
    slots: ClassVar[tuple[str, ...]] = ("a", "nu", "eta")

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
        """At rest, without a path; the furthest points of a virgin element are those of yielding."""
        u_y = jnp.asarray(self.yield_elongation)
        rest = still("hysteretic", "elongation", "u_r", "f_r", "side", "aim")
        return {**rest, "highest": u_y, "lowest": -u_y}

    def force(self, elongation: Scalar, memory: Memory, slots: Slots) -> Scalar:
        """Force on the curve from the committed state [N]."""
        return self._on(self._branch(elongation, memory), elongation, slots)

    def settle(self, elongation: Scalar, memory: Memory, slots: Slots) -> Memory:
        """The point, and the curve it is on."""
        branch = self._branch(elongation, memory)
        is_still = elongation == memory["elongation"]
        kept = {name: jnp.where(is_still, memory[name], value) for name, value in branch._asdict().items()}
        return {"hysteretic": self._on(branch, elongation, slots), "elongation": elongation, **kept}

    def _branch(self, elongation: Scalar, memory: Memory) -> _Branch:
        """The curve: that of the last step, or a new one if the direction changes."""
        u, way = memory["elongation"], jnp.sign(memory["side"])
        # Without motion the direction stays; that of a virgin element is positive.
        goes_up = jnp.where(elongation == u, way >= 0, elongation > u)
        sign = jnp.where(goes_up, 1.0, -1.0)
        is_new = sign != way
        highest = jnp.where(is_new & ~goes_up, jnp.maximum(memory["highest"], u), memory["highest"])
        lowest = jnp.where(is_new & goes_up, jnp.minimum(memory["lowest"], u), memory["lowest"])
        growth, after = jnp.where(goes_up, self.a3, self.a1), jnp.where(goes_up, self.a4, self.a2)
        grown = 1 + growth * ((highest - lowest) / (2 * after * self.yield_elongation)) ** 0.8
        side = sign * jnp.where(way == 0, 1.0, grown)
        fresh = _Branch(u, memory["hysteretic"], side, jnp.where(goes_up, highest, lowest), highest, lowest)
        return _Branch(*(jnp.where(is_new, new, memory[name]) for name, new in fresh._asdict().items()))

    def _on(self, branch: _Branch, elongation: Scalar, slots: Slots) -> Scalar:
        """Force on a curve [N]."""
        k = self.k * slots("a") / slots("eta")
        F_y = self.F_y * slots("a") / slots("nu")
        # The asymptotes meet where f_r + k (u_0 - u_r) = s F_y + b k (u_0 - s u_y), with u_y = F_y/k.
        span = (branch.side * F_y * (1 - self.b) - branch.f_r + self.b * k * branch.u_r) / (k * (1 - self.b))
        xi = jnp.abs(branch.aim - branch.u_r - span) / self.yield_elongation
        R = self.R0 * (1 - self.cR1 * xi / (self.cR2 + xi))
        # A curve that starts on its own asymptote has no length, and equals that asymptote.
        tiny = 1e-12 * self.yield_elongation
        span = jnp.where(jnp.abs(span) > tiny, span, jnp.copysign(tiny, branch.side))
        x = (elongation - branch.u_r) / span
        raised = power(jnp.clip(jnp.abs(x), _LEAST, _MOST), R)
        ratio = self.b * x + (1 - self.b) * x * power(1 + raised, -1 / R)
        return branch.f_r + ratio * k * span
