r"""What shapes the loop and what acts in series, in formulas that are in no textbook; written as in `.effects`.

r = |z|β/A is the hysteretic force over the ultimate one, d the largest elongation over u_c, N the number of reversals.
"""

import numpy as np

from .catalogue import add
from .degrading import COUNTED, energy, largest, reversals, sigmoid, this_side, work


def ratio(x):
    """Hysteretic force over the ultimate one."""
    return np.abs(x.z) / x.strength


# ---- pinching: tangent h about z = 0 ----------------------------------------------------------------------------------


def _pinch_with_reversals(x, s, p):
    """h = 1 − δ N/(N + 2)/(1 + (r/w)²)."""
    count = reversals(x, s)
    s.h = s.h * (1 - p["delta"] * count / (count + 2) / (1 + (ratio(x) / p["width"]) ** 2))


def _pinch_on_reloading(x, s, p):
    """Only while the force grows: h = 1 − δ d/(d + 0.3) exp(−r/w), from z = 0 on (over 2 % of z_u)."""
    severity = p["delta"] * largest(x) / (largest(x) + 0.3)
    growing = sigmoid(x.z * np.sign(x.v) / (0.01 * x.strength))
    s.h = s.h * (1 - severity * growing * np.exp(-ratio(x) / p["width"]))


def _pinch_in_two_windows(x, s, p):
    """A narrow window that opens with hysteretic work, 0.6 sigmoid((x_h − 0.3)/0.06), and a wide one with d/(d + 0.3)."""
    narrow = 0.6 * sigmoid((work(x) - 0.3) / 0.06) * np.exp(-((ratio(x) / p["width"]) ** 2))
    wide = 0.4 * largest(x) / (largest(x) + 0.3) * np.exp(-((ratio(x) / (3 * p["width"])) ** 4))
    s.h = s.h * (1 - p["delta"] * (narrow + wide))


WIDTH = {"draws": {"width": (0.05, 0.10)}}
add("pinching", "rational with reversals", _pinch_with_reversals, 0.98, **WIDTH, **COUNTED)
add("pinching", "on reloading", _pinch_on_reloading, 0.99, draws={"width": (0.08, 0.15)})
add("pinching", "two windows", _pinch_in_two_windows, 0.98, **WIDTH)

# ---- slip: compliance about z = 0, in series --------------------------------------------------------------------------


def _slip_of_elongation_and_reversals(x, s, p):
    """Slip of δ (d + log(1 + N)/3)/2 over a profile 1/cosh²(r/w)."""
    length = p["delta"] * 0.5 * (largest(x) + np.log1p(reversals(x, s)) / 3) * x.scales.elongation
    band = p["width"] * x.strength
    s.compliance = s.compliance + length / band / np.cosh(np.minimum(np.abs(x.z) / band, 50.0)) ** 2


def _slip_of_each_side(x, s, p):
    """Slip of each side of its own, δ log(1 + 2 d±)/2, over a trapezium that falls off from w/2 to 3w/2."""
    length = p["delta"] * 0.5 * np.log1p(2 * this_side(x)) * x.scales.elongation
    profile = np.clip(1.5 - ratio(x) / p["width"], 0.0, 1.0)
    s.compliance = s.compliance + length * profile / (p["width"] * x.strength)


def _slip_in_two_stages(x, s, p):
    """Little slip until d = 0.4, then much: δ (0.1 d + 1.5 max(d − 0.4, 0)), over a profile (1 − (r/2w)²)²."""
    length = p["delta"] * (0.1 * largest(x) + 1.5 * np.maximum(largest(x) - 0.4, 0.0)) * x.scales.elongation
    profile = np.maximum(1 - (0.5 * ratio(x) / p["width"]) ** 2, 0.0) ** 2
    s.compliance = s.compliance + length * profile / (p["width"] * x.strength)


SLIPPING = {"draws": {"width": (0.03, 0.08)}}
add("slip", "elongation and reversals", _slip_of_elongation_and_reversals, 1.5, **SLIPPING, **COUNTED)
add("slip", "log of each side's elongation", _slip_of_each_side, 1.5, **SLIPPING)
add("slip", "two stages of elongation", _slip_in_two_stages, 1.5, **SLIPPING)

# ---- asymmetry: strength by sign ---------------------------------------------------------------------------------------


def _asymmetric_rounded(x, s, p):
    """ν = 1 + δ ζ/√(ζ² + 0.3²), ζ = zβ/A: the strengths go over gradually."""
    side = x.z / x.strength
    s.nu = s.nu * (1 + p["delta"] * side / np.hypot(side, 0.3))


