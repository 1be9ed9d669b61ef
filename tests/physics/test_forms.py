"""Forms of effects: each against its equation in NumPy, one program for all of them, and what a study may say of them."""

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from builders.shares import by_default, has_default_driver
from observations import of_largest, relative
from scipy.integrate import quad, solve_ivp
from scipy.stats import gennorm

from hsed_jax.analysis import form_curves
from hsed_jax.config.load import load_study
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.effects.base import ADDED, AbstractSpringEffect, Setup, SpringPoint
from hsed_jax.physics.effects.forms import DRIVERS, forms_of, raised
from hsed_jax.physics.excitations import Imposed, Tabulated
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.response import Response
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.sensors import measured
from hsed_jax.physics.simulator import Conditions, Recorded, Timeline
from hsed_jax.reporting.catalogue import entry
from hsed_jax.reporting.formulas import in_text
from hsed_jax.study.build import Built

F, U, V, E = SCALES = Scales(force=1.2e5, elongation=0.25, rate=1.5, energy=2e4)
SEVERAL = tuple(
    name for name, effect in EFFECTS.items() if len(forms_of(effect)) > 1 and issubclass(effect, AbstractSpringEffect)
)
FORMS = tuple((name, label) for name in SEVERAL for label in forms_of(EFFECTS[name]))
MOST_PARAMETERS = max(len(forms_of(EFFECTS[name])[label].parameters(EFFECTS[name])) for name, label in FORMS)
STRENGTH, STIFFNESS = 1e5, 6e5
curves_of = cache(form_curves.curves_of)


def state(count: int = 60) -> dict:
    """Random states of a spring by name, the virgin one first."""
    draw = np.random.default_rng(5)
    u, v = draw.normal(scale=[[0.6 * U], [V]], size=(2, count))
    found = {"u": u, "v": v, "z": draw.normal(scale=0.5 * STRENGTH, size=count)}
    # Absorbed energy holds what is elastic.
    found |= {
        "energy": found["z"] ** 2 / (2 * STIFFNESS) + draw.exponential(E, count),
        "travel": draw.exponential(E / F, count),
    }
    found |= {"largest_elongation": np.abs(u) * draw.uniform(1, 3, count)}
    found |= {f"largest_{side}": np.abs(draw.normal(scale=U, size=count)) for side in ("tension", "compression")}
    found |= {"plastic": draw.normal(scale=0.5 * U, size=count)}
    for name in ("coulomb_friction", "stribeck_friction", "kinematic_hardening"):
        found |= {f"{name}_bristle": draw.uniform(-1, 1, count), f"{name}_foot": draw.normal(scale=0.6 * U, size=count)}
    found |= {"relaxing": draw.normal(scale=F, size=count)}
    found |= {"fatigue": draw.exponential(U * E / F, count)}
    found |= {"reversals": draw.integers(0, 30, count).astype(float)}
    return {name: np.concatenate([[0.0], values[1:]]) for name, values in found.items()}


def point(at: dict) -> SpringPoint:
    count = at["u"].size
    scales = Scales(*(np.full(count, scale) for scale in SCALES))
    return SpringPoint(at["u"], at["v"], at["z"], at, scales, np.full(count, STRENGTH), np.full(count, STIFFNESS))


def drawn(name: str, label: str, quantile: float | np.ndarray) -> dict[str, float]:
    """The free parameters of a form at a quantile of their priors, or each at one of its own, within their bounds."""
    known = forms_of(EFFECTS[name])[label].parameters(EFFECTS[name]).values()
    quantiles = np.broadcast_to(quantile, 12)[: len(known)]
    values = [float(Prior(*next(iter(p.prior.items()))).quantile(q)) for p, q in zip(known, quantiles, strict=True)]
    return {p.name: float(np.clip(value, p.lower, p.upper)) for p, value in zip(known, values, strict=True)}


# --- each form against its equation ------------------------------------------------------------------------------


def degradation(slot, turned=lambda factor: factor):
    """The factor that grows with a driver, in a slot."""
    shapes = {
        "linear": lambda p, x: 1 + p.delta * x,
        "exponential": lambda p, x: np.exp(p.delta * x),
        "saturating": lambda p, x: 1 + (1 - np.exp(-p.saturation * p.delta * x)) / p.saturation,
        "power": lambda p, x: 1 + p.delta * x**p.power,
        "threshold": lambda p, x: 1 + p.delta * np.maximum(x - p.onset, 0),
        "free": lambda p, x: (
            1
            + p.delta
            * (1 - np.exp(-((p.soonness * np.maximum(x - p.onset, 0)) ** p.power)))
            / (1 - np.exp(-(p.soonness**p.power)))
        ),
    }
    return {name: (slot, lambda p, x, s, shape=shape: turned(shape(p, x))) for name, shape in shapes.items()}


def share(p, moved):
    """What a force counts for: less to the side that it is not of."""
    return np.minimum(1 + p.side * np.sign(moved), 1)


def to_sides(form, moved, slot="force"):
    """A force to both sides, and to one of them, by the sign of what moves."""
    return {
        side: (slot, lambda p, x, s, has=has: np.where(has(moved(s)), form(p, x, s), 0))
        for side, has in {"": lambda m: m == m, "positive": lambda m: m > 0, "negative": lambda m: m < 0}.items()
    }


def beyond(p, s):
    return np.maximum(np.abs(s.u) / U - p.clearance, 0)


def rounded(p, s):
    return s.z / np.sqrt(s.z**2 + (p.rounding * STRENGTH) ** 2)


def come(p, s):
    ratio = np.maximum(np.abs(s.z) / STRENGTH, 1e-9)
    return (1 - np.exp(-((ratio / p.width) ** p.power))) / (1 - np.exp(-((1 / p.width) ** p.power)))


def bent(before, way, end=1.0):
    """A bristle after a way in its own lengths, towards where it slides."""
    return end * np.sign(way) + (before - end * np.sign(way)) * np.exp(-np.abs(way) / end)


def dragged(p, s):
    return bent(s.coulomb_friction_bristle, (s.u - s.coulomb_friction_foot) / (p.bristle * U))


def dragged_less(p, s):
    fallen = p.remaining + (1 - p.remaining) * np.exp(-np.abs(s.v) / (p.falling * V))
    return bent(s.stribeck_friction_bristle, (s.u - s.stribeck_friction_foot) / (p.bristle * U), fallen)


def dented(p, s):
    deepest = np.where(s.u > 0, s.largest_tension, s.largest_compression) / U
    touched = p.clearance + p.kept * np.maximum(deepest - p.clearance, 0)
    return np.maximum(np.abs(s.u) / U - touched, 0) * np.sign(s.u)


def grown_straight(p, rate):
    """A power of the rate that bends to one between it and a straight line."""
    after = 1 + p.passing * (p.power - 1)
    return rate**p.power * (1 + p.bend * rate**p.power) ** (after / p.power - 1)


def relieved(p, grown):
    """What a valve relieves: of a share of it no more than 1/b is left."""
    valve = grown / (1 + (p.bend * grown) ** p.abruptness) ** (1 / p.abruptness)
    return p.passing * grown + (1 - p.passing) * valve


