r"""What may be hidden: each effect of the catalogue in its own formula (`same`) and in others, named by what they are.

More formulas of the same physics are in `.degrading`, `.loops` and `.forces`.

A formula has an amplitude δ, neutral at zero, made dimensionless by the characteristic values F_c, u_c, v_c, E_c, and further
parameters with a range to draw from.  Where it acts: in the specimen (`Slots`), the frame, the imposed motion (component tests)
or the sensors (histories on the fine grid).
"""

from dataclasses import replace

import numpy as np

from .catalogue import FORCE, PER_ENERGY, STIFFNESS, TIME, VISCOUS, add
from .specimen import DAMPING_RATIO, MASSES, REFERENCE_STIFFNESS, SPRINGS


def _logistic(x):
    return 0.5 * (1 + np.tanh(0.5 * x))


def _worked(x, what="energy"):
    return np.maximum(getattr(x, what), 0.0) / x.scales.energy


# ---- stiffness and strength -------------------------------------------------------------------------------------------


def _degrade_linear(x, s, p):
    s.eta = s.eta * (1 + p["delta"] * x.energy / x.scales.energy)


def _degrade_exponential(x, s, p):
    """η = exp(δ e_h/E_c), e_h the work of the hysteretic force."""
    s.eta = s.eta * np.exp(p["delta"] * _worked(x, "hysteretic"))


def _weaken_linear(x, s, p):
    s.nu = s.nu * (1 + p["delta"] * x.energy / x.scales.energy)


def _weaken_exponential(x, s, p):
    """Strength falls to 15 % exponentially: 1/ν = 0.15 + 0.85 exp(−δ e_h/E_c)."""
    s.nu = s.nu / (0.15 + 0.85 * np.exp(-p["delta"] * _worked(x, "hysteretic")))


def _peak_hyperbola(x, s, p):
    s.a = s.a / (1 + p["delta"] * x.peak / x.scales.elongation)


def _peak_power(x, s, p):
    """A falls as a power of the largest elongation: a = (1 + 4 max|u|/u_c)^−δ."""
    s.a = s.a * (1 + 4 * x.peak / x.scales.elongation) ** -p["delta"]


def _fracture_path(x, s, p):
    used = x.path / (p["life"] * x.scales.elongation)
    s.share = s.share - p["delta"] * _logistic((used - 1) / 0.02)


def _fracture_energy(x, s, p):
    """A gradual loss once the hysteretic work reaches a share of E_c: z (1 − δ logistic((e_h/e_f − 1)/0.15))."""
    s.share = s.share - p["delta"] * _logistic((_worked(x, "hysteretic") / p["life"] - 1) / 0.15)


def _harden_energy(x, s, p):
    s.nu = s.nu / (1 - p["delta"] * np.expm1(-_worked(x) / p["width"]))


def _harden_path(x, s, p):
    """Strength grows with the length of the path: 1/ν = 1 + δ (1 − exp(−s/(w u_c)))."""
    s.nu = s.nu / (1 - p["delta"] * np.expm1(-x.path / (p["width"] * x.scales.elongation)))


ENERGY_WIDTH = {"width": ("energy", "J", lambda c: c.energy)}
LENGTH = {"life": ("path", "m", lambda c: c.elongation)}
add("stiffness_degradation", "same", _degrade_linear, 30.0, PER_ENERGY)
add("stiffness_degradation", "exponential in hysteretic work", _degrade_exponential, 10.0, PER_ENERGY)
add("strength_degradation", "same", _weaken_linear, 50.0, ("nu", "1/J", PER_ENERGY[2]))
add("strength_degradation", "exponential in hysteretic work", _weaken_exponential, 30.0, ("nu", "1/J", PER_ENERGY[2]))
add("peak_softening", "same", _peak_hyperbola, 30.0, ("softening", "1/m", lambda c: 1 / c.elongation))
add("peak_softening", "power", _peak_power, 3.0)
add("fracture", "same", _fracture_path, 0.9, draws={"life": (3.0, 6.0)}, also=LENGTH)
add(
    "fracture",
    "gradual, in hysteretic work",
    _fracture_energy,
    0.9,
    draws={"life": (0.3, 0.7)},
    also={"life": ENERGY_WIDTH["width"]},
)
add("isotropic_hardening", "same", _harden_energy, 20.0, draws={"width": (0.1, 0.5)}, also=ENERGY_WIDTH)
add(
    "isotropic_hardening", "with the path", _harden_path, 20.0, draws={"width": (0.7, 3.0)}, also={"width": LENGTH["life"]}
)  # fmt: skip

