r"""What tests of real specimens show, in formulas of no textbook: recentring, back-stresses, reloading, buckling, scragging.

Written as in `.effects`.  Drivers, dimensionless: elongation x = u/u_c, plastic elongation x_p = (u − z/A)/u_c, largest
elongation d to each side, r = |z|β/A.
"""

import numpy as np

from .catalogue import FORCE, STIFFNESS, add
from .degrading import largest
from .loops import ratio


def _elongation(x):
    return x.u / x.scales.elongation


def _loads(x):
    return x.v * x.z > 0


# ---- recentring: part of the hysteresis becomes a force that goes back the way it came --------------------------------------


def _tendons(x, s, p):
    """The share δ of the specimen is a tendon that opens a joint: z_u tanh(A u/z_u), without hysteresis."""
    s.share = s.share * (1 - p["delta"])
    s.force = s.force + p["delta"] * x.strength * np.tanh(x.A * x.u / x.strength)


def _tendons_with_a_slope(x, s, p):
    """The share δ of the specimen is a tendon that opens its joint at 0.6 z_u; the open joint has a slope of A/25."""
    s.share = s.share * (1 - p["delta"])
    opens = 0.6 * x.strength / x.A
    held = np.clip(x.u, -opens, opens)
    s.force = s.force + p["delta"] * x.A * (held + 0.04 * (x.u - held))


# ---- back-stress beside the law ---------------------------------------------------------------------------------------------


def _two_sliders(x, s, p):
    """Two elastic-plastic springs in parallel, with slopes of 0.7 and 0.3 δ F_c/u_c and bounds of 0.15 and 0.20 δ F_c."""
    for row, (share, bound) in enumerate(((0.7, 0.15), (0.3, 0.20))):
        full = np.minimum((np.abs(x.w[row]) / bound) ** 8, 1.0) * (x.w[row] * x.v > 0)
        s.rates += [share * x.v / x.scales.elongation * (1 - full)]
    s.force = s.force + p["delta"] * x.scales.force * (x.w[0] + x.w[1])


def _power_of_the_plastic_elongation(x, s, p):
    """δ F_c sign(x_p)|x_p|^0.6 with the plastic elongation u − z/A."""
    plastic = (x.u - x.z / x.A) / x.scales.elongation
    s.force = s.force + p["delta"] * x.scales.force * np.sign(plastic) * np.abs(plastic) ** 0.6


# ---- reloading towards where it has been ------------------------------------------------------------------------------------


def _towards(x, peak):
    """The slope to the point of the virgin curve at an elongation on the side of loading, over that of the law, 1 at most.

    It goes over into 1 within 0.04 u_c before the peak: on virgin ground the law goes its own way.
    """
    at_peak = -x.strength * np.expm1(-peak * x.A / x.strength)
    left = peak - np.sign(x.v) * x.u
    way = np.maximum(left, 0.02 * x.scales.elongation)
    slope = np.maximum(at_peak - np.abs(x.z), 0.0) / way
    share = np.minimum(slope / (x.A * np.maximum(1 - ratio(x), 0.01)), 1.0)
    virgin = np.clip(2 - left / (0.02 * x.scales.elongation), 0.0, 1.0)
    return virgin + (1 - virgin) * share


def _aims_at_the_peak(x, s, p):
    """Loading aims at the virgin curve at the largest elongation of its side: h = 1 − δ (1 − slope over the law's)."""
    share = _towards(x, np.where(x.v > 0, x.high, x.low))
    s.h = s.h * (1 - p["delta"] * np.where(_loads(x), 1 - share, 0.0))


def _aims_at_the_larger_peak(x, s, p):
    """Loading aims at the virgin curve at the largest elongation of both sides, at first faster: h = 1 − δ (1 − slope^0.7)."""
    share = _towards(x, x.peak) ** 0.7
    s.h = s.h * (1 - p["delta"] * np.where(_loads(x), 1 - share, 0.0))


# ---- buckling: one side loses strength as it shortens -----------------------------------------------------------------------


def _reached(x, p):
    """Whether the force is on the side that buckles, and the largest elongation of this side over u_c."""
    buckles = x.z * np.sign(p["delta"]) < 0
    return buckles, np.where(p["delta"] > 0, x.low, x.high) / x.scales.elongation


def _buckles_exponentially(x, s, p):
    """ν = exp(|δ| (0.5 + 3 d)) on the side that buckles."""
    buckles, reached = _reached(x, p)
    s.nu = s.nu * np.where(buckles, np.exp(np.abs(p["delta"]) * (0.5 + 3 * reached)), 1.0)


def _buckles_and_straightens(x, s, p):
    """ν = 1 + 4|δ| d on the side that buckles; loading of the other side loses h = 1 − |δ| d/(d + 0.2) until u = 0."""
    buckles, reached = _reached(x, p)
    s.nu = s.nu * np.where(buckles, 1 + 4 * np.abs(p["delta"]) * reached, 1.0)
    bent = ~buckles & _loads(x) & (x.u * np.sign(p["delta"]) < 0)
    s.h = s.h * np.where(bent, 1 - np.minimum(np.abs(p["delta"]), 0.95) * reached / (reached + 0.2), 1.0)


# ---- scragging: a spring that is stiff on virgin ground only ----------------------------------------------------------------


def _softer_within(x, s, p):
    """δ F_c x exp(−2 (1 − |x|/d)), d the largest elongation so far."""
    reached = np.maximum(largest(x), 1e-9)
    s.force = s.force + p["delta"] * x.scales.force * _elongation(x) * np.exp(
        -2 * (1 - np.abs(_elongation(x)) / reached)
    )


def _softer_by_energy(x, s, p):
    """δ F_c x (1 − 0.8 tanh((d² − x²)/0.15)): the elastic energy below the largest one decides."""
    missing = np.maximum(largest(x) ** 2 - _elongation(x) ** 2, 0.0)
    s.force = s.force + p["delta"] * x.scales.force * _elongation(x) * (1 - 0.8 * np.tanh(missing / 0.15))


add("self_centering", "tendons", _tendons, 0.95)
add("self_centering", "tendons with a slope", _tendons_with_a_slope, 0.95)
add("kinematic_hardening", "two sliders", _two_sliders, 20.0, STIFFNESS, states=2)
add("kinematic_hardening", "power of the plastic elongation", _power_of_the_plastic_elongation, 5.0, FORCE)
add("peak_oriented", "peak of each side", _aims_at_the_peak, 1.0)
add("peak_oriented", "larger peak of both sides", _aims_at_the_larger_peak, 1.0)
add("buckling", "exponential", _buckles_exponentially, 3.0, is_signed=True)
add("buckling", "straightening", _buckles_and_straightens, 20.0, is_signed=True)
add("scragging", "exponential within", _softer_within, 10.0, STIFFNESS)
add("scragging", "energy within", _softer_by_energy, 10.0, STIFFNESS)
