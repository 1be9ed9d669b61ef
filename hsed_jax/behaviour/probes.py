r"""The engineering quantities from the loop of a numerical experiment (`hsed_jax.behaviour.histories`).

Close to a reversal, where the rate changes its sign at one elongation, the force before and the force after are continued to
the reversal.  Half the difference is the force that depends on the rate, for any other behaviour of the specimen:

$$f(v) = \tfrac12\,[F(a^-) - F(a^+)] .$$
"""

import itertools
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
        quantities: by name, SI, (B,) each; those of one side end with its sign.  `force` is that at the ends of the loop; the
            strength is the force at the largest elongation of its side, where the histories go there.
        drivers: the drivers at the first turn of the loop, by name, SI, (B,) each.
    """

    quantities: dict[str, Float[np.ndarray, " B"]]
    drivers: dict[str, Float[np.ndarray, " B"]]


class _Branch(NamedTuple):
    """A leg of every loop where its speed is constant, (B, m) each."""

    elongation: Float[np.ndarray, "B m"]
    force: Float[np.ndarray, "B m"]

    def at(self, elongation: Float[np.ndarray, "B p"]) -> Float[np.ndarray, "B p"]:
        """The force at elongations of each loop [N]."""
        order = np.sign(self.elongation[0, -1] - self.elongation[0, 0]).astype(int)
        rows = zip(elongation, self.elongation[:, ::order], self.force[:, ::order], strict=True)
        return np.stack([np.interp(*row) for row in rows])

    def crossing(self, level: Float[np.ndarray, " B"] | float = 0.0) -> Float[np.ndarray, " B"]:
        """Elongation where the force first passes a level; the end, where it does not [m]."""
        above = self.force - np.reshape(level, (-1, 1))
        changes = np.sign(above[:, 1:]) != np.sign(above[:, :-1])
        row, first = np.arange(len(changes)), changes.argmax(axis=1)
        (u, v), (f, g) = ((values[row, first], values[row, first + 1]) for values in (self.elongation, above))
        passes = changes.any(axis=1)
        return np.where(passes, u - f * (v - u) / np.where(passes, g - f, 1.0), self.elongation[:, -1])

    def slope(self, at: Float[np.ndarray, " B"], reach: Float[np.ndarray, " B"]) -> Float[np.ndarray, " B"]:
        """Least-squares slope of samples within `reach`, of three samples at least [N/m]."""
        near = self._near(at, reach, 3)
        x = np.where(near, self.elongation - self.elongation.mean(axis=1, where=near, keepdims=True), 0.0)
        return (x * self.force).sum(axis=1) / (x * x).sum(axis=1)

    def tangent(self, at: Float[np.ndarray, " B"], reach: Float[np.ndarray, " B"]) -> Float[np.ndarray, " B"]:
        """Slope at an elongation, by a parabola through the samples within `reach` and the nearest samples [N/m]."""
        return self._parabola(at, reach)[1]

    def continued(self, to: Float[np.ndarray, " B"]) -> Float[np.ndarray, " B"]:
        """The force continued to an elongation beyond an end, by a parabola through the nearest samples [N]."""
        return self._parabola(to, np.zeros_like(to))[0]

    def _near(self, at: np.ndarray, reach: np.ndarray, least: int) -> Bool[np.ndarray, "B m"]:
        """The samples that are no farther than `reach`, at least so many."""
        away = np.abs(self.elongation - at[:, None])
        return away <= np.maximum(reach, np.sort(away, axis=1)[:, least - 1])[:, None]

    def _parabola(self, at: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force [N] and slope [N/m] at an elongation."""
        near, x = self._near(at, reach, _NEAREST), self.elongation - at[:, None]
        scale = np.abs(x).max(axis=1, where=near, initial=0.0)
        powers = np.where(near[..., None], (x / scale[:, None])[..., None] ** np.arange(3), 0.0)
        force, slope, _ = np.moveaxis((np.linalg.pinv(powers) @ self.force[..., None])[..., 0], 1, 0)
        return force, slope / scale


