r"""Forces beside the spring, in elongation and rate, in formulas that are in no textbook; written as in `.effects`.

x = u/u_c is the elongation, q = v/v_c its rate; a force is δ F_c times what stands in the docstring.
"""

from collections.abc import Callable

import numpy as np

from .catalogue import add
from .degrading import energy, path, sigmoid


def _force(shape: Callable) -> Callable:
    """Adds δ F_c shape(x, q, further parameters, the point)."""

    def act(x, s, p):
        s.force = s.force + p["delta"] * x.scales.force * shape(x.u / x.scales.elongation, x.v / x.scales.rate, p, x)

    act.__doc__ = shape.__doc__
    return act


def _beside(effect: str, name: str, largest: float, **more) -> Callable:
    """Registers the shape of a force under this name."""

    def put(shape):
        add(effect, name, _force(shape), largest, **more)
        return shape

    return put


def _rounded(ratio, exponent, core=0.02):
    """|ratio|^exponent with its sign, linear within `core`."""
    return ratio * np.hypot(ratio, core) ** (exponent - 1)


# ---- springs ----------------------------------------------------------------------------------------------------------


@_beside("hardening", "three slopes", 8.0)
def _three_slopes(x, q, p, point):
    """A table with slopes 1, 0.6, 0.3 and kinks at |x| = 0.3 and 0.7."""
    far = np.abs(x)
    return np.sign(x) * np.minimum(np.minimum(far, 0.3 + 0.6 * (far - 0.3)), 0.54 + 0.3 * (far - 0.7))


@_beside("hardening", "log", 8.0)
def _log_spring(x, q, p, point):
    """arsinh(2x)/2."""
    return 0.5 * np.arcsinh(2 * x)


@_beside("hardening", "wearing with energy", 10.0)
def _worn_spring(x, q, p, point):
    """x (0.6 + 0.4/(1 + 3e/E_c)): a parallel spring that loses some of its stiffness."""
    return x * (0.6 + 0.4 / (1 + 3 * energy(point)))


def _back_stresses(x, s, p):
    """Two back-forces on the plastic elongation (Chaboche): 0.6 α₁ + α₂, α̇₁ = u̇_p/u_c, α̇₂ = α̇₁ − 3|α̇₁|α₂ (one state)."""
    # Of the plain law the plastic rate is v |z|/z_u while it loads; unloading is as good as elastic.
    plastic = np.where(x.z * x.v > 0, x.v * np.minimum(np.abs(x.z) / x.strength, 1.0), 0.0) / x.scales.elongation
    s.rates.append(plastic - 3 * np.abs(plastic) * x.w[0])
    linear = (x.u - x.z / x.A) / x.scales.elongation
    s.force = s.force + p["delta"] * x.scales.force * (0.6 * linear + x.w[0])


add("hardening", "two back-stresses", _back_stresses, 10.0, states=1)


@_beside("cubic_stiffness", "cubic and quintic", 5.0)
def _cubic_and_quintic(x, q, p, point):
    """(x³ + x⁵)/2."""
    return 0.5 * (x**3 + x**5)


@_beside("cubic_stiffness", "rational", 8.0)
def _rational_spring(x, q, p, point):
    """x³/(x² + 0.6²)."""
    return x**3 / (x**2 + 0.36)


@_beside("cubic_stiffness", "table with kinks", 8.0)
def _progressive_table(x, q, p, point):
    """Slopes 0.1, 0.6, 1.6, 3 with kinks at |x| = 0.25, 0.55, 0.85."""
    far = np.abs(x)
    beyond = [np.maximum(far - kink, 0.0) for kink in (0.25, 0.55, 0.85)]
    return np.sign(x) * (0.1 * far + 0.5 * beyond[0] + beyond[1] + 1.4 * beyond[2])


@_beside("quadratic_stiffness", "log", 3.0, is_signed=True)
def _even_log(x, q, p, point):
    """log(1 + (x/0.4)²)/2."""
    return 0.5 * np.log1p((x / 0.4) ** 2)