def two_powers(p, grown):
    """What bends, and goes on with a part of its power."""
    return grown / (1 + p.bend * grown) ** (1 - p.passing)


def bending(p, s):
    return two_powers(p, np.abs(s.u / U) ** p.power)


def rate_to(p, s):
    """The rate to the power of a damper, linear next to rest."""
    at = np.abs(s.v / V)
    return np.where(at > 1e-3, at**p.alpha, at * 1e-3 ** (p.alpha - 1))


def around_no_force(z, width, m):
    """A profile in force with an area of one to either side."""
    return np.exp(-(np.abs(z / width) ** m) / m) / quad(lambda q: width * np.exp(-(q**m) / m), 0, np.inf)[0]


def lasting(p, x):
    return 1 + p.worn * (1 - np.exp(-x / p.wears))


def stop(p, x, s):
    return p.delta * F * beyond(p, s) * np.sign(s.u)


def severity(p, x):
    return p.zeta * (1 - np.exp(-p.p * x))


def foliente(p, x, s):
    spread = (p.psi + p.spread * x) * (p.ratio + severity(p, x))
    return 1 - severity(p, x) * np.exp(-((s.z * np.sign(s.v) - p.q * STRENGTH) ** 2) / (spread * STRENGTH) ** 2)


def lost(width):
    # The life is given in u_c; any driver is compared with a path of that length.
    return lambda p, x, s: -p.delta * s.z / (1 + np.exp(-(x - (c := p.life * F * U / E)) / (width(p) * c)))


spring, dashpot, drag = (
    to_sides(lambda p, x, s: p.delta * F / U * s.u, lambda s: s.u),
    to_sides(lambda p, x, s: p.delta * F * s.v / V, lambda s: s.v),
    to_sides(lambda p, x, s: p.delta * F * np.abs(s.v) * s.v / V**2, lambda s: s.v),
)


def towards_peak(s, is_sharp=False):
    """Slope of the line to the virgin curve at the former peak, over that of the law."""
    own, other = np.where(
        s.v > 0, [s.largest_tension, s.largest_compression], [s.largest_compression, s.largest_tension]
    )
    way, force = STRENGTH / STIFFNESS, np.abs(s.z) / STRENGTH
    peak = np.maximum(own, np.minimum(other, way))
    left = peak - np.sign(s.v) * s.u
    at_peak = np.minimum(peak / way, 1.0) if is_sharp else 1 - np.exp(-peak / way)
    slope = (
        (at_peak - force) / (np.where(left > 0, left, 1.0) / way) / (1.0 if is_sharp else np.maximum(1 - force, 1e-6))
    )
    return np.where(np.sign(s.v) * s.u < own, np.clip(slope, 0.0, 1.0), 1.0)


def tendon(s, share):
    return STRENGTH * share * np.sign(s.u)


def slid_back(p, s):
    """A flag: on unloading it slides back at its own force while it is open."""
    open_by = np.clip((s.u - s.z / STIFFNESS) * np.sign(s.z) / (0.02 * U), 0.0, 1.0)
    low = 1 / (1 + np.exp((np.abs(s.z) - p.delta * STRENGTH) / (0.03 * STRENGTH)))
    return 1 - min(10 * p.delta, 1.0) * np.where(s.v * s.z < 0, open_by * low, 0.0)