# ---- shape of the loop ------------------------------------------------------------------------------------------------


def _pinch_gauss(x, s, p):
    worked = _worked(x)
    severity = -p["delta"] * np.expm1(-p["p"] * worked)
    width = p["psi"] * (0.5 + severity)
    place = x.z * np.sign(x.v) / x.strength - p["q"]
    s.h = s.h * (1 - severity * np.exp(-((place / width) ** 2)))


def _pinch_window(x, s, p):
    """The tangent drops by δ d/(d + u_c) inside a flat window of force, |z| < w A/β, with the largest elongation d."""
    severity = p["delta"] * x.peak / (x.peak + 0.2 * x.scales.elongation)
    s.h = s.h * (1 - severity / (1 + (x.z / (p["width"] * x.strength)) ** 6))


def _slip_gauss(x, s, p):
    sigma = p["width"] * x.strength
    s.compliance = s.compliance + p["delta"] * x.peak * np.sqrt(2 / np.pi) * np.exp(-0.5 * (x.z / sigma) ** 2) / sigma


def _slip_linear(x, s, p):
    """Piecewise-linear slip: δ d of slip spread evenly over |z| < w A/β."""
    band = p["width"] * x.strength
    s.compliance = s.compliance + np.where(np.abs(x.z) < band, p["delta"] * x.peak / (2 * band), 0.0)


def _asymmetric_strength(x, s, p):
    s.nu = s.nu * (1 + p["delta"] * np.sign(x.z))


def _asymmetric_stiffness(x, s, p):
    """A and β both differ with the sign of the force (a weaker and softer side)."""
    s.a, s.nu = s.a * (1 + p["delta"] * np.sign(x.z)), s.nu * (1 + p["delta"] * np.sign(x.z))


def _sharp_power(x, s, p):
    """φ = z_u |z/z_u|^(1+δ): the sharpness alone, the ultimate force A/β kept."""
    s.phi = x.strength * np.maximum(np.abs(x.z) / x.strength, 1e-12) ** (1 + p["delta"])


def _sharp_sinh(x, s, p):
    """φ = z_u sinh(δ|z|/z_u)/sinh(δ): an exponential approach to the same ultimate force."""
    delta = np.maximum(p["delta"], 1e-6)
    s.phi = x.strength * np.sinh(delta * np.minimum(np.abs(x.z) / x.strength, 3.0)) / np.sinh(delta)


def _gamma(x, s, p):
    s.gamma = s.gamma + p["delta"]


def _fullness(x, s, p):
    """β (1 − δ s) and γ = δ β s, s = r/(0.05 + r), r = |z|β/A: the unloading branch alone, the more the larger the force."""
    ratio = np.abs(x.z) / x.strength
    share = p["delta"] * ratio / (0.05 + ratio)
    s.gamma, s.beta = s.gamma + share, s.beta - share


PINCH = {"p": (3.0, 8.0), "q": (0.0, 0.05), "psi": (0.08, 0.15)}
add("pinching", "same", _pinch_gauss, 0.99, ("zeta", "1", lambda _: 1.0), draws=PINCH)
add("pinching", "window of force", _pinch_window, 0.97, draws={"width": (0.04, 0.08)})
add("slip", "same", _slip_gauss, 1.0, draws={"width": (0.03, 0.08)})
add("slip", "piecewise linear", _slip_linear, 1.0, draws={"width": (0.03, 0.08)})
add("asymmetry", "same", _asymmetric_strength, 0.95, is_signed=True)
add("asymmetry", "stiffness and strength", _asymmetric_stiffness, 0.8, is_signed=True)
add("yield_sharpness", "same", _sharp_power, 6.0)
add("yield_sharpness", "sinh", _sharp_sinh, 8.0)
add("loop_shape", "same", _gamma, 4.0)
add("loop_shape", "unloading with the force", _fullness, 0.95)

