r"""A hysteretic specimen, shaken in the paper's structure or pulled in a rig, in NumPy alone.

$$\ddot u = -M^{-1}(C\dot u + K u + b\,r) - a_g,\qquad \Delta u = u_2 - u_1,\qquad \dot z = \frac{g}{1 + c\,g}\Delta\dot u,\qquad
  g = h\,\frac{aA - \nu\,\varphi\,(\beta\,\mathrm{sign}(z\Delta\dot u)+\gamma)}{\eta},\qquad r = s\,z + f$$

with φ = |z| [N] and a = ν = η = h = s = 1, c = γ = f = 0 unless an effect says otherwise.  Everything is an array over *lanes*
(experiments, or experiments × sizes of an effect).  This file shares no code with `hsed_jax`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

MASSES = np.array([8.0e3, 9.0e3])  # kg
SPRINGS = np.array([4.0e5, 1.0e6])  # N/m, mass 1 and mass 2 to the ground
DAMPING_RATIO, REFERENCE_STIFFNESS = 0.05, 5.0e5  # of both modes; specimen [N/m] while C is formed
PULSE_GAMMA, PULSE_NU = 2.0, 0.10
DURATION = 10.0  # s

# Rows of the state: positions and speeds of the masses, then the memory of the specimen, then rows that effects ask for.
U1, U2, V1, V2, Z, ENERGY, HYSTERETIC, PATH, EXTRA = range(9)


class Scales(NamedTuple):
    """Characteristic force [N], elongation [m], elongation rate [m/s], absorbed energy [J]."""

    force: float
    elongation: float
    rate: float
    energy: float


UNIT = Scales(1.0, 1.0, 1.0, 1.0)


class Point:
    """The specimen at one instant, arrays over lanes.

    Attributes:
        u, v: elongation [m] and its rate [m/s].
        z: hysteretic force [N].
        energy: total work ∫ r du [J].
        hysteretic: work of the hysteretic force ∫ z du [J].
        path: length of the path of u [m].
        high, low: largest u and largest −u so far [m].
        A, beta: parameters of the specimen.
        scales: characteristic values.
        w: the extra states of the effect that is asked, shape (k, lanes).
    """

    __slots__ = ("A", "beta", "energy", "high", "hysteretic", "low", "path", "scales", "u", "v", "w", "z")

    @property
    def peak(self):
        """Largest |u| so far [m]."""
        return np.maximum(self.high, self.low)

    @property
    def strength(self):
        """A/β [N]."""
        return self.A / self.beta


class Slots:
    """Where effects write: see the equation at the top; `rates` are the derivatives of extra states."""

    __slots__ = ("a", "beta", "compliance", "eta", "force", "gamma", "h", "nu", "phi", "rates", "share")

    def __init__(self):
        self.a = self.nu = self.eta = self.h = self.share = self.beta = 1.0
        self.gamma = self.compliance = self.force = 0.0
        self.phi, self.rates = None, []


Act = Callable[[Point, Slots, dict[str, np.ndarray]], None]


@dataclass
class Specimen:
    """Parameters per lane, and the effects as (function, parameters, number of extra states)."""

    A: np.ndarray
    beta: np.ndarray
    scales: Scales = UNIT
    acts: list[tuple[Act, dict[str, np.ndarray], int]] = field(default_factory=list)

    @property
    def rows(self) -> int:
        """Number of states."""
        return EXTRA + sum(count for *_, count in self.acts)

    def __call__(self, u, v, state, reach) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Force r [N], slope dz/du [N/m] (before the product with v), and the derivatives of the extra states.

        `reach` is the largest u and the largest −u so far [m], zero at least, shape (2, lanes).
        """
        x, s = Point(), Slots()
        x.u, x.v, x.z = u, v, state[Z]
        x.high, x.low = np.maximum(reach[0], u), np.maximum(reach[1], -u)
        x.energy, x.hysteretic, x.path = state[ENERGY], state[HYSTERETIC], state[PATH]
        x.A, x.beta, x.scales = self.A, self.beta, self.scales
        row = EXTRA
        for act, parameters, count in self.acts:
            x.w = state[row : row + count]
            act(x, s, parameters)
            row += count
        phi = np.abs(x.z) if s.phi is None else s.phi
        slope = s.h * (s.a * x.A - s.nu * x.beta * phi * (s.beta * np.sign(x.z * v) + s.gamma)) / s.eta
        slope = slope / (1 + s.compliance * slope)
        return s.share * x.z + s.force, slope, s.rates


def pulse(time, V_P, T_P) -> np.ndarray:
    """Ground acceleration [m/s²] of the near-fault pulse (the paper's Eqs. 16-17, differentiated), started at t = 0."""
    turn = PULSE_GAMMA * np.pi
    residual = V_P * T_P * (np.sin(PULSE_NU + turn) - np.sin(PULSE_NU - turn)) / (4 * np.pi * (1 - PULSE_GAMMA**2))
    since = time - 0.5 * PULSE_GAMMA * T_P
    fast, slow = 2 * np.pi / T_P, 2 * np.pi / (PULSE_GAMMA * T_P)
    carrier, envelope = fast * since + PULSE_NU, slow * since
    bracket = 0.5 * V_P * np.cos(carrier) - residual / (PULSE_GAMMA * T_P)
    rate = -0.5 * V_P * fast * np.sin(carrier) * (1 + np.cos(envelope)) - bracket * slow * np.sin(envelope)
    return np.where(np.abs(since) <= 0.5 * PULSE_GAMMA * T_P, rate, 0.0)


