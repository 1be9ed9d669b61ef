r"""The influence of one effect in a fitted specimen: the specimen with it minus the same specimen without it.

The difference of the forces, ΔF, may be a function of the elongation alone, or of the rate alone.  Each is the share of its
square that means over classes of equal elongation, or of equal rate, explain (the correlation ratio, a first-order Sobol' index):

$$\eta_x^2 = 1 - \frac{\sum(\Delta F - \overline{\Delta F}(x))^2}{\sum \Delta F^2} .$$

Otherwise the effect changes the hysteresis. Then quantities of the loops differ. Their driver is the one along which a
history is predicted best from its neighbours (predictivity, one minus the relative squared error).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.behaviour.histories import Histories
from hsed_jax.behaviour.probes import Probed

# Classes of equal elongation.
_CLASSES = 40


class Curve(NamedTuple):
    """A force as a function of one variable.

    Attributes:
        share: of ΔF that it explains.
        at: the elongation over the largest one, or the rate over the characteristic one, (m,).
        force: the mean of ΔF there [N], (m,).
    """

    share: float
    at: Float[np.ndarray, " m"]
    force: Float[np.ndarray, " m"]


class Contribution(NamedTuple):
    """The influence of an effect.

    Attributes:
        size: root mean square of ΔF over that of the force.
        elastic, by_rate: ΔF as a function of the elongation, and of the rate.
        changes: of quantities, relative to their values without the effect (ratios: absolute changes), (B,) each; NaN for
            histories that were not simulated.
        drivers: as of `Probed`, of the specimen with the effect.
    """

    size: float
    elastic: Curve
    by_rate: Curve
    changes: dict[str, Float[np.ndarray, " B"]]
    drivers: dict[str, Float[np.ndarray, " B"]]

    def mean(self, *names: str) -> float:
        """The mean change of quantities."""
        values = np.stack([self.changes[name] for name in names])
        return float(np.nanmean(values)) if np.isfinite(values).any() else 0.0


def contribution(
    histories: Histories, force: Float[np.ndarray, "2 B samples"], probed: tuple[Probed, Probed], rate: float
) -> Contribution:
    """The influence of an effect.

    Arguments:
        histories: the imposed ones.
        force: with and without the effect [N].
        probed: the quantities of both.
        rate: characteristic rate of the elongation [m/s].
    """
    u, v = histories.imposed.elongation[:, ::2], histories.imposed.rate[:, ::2] / rate
    weight = np.zeros(u.shape)
    weight[:, 1:] = np.abs(np.diff(u, axis=1))
    is_read = np.isfinite(probed[0].quantities["force+"]) & np.isfinite(probed[1].quantities["force+"])
    weight *= is_read[:, None]
    # During the acceleration of a leg, the rate belongs to no class.
    is_steady = np.pad(np.abs(np.diff(v, axis=1)) < 1e-3 * np.abs(v[:, 1:]), ((0, 0), (1, 1)))
    weight *= is_steady[:, :-1] | is_steady[:, 1:]
    used = weight > 0
    x, rates, w = u[used] / np.abs(u).max(), v[used], weight[used]
    apart = (force[0] - force[1])[used]
    size = np.sqrt(np.sum(w * apart**2) / max(np.sum(w * force[1][used] ** 2), 1e-300))
    return Contribution(
        float(size),
        _curve(x, apart, w, np.linspace(-1, 1, _CLASSES + 1)),
        _curve(rates, apart, w, _edges(rates)),
        _changes(*probed, amplitude=float(histories.imposed.elongation[0, 2 * histories.ends[1]])),
        probed[0].drivers,
    )


def dependence(values: Float[np.ndarray, " B"], drivers: Mapping[str, Float[np.ndarray, " B"]]) -> dict[str, float]:
    """The predictivity of each driver alone, between 0 and 1, the best first."""
    known = np.isfinite(values)
    found = {name: _predictivity(values[known], driver[known]) for name, driver in drivers.items()}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _predictivity(values: np.ndarray, driver: np.ndarray) -> float:
    if len(values) < 4 or not np.ptp(driver) > 0 or not np.ptp(values) > 0:
        return 0.0
    order = np.argsort(driver, kind="stable")
    y, x = values[order], driver[order]
    left, right = x[1:-1] - x[:-2], x[2:] - x[1:-1]
    both = np.where(left + right > 0, left + right, 1.0)
    share = np.where(left + right > 0, left / both, 0.5)
    missed = y[1:-1] - ((1 - share) * y[:-2] + share * y[2:])
    return max(1 - float(missed @ missed / np.sum((y[1:-1] - y.mean()) ** 2)), 0.0)


def _changes(own: Probed, without: Probed, amplitude: float) -> dict[str, np.ndarray]:
    scales = {"force": np.nanmean(np.abs(without.quantities["force+"])), "play": amplitude}
    found = {}
    for name, values in own.quantities.items():
        before, kind = without.quantities[name], name.rstrip("+-").rsplit("_", 1)[-1]
        scale = np.nanmean(np.abs(before)) if kind == "stiffness" else scales.get(kind, 1.0)
        found[name] = (values - before) / max(scale, 1e-300)
    return found


def _curve(x: np.ndarray, apart: np.ndarray, weight: np.ndarray, edges: np.ndarray) -> Curve:
    place = np.clip(np.searchsorted(edges, x) - 1, 0, len(edges) - 2)
    there = np.bincount(place, weight, len(edges) - 1)
    mean = np.bincount(place, weight * apart, len(edges) - 1) / np.where(there > 0, there, 1.0)
    left = np.sum(weight * (apart - mean[place]) ** 2)
    kept = there > 0
    middle = np.bincount(place, weight * x, len(edges) - 1)[kept] / there[kept]
    return Curve(float(1 - left / max(np.sum(weight * apart**2), 1e-300)), middle, mean[kept])


def _edges(rates: np.ndarray) -> np.ndarray:
    """Between different rates: legs have few."""
    values = np.unique(np.round(rates, 6))
    return np.concatenate([values - 5e-7, values[-1:] + 5e-7])