# ---- elastic forces and contact ---------------------------------------------------------------------------------------


def _linear(x, s, p):
    s.force = s.force + p["delta"] * x.scales.force / x.scales.elongation * x.u


def _kinematic(x, s, p):
    """Linear kinematic hardening (Prager): a back-force on the plastic elongation u − z/A only."""
    s.force = s.force + p["delta"] * x.scales.force / x.scales.elongation * (x.u - x.z / x.A)


def _power_elastic(exponent):
    def act(x, s, p):
        ratio = x.u / x.scales.elongation
        s.force = s.force + p["delta"] * x.scales.force * ratio * np.abs(ratio) ** (exponent - 1)

    return act


def _square(x, s, p):
    s.force = s.force + p["delta"] * x.scales.force * (x.u / x.scales.elongation) ** 2


def _one_sided(x, s, p):
    """A spring that pushes one way, rounded: δ F_c (√(x² + 0.1²) − 0.1), x = u/u_c."""
    s.force = s.force + p["delta"] * x.scales.force * (np.hypot(x.u / x.scales.elongation, 0.1) - 0.1)


def _stop(exponent):
    def act(x, s, p):
        beyond = np.maximum(np.abs(x.u) / x.scales.elongation - p["clearance"], 0.0)
        s.force = s.force + p["delta"] * x.scales.force * np.sign(x.u) * beyond**exponent

    return act


def _gap_sharp(x, s, p):
    closed = np.abs(x.u) >= p["delta"] * x.scales.elongation
    s.share, s.h = s.share * closed, s.h * closed


def _gap_smooth(x, s, p):
    """The slack opens and closes over a tenth of its width."""
    width = np.maximum(p["delta"], 1e-9) * x.scales.elongation
    closed = np.where(p["delta"] > 0, _logistic((np.abs(x.u) - width) / (0.1 * width)), 1.0)
    s.share, s.h = s.share * closed, s.h * closed


def _gap_series(x, s, p):
    """A slack in series, which travels with the specimen's plastic elongation: ± δ u_c tanh(z/(0.03 F_c)) of free play."""
    band = 0.03 * x.scales.force
    free = p["delta"] * x.scales.elongation / band
    s.compliance = s.compliance + free / np.cosh(np.minimum(np.abs(x.z) / band, 50.0)) ** 2


def _series_linear(x, s, p):
    s.compliance = s.compliance + p["delta"] * x.scales.elongation / x.scales.force


def _series_stiffening(x, s, p):
    """A support that stiffens under load: compliance δ (u_c/F_c)/(1 + |z/F_c|)."""
    s.compliance = s.compliance + p["delta"] * x.scales.elongation / (x.scales.force + np.abs(x.z))


CLEARANCE = {"draws": {"clearance": (0.3, 0.6)}, "also": {"clearance": ("gap", "m", lambda c: c.elongation)}}
add("hardening", "same", _linear, 5.0, STIFFNESS)
add("hardening", "kinematic", _kinematic, 20.0, STIFFNESS)
add("cubic_stiffness", "same", _power_elastic(3), 5.0, ("k3", "N/m^3", lambda c: c.force / c.elongation**3))
add("cubic_stiffness", "power 2.4", _power_elastic(2.4), 5.0)
add("quadratic_stiffness", "same", _square, 2.0, ("k2", "N/m^2", lambda c: c.force / c.elongation**2), is_signed=True)
add("quadratic_stiffness", "one-sided, rounded", _one_sided, 1.0, STIFFNESS, is_signed=True)
add("contact_stiffening", "same", _stop(1), 50.0, STIFFNESS, **CLEARANCE)
add("contact_stiffening", "Hertz", _stop(1.5), 50.0, **CLEARANCE)
add("gap", "same", _gap_sharp, 0.8, ("width", "m", lambda c: c.elongation))
add("gap", "smooth", _gap_smooth, 0.8, ("width", "m", lambda c: c.elongation))
add("gap", "series", _gap_series, 0.8, ("width", "m", lambda c: c.elongation))
add("support_flexibility", "same", _series_linear, 5.0, ("compliance", "m/N", lambda c: c.elongation / c.force))
add(
    "support_flexibility",
    "stiffening",
    _series_stiffening,
    10.0,
    ("compliance", "m/N", lambda c: c.elongation / c.force),
)

