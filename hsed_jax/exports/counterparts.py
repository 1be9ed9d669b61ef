r"""A spring law with its effects as materials of OpenSees, in SI units.

OpenSees' `BoucWen` has the hysteretic displacement $z' = z/A$ in metres, and this package has the force z,

$$f = k_o z',\qquad \dot z' = \frac{A_o - |z'|^n\,[\gamma' + \beta'\,\mathrm{sign}(\dot u z')]\,\nu}{\eta}\,\dot u,\qquad
  \nu = 1 + \delta_\nu e,\quad \eta = 1 + \delta_\eta e,\quad e = \int k_o z'\,du,$$

so $k_o = A$, $\beta' = \beta A^{n-1}$, $\gamma' = \gamma A^{n-1}$.  `BWBN` is the same with Foliente's pinching for ν and η.
Source: OpenSees' documentation of BoucWen (Haukaas & Der Kiureghian 2003), BWBN, Steel01, Steel02, Hysteretic, Parallel, Series.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.base import AbstractSpringEffect, SpringPoint
from hsed_jax.physics.effects.forms import chosen
from hsed_jax.physics.laws.base import AbstractSpringLaw
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.scales import Scales

# Points of a curve, and how far beyond the largest elongation it goes.
_POINTS, _BEYOND = 801, 2.0

_WITH_COUNTERPART = {
    "stiffness_degradation": "linear, driven by energy",
    "strength_degradation": "linear, driven by energy",
    "pinching": "foliente, driven by energy",
    "viscous_damping": "linear, with a positive amplitude",
    "quadratic_damping": "quadratic or power, with a positive amplitude",
    "coulomb_friction": "bristle",
    "support_flexibility": "linear",
}
"""Effects with a counterpart, and their forms with a counterpart."""


class Command(NamedTuple):
    """One command of OpenSees, the same in Tcl and in Python.

    Attributes:
        name: of the command.
        words: its arguments; of a material the kind, the tag and its parameters.
    """

    name: str
    words: tuple[str | int | float, ...]


def material(
    law: AbstractSpringLaw, effects: Mapping[str, AbstractSpringEffect], scales: Scales, reach: float
) -> list[Command]:
    """The commands that define material 1, those of its parts before it.

    Arguments:
        law: with its calibrated parameters, numbers.
        effects: in the spring, by name, with theirs.
        scales: characteristic values of the effects.
        reach: largest elongation of the experiments [m]; curves are tabulated up to twice as far.

    Raises:
        UserError: the law, an effect or the effects together have no counterpart; the message names it and proposes a remedy.
    """
    acting = {name: effect for name, effect in effects.items() if _acts(effect)}
    element = _element(law, acting, scales, reach)
    in_series = [_flexibility(name, e, scales) for name, e in acting.items() if e.name == "support_flexibility"]
    beside = [_beside(name, e, law, scales, reach) for name, e in acting.items() if e.name in _BESIDE]
    left = [n for n, e in acting.items() if e.name not in (*_IN_ELEMENT[law.name], *_BESIDE, "support_flexibility")]
    if left:
        raise _refused(left[0], acting[left[0]])
    counting = [n for n, e in acting.items() if e.name in _OF_ENERGY]
    if counting and (beside or in_series):
        other = next(n for n, e in acting.items() if e.name in (*_BESIDE, "support_flexibility"))
        raise UserError(
            f"{counting[0]} with {other}: OpenSees' material counts the energy of its own force, ours that of the "
            "whole specimen; calibrate with one of them alone, and export that run"
        )
    return _assembled(element, in_series, beside)


def _assembled(element: tuple, in_series: Sequence[tuple], beside: Sequence[tuple]) -> list[Command]:
    """The element with its parts in series, and the parts parallel to both."""
    commands: list[Command] = []

    def defined(part: tuple, tag: int | None = None) -> int:
        kind, *values = part
        tag = len(commands) + 2 if tag is None else tag
        plain = [value if isinstance(value, int | str) else float(value) for value in values]
        commands.append(Command("uniaxialMaterial", (kind, tag, *plain)))
        return tag

    if not in_series and not beside:
        defined(element, 1)
        return commands
    parts = [defined(part) for part in (element, *in_series)]
    if in_series:
        parts = [defined(("Series", *parts), None if beside else 1)]
    if beside:
        defined(("Parallel", *parts, *[defined(part) for part in beside]), 1)
    return commands


def _element(law: AbstractSpringLaw, effects: Mapping[str, Any], scales: Scales, reach: float) -> tuple:
    """Kind and arguments of the law with the effects that are in its element."""
    if law.name not in _LAWS:
        raise UserError(
            f"the law {law.name} has no counterpart in OpenSees; those with one are {', '.join(_LAWS)}: "
            "calibrate one of them (model.spring), and export that run"
        )
    return _LAWS[law.name](law, {e.name: (name, e) for name, e in effects.items()}, scales, reach)


def _bouc_wen(law: Any, effects: Mapping[str, tuple[str, Any]], scales: Scales, reach: float) -> tuple:
    beta, gamma, n = law.beta, law.gamma, law.n
    strength = float(law.yardstick)
    if "loop_shape" in effects:
        gamma = gamma + effects["loop_shape"][1].delta * beta
    if "yield_sharpness" in effects:
        sharper = effects["yield_sharpness"][1].delta
        beta, gamma, n = beta * strength**-sharper, gamma * strength**-sharper, n + sharper
    plain = (0.0, law.A, n, gamma * law.A ** (n - 1), beta * law.A ** (n - 1), 1.0)
    degrading = [effects[name] for name in ("stiffness_degradation", "strength_degradation") if name in effects]
    for name, effect in degrading:
        _require(
            name,
            effect,
            growth=0,
            saturation=0,
            power=1,
            onset=0,
            **dict.fromkeys(map(chosen, range(1, len(effect.drivers))), 0),
        )
    if "pinching" in effects:
        name, p = effects["pinching"]
        _require(name, p, widening=1, flatness=1, of_elongation=0, driver_1=0)
        if degrading:
            raise UserError(
                f"{name} with {degrading[0][0]}: OpenSees' BWBN, which pinches, does not degrade; calibrate with one of them "
                "alone, and export that run"
            )
        if law.beta + law.gamma <= 0 or (gamma, n) != (law.gamma, law.n):
            raise _refused(name, p, "of a law without strength, or with loop_shape or yield_sharpness, ")
        z_u = strength / law.A
        return ("BWBN", *plain, p.q, p.zeta, p.p / scales.energy, p.psi * z_u, p.spread * z_u / scales.energy, p.ratio,
                1e-9, 200)  # fmt: skip

    def rate(name: str) -> float:
        return effects[name][1].delta / scales.energy if name in effects else 0.0

    return ("BoucWen", *plain, 0.0, rate("strength_degradation"), rate("stiffness_degradation"))


def _elastic(law: Any, effects: Mapping[str, tuple[str, Any]], scales: Scales, reach: float) -> tuple:
    if "yielding" not in effects:
        return ("Elastic", law.k)
    # The elastic elongation of a spring that yields is the z of Bouc–Wen with n = 1.
    effect = effects["yielding"][1]
    bound, n = effect.delta / scales.elongation**effect.sharpness, effect.sharpness
    gamma, beta = (1 - effect.phi - effect.turned) * bound, effect.phi * bound
    return ("BoucWen", effect.elastic, law.k, n, gamma, beta, 1.0, 0.0, 0.0, 0.0)


def _bilinear(law: Any, effects: Mapping[str, tuple[str, Any]], scales: Scales, reach: float) -> tuple:
    return ("Steel01", law.F_y, law.k, law.b)


def _menegotto_pinto(law: Any, effects: Mapping[str, tuple[str, Any]], scales: Scales, reach: float) -> tuple:
    return ("Steel02", law.F_y, law.k, law.b, law.R0, law.cR1, law.cR2, law.a1, law.a2, law.a3, law.a4)


def _takeda(law: Any, effects: Mapping[str, tuple[str, Any]], scales: Scales, reach: float) -> tuple:
    if law.alpha != 0:
        raise UserError(
            "the law takeda with alpha > 0 has no counterpart: OpenSees' Hysteretic unloads with another stiffness there; "
            "calibrate with alpha: 0 (model.parameters), and export that run"
        )
    u_y = law.F_y / law.k
    far = max(100 * u_y, 10 * reach)
    ends = (law.F_y, u_y, law.F_y + law.b * law.k * (far - u_y), far)
    return ("Hysteretic", *ends, *(-value for value in ends), 1.0, 1.0, 0.0, 0.0, 0.0)


_LAWS: dict[str, Callable[..., tuple]] = {
    "bouc_wen": _bouc_wen,
    "elastic": _elastic,
    "bilinear": _bilinear,
    "menegotto_pinto": _menegotto_pinto,
    "takeda": _takeda,
}
_OF_ENERGY = ("stiffness_degradation", "strength_degradation", "pinching")
_IN_ELEMENT = {name: () for name in _LAWS} | {
    "bouc_wen": (*_OF_ENERGY, "loop_shape", "yield_sharpness"),
    "elastic": ("yielding",),
}
_CURVES = ("hardening", "cubic_stiffness", "quadratic_stiffness", "contact_stiffening")
_BESIDE = (*_CURVES, "viscous_damping", "quadratic_damping", "power_damping", "coulomb_friction")


def _flexibility(name: str, effect: Any, scales: Scales) -> tuple:
    _require(name, effect, power=1, bedding=0)
    return ("Elastic", scales.force / (effect.delta * scales.elongation))


def _beside(name: str, effect: Any, law: AbstractSpringLaw, scales: Scales, reach: float) -> tuple:
    """Kind and arguments of the material that an effect adds parallel to the element."""
    if effect.name in _CURVES:
        _require(name, effect, worn=0, kept=0)
        return _curve(effect, scales, reach)
    force = float(effect.delta * scales.force)
    if effect.name == "coulomb_friction":
        # Sharp friction changes its sign with the rate; an ElasticPP that sticks over 1e-3 u_c has an error of 6 %.
        _require(name, effect, of_bristle=1, worn=0)
        length = effect.bristle * scales.elongation
        return ("BoucWen", 0.0, force / length, 1.0, 0.0, 1 / length, 1.0, 0.0, 0.0, 0.0)
    if effect.delta < 0:
        raise _refused(name, effect, "with a negative amplitude ")
    if effect.name == "viscous_damping":
        _require(name, effect, side=0, bend=0, of_elongation=0, worn=0)
        power = 1.0
    elif effect.name == "quadratic_damping":
        _require(name, effect, side=0, bend=0)
        power = effect.power
    else:
        _require(name, effect, side=0, bend=0, worn=0)
        power = effect.alpha
    return ("Viscous", force / scales.rate**power, power)


def _curve(effect: Any, scales: Scales, reach: float) -> tuple:
    """An elastic spring: two straight lines, or a curve in points."""

    def force(elongation: float) -> float:
        point = SpringPoint(np.float64(elongation), 0.0, 0.0, {}, scales, 1.0, 1.0)
        return float(effect.contribute(point)["force"])

    if effect.name == "hardening" and (effect.power, effect.bend) == (1, 0):
        unit = float(scales.elongation)
        return ("Elastic", force(unit) / unit, 0.0, -force(-unit) / unit)
    corner = [effect.clearance * scales.elongation] if effect.name == "contact_stiffening" else []
    half = np.linspace(0, _BEYOND * reach, _POINTS // 2 + 1)[1:]
    half = np.unique([*half, *corner, *(1.001 * c for c in corner)])
    path = [float(u) for u in (*-half[::-1], 0.0, *half) if u or not corner or corner[0] > 0]
    return ("ElasticMultiLinear", 0.0, "-strain", *path, "-stress", *map(force, path))


def _acts(effect: AbstractSpringEffect) -> bool:
    """Whether it is active: the first parameter of every effect is its amplitude."""
    return getattr(effect, next(iter(parameters_of(effect)))) != 0


def _require(name: str, effect: AbstractSpringEffect, **values: float) -> None:
    """Refuse an effect in a form whose parameters are not these."""
    for key, value in values.items():
        found = getattr(effect, key, value)
        if found != value:
            raise _refused(name, effect, f"in this form ({key} = {float(found):g}, where OpenSees has {value:g}) ")


def _refused(name: str, effect: AbstractSpringEffect, how: str = "") -> UserError:
    forms = _WITH_COUNTERPART.get(effect.name)
    remedy = (
        f"the form that has one is {forms}: calibrate with it"
        if forms and effect.name in EFFECTS
        else "calibrate without it (or say --before for the model before its improvement)"
    )
    return UserError(f"{name} {how}has no counterpart in OpenSees; {remedy}, and export that run")