def probed(histories: Histories, force: Float[np.ndarray, "B samples"], ok: Bool[np.ndarray, " B"]) -> Probed:
    """Evaluate the loops.

    Arguments:
        histories: the imposed ones.
        force: the response at the start and at the ends of the steps [N], (B, n+1).
        ok: the simulated histories; the quantities of the others are NaN.
    """
    u = histories.imposed.elongation[:, ::2]
    force = np.where(ok[:, None], force, 0.0)
    read = _read(histories.ends, u[ok], force[ok])
    quantities = {name: np.full(len(ok), np.nan) for name in read}
    for name, values in read.items():
        quantities[name][ok] = values
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


def _read(ends: tuple[int, ...], u: np.ndarray, force: np.ndarray) -> dict[str, Float[np.ndarray, " B"]]:
    rise, down, up = (_constant(u, force, *ends[k : k + 2]) for k in range(3))
    a = u[:, ends[1]]
    close = _NEAR * a
    jumps = rise.continued(a) - down.continued(a), up.continued(-a) - down.continued(-a)
    by_rate = 0.25 * (jumps[0] + jumps[1])
    zeros = down.crossing(), up.crossing()
    # Where the force without the part that depends on the rate is zero.
    middles = down.crossing(-by_rate), up.crossing(by_rate)
    peaks = up.force[:, -1], -down.force[:, -1]
    size = 0.5 * (np.abs(peaks[0]) + np.abs(peaks[1]))
    unloading = down.slope(a, close), up.slope(-a, close)
    span = up.force[:, -1] - up.force[:, 0]
    corner = np.divide(span, unloading[1], out=np.full_like(span, np.inf), where=unloading[1] > 0)
    has_corner = corner < 1.9 * a
    at_corner = up.at((np.where(has_corner, corner, 0.0) - a)[:, None])[:, 0]
    middle = np.linspace(-0.9, 0.9, 37) * a[:, None]
    height = up.at(middle) - down.at(middle)
    highest = height.max(axis=1)
    # A specimen that still loses force within the loop may have no closed loop.
    is_loop = (highest > _HEIGHT * size) & (height[:, 18] > -_HEIGHT * size)
    return {
        "initial_stiffness": 0.5 * (down.tangent(middles[0], close) + up.tangent(middles[1], close)),
        "unloading_stiffness+": unloading[0],
        "unloading_stiffness-": unloading[1],
        "reloading_stiffness": 0.5
        * (peaks[1] / np.maximum(middles[0] + a, close) + peaks[0] / np.maximum(a - middles[1], close)),
        "post_yield_stiffness": 0.5 * (down.slope(-a, _LATE * a) + up.slope(a, _LATE * a)),
        "force+": peaks[0],
        "force-": peaks[1],
        "sharpness": np.where(has_corner, (at_corner - up.force[:, 0]) / span, 1.0),
        "pinching_ratio": np.where(is_loop, height[:, 18] / np.where(is_loop, highest, 1.0), np.nan),
        "recentring": 1 - 0.5 * (np.abs(zeros[0]) + np.abs(zeros[1])) / a,
        "play": _play(up, _HEIGHT * size, close),
        "rate_force": by_rate,
        "relaxation": (force[:, ends[3]] - force[:, ends[4]]) / size,
    } | _strength(ends, u, force)


def _strength(ends: tuple[int, ...], u: np.ndarray, force: np.ndarray) -> dict[str, Float[np.ndarray, " B"]]:
    """The force at the largest elongation of either side, where the histories go there, at constant speed like the loop."""
    legs = itertools.pairwise(ends[4:])
    sides = zip(("strength+", "strength-"), (1, -1), legs, strict=False)
    return {name: sign * _constant(u, force, *leg).force[:, -1] for name, sign, leg in sides}


def _play(branch: _Branch, level: np.ndarray, close: np.ndarray) -> Float[np.ndarray, " B"]:
    """Range of the elongation with hardly any force, minus the elongation that the neighbouring stiffness explains [m]."""
    first, last = branch.crossing(-level), branch.crossing(level)
    stiffness = branch.slope(last + 0.5 * close, 0.5 * close)
    rising = stiffness > 0
    return np.where(rising, np.maximum(last - first - 2 * level / np.where(rising, stiffness, 1.0), 0.0), 0.0)


def _constant(u: np.ndarray, force: np.ndarray, first: int, last: int) -> _Branch:
    ramp = (last - first) // 8
    inside = slice(first + ramp, last - ramp + 1)
    return _Branch(u[:, inside], force[:, inside])
