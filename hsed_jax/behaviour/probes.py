r"""The engineering quantities from the loop of a numerical experiment (`hsed_jax.behaviour.histories`).

Close to a reversal, where the rate changes its sign at one elongation, the force before and the force after are continued to
the reversal.  Half the difference is the force that depends on the rate, for any other behaviour of the specimen:

$$f(v) = \tfrac12\,[F(a^-) - F(a^+)] .$$
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hsed_jax.behaviour.histories import Histories

# Least height of a loop, and least force, as shares of the force at the peaks.
_HEIGHT = 0.02
# Slopes are taken within these shares of the amplitude.
_NEAR, _LATE = 0.05, 0.3
# Samples for the continuation of a branch: those of the stretch with small steps.
_NEAREST = 4


class Probed(NamedTuple):
    """The quantities of every history.

    Attributes:
        quantities: by name, SI, (B,) each; those of one side end with its sign.
        drivers: the drivers at the first turn of the loop, by name, SI, (B,) each.
    """

    quantities: dict[str, Float[np.ndarray, " B"]]
    drivers: dict[str, Float[np.ndarray, " B"]]


class _Branch(NamedTuple):
    """A leg of the loop where its speed is constant."""

    elongation: np.ndarray
    force: np.ndarray

    def at(self, elongation: float) -> float:
        """The force at an elongation [N]."""
        order = np.sign(self.elongation[-1] - self.elongation[0]).astype(int)
        return float(np.interp(elongation, self.elongation[::order], self.force[::order]))

    def crossing(self, level: float = 0.0) -> float:
        """Elongation where the force first passes a level; the end, where it does not [m]."""
        changes = np.flatnonzero(np.sign(self.force[1:] - level) != np.sign(self.force[:-1] - level))
        if not changes.size:
            return float(self.elongation[-1])
        (u, v), (f, g) = (values[changes[0] : changes[0] + 2] for values in self)
        return float(u + (level - f) * (v - u) / (g - f))

    def slope(self, at: float, reach: float) -> float:
        """Least-squares slope of samples within `reach`, of three samples at least [N/m]."""
        away = np.abs(self.elongation - at)
        near = away <= max(reach, np.sort(away)[2])
        x = self.elongation[near] - self.elongation[near].mean()
        return float(x @ self.force[near] / (x @ x))

    def tangent(self, at: float, reach: float) -> float:
        """Slope at an elongation, by a parabola through the samples within `reach` and the nearest samples [N/m]."""
        return self._parabola(at, reach)[1]

    def continued(self, to: float) -> float:
        """The force continued to an elongation beyond an end, by a parabola through the nearest samples [N]."""
        return self._parabola(to, 0.0)[0]

    def _parabola(self, at: float, reach: float) -> tuple[float, float]:
        """Force [N] and slope [N/m] at an elongation."""
        away = np.abs(self.elongation - at)
        near = away <= max(reach, np.sort(away)[_NEAREST - 1])
        scale = away[near].max()
        force, slope, _ = np.polynomial.polynomial.polyfit((self.elongation[near] - at) / scale, self.force[near], 2)
        return float(force), float(slope / scale)


def probed(histories: Histories, force: Float[np.ndarray, "B samples"], ok: Bool[np.ndarray, " B"]) -> Probed:
    """Evaluate the loops.

    Arguments:
        histories: the imposed ones.
        force: the response at the start and at the ends of the steps [N], (B, n+1).
        ok: the simulated histories; the quantities of the others are NaN.
    """
    u = histories.elongation[:, ::2]
    force = np.where(ok[:, None], force, 0.0)
    rows = [_read(histories, u[k], force[k]) if ok[k] else None for k in range(len(force))]
    names = next(row for row in rows if row is not None)
    quantities = {name: np.asarray([np.nan if row is None else row[name] for row in rows]) for name in names}
    return Probed(quantities, _drivers(histories, u, force))


def _drivers(histories: Histories, u: np.ndarray, force: np.ndarray) -> dict[str, np.ndarray]:
    until = histories.ends[1] + 1
    moved = np.diff(u[:, :until], axis=1)
    work = 0.5 * (force[:, 1:until] + force[:, : until - 1]) * moved
    turns = [np.count_nonzero(np.diff(np.sign(row[row != 0]))) for row in moved]
    return {
        "absorbed_energy": work.sum(axis=1),
        "path": np.abs(moved).sum(axis=1),
        "largest_elongation": np.abs(u[:, :until]).max(axis=1),
        "reversals": np.asarray(turns, dtype=float),
        "rest": histories.rest,
        "rate": histories.speed,
    }


def _read(histories: Histories, u: np.ndarray, force: np.ndarray) -> dict[str, float]:
    ends = histories.ends
    rise, down, up = (_constant(u, force, *ends[k : k + 2]) for k in range(3))
    a = float(u[ends[1]])
    close = _NEAR * a
    jumps = [
        rise.continued(a) - down.continued(a),
        up.continued(-a) - down.continued(-a),
    ]
    zeros = down.crossing(), up.crossing()
    peaks = up.force[-1], -down.force[-1]
    size = 0.5 * (abs(peaks[0]) + abs(peaks[1]))
    unloading = down.slope(a, close), up.slope(-a, close)
    span = up.force[-1] - up.force[0]
    corner = span / unloading[1] if unloading[1] > 0 else np.inf
    height = np.asarray([up.at(x) - down.at(x) for x in np.linspace(-0.9 * a, 0.9 * a, 37)])
    is_loop = height.max() > _HEIGHT * size
    return {
        "initial_stiffness": 0.5 * (down.tangent(zeros[0], close) + up.tangent(zeros[1], close)),
        "unloading_stiffness+": unloading[0],
        "unloading_stiffness-": unloading[1],
        "reloading_stiffness": 0.5 * (peaks[1] / max(zeros[0] + a, close) + peaks[0] / max(a - zeros[1], close)),
        "post_yield_stiffness": 0.5 * (down.slope(-a, _LATE * a) + up.slope(a, _LATE * a)),
        "strength+": float(peaks[0]),
        "strength-": float(peaks[1]),
        "sharpness": (up.at(-a + corner) - up.force[0]) / span if corner < 1.9 * a else 1.0,
        "pinching_ratio": height[len(height) // 2] / height.max() if is_loop else np.nan,
        "recentring": 1 - 0.5 * (abs(zeros[0]) + abs(zeros[1])) / a,
        "play": _play(up, _HEIGHT * size, close),
        "rate_force": 0.25 * sum(jumps),
        "relaxation": (force[ends[3]] - force[ends[4]]) / size,
    }


def _play(branch: _Branch, level: float, close: float) -> float:
    """Range of the elongation with hardly any force, minus the elongation that the neighbouring stiffness explains [m]."""
    first, last = branch.crossing(-level), branch.crossing(level)
    stiffness = branch.slope(last + 0.5 * close, 0.5 * close)
    return max(last - first - 2 * level / stiffness, 0.0) if stiffness > 0 else 0.0


def _constant(u: np.ndarray, force: np.ndarray, first: int, last: int) -> _Branch:
    ramp = (last - first) // 8
    inside = slice(first + ramp, last - ramp + 1)
    return _Branch(u[inside], force[inside])