@_beside("quadratic_stiffness", "square and cube", 3.0, is_signed=True)
def _square_and_cube(x, q, p, point):
    """0.6 x² + 0.4 |x|³."""
    return 0.6 * x**2 + 0.4 * np.abs(x) ** 3


@_beside("quadratic_stiffness", "table with kinks", 3.0, is_signed=True)
def _even_table(x, q, p, point):
    """Even, zero up to |x| = 0.15, then slopes 0.5 and from 0.6 on 1.5."""
    far = np.abs(x)
    return 0.5 * np.maximum(far - 0.15, 0.0) + np.maximum(far - 0.6, 0.0)


# ---- contact ----------------------------------------------------------------------------------------------------------

CLEARANCE = {"draws": {"clearance": (0.3, 0.55)}}


@_beside("contact_stiffening", "two stops", 50.0, **CLEARANCE)
def _two_stops(x, q, p, point):
    """A soft stop at c and one three times as stiff at 1.4 c."""
    far, c = np.abs(x), p["clearance"]
    return np.sign(x) * (np.maximum(far - c, 0.0) + 3 * np.maximum(far - 1.4 * c, 0.0))


@_beside("contact_stiffening", "with damping", 50.0, **CLEARANCE)
def _damped_stop(x, q, p, point):
    """Pounding with restitution (Hunt & Crossley): y^1.5 (1 + 0.3 ẏ/v_c) behind the clearance."""
    return np.sign(x) * np.maximum(np.abs(x) - p["clearance"], 0.0) ** 1.5 * (1 + 0.3 * np.tanh(np.sign(x) * q))


@_beside("contact_stiffening", "crushing stops", 50.0, **CLEARANCE)
def _crushing_stops(x, q, p, point):
    """Each stop keeps 30 % of the deepest dent as additional clearance; rounded, y²/(y + 0.05)."""
    reached = np.where(x > 0, point.high, point.low) / point.scales.elongation
    moved = p["clearance"] + 0.3 * np.maximum(reached - p["clearance"], 0.0)
    beyond = np.maximum(np.abs(x) - moved, 0.0)
    return np.sign(x) * beyond**2 / (beyond + 0.05)


def _slack(x, s, width, centre=0.0):
    """No spring within ± width of the centre, both in u_c; it opens and closes over a tenth of the width."""
    beyond = np.abs(x.u / x.scales.elongation - centre) / np.maximum(width, 1e-9) - 1
    closed = np.where(width > 0, sigmoid(beyond / 0.1), 1.0)
    s.share, s.h = s.share * closed, s.h * closed


def _gap_that_wears(x, s, p):
    """The slack grows from 0.6 to 1 of its width with energy: 0.6 + 0.4 x/(x + 0.3)."""
    _slack(x, s, p["delta"] * (0.6 + 0.4 * energy(x) / (energy(x) + 0.3)))


def _gap_off_centre(x, s, p):
    """A slack from −0.85 δ to 1.15 δ."""
    _slack(x, s, p["delta"], 0.15 * p["delta"])


def _gap_rational(x, s, p):
    """The spring is engaged by u⁶/(u⁶ + (δ u_c)⁶), and never less than 5 %."""
    power, width = x.u**6, (p["delta"] * x.scales.elongation) ** 6
    closed = np.where(width > 0, (power + 0.05 * width) / np.maximum(power + width, 1e-300), 1.0)
    s.share, s.h = s.share * closed, s.h * closed


add("gap", "growing with energy", _gap_that_wears, 0.8)
add("gap", "off centre", _gap_off_centre, 0.6)
add("gap", "rational", _gap_rational, 0.8)

# ---- damping ----------------------------------------------------------------------------------------------------------


@_beside("viscous_damping", "heating with energy", 20.0)
def _heating_dashpot(x, q, p, point):
    """q (0.6 + 0.4/(1 + 2e/E_c)): oil that gets thinner."""
    return q * (0.6 + 0.4 / (1 + 2 * energy(point)))


