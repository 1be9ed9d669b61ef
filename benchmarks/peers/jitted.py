"""The numba peer: the same method as a loop over simulations, as a careful user of numba would write it."""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from case import GAMMA, NU, Numbers

NOTE = "numba is not installed, so it was not measured"


def compiled() -> Callable[..., np.ndarray] | None:
    """`simulate(numbers, V_P, T_P, A, beta, eta)` to quantities (n, 3), by numba; None where it is not installed."""
    if find_spec("numba") is None:
        return None
    import numba

    inlined = numba.njit(inline="always", fastmath=True)

    @inlined
    def rates(u1, u2, v1, v2, z, e, ground, a, beta, eta, m):
        v = v2 - v1
        return (
            (z - m[4] * v1 - m[5] * v2 - m[2] * u1) * m[0] - ground,
            (-z - m[6] * v1 - m[7] * v2 - m[3] * u2) * m[1] - ground,
            (a * v - beta * abs(v) * z) / (1 + eta * e),
            z * v,
        )

    @inlined
    def ground_at(t, v_p, t_p, offset):
        if t > GAMMA * t_p:
            return 0.0
        p = 2 * np.pi / t_p
        q, s = p / GAMMA, t - 0.5 * GAMMA * t_p
        wave, envelope = p * s + NU, q * s
        one = -0.5 * v_p * p * np.sin(wave) * (1 + np.cos(envelope))
        return one - (0.5 * v_p * np.cos(wave) - offset) * q * np.sin(envelope)

    @numba.njit(fastmath=True)
    def run(all_v_p, all_t_p, all_a, all_beta, eta, m, h, steps):
        out = np.empty((len(all_v_p), 3))
        sines = np.sin(NU + GAMMA * np.pi) - np.sin(NU - GAMMA * np.pi)
        for i in range(len(all_v_p)):
            v_p, t_p, a, beta = all_v_p[i], all_t_p[i], all_a[i], all_beta[i]
            offset = v_p * sines / (4 * np.pi * (1 - GAMMA**2) * GAMMA)
            u1 = u2 = v1 = v2 = z = e = g1 = force = elongation = 0.0
            for k in range(steps):
                g0, gm = g1, ground_at((k + 0.5) * h, v_p, t_p, offset)
                g1 = ground_at((k + 1) * h, v_p, t_p, offset)
                # Suffixes: of the four stages a to d, then n for the end of the step.
                p1a, p2a, za, ea = rates(u1, u2, v1, v2, z, e, g0, a, beta, eta, m)
                q = 0.5 * h
                v1b, v2b = v1 + q * p1a, v2 + q * p2a
                p1b, p2b, zb, eb = rates(
                    u1 + q * v1, u2 + q * v2, v1b, v2b, z + q * za, e + q * ea, gm, a, beta, eta, m
                )
                v1c, v2c = v1 + q * p1b, v2 + q * p2b
                p1c, p2c, zc, ec = rates(
                    u1 + q * v1b, u2 + q * v2b, v1c, v2c, z + q * zb, e + q * eb, gm, a, beta, eta, m
                )
                v1d, v2d = v1 + h * p1c, v2 + h * p2c
                p1d, p2d, zd, ed = rates(
                    u1 + h * v1c, u2 + h * v2c, v1d, v2d, z + h * zc, e + h * ec, g1, a, beta, eta, m
                )
                s = h / 6
                u1n, u2n = u1 + s * (v1 + 2 * (v1b + v1c) + v1d), u2 + s * (v2 + 2 * (v2b + v2c) + v2d)
                v1n, v2n = v1 + s * (p1a + 2 * (p1b + p1c) + p1d), v2 + s * (p2a + 2 * (p2b + p2c) + p2d)
                zn, en = z + s * (za + 2 * (zb + zc) + zd), e + s * (ea + 2 * (eb + ec) + ed)
                r0, r1, d0, d1 = v2 - v1, v2n - v1n, u2 - u1, u2n - u1n
                if r0 * r1 < 0:
                    theta = r0 / (r0 - r1)
                    rest = 1 - theta
                    d = d0 * rest**2 * (1 + 2 * theta) + d1 * theta**2 * (3 - 2 * theta)
                    d += h * theta * rest * (rest * r0 - theta * r1)
                    turn = z + za / r0 * (d - d0)
                    jump = (2.0 if r1 > 0 else -2.0) * beta * turn / (1 + eta * en)
                    simpson = (r0 + (2 * (r0 + r1) if theta > 0.5 else 0.0)) / 6
                    zn += h * jump * (0.5 * r0 * theta - simpson)
                    force, elongation = max(force, abs(turn)), max(elongation, abs(d))
                u1, u2, v1, v2, z, e = u1n, u2n, v1n, v2n, zn, en
            out[i, 0], out[i, 1], out[i, 2] = max(force, abs(z)), max(elongation, abs(u2 - u1)), e
        return out

    def simulate(numbers: Numbers, v_p, t_p, a, beta, eta):
        return run(v_p, t_p, a, beta, eta, numbers.packed, numbers.step, numbers.steps)

    return simulate