EQUATIONS = {
    "self_centering": {
        "flag": ("h", lambda p, x, s: slid_back(p, s)),
        "tendon": (
            "force",
            lambda p, x, s: p.delta * (tendon(s, 1 - np.exp(-np.abs(s.u) * STIFFNESS / STRENGTH)) - s.z),
        ),
        "sharp tendon": (
            "force",
            lambda p, x, s: p.delta * (tendon(s, np.minimum(np.abs(s.u) * STIFFNESS / STRENGTH, 1)) - s.z),
        ),
    },
    "peak_oriented": {
        "gradual": ("h", lambda p, x, s: 1 - p.delta * np.where(s.z * s.v > 0, 1 - towards_peak(s), 0.0)),
        "sharp": ("h", lambda p, x, s: 1 - p.delta * np.where(s.z * s.v > 0, 1 - towards_peak(s, True), 0.0)),
    },
    "gap": {
        "fixed": ("slack", lambda p, x, s: p.delta * U + 0 * s.u),
        "widening": ("slack", lambda p, x, s: p.delta * s.largest_elongation),
        "widening of energy": ("slack", lambda p, x, s: p.delta * U * s.energy / E),
        "free": (
            "slack",
            lambda p, x, s: (
                p.delta
                * np.maximum(
                    p.of_largest * s.largest_elongation
                    + p.of_energy * U * s.energy / E
                    + (1 - p.of_largest - p.of_energy) * U,
                    0,
                )
            ),
        ),
        "in series": (
            "compliance",
            # Of one to either side: twice a generalized normal distribution, whose scale is σ m^(1/m).
            lambda p, x, s: (
                2 * p.delta * U * gennorm.pdf(s.z, p.abruptness, scale=p.play * F * p.abruptness ** (1 / p.abruptness))
            ),
        ),
    },
    "support_flexibility": {
        "linear": ("compliance", lambda p, x, s: p.delta * U / F + 0 * s.z),
        "power": (
            "compliance",
            lambda p, x, s: p.delta * U / F * p.power * np.maximum(np.abs(s.z / F), 0.02) ** (p.power - 1),
        ),
        "loosening": ("compliance", lambda p, x, s: p.delta * U / F * lasting(p, s.energy / E)),
        "free": (
            "compliance",
            lambda p, x, s: (
                p.delta
                * U
                / F
                * (
                    p.power * np.maximum(np.abs(s.z / F), 0.02) ** (p.power - 1)
                    + p.bedding * np.exp(-((np.abs(s.z) / (p.bedded * F)) ** p.abruptness))
                )
            ),
        ),
    },
    "stiffness_degradation": degradation("eta"),
    "strength_degradation": degradation("nu"),
    "peak_softening": degradation("a", lambda factor: 1 / factor),
    "viscous_damping": {
        "linear": dashpot[""],
        "of elongation": ("force", lambda p, x, s: p.delta * F * np.abs(s.u) / U * s.v / V),
        "thinning": ("force", lambda p, x, s: p.delta * F * (s.v / V) / (1 + p.bend * np.abs(s.v / V))),
        "opening only": dashpot["positive"],
        "closing only": dashpot["negative"],
        "free": (
            "force",
            lambda p, x, s: (
                p.delta * F * (1 - p.of_elongation + p.of_elongation * np.abs(s.u) / U) * s.v / V * share(p, s.v)
            ),
        ),
        "heating": ("force", lambda p, x, s: p.delta * F * s.v / V * lasting(p, s.energy / E)),
    },
    "quadratic_damping": {
        "quadratic": drag[""],
        "power": ("force", lambda p, x, s: p.delta * F * np.abs(s.v / V) ** p.power * np.sign(s.v)),
        "opening only": drag["positive"],
        "closing only": drag["negative"],
        "free": (
            "force",
            lambda p, x, s: p.delta * F * grown_straight(p, np.abs(s.v / V)) * np.sign(s.v) * share(p, s.v),
        ),
    },
    "coulomb_friction": {
        "sharp": ("force", lambda p, x, s: p.delta * F * np.tanh(s.v / (0.02 * V))),
        "regularised": ("force", lambda p, x, s: p.delta * F * np.tanh(s.v / (p.sticking * V))),
        "bristle": ("force", lambda p, x, s: p.delta * F * dragged(p, s)),
        "free": (
            "force",
            lambda p, x, s: p.delta * F * np.tanh(np.abs(s.v / (p.sticking * V)) ** p.roundness) * np.sign(s.v),
        ),
        "wearing": ("force", lambda p, x, s: p.delta * F * np.tanh(s.v / (0.02 * V)) * lasting(p, s.travel * F / E)),
        "heating": ("force", lambda p, x, s: p.delta * F * np.tanh(s.v / (0.02 * V)) * lasting(p, s.energy / E)),
    },
    "power_damping": {
        "power": ("force", lambda p, x, s: p.delta * F * rate_to(p, s) * np.sign(s.v)),
        "free": (
            "force",
            lambda p, x, s: p.delta * F * relieved(p, rate_to(p, s)) * np.sign(s.v) * share(p, s.v),
        ),
        "heating": ("force", lambda p, x, s: p.delta * F * rate_to(p, s) * np.sign(s.v) * lasting(p, s.energy / E)),
    },
    "yield_sharpness": {
        "power": ("n", lambda p, x, s: p.delta + 0 * s.z),
        "free": ("nu", lambda p, x, s: 1 - p.of_part + p.of_part * np.maximum(np.abs(s.z) / STRENGTH, 1e-3) ** p.delta),
    },
    "loop_shape": {
        "constant": ("gamma", lambda p, x, s: p.delta + 0 * s.z),
        "free": [
            ("gamma", lambda p, x, s: p.delta * come(p, s)),
            ("nu", lambda p, x, s: 1 / (1 + p.kept * p.delta * come(p, s))),
        ],
    },
    "relaxation": dict.fromkeys(
        ("linear", "power", "thermally activated"), ("force", lambda p, x, s: p.delta * s.relaxing)
    ),
    "stribeck_friction": {
        name: (
            "force",
            lambda p, x, s, r=r: (
                p.delta
                * F
                * (p.remaining + (1 - p.remaining) * np.exp(-np.abs(s.v) / (r(p) * V)))
                * np.tanh(s.v / (0.02 * V))
            ),
        )
        for name, r in {"exponential": lambda p: 0.2, "of any speed": lambda p: p.falling}.items()
    }
    | {
        "bristle": ("force", lambda p, x, s: p.delta * F * dragged_less(p, s)),
        "free": (
            "force",
            lambda p, x, s: (
                p.delta
                * F
                * (
                    p.remaining
                    + (1 - p.remaining) * np.exp(-((np.abs(s.v) / (max(p.falling, 3 * p.sticking) * V)) ** p.steepness))
                )
                * np.tanh(s.v / (p.sticking * V))
            ),
        ),
    },
    "hardening": {
        "linear": spring[""],
        "tension only": spring["positive"],
        "compression only": spring["negative"],
        "power": ("force", lambda p, x, s: p.delta * F * np.abs(s.u / U) ** p.power * np.sign(s.u)),
        "saturating": ("force", lambda p, x, s: p.delta * F * (s.u / U) / (1 + p.bend * np.abs(s.u / U))),
        "wearing of energy": ("force", lambda p, x, s: p.delta * F / U * s.u * lasting(p, s.energy / E)),
        "free": ("force", lambda p, x, s: p.delta * F * bending(p, s) * np.sign(s.u) * share(p, s.u)),
    },
    "cubic_stiffness": {
        "cubic": ("force", lambda p, x, s: p.delta * F * (s.u / U) ** 3),
        "power": ("force", lambda p, x, s: p.delta * F * np.abs(s.u / U) ** p.power * np.sign(s.u)),
        "free": ("force", lambda p, x, s: p.delta * F * bending(p, s) * np.sign(s.u) * share(p, s.u)),
    },
    "quadratic_stiffness": {
        "quadratic": ("force", lambda p, x, s: p.delta * F * (s.u / U) ** 2),
        "power": ("force", lambda p, x, s: p.delta * F * np.abs(s.u / U) ** p.power),
        "free": ("force", lambda p, x, s: p.delta * F * bending(p, s)),
    },
    "contact_stiffening": {
        "linear": ("force", stop),
        "hertz": ("force", lambda p, x, s: p.delta * F * beyond(p, s) ** 1.5 * np.sign(s.u)),
        "power": ("force", lambda p, x, s: p.delta * F * beyond(p, s) ** p.power * np.sign(s.u)),
        "tension only": ("force", lambda p, x, s: np.where(s.u > 0, stop(p, x, s), 0)),
        "compression only": ("force", lambda p, x, s: np.where(s.u < 0, stop(p, x, s), 0)),
        "crushed": ("force", lambda p, x, s: p.delta * F * dented(p, s)),
        "free": ("force", lambda p, x, s: p.delta * F * beyond(p, s) ** p.power * np.sign(s.u) * share(p, s.u)),
    },
    "slip": {
        "gaussian": (
            "compliance",
            lambda p, x, s: (
                np.sqrt(2 / np.pi) * (p.delta * x * U / (w := p.width * STRENGTH)) * np.exp(-(s.z**2) / (2 * w**2))
            ),
        ),
        "window": ("compliance", lambda p, x, s: p.delta * x * U * around_no_force(s.z, p.width * STRENGTH, 6)),
        "free": (
            "compliance",
            lambda p, x, s: (
                p.delta
                * np.maximum(x - p.onset, 0) ** p.power
                * U
                * around_no_force(s.z, p.width * STRENGTH, p.abruptness)
            ),
        ),
    },
    "fracture": {"sudden": ("force", lost(lambda p: 0.02)), "gradual": ("force", lost(lambda p: p.width))},
    "asymmetry": {
        "strength": ("nu", lambda p, x, s: 1 + p.delta * np.sign(s.z)),
        "loading": ("gamma", lambda p, x, s: p.delta * (np.sign(s.z) + np.sign(s.v)) / 2),
        "stiffness": ("eta", lambda p, x, s: 1 / (1 - p.delta * np.sign(s.z))),
        "stiffness and strength": ("force", lambda p, x, s: -p.delta * np.abs(s.z)),
        "free": [
            ("nu", lambda p, x, s: 1 + p.delta * rounded(p, s)),
            ("gamma", lambda p, x, s: p.of_loading * p.delta * (rounded(p, s) + np.sign(s.v)) / 2),
            ("eta", lambda p, x, s: 1 / (1 - p.of_stiffness * p.delta * rounded(p, s))),
        ],
    },
    "isotropic_hardening": {
        "saturating": ("nu", lambda p, x, s: 1 / (1 + p.delta * (1 - np.exp(-x / p.width)))),
        "linear": ("nu", lambda p, x, s: 1 / (1 + p.delta * x)),
        "power": ("nu", lambda p, x, s: 1 / (1 + p.delta * x**p.power)),
        "free": ("nu", lambda p, x, s: 1 / (1 + p.delta * (1 - np.exp(-(x**p.power) / p.width)))),
    },
    "rate_dependence": {
        "logarithmic": ("a", lambda p, x, s: 1 + p.delta * np.log(1 + np.abs(s.v) / V)),
        "power": ("a", lambda p, x, s: 1 + p.delta * (np.abs(s.v) / V) ** p.power),
        "strength": ("nu", lambda p, x, s: 1 / (1 + p.delta * np.log(1 + np.abs(s.v) / V))),
        "sliding": ("nu", lambda p, x, s: 1 / (1 + p.delta * (1 - np.exp(-np.abs(s.v) / (p.bounding * V))))),
        "free": [
            ("a", lambda p, x, s: 1 + p.of_both * p.delta * (np.abs(s.v) / V) ** p.power),
            ("nu", lambda p, x, s: 1 / (1 + p.of_strength * p.delta * (np.abs(s.v) / V) ** p.power)),
        ],
    },
    "pinching": {
        "foliente": ("h", foliente),
        "gaussian": ("h", lambda p, x, s: 1 - severity(p, x) * np.exp(-((s.z / (p.psi * STRENGTH)) ** 2))),
        "window": ("h", lambda p, x, s: 1 - severity(p, x) * np.exp(-((s.z / (p.psi * STRENGTH)) ** 6))),
        "elongation": (
            "h",
            lambda p, x, s: 1 - severity(p, x) * np.exp(-((s.u / (p.psi * (s.largest_elongation + 1e-3 * U))) ** 2)),
        ),
        "free": (
            "h",
            lambda p, x, s: (
                1
                - severity(p, x**p.power)
                * np.exp(
                    -(
                        np.abs(
                            (
                                (1 - p.of_elongation) * (s.z * np.sign(s.v) / STRENGTH - p.q)
                                + p.of_elongation * s.u / (s.largest_elongation + 1e-3 * U)
                            )
                            / p.psi
                        )
                        ** (2 * p.flatness)
                    )
                )
            ),
        ),
    },
}
EQUATIONS["yielding"] = {
    "to a bound": ("plastic", lambda p, x, s: p.delta * s.plastic),
    **dict.fromkeys(("beside a spring", "free"), ("plastic", lambda p, x, s: (1 - p.elastic) * p.delta * s.plastic)),
}
CONSTANT = {
    *(("gap", "fixed"), ("support_flexibility", "linear"), ("yield_sharpness", "power"), ("loop_shape", "constant"))
}
CREEP = {
    "linear": lambda p, q: q,
    "power": lambda p, q: np.abs(q) ** (p.power - 1) * q,
    "thermally activated": lambda p, q: q * np.sinh(y := np.minimum(p.activation * np.abs(q), 6.0)) / y,
}
DRIVEN = {
    "energy": lambda s: s.energy / E,
    "path": lambda s: s.travel * F / E,
    "largest_elongation": lambda s: s.largest_elongation / U,
    "hysteretic_energy": lambda s: (s.energy - s.z**2 / (2 * STIFFNESS)) / E,
    "reversals": lambda s: s.reversals / 10,
    "fatigue": lambda s: s.fatigue * F / (E * U),
    "excursion": lambda s: np.where(s.z > 0, s.largest_tension, s.largest_compression) / U,
}