@_beside("viscous_damping", "varying with stroke", 20.0)
def _stroke_dashpot(x, q, p, point):
    """q (0.75 + 0.5 x²/(x² + 0.3))."""
    return q * (0.75 + 0.5 * x**2 / (x**2 + 0.3))


@_beside("viscous_damping", "Eyring", 20.0)
def _eyring(x, q, p, point):
    """arsinh(0.8 q)/arsinh(0.8): oil that thins."""
    return np.arcsinh(0.8 * q) / np.arcsinh(0.8)


@_beside("quadratic_damping", "laminar to turbulent", 20.0)
def _turbulent(x, q, p, point):
    """q|q|·|q|/(0.2 + |q|): square from a fifth of v_c on."""
    return q * np.abs(q) * np.abs(q) / (0.2 + np.abs(q))


@_beside("quadratic_damping", "relief valve", 20.0)
def _relieved(x, q, p, point):
    """q|q| up to 0.8, beyond it straight with the slope 1.2."""
    speed = np.abs(q)
    return np.sign(q) * np.where(speed < 0.8, speed**2, 0.64 + 1.2 * (speed - 0.8))


@_beside("quadratic_damping", "varying with stroke", 20.0)
def _orifice_of_stroke(x, q, p, point):
    """q|q| (0.7 + 0.6 |x|/(|x| + 0.5)): a metering pin."""
    return q * np.abs(q) * (0.7 + 0.6 * np.abs(x) / (np.abs(x) + 0.5))


@_beside("power_damping", "two powers", 5.0)
def _two_powers(x, q, p, point):
    """(|q|^0.25 + |q|^0.75)/2, rounded at rest."""
    return 0.5 * (_rounded(q, 0.25) + _rounded(q, 0.75))


@_beside("power_damping", "relief valve", 5.0)
def _valve(x, q, p, point):
    """Slope 2.5 up to 0.2 v_c, then 0.6: a dashpot whose valve opens."""
    return np.sign(q) * np.minimum(2.5 * np.abs(q), 0.5 + 0.6 * (np.abs(q) - 0.2))


@_beside("power_damping", "orifice and capillary", 5.0)
def _orifice_and_capillary(x, q, p, point):
    """The F ≥ 0 of |q| = 0.15 F + 0.85 F²: laminar and turbulent losses in series."""
    return np.sign(q) * (np.sqrt(0.15**2 + 4 * 0.85 * np.abs(q)) - 0.15) / (2 * 0.85)


# ---- friction ---------------------------------------------------------------------------------------------------------


def _two_bristles(x, s, p):
    """Two bristles of 0.02 u_c and 0.08 u_c with halves of the friction (Iwan; two states)."""
    for row, length in zip(x.w, (0.02, 0.08), strict=True):
        s.rates.append((x.v - np.abs(x.v) * row) / (length * x.scales.elongation))
        s.force = s.force + 0.5 * p["delta"] * x.scales.force * row


add("coulomb_friction", "two bristles", _two_bristles, 3.0, states=2)


@_beside("coulomb_friction", "wedge", 3.0)
def _wedge(x, q, p, point):
    """tanh(q/0.02) (0.85 + 0.3 |x|): the pressure grows to the ends."""
    return np.tanh(q / 0.02) * (0.85 + 0.3 * np.abs(x))


@_beside("coulomb_friction", "polished with the path", 3.0)
def _polished(x, q, p, point):
    """q/√(q² + 0.02²) (0.7 + 0.3/(1 + s/2u_c))."""
    return q / np.hypot(q, 0.02) * (0.7 + 0.3 / (1 + 0.5 * path(point)))


REMAINING = {"draws": {"remaining": (0.2, 0.6)}}


@_beside("stribeck_friction", "rational", 3.0, **REMAINING)
def _stribeck_rational(x, q, p, point):
    """(μ + (1 − μ)/(1 + (q/0.2)²)) tanh(q/0.02)."""
    return (p["remaining"] + (1 - p["remaining"]) / (1 + (q / 0.2) ** 2)) * np.tanh(q / 0.02)


