r"""What degrades or grows with the history, in formulas of no textbook: stages, mixtures of drivers, stairs of reversals.

Written as in `.effects`; each says in its name what it is.  Drivers, dimensionless: absorbed energy x = e/E_c, hysteretic work
x_h, path s/u_c, largest elongation d = max|u|/u_c, to each side d₊ and d₋, number of reversals N.
"""

import numpy as np

from .catalogue import add

TURN = 0.1  # a reversal is counted over this much path, in u_c


def sigmoid(x):
    """Logistic function, without overflow."""
    return 0.5 * (1 + np.tanh(0.5 * x))


def energy(x):
    """Absorbed energy over E_c."""
    return np.maximum(x.energy, 0.0) / x.scales.energy


def work(x):
    """Hysteretic work over E_c."""
    return np.maximum(x.hysteretic, 0.0) / x.scales.energy


def path(x):
    """Length of the path over u_c."""
    return x.path / x.scales.elongation


def largest(x):
    """Largest elongation over u_c."""
    return x.peak / x.scales.elongation


def this_side(x):
    """Largest elongation to the side to which the specimen pushes, over u_c."""
    return np.where(x.z > 0, x.high, x.low) / x.scales.elongation


def reversals(x, s):
    """Number of reversals so far: a bristle goes over from −1 to 1 within a path of about TURN u_c; N = ∫|dw|/2 (two states)."""
    turn = (x.v - np.abs(x.v) * x.w[0]) / (TURN * x.scales.elongation)
    s.rates += [turn, 0.5 * np.abs(turn)]
    return x.w[1]


def stairs(count):
    """A rounded staircase, one step for each of `count`."""
    return count - np.sin(2 * np.pi * count) / (2 * np.pi)


# ---- stiffness: 1/η ---------------------------------------------------------------------------------------------------


def _soften_in_two_stages(x, s, p):
    """η = 1 + δ (0.2 x + 2 max(x − 0.4, 0)): slowly at first, ten times as fast from x = 0.4."""
    s.eta = s.eta * (1 + p["delta"] * (0.2 * energy(x) + 2 * np.maximum(energy(x) - 0.4, 0.0)))


def _soften_in_stairs(x, s, p):
    """η = 1 + δ log(1 + stairs(N)/3): a step at every reversal, ever smaller."""
    s.eta = s.eta * (1 + p["delta"] * np.log1p(stairs(reversals(x, s)) / 3))


def _soften_by_path_and_elongation(x, s, p):
    """η = 1 + δ (d² + log(1 + s/3))/2."""
    s.eta = s.eta * (1 + p["delta"] * 0.5 * (largest(x) ** 2 + np.log1p(path(x) / 3)))


def _soften_by_logistic(x, s, p):
    """1/η falls between two plateaus: η = 1 + δ sigmoid((x_h − 0.35)/0.08), from its value at rest."""
    s.eta = s.eta * (1 + p["delta"] * (sigmoid((work(x) - 0.35) / 0.08) - sigmoid(-0.35 / 0.08)))


COUNTED = {"states": 2}
add("stiffness_degradation", "two stages of energy", _soften_in_two_stages, 20.0)
add("stiffness_degradation", "stairs of reversals", _soften_in_stairs, 20.0, **COUNTED)
add("stiffness_degradation", "path and elongation", _soften_by_path_and_elongation, 30.0)
add("stiffness_degradation", "logistic in hysteretic work", _soften_by_logistic, 30.0)

# ---- strength: 1/ν ----------------------------------------------------------------------------------------------------


def _weaken_by_logistic(x, s, p):
    """1/ν = 1 − δ sigmoid((x_h − 0.4)/0.1), from its value at rest."""
    s.nu = s.nu / (1 - p["delta"] * (sigmoid((work(x) - 0.4) / 0.1) - sigmoid(-4.0)))


def _weaken_by_damage_index(x, s, p):
    """ν = 1 + δ i (1 + i/2), i = d + 0.6 x: faster and faster with a damage index of largest elongation and energy."""
    index = largest(x) + 0.6 * energy(x)
    s.nu = s.nu * (1 + p["delta"] * index * (1 + 0.5 * index))


def _weaken_each_side(x, s, p):
    """ν = 1 + δ log(1 + 3 d±): what was reached to one side weakens that side."""
    s.nu = s.nu * (1 + p["delta"] * np.log1p(3 * this_side(x)))