def of_two(p):
    """Drivers of two measures."""

    def index(s):
        return (1 - p.driver_share) * s.energy / E + p.driver_share * s.largest_elongation / U

    def each_with_a_power(s):
        worn, stretched = (s.travel * F / E) ** p.driver_power, (s.largest_elongation / U) ** p.driver_other
        return (1 - p.driver_share) * worn + p.driver_share * stretched

    return {"damage_index": index, "path_and_elongation": each_with_a_power}


def weakened(p, s):
    """The side that buckles: weaker at once, and with its largest elongation."""
    side, lost = np.sign(p.delta), np.abs(p.delta)
    reached = (s.largest_compression if p.delta > 0 else s.largest_tension) / U
    return np.where(s.z * side < 0, (1 + p.growth * lost * reached) / (1 - lost), 1.0)


def returning(p, s):
    """The other side of a strut that buckled: loading aims at the former peak."""
    side = np.sign(p.delta)
    loads = (s.z * side > 0) & (s.v * side > 0)
    return 1 - p.late * min(4 * abs(p.delta), 1.0) * np.where(loads, 1 - towards_peak(s), 0.0)


def first_way(p, s):
    """A spring that is stiff on its first way."""
    reached = np.maximum(np.maximum(s.largest_elongation, np.abs(s.u)), 1e-9 * U)
    return p.delta * F * s.u / U * (np.abs(s.u) / reached) ** p.power


SINGLE = {
    "buckling": {"nu": weakened, "h": returning},
    "scragging": {"force": first_way},
}


def test_every_form_has_its_equation_here():
    assert {name: list(forms) for name, forms in EQUATIONS.items()} == {
        name: [shape.name for shape in EFFECTS[name].forms] for name in SEVERAL
    }


@pytest.mark.verification("effects")
@pytest.mark.parametrize("name", SINGLE)
def test_an_effect_of_one_form_is_its_equation(name, observed):
    at = state()
    for quantile in (0.3, 0.8):
        values = drawn(name, "", quantile)
        found = jax.vmap(EFFECTS[name](**values).contribute)(point(at))
        assert set(found) == set(SINGLE[name])
        for slot, equation in SINGLE[name].items():
            expected = equation(SimpleNamespace(**values), SimpleNamespace(**at))
            observed(f"{name}: {slot} at random states", "equation in NumPy", of_largest(found[slot], expected), 1e-11)
            assert np.ptp(expected) > 1e-3 * np.abs(expected).max()


@pytest.mark.verification("effects")
@pytest.mark.parametrize(("name", "label"), FORMS)
def test_a_form_is_its_equation(name, label, observed):
    effect, at = EFFECTS[name], state()
    form = forms_of(effect)[label]
    s = SimpleNamespace(**at)
    for quantile in (0.3, 0.8):
        values = drawn(name, label, quantile)
        x = (
            (DRIVEN | of_two(SimpleNamespace(**values)))[form.driver or effect.drivers[0]](s)
            if effect.drivers
            else None
        )
        found = jax.vmap(effect(**form.held, **values).contribute)(point(at))
        equations = EQUATIONS[name][form.name]
        equations = equations if isinstance(equations, list) else [equations]
        assert set(found) == {slot for slot, _ in equations}
        for slot, equation in equations:
            expected = equation(SimpleNamespace(**values), x, s)
            within = 1e-10 if name == "slip" else 1e-11
            observed(f"{name}: {slot} at random states", "equation in NumPy", of_largest(found[slot], expected), within)
            assert np.ptp(expected) > 1e-3 * np.abs(expected).max() or (name, form.name) in CONSTANT