@_beside("stribeck_friction", "table with kinks", 3.0, **REMAINING)
def _stribeck_table(x, q, p, point):
    """Falls from 1 to (1 + μ)/2 at 0.1 v_c, to μ at 0.5 v_c, straight between; tanh(q/0.02) at rest."""
    fallen = 0.5 * np.minimum(np.abs(q) / 0.1, 1.0) + 0.5 * np.clip((np.abs(q) - 0.1) / 0.4, 0.0, 1.0)
    return (1 - (1 - p["remaining"]) * fallen) * np.tanh(q / 0.02)


def _two_falling_bristles(x, s, p):
    """Two bristles of 0.03 u_c and 0.09 u_c, half of the friction each, that bend to μ + (1 − μ)/(1 + q/0.15)² (two states)."""
    bent = p["remaining"] + (1 - p["remaining"]) / (1 + np.abs(x.v) / (0.15 * x.scales.rate)) ** 2
    for row, length in zip(x.w, (0.03, 0.09), strict=True):
        s.rates.append((x.v - np.abs(x.v) * row / bent) / (length * x.scales.elongation))
        s.force = s.force + 0.5 * p["delta"] * x.scales.force * row


add("stribeck_friction", "two bristles", _two_falling_bristles, 3.0, states=2, draws={"remaining": (0.35, 0.6)})

# ---- rate of the hysteretic spring, and relaxation --------------------------------------------------------------------


def _rate(shape: Callable) -> Callable:
    """a = 1 + δ shape(|v|/v_c)."""

    def act(x, s, p):
        s.a = s.a * (1 + p["delta"] * shape(np.abs(x.v) / x.scales.rate))

    act.__doc__ = shape.__doc__
    return act


def _two_regimes(q):
    """log(1 + q/0.05)/10 + max(q − 0.4, 0): little at first, more at high rates, as in codes for impact."""
    return 0.1 * np.log1p(q / 0.05) + np.maximum(q - 0.4, 0.0)


def _rational_rate(q):
    """q²/(q² + 0.3²)."""
    return q**2 / (q**2 + 0.09)


def _two_rates(q):
    """(q + √q)/2, rounded at rest."""
    return 0.5 * (q + np.sqrt(np.hypot(q, 0.01)) - 0.1)


add("rate_dependence", "two regimes", _rate(_two_regimes), 10.0)
add("rate_dependence", "rational", _rate(_rational_rate), 10.0)
add("rate_dependence", "linear and root", _rate(_two_rates), 10.0)


def _maxwell(decay: Callable, shares: tuple[float, ...] = (1.0,)) -> Callable:
    """Springs of share δ F_c/u_c, each in series with something viscous; w is the elongation of a spring over u_c."""

    def act(x, s, p):
        tau = p["tau"] * x.scales.elongation / x.scales.rate
        for number, (row, share) in enumerate(zip(x.w, shares, strict=True)):
            s.rates.append(x.v / x.scales.elongation - decay(row, number) / tau)
            s.force = s.force + p["delta"] * x.scales.force * share * row

    act.__doc__ = decay.__doc__
    return act


def _three_times(w, number):
    """Three Maxwell elements with τ/3, τ, 4τ and shares 0.3, 0.4, 0.3."""
    return w * (3.0, 1.0, 0.25)[number]


def _power_creep(w, number):
    """A dashpot of a power: ẇ = ẋ − 2 w|w|^0.5/τ, rounded at rest."""
    return 2 * w * np.sqrt(np.hypot(w, 1e-3))


def _eyring(w, number):
    """Eyring's dashpot: ẇ = ẋ − 0.15 sinh(w/0.15)/τ."""
    return 0.15 * np.sinh(np.clip(w / 0.15, -8.0, 8.0))


TAU = {"draws": {"tau": (0.4, 1.2)}}
add("relaxation", "three times", _maxwell(_three_times, (0.3, 0.4, 0.3)), 10.0, states=3, **TAU)
add("relaxation", "power-law creep", _maxwell(_power_creep), 10.0, states=1, **TAU)
add("relaxation", "Eyring", _maxwell(_eyring), 10.0, states=1, **TAU)
