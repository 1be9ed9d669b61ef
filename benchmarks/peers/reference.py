"""A tight reference by other means: SciPy's DOP853, stopped at every kink, peaks read where they stand.

The law has a kink where the rate of the elongation is zero, and both peaks lie there; the pulse ends at γT_P.  Between these
instants everything is smooth, so an error control of 1e-11 means what it says.
"""

import numpy as np
from case import GAMMA, NU, QUANTITIES, Numbers
from scipy.integrate import solve_ivp

_RELATIVE = 1e-11
_ABSOLUTE = np.array([1e-11] * 4 + [1e-5] * 2)  # m, m/s; N, J


def reference(numbers: Numbers, v_p: float, t_p: float, a: float, beta: float, eta: float) -> np.ndarray:
    """Peak force [N], peak elongation [m] and dissipated energy [J]."""
    inverse, (k1, k2), c = 1 / numbers.masses, numbers.springs, numbers.damping
    offset = v_p * (np.sin(NU + GAMMA * np.pi) - np.sin(NU - GAMMA * np.pi)) / (4 * np.pi * (1 - GAMMA**2) * GAMMA)
    carrier = 2 * np.pi / t_p
    envelope = carrier / GAMMA

    def ground(t):
        s = t - GAMMA * t_p / 2
        p, q = carrier * s + NU, envelope * s
        one = -0.5 * v_p * carrier * np.sin(p) * (1 + np.cos(q))
        return one - (0.5 * v_p * np.cos(p) - offset) * envelope * np.sin(q)

    def rates(t, y, direction, forced):
        u1, u2, v1, v2, z, energy = y
        rate = v2 - v1
        magnitude = direction * rate if direction else abs(rate)
        shaking = ground(t) if forced else 0.0
        return (
            v1,
            v2,
            -(c[0, 0] * v1 + c[0, 1] * v2 + k1 * u1 - z) * inverse[0] - shaking,
            -(c[1, 0] * v1 + c[1, 1] * v2 + k2 * u2 + z) * inverse[1] - shaking,
            (a * rate - beta * magnitude * z) / (1 + eta * energy),
            z * rate,
        )

    def reversal(t, y, direction, forced):
        return y[3] - y[2]

    reversal.terminal = True
    end, pulse = numbers.step * numbers.steps, GAMMA * t_p
    t, y, direction = 0.0, np.zeros(6), 0
    force = elongation = 0.0
    while t < end:
        # At rest the direction is not known yet: a first instant without it.
        until = 1e-3 if direction == 0 else pulse if t < pulse else end
        reversal.direction = -direction
        part = solve_ivp(
            rates,
            (t, until),
            y,
            "DOP853",
            rtol=_RELATIVE,
            atol=_ABSOLUTE,
            args=(direction, t < pulse),
            events=reversal if direction else None,
        )
        t, y = part.t[-1], part.y[:, -1]
        force, elongation = max(force, abs(y[4])), max(elongation, abs(y[1] - y[0]))
        direction = -direction if part.status == 1 else direction or (1 if y[3] > y[2] else -1)
    return np.array([force, elongation, y[5]])


def worst(values: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """Largest relative error of the two peaks, and of the energy."""
    error = dict(zip(QUANTITIES, np.max(np.abs(values / exact - 1), axis=0).tolist(), strict=True))
    return {
        "peaks": max(error["peak_force"], error["peak_elongation"]),
        "energy": error["dissipated_energy"],
    }