FLOORED = {
    ("support_flexibility", "power"): F,
    ("support_flexibility", "free"): F,
    ("yield_sharpness", "free"): STRENGTH,
}


@pytest.mark.parametrize(("name", "label"), FLOORED)
def test_a_form_has_the_floor_that_its_equation_says(name, label):
    form, scale = forms_of(EFFECTS[name])[label], FLOORED[name, label]
    (said,) = re.findall(r"\\max\(\|[Fz][^,]*, ([^)]+)\)", form.equation)
    floor = float(re.sub(r"10\^\{(-\d+)\}", r"1e\1", said))
    share = floor * np.array([0.0, 0.3, 0.999, 1.001, 2.0])
    at = point({key: np.repeat(values[7], share.size) for key, values in state().items()} | {"z": share * scale})
    p = SimpleNamespace(**drawn(name, label, 0.8) | {"bedding": 0.0})
    values = {key: value for key, value in vars(p).items() if hasattr(EFFECTS[name](), key)}
    (found,) = jax.vmap(EFFECTS[name](**form.held, **values).contribute)(at).values()
    reached = np.maximum(share, floor)
    if name == "yield_sharpness":
        expected = 1 - p.of_part + p.of_part * reached**p.delta
        assert f"$10^{{{round(np.log10(floor))}}}$" in EFFECTS[name].__doc__
    else:
        expected = p.delta * U / F * p.power * reached ** (p.power - 1)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    assert found[0] == found[2] and abs(found[4] / found[2] - 1) > 0.01 * p.delta * floor


@pytest.mark.parametrize("label", forms_of(EFFECTS["support_flexibility"]))
def test_a_support_is_told_by_its_elongation_only_where_its_compliance_is_one_number(label):
    # What loosens has no elongation that follows from the force alone: the code has its tangent.
    form = forms_of(EFFECTS["support_flexibility"])[label]
    made = EFFECTS["support_flexibility"](**form.held, **drawn("support_flexibility", label, 0.8))
    compliance = np.asarray(jax.vmap(made.contribute)(point(state()))["compliance"])
    assert form.equation.startswith(r"\frac{du}{dF}" if np.ptp(compliance) > 0 else "u = ")


def test_friction_falls_no_sooner_than_its_forms_say():
    at = point({key: values[1:2] for key, values in state().items()})
    for label in ("of any speed", "bristle"):
        form = forms_of(EFFECTS["stribeck_friction"])[label]
        values = drawn("stribeck_friction", label, 0.5)

        def force(falling, form=form, values=values):
            made = EFFECTS["stribeck_friction"](**form.held, **{**values, "falling": falling})
            return float(jax.vmap(made.contribute)(at)["force"][0])

        assert force(0.02) == force(0.06) != force(0.07)
        assert r"\max(r, 0.06)" in form.equation


SMALL = np.geomspace(1e-5, 1.0, 400)


def plain_up_to(values: np.ndarray) -> float | None:
    """Up to where, of arguments `SMALL`, values are exactly constant or linear, while beyond they are not."""
    for shown in (values, values / SMALL):
        is_same = np.abs(shown - shown[0]) <= 1e-12 * max(abs(shown[0]), 1e-300)
        if not is_same.all() and (count := int(np.argmin(is_same))) > 20:
            return float(f"{SMALL[count]:.0e}")
    return None


@pytest.mark.parametrize(("name", "label"), by_default(FORMS, has_default_driver))
def test_where_a_form_leaves_its_formula_the_documentation_says_so(name, label):
    effect, form = EFFECTS[name], forms_of(EFFECTS[name])[label]
    said = f"{form.equation} {effect.__doc__}"
    still = {key: np.repeat(values[7], SMALL.size) for key, values in state().items()}
    # Force over strength and over characteristic force is one grid.
    scales = Scales(*(np.full(SMALL.size, scale) for scale in (STRENGTH, U, V, E)))
    for variable, scale in (("z", STRENGTH), ("v", V)):
        at = point({**still, variable: SMALL * scale})._replace(scales=scales)
        found: dict[str, set] = {}
        for quantile in (0.35, 0.8):
            made = effect(**form.held, **drawn(name, label, quantile))
            for slot, values in jax.vmap(made.contribute)(at).items():
                found.setdefault(slot, set()).add(plain_up_to(np.asarray(values)))
        # What parameters move is theirs, and what stays where it is a number of the code.
        for (limit,) in (limits for limits in found.values() if len(limits) == 1):
            exponent = "" if limit is None else f"10^{{{round(np.log10(limit))}}}"
            assert limit is None or f"{limit:g}" in said or exponent in said, (variable, limit)


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("viscous_damping", 0.5, 1.0), ("quadratic_damping", 1.0, 6.0), ("power_damping", 0.0, 1.0)],
)
def test_no_form_of_a_damper_grows_with_the_rate_as_another_damper_does(name, least, most):
    # The slope of log force over log rate; to the other side and where it has warmed it is the same.
    random, rates = np.random.default_rng(0), V * np.geomspace(0.01, 2.0, 60)
    at = {key: np.zeros(60) for key in state()} | {"v": rates, "u": np.full(60, 0.3 * U)}
    for label, form in forms_of(EFFECTS[name]).items():
        if label == "closing only":
            continue
        for _ in range(40):
            values = drawn(name, label, random.uniform(0.02, 0.98, 12))
            found = jax.vmap(EFFECTS[name](**form.held, **values).contribute)(point(at))["force"]
            slopes = np.gradient(np.log(np.asarray(found)), np.log(rates))
            assert np.all((slopes > least - 1e-3) & (slopes < most + 1e-3)), (label, values)


@pytest.mark.verification("effects")
@pytest.mark.parametrize("label", CREEP)
def test_a_relaxing_force_creeps_as_its_form_says(label, observed):
    effect, at = EFFECTS["relaxation"], state()
    values = drawn("relaxation", label, 0.7)
    found = jax.vmap(effect(**forms_of(effect)[label].held, **values).flow)(point(at))["relaxing"]
    # The virgin element has no force, and the sine over its argument there is one.
    creep = CREEP[label](SimpleNamespace(**values), at["relaxing"][1:] / F)
    error = relative(found[1:], F / U * at["v"][1:] - F * creep / (values["time"] * U / V))
    observed("relaxation: rate of its force at random states", "equation in NumPy", error, 1e-12)
    assert found[0] == 0.0


def sensed_force(slots, step):
    """What a load cell shows of no force at 101 times."""
    response = Response({}, {"force": jnp.zeros(101)}, jnp.asarray(True))
    found = measured(response, lambda slot, owner="": slots.get(slot, 0.0 if slot in ADDED else 1.0), step, 1,
                     is_imposed=False, is_gated=False)  # fmt: skip
    return found.channels["force"]