# ---- forces that depend on the rate -----------------------------------------------------------------------------------


def _dashpot(shape):
    """δ F_c shape(Δu̇/v_c, parameters)."""

    def act(x, s, p):
        s.force = s.force + p["delta"] * x.scales.force * shape(x.v / x.scales.rate, p)

    return act


def _stribeck_gauss(ratio, p):
    """(μ + (1 − μ) exp(−(v/0.25 v_c)²)) v/√(v² + (0.02 v_c)²)."""
    return (p["remaining"] + (1 - p["remaining"]) * np.exp(-((ratio / 0.25) ** 2))) * ratio / np.hypot(ratio, 0.02)


def _stribeck(ratio, p):
    return (p["remaining"] + (1 - p["remaining"]) * np.exp(-np.abs(ratio) / 0.2)) * np.tanh(ratio / 0.02)


def _dahl(x, s, p):
    """Dahl's bristle: ẇ = v − |v| w/u_b with u_b = 0.02 u_c; the force is δ F_c w/u_b."""
    length = 0.02 * x.scales.elongation
    s.rates.append(x.v - np.abs(x.v) * x.w[0] / length)
    s.force = s.force + p["delta"] * x.scales.force * x.w[0] / length


def _rate_log(x, s, p):
    s.a = s.a * (1 + p["delta"] * np.log1p(np.abs(x.v) / x.scales.rate))


def _rate_power(x, s, p):
    """Cowper–Symonds: A and the strength grow by (1 + δ |v/v_c|^0.4), rounded at rest."""
    s.a = s.a * (1 + p["delta"] * (np.hypot(x.v / x.scales.rate, 0.01) ** 0.4 - 0.01**0.4))


def _maxwell(shares):
    """Maxwell elements in parallel: ḟ = δ (F_c/u_c) share v − f/τ, for (share of stiffness, factor on τ) each."""

    def act(x, s, p):
        for row, (share, factor) in zip(x.w, shares, strict=True):
            tau = factor * p["tau"] * x.scales.elongation / x.scales.rate
            s.rates.append(p["delta"] * x.scales.force / x.scales.elongation * share * x.v - row / tau)
            s.force = s.force + row

    return act


add("viscous_damping", "same", _dashpot(lambda r, p: r), 10.0, VISCOUS)
add("viscous_damping", "unlike by direction", _dashpot(lambda r, p: r + 0.3 * np.abs(r)), 10.0, FORCE)
add(
    "quadratic_damping", "same", _dashpot(lambda r, p: np.abs(r) * r), 10.0,
    ("c2", "N*s^2/m^2", lambda c: c.force / c.rate**2),
)  # fmt: skip
add("quadratic_damping", "power 1.8", _dashpot(lambda r, p: np.abs(r) ** 0.8 * r), 10.0, FORCE)
add(
    "power_damping", "same", _dashpot(lambda r, p: np.maximum(np.abs(r), 1e-3) ** (p["alpha"] - 1) * r), 5.0, FORCE,
    draws={"alpha": (0.3, 0.7)},
)  # fmt: skip
add("power_damping", "arsinh", _dashpot(lambda r, p: np.arcsinh(r / 0.1) / np.arcsinh(10)), 5.0, FORCE)
add("coulomb_friction", "same", _dashpot(lambda r, p: np.tanh(r / 0.02)), 3.0, FORCE)
add("coulomb_friction", "rounded", _dashpot(lambda r, p: r / np.hypot(r, 0.03)), 3.0, FORCE)
add("coulomb_friction", "dahl", _dahl, 3.0, FORCE, states=1)
add("stribeck_friction", "same", _dashpot(_stribeck), 3.0, FORCE, draws={"remaining": (0.2, 0.6)})
add("stribeck_friction", "Gauss", _dashpot(_stribeck_gauss), 3.0, FORCE, draws={"remaining": (0.2, 0.6)})
add("rate_dependence", "same", _rate_log, 10.0)
add("rate_dependence", "Cowper-Symonds", _rate_power, 5.0)
add(
    "relaxation",
    "same",
    _maxwell([(1.0, 1.0)]),
    10.0,
    STIFFNESS,
    draws={"tau": (0.5, 1.5)},
    also={"tau": TIME},
    states=1,
)
add(
    "relaxation", "two times", _maxwell([(0.5, 1.0), (0.5, 6.0)]), 10.0, STIFFNESS, draws={"tau": (0.3, 0.8)},
    also={"tau": TIME}, states=2,
)  # fmt: skip