def _asymmetric_by_elongation(x, s, p):
    """ν = 1 + δ tanh(u/0.2 u_c): the side to which it is pulled decides, not the sign of the force."""
    s.nu = s.nu * (1 + p["delta"] * np.tanh(x.u / (0.2 * x.scales.elongation)))


def _asymmetric_mostly_in_strength(x, s, p):
    """ν = 1 + δ sign z, and a = 1 + 0.3 δ tanh(z/0.2 z_u): the weaker side is a little stiffer."""
    s.nu = s.nu * (1 + p["delta"] * np.sign(x.z))
    s.a = s.a * (1 + 0.3 * p["delta"] * np.tanh(x.z / (0.2 * x.strength)))


add("asymmetry", "rounded in force", _asymmetric_rounded, 0.95, is_signed=True)
add("asymmetry", "by side of elongation", _asymmetric_by_elongation, 0.95, is_signed=True)
add("asymmetry", "strength and some stiffness", _asymmetric_mostly_in_strength, 0.9, is_signed=True)

# ---- how sharply it yields: φ, its value at the ultimate force kept ---------------------------------------------------


def _sharp_table(x, s, p):
    """φ/z_u goes from r to a table with kinks at (0.4, 0.05) and (0.75, 0.35) with the weight δ/(1 + δ)."""
    r, weight = ratio(x), p["delta"] / (1 + p["delta"])
    kinked = np.maximum(np.maximum(0.125 * r, 0.05 + (r - 0.4) * 6 / 7), 0.35 + (r - 0.75) * 2.6)
    s.phi = x.strength * ((1 - weight) * r + weight * kinked)


def _sharp_rational(x, s, p):
    """φ/z_u = r/(1 + δ (1 − r)), a hyperbola."""
    r = ratio(x)
    s.phi = x.strength * r / (1 + p["delta"] * np.maximum(1 - r, 0.0))


def _sharp_two_powers(x, s, p):
    """φ/z_u goes from r to (r³ + r⁸)/2 with the weight δ/(1 + δ)."""
    r, weight = np.minimum(ratio(x), 2.0), p["delta"] / (1 + p["delta"])
    s.phi = x.strength * ((1 - weight) * r + weight * 0.5 * (r**3 + r**8))


add("yield_sharpness", "table with kinks", _sharp_table, 50.0)
add("yield_sharpness", "hyperbola", _sharp_rational, 20.0)
add("yield_sharpness", "two powers", _sharp_two_powers, 50.0)

# ---- fullness of the loop: γ ------------------------------------------------------------------------------------------


def _fuller_at_high_force(x, s, p):
    """γ = δ r/(0.5 + r)."""
    s.gamma = s.gamma + p["delta"] * ratio(x) / (0.5 + ratio(x))


def _fuller_by_logistic(x, s, p):
    """γ = δ (0.3 + 0.7 sigmoid((r − 0.3)/0.08))."""
    s.gamma = s.gamma + p["delta"] * (0.3 + 0.7 * sigmoid((ratio(x) - 0.3) / 0.08))


def _fuller_with_elongation(x, s, p):
    """γ = δ (1 + log(1 + 3 d))/2."""
    s.gamma = s.gamma + p["delta"] * 0.5 * (1 + np.log1p(3 * largest(x)))


add("loop_shape", "rational in force", _fuller_at_high_force, 12.0)
add("loop_shape", "logistic in force", _fuller_by_logistic, 6.0)
add("loop_shape", "log of elongation", _fuller_with_elongation, 4.0)

# ---- a support in series: compliance ----------------------------------------------------------------------------------


def _series(x, p, share):
    return p["delta"] * x.scales.elongation / x.scales.force * share


def _support_takes_up(x, s, p):
    """A bedding that gives way until it bears: compliance 0.3 + 0.7 sigmoid((0.35 − |z|/F_c)/0.05)."""
    s.compliance = s.compliance + _series(x, p, 0.3 + 0.7 * sigmoid((0.35 - np.abs(x.z) / x.scales.force) / 0.05))


def _support_loosens(x, s, p):
    """A joint that loosens: compliance (1 + x/(x + 0.3))/2."""
    s.compliance = s.compliance + _series(x, p, 0.5 * (1 + energy(x) / (energy(x) + 0.3)))


def _support_in_contact(x, s, p):
    """Rough surfaces in contact: compliance (0.2² + (z/F_c)²)^−1/4."""
    s.compliance = s.compliance + _series(x, p, (0.04 + (x.z / x.scales.force) ** 2) ** -0.25)


SUPPORT = "support_flexibility"
add(SUPPORT, "bedding in two stages", _support_takes_up, 8.0)
add(SUPPORT, "loosening joint", _support_loosens, 8.0)
add(SUPPORT, "rough contact", _support_in_contact, 5.0)