@pytest.mark.verification("effects")
def test_a_late_drift_begins_when_its_form_says(observed):
    values = {"delta": 0.2, "onset": 0.3}
    found = EFFECTS["force_drift"](**values).contribute(Setup(SCALES, 1, 1))
    span = 100 * U / V
    assert found == pytest.approx({"force_drift": 0.2 * F / span, "drift_onset": 0.3 * span})
    time = np.linspace(0.0, span, 101)
    error = of_largest(sensed_force(found, span / 100), 0.2 * F * np.maximum(time / span - 0.3, 0))
    observed("force_drift: force of a load cell, late", "equation in NumPy", error, 1e-9)


@pytest.mark.verification("effects")
def test_a_drift_slows_down_as_its_form_says(observed):
    found = EFFECTS["force_drift"](delta=0.2, slowing=4.0).contribute(Setup(SCALES, 1, 1))
    span = 100 * U / V
    time = np.linspace(0.0, span, 101)
    error = of_largest(sensed_force(found, span / 100), 0.2 * F * np.log(1 + 4 * time / span) / 4)
    observed("force_drift: force of a load cell, slowing", "equation in NumPy", error, 1e-9)


@pytest.mark.verification("effects")
def test_an_offset_settles_as_its_form_says(observed):
    values = {"delta": 0.2, "settling": 0.7, "settles": 0.1}
    found = EFFECTS["force_offset"](**values).contribute(Setup(SCALES, 1, 1))
    span = 100 * U / V
    time = np.linspace(0.0, span, 101)
    expected = 0.2 * F * (1 - 0.7 * np.exp(-time / span / 0.1))
    error = of_largest(sensed_force(found, span / 100), expected)
    observed("force_offset: force of a load cell, settling", "equation in NumPy", error, 1e-9)


@pytest.mark.verification("effects")
@pytest.mark.parametrize(("name", "label"), [("coulomb_friction", "bristle"), ("stribeck_friction", "bristle"),
                                             ("kinematic_hardening", "")])  # fmt: skip
def test_a_bristle_follows_its_equation_along_a_path(name, label, observed):
    values = drawn(name, label, 0.5)
    effect = EFFECTS[name](**forms_of(EFFECTS[name])[label].held, **values)
    # At the characteristic rate, and of an element without force, whose elongation is plastic.
    slides = 1.0
    if name == "stribeck_friction":
        slides = values["remaining"] + (1 - values["remaining"]) * np.exp(-1 / values["falling"])
    largest = values["delta"] * F * (values["bristle"] if name == "kinematic_hardening" else 1.0)
    turns, memory, expected = U * np.array([0.0, 0.1, -0.05, -0.02, -0.3]), dict.fromkeys(effect.states, 0.0), 0.0
    for start, end in pairwise(turns):
        sign = np.sign(end - start)
        bent = solve_ivp(lambda u, q, s=sign: (1 - s * q / slides) / (values["bristle"] * U), (start, end), [expected],
                         rtol=1e-10, atol=1e-12)  # fmt: skip
        expected = bent.y[0, -1]
        at = SpringPoint(end, sign * V, 0.0, memory, SCALES, STRENGTH, STIFFNESS)
        error = relative(effect.contribute(at)["force"], largest * expected)
        observed(f"{name}: force of the bristle along a path", "SciPy RK45, rtol 1e-10", error, 1e-7)
        memory = effect.settle(at)


@pytest.mark.parametrize("label", forms_of(EFFECTS["slip"]))
def test_the_length_of_slip_is_what_its_name_says(label):
    # The compliance over forces of one sign is the length that is slipped through on the way to none.
    effect, force = EFFECTS["slip"], np.linspace(-STRENGTH, STRENGTH, 4000)
    form = forms_of(effect)[label]
    at = {name: np.full(force.size, values[3]) for name, values in state().items()} | {"z": force}
    compliance = jax.vmap(effect(delta=0.4, width=0.1, **form.held).contribute)(point(at))["compliance"]
    driver = at["energy"][0] / E * U if form.driver == "energy" else at["largest_elongation"][0]
    if form.driver == "damage_index":
        driver = 0.5 * (driver + at["energy"][0] / E * U)
    if form.driver == "reversals":
        driver = at["reversals"][0] / 10 * U
    if form.driver == "path_and_elongation":
        driver = 0.5 * (driver + at["travel"][0] * F / E * U)
    if form.driver == "excursion":
        driver = 0.5 * (at["largest_tension"][0] + at["largest_compression"][0])
    assert np.trapezoid(compliance, force) == pytest.approx(2 * 0.4 * driver)


# --- one program for all of them ---------------------------------------------------------------------------------


@cache
def program(name: str):
    """Contributions and rates of an effect with all of its parameters as inputs, and their derivatives: compiled once."""

    def of(values, at):
        made = EFFECTS[name](**values)
        return jax.vmap(lambda one: (made.contribute(one), made.flow(one)))(at)

    return jax.jit(lambda values, at: (of(values, at), jax.jacfwd(of)(values, at)))


@pytest.mark.parametrize(("name", "label"), by_default(FORMS, has_default_driver))
def test_one_program_with_held_numbers_as_inputs_serves_every_form(name, label):
    effect, form = EFFECTS[name], forms_of(EFFECTS[name])[label]
    at = state()
    # A little elastic energy given back at the start.
    at["energy"][1] = -1e-3 * E
    values = drawn(name, label, 0.6)

    def folded(values):
        made = effect(**form.held, **values)
        return jax.vmap(lambda one: (made.contribute(one), made.flow(one)))(point(at))

    known = parameters_of(effect)
    every = {key: jnp.asarray(float((values | dict(form.held)).get(key, p.neutral))) for key, p in known.items()}
    traced, traced_slopes = program(name)(every, point(at))
    # As many numbers for every form, so that each operation is compiled for one shape; nothing depends on the last of them.
    numbers = jnp.asarray(np.pad(list(values.values()), (0, MOST_PARAMETERS - len(values))))
    both = jax.jacfwd(lambda numbers: (folded(dict(zip(values, numbers, strict=False))),) * 2, has_aux=True)
    slopes, plain = both(numbers)
    slopes = jax.tree.map(lambda along: {key: along[..., i] for i, key in enumerate(values)}, slopes)
    for found, expected in ((traced, plain), (traced_slopes, slopes)):
        for of_found, of_expected in zip(found, expected, strict=True):
            for slot, value in of_found.items():
                # What a form leaves alone, the one expression leaves alone, too.
                idle = 1.0 if slot in ("a", "nu", "eta", "h") else 0.0
                if found is traced:
                    shown, wanted = {slot: value}, {slot: of_expected.get(slot, np.full_like(value, idle))}
                else:
                    shown = {key: value[key] for key in values}
                    wanted = of_expected.get(slot, {key: np.zeros_like(value[key]) for key in values})
                for key, numbers_found in shown.items():
                    size = max(np.abs(wanted[key]).max(), 1e-300)
                    np.testing.assert_allclose(numbers_found, wanted[key], rtol=1e-10, atol=1e-10 * size)