def modal_damping(specimen_stiffness: float = REFERENCE_STIFFNESS) -> np.ndarray:
    """C = 2ζ M √(M⁻¹K) [N·s/m], shape (2, 2), by the closed form of a 2×2 square root."""
    k = specimen_stiffness
    x = np.array([[SPRINGS[0] + k, -k], [-k, SPRINGS[1] + k]]) / MASSES[:, None]
    root = np.sqrt(np.linalg.det(x))
    return 2 * DAMPING_RATIO * MASSES[:, None] * (x + root * np.eye(2)) / np.sqrt(np.trace(x) + 2 * root)


@dataclass
class Frame:
    """The two masses: masses, springs and damping per lane, and the factor on the ground motion."""

    m1: np.ndarray | float = MASSES[0]
    m2: np.ndarray | float = MASSES[1]
    k1: np.ndarray | float = SPRINGS[0]
    k2: np.ndarray | float = SPRINGS[1]
    c11: np.ndarray | float = 0.0
    c12: np.ndarray | float = 0.0
    c22: np.ndarray | float = 0.0
    gain: np.ndarray | float = 1.0

    @classmethod
    def nominal(cls) -> "Frame":
        """The paper's."""
        c = modal_damping()
        return cls(c11=c[0, 0], c12=c[0, 1], c22=c[1, 1])


@dataclass
class Run:
    """Histories on the grid of the integration: time (steps+1,) [s], the others (steps+1, lanes), SI."""

    time: np.ndarray
    u: np.ndarray
    v: np.ndarray
    force: np.ndarray
    energy: np.ndarray


def shaken_rates(specimen: Specimen, frame: Frame):
    """The right-hand side (state, ground acceleration, reach) -> rates, and the force as function of the same."""

    def rates(state, ground, reach):
        out = np.empty_like(state)
        p, q, v1, v2 = state[U1], state[U2], state[V1], state[V2]
        v = v2 - v1
        r, slope, more = specimen(q - p, v, state, reach)
        ground = frame.gain * ground
        out[U1], out[U2] = v1, v2
        out[V1] = (r - frame.c11 * v1 - frame.c12 * v2 - frame.k1 * p) / frame.m1 - ground
        out[V2] = (-r - frame.c12 * v1 - frame.c22 * v2 - frame.k2 * q) / frame.m2 - ground
        _memory(out, state, v, r, slope, more)
        return out

    return rates


def driven_rates(specimen: Specimen):
    """The right-hand side (state, (u, v), reach) -> rates of the specimen alone."""

    def rates(state, imposed, reach):
        out = np.zeros_like(state)
        u, v = imposed
        r, slope, more = specimen(u, v, state, reach)
        _memory(out, state, v, r, slope, more)
        return out

    return rates


def _memory(out, state, v, r, slope, more):
    out[Z] = slope * v
    out[ENERGY] = r * v
    out[HYSTERETIC] = state[Z] * v
    out[PATH] = np.abs(v)
    for i, rate in enumerate(more):
        out[EXTRA + i] = rate


def shake(specimen: Specimen, frame: Frame, V_P, T_P, step: float = 1e-3, duration: float = DURATION) -> Run:
    """The specimen in the structure under the pulses (arrays over lanes), by classical RK4."""
    steps = round(duration / step)
    half = 0.5 * step * np.arange(2 * steps + 1)
    ground = pulse(half[:, None], V_P, T_P)
    rates = shaken_rates(specimen, frame)
    return _integrate(rates, specimen, ground, step, steps, lambda y, _: (y[U2] - y[U1], y[V2] - y[V1]))


def pull(specimen: Specimen, program, step: float = 1e-3, duration: float = DURATION) -> Run:
    """The specimen alone under `program(time (n, 1)) -> (u, v)`, each (n, lanes)."""
    steps = round(duration / step)
    half = 0.5 * step * np.arange(2 * steps + 1)
    imposed = np.stack(program(half[:, None]), axis=1)
    return _integrate(driven_rates(specimen), specimen, imposed, step, steps, lambda _, sample: tuple(sample))


def _integrate(rates, specimen, samples, step, steps, kinematics) -> Run:
    lanes = specimen.A.size
    state, reach = np.zeros((specimen.rows, lanes)), np.zeros((2, lanes))
    kept = np.empty((4, steps + 1, lanes))
    with np.errstate(all="ignore"):
        for i in range(steps + 1):
            u, v = kinematics(state, samples[2 * i])
            reach = np.maximum(reach, [u, -u])
            kept[:, i] = u, v, specimen(u, v, state, reach)[0], state[ENERGY]
            if i == steps:
                break
            first, middle, last = samples[2 * i : 2 * i + 3]
            a = rates(state, first, reach)
            b = rates(state + 0.5 * step * a, middle, reach)
            c = rates(state + 0.5 * step * b, middle, reach)
            d = rates(state + step * c, last, reach)
            state = state + step / 6 * (a + 2 * (b + c) + d)
    return Run(step * np.arange(steps + 1), *kept)