def _weaken_in_stairs(x, s, p):
    """ν = 1 + δ n²/(n² + 25), n = stairs(N): steps at the reversals, slow, then fast, then no more."""
    steps = stairs(reversals(x, s))
    s.nu = s.nu * (1 + p["delta"] * steps**2 / (steps**2 + 25))


add("strength_degradation", "logistic in hysteretic work", _weaken_by_logistic, 0.9)
add("strength_degradation", "damage index, ever faster", _weaken_by_damage_index, 30.0)
add("strength_degradation", "log of each side's elongation", _weaken_each_side, 30.0)
add("strength_degradation", "stairs of reversals", _weaken_in_stairs, 50.0, **COUNTED)

# ---- softening with the largest elongation: a -------------------------------------------------------------------------


def _peak_in_two_stages(x, s, p):
    """1/a = 1 + δ (0.3 d + 1.5 max(d − 0.5, 0))."""
    s.a = s.a / (1 + p["delta"] * (0.3 * largest(x) + 1.5 * np.maximum(largest(x) - 0.5, 0.0)))


def _peak_of_both_sides(x, s, p):
    """1/a = 1 + δ log(1 + 2 (d₊ + d₋)): the range that was visited counts."""
    s.a = s.a / (1 + p["delta"] * np.log1p(2 * (x.high + x.low) / x.scales.elongation))


def _peak_rational(x, s, p):
    """a = 1 − δ d³/(d³ + 0.4³): a rational fall between two plateaus."""
    s.a = s.a * (1 - p["delta"] * largest(x) ** 3 / (largest(x) ** 3 + 0.4**3))


add("peak_softening", "two stages of elongation", _peak_in_two_stages, 30.0)
add("peak_softening", "log of the range", _peak_of_both_sides, 20.0)
add("peak_softening", "rational", _peak_rational, 0.9)

# ---- fracture: share of z that is left --------------------------------------------------------------------------------


def _break_twice(x, s, p):
    """Two parts break, 40 % and 60 %, the second after 1.6 times the path of the first."""
    used = path(x) / p["life"]
    s.share = s.share - p["delta"] * (0.4 * sigmoid((used - 1) / 0.02) + 0.6 * sigmoid((used - 1.6) / 0.02))


def _break_by_damage_index(x, s, p):
    """Breaks over a tenth of its life when (d + x_h/2)/life reaches one."""
    s.share = s.share - p["delta"] * sigmoid(((largest(x) + 0.5 * work(x)) / p["life"] - 1) / 0.05)


def _break_by_fatigue(x, s, p):
    """Breaks when Miner's sum with the law of Coffin and Manson reaches one: D = ∫(|u|/u_c)^1.5 |du|/(u_c life) (one state)."""
    s.rates.append(np.abs(x.u / x.scales.elongation) ** 1.5 * np.abs(x.v) / x.scales.elongation / p["life"])
    s.share = s.share - p["delta"] * sigmoid((x.w[0] - 1) / 0.04)


add("fracture", "two breaks along the path", _break_twice, 0.9, draws={"life": (2.5, 4.0)})
add("fracture", "damage index", _break_by_damage_index, 0.9, draws={"life": (0.8, 1.1)})
add("fracture", "low-cycle fatigue", _break_by_fatigue, 0.9, draws={"life": (0.5, 1.0)}, states=1)

# ---- hardening of the strength: 1/ν -----------------------------------------------------------------------------------


def _harden_fast_and_slowly(x, s, p):
    """1/ν = 1 + δ (0.4 (1 − exp(−x/0.05)) + log(1 + x))."""
    s.nu = s.nu / (1 + p["delta"] * (-0.4 * np.expm1(-energy(x) / 0.05) + np.log1p(energy(x))))


def _harden_in_stairs(x, s, p):
    """1/ν = 1 + δ n²/(n² + w²), n = stairs(N)."""
    steps = stairs(reversals(x, s))
    s.nu = s.nu / (1 + p["delta"] * steps**2 / (steps**2 + p["width"] ** 2))


def _harden_by_elongation_and_path(x, s, p):
    """1/ν = 1 + δ (d/(d + 0.3) + s/(s + 3))/2."""
    s.nu = s.nu / (1 + p["delta"] * 0.5 * (largest(x) / (largest(x) + 0.3) + path(x) / (path(x) + 3)))


add("isotropic_hardening", "fast and slow", _harden_fast_and_slowly, 20.0)
add("isotropic_hardening", "stairs of reversals", _harden_in_stairs, 20.0, draws={"width": (1.0, 3.0)}, **COUNTED)
add("isotropic_hardening", "elongation and path", _harden_by_elongation_and_path, 20.0)