def test_a_power_of_one_is_the_number_itself_traced_or_not():
    values, large = jnp.asarray([-0.3, 0.0, 1e-12, 0.2, 7.0]), jnp.asarray([0.2, 7.0])
    power = jax.vmap(raised, (0, None))
    np.testing.assert_array_equal(jax.jit(power)(values, jnp.asarray(1.0)), values)
    np.testing.assert_allclose(power(large, 2.5), large**2.5, rtol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(power, 1)(large, 2.5), large**2.5 * jnp.log(large), rtol=1e-13)
    assert np.isfinite(jax.vmap(jax.jacfwd(raised))(values, jnp.full(5, 0.3))).all()


# --- as pictures and as text -------------------------------------------------------------------------------------


def test_curves_are_the_equations_of_the_forms():
    _, across, x, values = curves_of(EFFECTS["stiffness_degradation"])
    assert "driver" in across and (x[0], x[-1]) == (0.0, 1.0)
    np.testing.assert_allclose(values["linear"], 0.5 * x, atol=1e-15)
    np.testing.assert_allclose(values["exponential"], np.exp(0.5 * x) - 1, atol=1e-15)
    what, across, u, values = curves_of(EFFECTS["hardening"])
    assert "contribution of each form" in what and "elongation, from" in across
    np.testing.assert_allclose(values["tension only"], 0.5 * np.maximum(u, 0.0), atol=1e-15)


@pytest.mark.parametrize("name", SEVERAL)
def test_forms_are_shown_over_what_tells_them_apart(name):
    what, across, x, values = curves_of(EFFECTS[name])
    assert list(values) == [form.name for form in EFFECTS[name].forms]
    assert all(v.shape == x.shape and np.isfinite(v).all() for v in values.values())
    assert sum(np.ptp(v) > 1e-6 for v in values.values()) >= len(values) / 2
    shown = entry(name, EFFECTS, curves_of)
    assert across in shown and what in shown
    assert shown.count("█") + shown.count("─") >= len(values)


def test_of_an_effect_with_a_state_of_its_own_the_rate_is_shown():
    assert "rate of its own state" in entry("relaxation", EFFECTS, curves_of)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_entry_of_an_effect_shows_its_forms_without_latex(name):
    text, effect = entry(name, EFFECTS, curves_of), EFFECTS[name]
    assert not set("\\{}$") & set(re.sub(r"prior .*", "", text))
    lines = text.splitlines()
    for form in effect.forms:
        width = max(len(other.name) for other in effect.forms)
        (line,) = [line for line in lines if line.startswith(f"  {form.name:{width}}  ")]
        assert in_text(form.equation) in line
        more = lines[lines.index(line) + 1] if lines.index(line) + 1 < len(lines) else ""
        assert all(word in more for word in (*form.free, form.reference))
    for key in effect.drivers:
        assert f"  {key}: {DRIVERS[key].words}" in text
    shown = {line.split()[0] for line in lines if line.startswith("  ") and " prior " in line}
    freed = {key for form in forms_of(effect).values() for key in form.free}
    assert shown == {key for key, known in parameters_of(effect).items() if not known.shapes} | freed


@pytest.mark.parametrize(
    ("latex", "text"),
    [
        (r"\left[1 - \rho e^{-x/x_w}\right]", "[1 - ρe^(-x/x_w)]"),
        (r"e^{\delta x}", "e^(δx)"),
        (r"1/\nu = 1 + \delta(1 - e^{-x^p/w})", "1/ν = 1 + δ(1 - e^(-x^p/w))"),
        (r"so: $\dot q = \frac{F_c}{u_c}\Delta\dot u - q/\tau$.", "so: q\u0307 = (F_c/u_c) Δu\u0307 - q/τ."),
        (r"\delta F_c|\Delta u/u_c|^p\,\mathrm{sign}\,\Delta u", "δF_c|Δu/u_c|^p sign Δu"),
        (r"\delta F_c\,b^{3/2} + x^2", "δF_c b^(3/2) + x²"),
        (r"1 - \frac{\alpha}{\ell},\ \text{one way}", "1 - (α/ℓ), one way"),
    ],
)
def test_a_formula_reads_as_text(latex, text):
    assert in_text(latex) == text


# --- in a study --------------------------------------------------------------------------------------------------

A, BETA = 5e5, 8.0


def study(effects, virtual=None, **model) -> dict:
    return {
        "study": "forms",
        "excitation": {"imposed": {"amplitudes": [0.1, "a"], "cycles": 1, "rate": 0.4}},
        "inputs": {"a": {"uniform": [0.1, 0.2], "unit": "m"}},
        "model": {
            "parameters": {"A": {"uniform": [1e5, 1e6]}, "beta": BETA, "gamma": 0.0},
            "effects": effects,
            **model,
        },
        "scales": SCALES._asdict(),
        "experiments": {"virtual": {"parameters": {"A": A, "beta": BETA}, "effects": virtual or {}}},
        "observe": "histories",
        "steps": ["design", "calibrate"],
    }


STEP, STEPS, PERIOD, AMPLITUDE = 1 / 400, 1200, 1.5, 0.3


def respond(effects) -> np.ndarray:
    """Force along two cycles of a sine, from a study with these effects."""
    built = Built(load_study(study(effects)))
    t, omega = np.arange(2 * STEPS + 1) * STEP / 2, 2 * np.pi / PERIOD
    path = Imposed(jnp.asarray(AMPLITUDE * np.sin(omega * t)), jnp.asarray(AMPLITUDE * omega * np.cos(omega * t)))
    conditions = Conditions({}, Recorded(Tabulated(path), jnp.full(STEPS, STEP)))
    simulator = replace(built.simulation.simulator, timeline=Timeline(STEP, STEPS))
    response = simulator.respond({"A": A}, conditions, ("force",))
    assert response.ok
    return np.asarray(response.channels["force"])


def by_scipy(eta=None, nu=None, force=None, bristle=1.0, compliance=None) -> np.ndarray:
    """The same by DOP853 from turn to turn; eta, nu and compliance in series of energy, path and force of the bristle."""
    omega = 2 * np.pi / PERIOD
    t = np.arange(STEPS + 1) * STEP
    nothing = lambda e, s: 1.0  # noqa: E731
    eta, nu = eta or nothing, nu or nothing

    def flow(time, y):
        z, e, s, q = y
        v = AMPLITUDE * omega * np.cos(omega * time)
        total = z + (force(q) if force else 0.0)
        tangent = (A - nu(e, s) * BETA * np.sign(v) * z) / eta(e, s)
        # What is in series takes its share of the elongation: of the increment, so that a force that stays moves nothing.
        slope = tangent * v / (1 + tangent * (compliance(e, s) if compliance else 0.0))
        return [slope, total * v, abs(v), (v - abs(v) * q) / bristle]

    turns = [0.0, *(PERIOD * np.arange(0.25, 2, 0.5)), t[-1]]
    y, found = np.zeros(4), np.zeros(t.size)
    for start, end in pairwise(turns):
        path = solve_ivp(flow, (start, end), y, "DOP853", rtol=1e-11, atol=1e-9, dense_output=True)
        within = (t >= start) & (t <= end)
        z, _, _, q = path.sol(t[within])
        found[within] = z + (force(q) if force else 0.0)
        y = path.y[:, -1]
    return found