# ---- the frame: (frame, δ) -> frame -----------------------------------------------------------------------------------


def _damping_scaled(frame, delta):
    return replace(frame, c11=frame.c11 * (1 + delta), c12=frame.c12 * (1 + delta), c22=frame.c22 * (1 + delta))


def _damping_stiffness(frame, delta):
    """Stiffness-proportional damping instead of modal: C + δ (2ζ/ω₁) K."""
    k, low = REFERENCE_STIFFNESS, 2 * np.pi * 1.376
    factor = delta * 2 * DAMPING_RATIO / low
    return replace(
        frame,
        c11=frame.c11 + factor * (SPRINGS[0] + k),
        c12=frame.c12 - factor * k,
        c22=frame.c22 + factor * (SPRINGS[1] + k),
    )


def _frame(**names):
    def act(frame, delta):
        return replace(frame, **{name: getattr(frame, name) * (1 + factor * delta) for name, factor in names.items()})

    return act


add("damping_error", "same", _damping_scaled, 10.0, place="frame")
add("damping_error", "proportional to stiffness", _damping_stiffness, 10.0, place="frame")
add("mass_error", "same", _frame(m1=1, m2=1), 0.6, place="frame", is_signed=True)
add("mass_error", "one mass", _frame(m1=1), 0.8, ("mass", "kg", lambda _: MASSES[0]), place="frame", is_signed=True)
add("support_stiffness_error", "same", _frame(k1=1, k2=1), 0.8, place="frame", is_signed=True)
add(
    "support_stiffness_error",
    "one spring",
    _frame(k1=1),
    0.9,
    ("k", "N/m", lambda _: SPRINGS[0]),
    place="frame",
    is_signed=True,
)
add("ground_motion_gain", "same", _frame(gain=1), 0.9, place="frame", is_signed=True)

# ---- component tests by OpenSees: the material's name ------------------------------------------------------------------

SERIES, BY_OPENSEES = ("compliance", "m/N", lambda c: c.elongation / c.force), {"place": "opensees"}
add("stiffness_degradation", "opensees", "stiffness_degradation", 30.0, PER_ENERGY, **BY_OPENSEES)
add("strength_degradation", "opensees", "strength_degradation", 50.0, ("nu", "1/J", PER_ENERGY[2]), **BY_OPENSEES)
add("pinching", "opensees", "pinching", 0.95, ("zeta", "1", lambda _: 1.0), draws=PINCH, **BY_OPENSEES)
add("hardening", "opensees", "hardening", 0.9, **BY_OPENSEES)
add("contact_stiffening", "opensees", "contact_stiffening", 50.0, STIFFNESS, **CLEARANCE, **BY_OPENSEES)
add("coulomb_friction", "opensees", "coulomb_friction", 3.0, FORCE, **BY_OPENSEES)
add("quadratic_stiffness", "opensees", "quadratic_stiffness", 3.0, STIFFNESS, **BY_OPENSEES)
add("support_flexibility", "opensees", "support_flexibility", 5.0, SERIES, **BY_OPENSEES)