CASES = {
    "exponential with the path": (
        {"stiffness_degradation": {"form": "exponential", "driver": "path", "delta": 0.1}},
        {"eta": lambda e, s: np.exp(0.1 * s * F / E)},
    ),
    "saturating with energy": (
        {"strength_degradation": {"form": "saturating", "delta": 0.6, "saturation": 0.5}},
        {"nu": lambda e, s: 1 + (1 - np.exp(-0.3 * e / E)) / 0.5},
    ),
    "a power of the path": (
        {"isotropic_hardening": {"form": "power", "driver": "path", "delta": 0.3, "power": 0.7}},
        {"nu": lambda e, s: 1 / (1 + 0.3 * (s * F / E) ** 0.7)},
    ),
    "a bristle": (
        {"coulomb_friction": {"form": "bristle", "delta": 0.2, "bristle": 0.1}},
        {"force": lambda q: 0.2 * F * q, "bristle": 0.1 * U},
    ),
    "a tangent that loosens": (
        {"support_flexibility": {"form": "loosening", "delta": 0.3, "worn": 2.0, "wears": 0.5}},
        {"compliance": lambda e, s: 0.3 * U / F * (1 + 2.0 * (1 - np.exp(-np.maximum(e, 0) / (0.5 * E))))},
    ),
}


@pytest.mark.verification("effects")
@pytest.mark.parametrize("case", CASES)
def test_a_study_with_a_form_simulates_its_equation(case, observed):
    effects, equation = CASES[case]
    found, expected, plain = respond(effects), by_scipy(**equation), by_scipy()
    size = np.abs(expected).max()
    (name,) = effects
    observed(f"{name}: force along two cycles, {case}", "SciPy DOP853", of_largest(found, expected), 1e-7)
    assert np.abs(plain - expected).max() > 0.03 * size


def test_the_default_form_by_its_name_gives_the_same_numbers_to_the_last_bit():
    said = {"form": "linear", "driver": "energy", "delta": 0.4}
    plain = respond({"stiffness_degradation": {"delta": 0.4}})
    np.testing.assert_array_equal(respond({"stiffness_degradation": said}), plain)
    assert np.abs(plain - respond({"stiffness_degradation": {**said, "form": "exponential"}})).max() > 1e2


def test_the_default_form_by_its_name_is_the_same_model_for_every_effect():
    for name in (name for name in SEVERAL if not EFFECTS[name].linear_only):
        effect = EFFECTS[name]
        said = {"form": effect.forms[0].name} | ({"driver": effect.drivers[0]} if effect.drivers else {})
        plain, named = (Built(load_study(study({name: entry}))).mechanics.parameters for entry in ({}, said))
        assert plain[1] == named[1]
        assert {key: str(prior) for key, prior in plain[0].items()} == {
            key: str(prior) for key, prior in named[0].items()
        }


@pytest.mark.parametrize("name", SEVERAL)
def test_what_a_form_holds_is_fixed_and_what_it_frees_has_its_prior(name):
    effect = EFFECTS[name]
    for form in forms_of(effect).values():
        said = {"form": form.name} | ({"driver": form.driver} if form.driver else {})
        law = {"spring": "elastic", "parameters": {"k": {"uniform": [1e5, 1e6]}}} if effect.linear_only else {}
        content = study({name: said}, **law)
        if law:
            content["experiments"]["virtual"]["parameters"] = {"k": A}
        free, fixed = Built(load_study(content)).mechanics.parameters
        assert {key for key in free if "." in key} == {f"{name}.{key}" for key in form.parameters(effect)}
        assert {k: v for k, v in fixed.items() if k.startswith(name)} == {
            f"{name}.{k}": v for k, v in form.held.items()
        }


def test_a_virtual_specimen_has_the_form_that_it_is_given():
    entry = {"form": "exponential", "driver": "path", "delta": 0.1}
    built = Built(load_study(study({}, {"stiffness_degradation": entry})))
    assert {k: v for k, v in built.mechanics.naming.true_parameters(built.study).items() if "." in k} == {
        "stiffness_degradation.delta": 0.1,
        "stiffness_degradation.growth": 1.0,
        "stiffness_degradation.driver_1": 1.0,
    }


MISTAKES = {
    "unknown form": (
        {"stiffness_degradation": {"form": "cubic"}},
        (
            "model.effects.stiffness_degradation.form",
            "'cubic'",
            "linear, exponential, saturating, power, threshold, free",
        ),
    ),
    "unknown driver": (
        {"stiffness_degradation": {"driver": "time"}},
        ("model.effects.stiffness_degradation.driver", "'time'", "energy, path, largest_elongation"),
    ),
    "a power of a driver of powers": (
        {"stiffness_degradation": {"form": "power", "driver": "path_and_elongation"}},
        ("model.effects.stiffness_degradation.form", "'power'", "linear, exponential, saturating, threshold"),
    ),
    "no word": (
        {"stiffness_degradation": {"form": 3}},
        ("model.effects.stiffness_degradation", "form", "must be a word"),
    ),
    "a form of an effect without forms": (
        {"force_gain": {"form": "linear"}},
        ("model.effects.force_gain.form", "'linear'", "no choice of a form"),
    ),
    "a driver of an effect without drivers": (
        {"hardening": {"driver": "path"}},
        ("model.effects.hardening.driver", "'path'", "no choice of a driver"),
    ),
    "a parameter of another form": (
        {"stiffness_degradation": {"form": "exponential", "power": 2.0}},
        ("model.effects.stiffness_degradation", "power", "delta"),
    ),
    "what a form holds": (
        {"pinching": {"form": "gaussian", "q": 0.1}},
        ("model.effects.pinching", "q", "zeta, p, psi"),
    ),
    "per joule, with another driver": (
        {"stiffness_degradation": {"driver": "path", "eta": 1e-5}},
        ("model.effects.stiffness_degradation", "eta", "delta"),
    ),
    "a unit that the shape changes": (
        {"cubic_stiffness": {"form": "power", "k3": 1e5}},
        ("model.effects.cubic_stiffness", "k3", "delta, power"),
    ),
}


@pytest.mark.parametrize("where", ["model", "virtual"])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_form_is_one_sentence_with_key_and_what_is_allowed(mistake, where):
    effects, words = MISTAKES[mistake]
    content = study(effects) if where == "model" else study({}, effects)
    with pytest.raises(UserError) as error:
        built = Built(load_study(content))
        assert built.mechanics.parameters and built.mechanics.naming.true_parameters(built.study)
    (line,) = str(error.value).splitlines()
    for word in words:
        assert (
            word.replace("model.effects", "experiments.virtual.effects" if where == "virtual" else "model.effects")
            in line
        )


def test_a_law_without_the_place_of_a_form_says_so():
    parameters = {"k": {"uniform": [1e5, 1e6]}, "F_y": 6e4}
    content = study({"asymmetry": {"form": "loading"}}, spring="bilinear", parameters=parameters)
    with pytest.raises(
        UserError, match=r"model\.effects\.asymmetry: it writes to the slot gamma, which the law bilinear"
    ):
        _ = Built(load_study(content)).mechanics.parameters
