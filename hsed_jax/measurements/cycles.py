r"""Engineering measures of the cycles of a measured loop.

For cycle i with the largest elongation $u_i^+$ and the smallest $u_i^-$, and the forces $F_i^\pm$ there:

* the energy it absorbs, $E_i = \oint F\,\mathrm du$, and the sum of these;
* its secant stiffness from peak to peak, $k_i = (F_i^+ - F_i^-)/(u_i^+ - u_i^-)$ (the effective stiffness of ASCE/SEI 41);
* its equivalent viscous damping, $\zeta_i = E_i / (2\pi k_i u_i^2)$ with $u_i = (u_i^+ - u_i^-)/2$ (Jacobsen 1930);
* the residual elongation $u_{0,i}^\pm$, at which the force is zero after the unloading from $u_i^\pm$;
* the unloading stiffness, the slope from 80 to 20 % of $F_i^\pm$ after the peak;
* the reloading stiffness, from the last zero of the force before the peak to the peak;
* the strength loss, $1 - F_i^\pm/F_1^\pm$ against the first of consecutive cycles of one amplitude (EN 12512).

If a specimen unloads steeply, the force at the sample of a reversal has already fallen.  So $F_i^\pm$ is the largest force
towards that side among the samples within the noise of the peak and the two samples before the peak.  A peak is a reversal: a
record that begins beyond all later values of its cycle has no peak there.

The cycles are those of the measured elongation (`hsed_jax.measurements.turns`); a prediction is read over the same samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hsed_jax.measurements.noise import noise_estimate
from hsed_jax.measurements.turns import Span, spans
from hsed_jax.physics.outputs import absorbed_energy
from hsed_jax.tables import Table, Tabular, cell

SIDES = (-1.0, 1.0)
"""Rows of the arrays with a value for either side of a cycle."""

# Samples that count as a peak: within so many times the noise, between these shares of the range of the cycle; and a few before.
_NOISE, _NEAR, _BEFORE = 3.0, (0.0005, 0.005), 2
# A peak is reached from further away than this share of its size.
_REACHED = 0.05
# Consecutive cycles whose amplitudes differ by less than this share have one amplitude.
_SAME = 0.05
# A cycle returns more energy than it received if its energy is below zero by this share of the rectangle around it.
_RETURNED = 0.02
# Standard deviations of its noise that an energy does not exceed by chance.
_SURPRISE = 4.0
# The unloading stiffness is the slope between these shares of the force at the peak.
_UNLOADING = (0.8, 0.2)


@dataclass(frozen=True, repr=False)
class Cycles(Tabular):
    """The cycles of one loop, SI; c cycles, and two rows where there is a value for either side, the negative one first.

    Attributes:
        begin, end: first sample of each cycle, and the one after its last, (c,).
        is_whole: whether a cycle begins and ends in the record, with a peak on either side, (c,).
        elongation, force: at the peaks [m], [N], (2, c); NaN where a cycle has no peak.
        at: sample of each peak, (2, c).
        energy: absorbed in each cycle [J], (c,); for an incomplete cycle, the part in the record.
        secant_stiffness: from peak to peak [N/m], (c,); NaN of a cycle that is not whole.
        damping: equivalent viscous damping ratio [1], (c,); NaN of a cycle that is not whole.
        unloading_stiffness, reloading_stiffness: [N/m], (2, c); infinite where the force falls at one elongation.
        residual: elongation at zero force after each peak [m], (2, c).
        strength_loss: against the first of consecutive cycles of one amplitude [1], (2, c); 0 of that one, NaN where its force is
            not towards its side.
        group: number of the amplitude that each cycle belongs to, from 0, (c,).
    """

    begin: np.ndarray
    end: np.ndarray
    is_whole: np.ndarray
    elongation: np.ndarray
    force: np.ndarray
    at: np.ndarray
    energy: np.ndarray
    secant_stiffness: np.ndarray
    damping: np.ndarray
    unloading_stiffness: np.ndarray
    reloading_stiffness: np.ndarray
    residual: np.ndarray
    strength_loss: np.ndarray
    group: np.ndarray

    def __len__(self) -> int:
        """Return the number of cycles."""
        return self.begin.size

    @property
    def cumulative_energy(self) -> np.ndarray:
        """Energy absorbed until the end of each cycle [J], (c,)."""
        return np.cumsum(self.energy)

    @property
    def amplitude(self) -> np.ndarray:
        """The larger elongation of both sides [m], (c,); NaN without a peak."""
        return np.fmax(*np.abs(self.elongation))

    def _table(self) -> Table:
        heads = ("cycle", "u- [m]", "u+ [m]", "F- [N]", "F+ [N]", "energy [J]", "damping", "secant [N/m]")
        columns = [*self.elongation, *self.force, self.energy, self.damping, self.secant_stiffness]
        rows = [
            [f"{number + 1}{'' if self.is_whole[number] else ' (part)'}", *(cell(c[number], ".4g") for c in columns)]
            for number in range(len(self))
        ]
        total = cell(float(self.energy.sum()), ".4g")
        return Table(f"{len(self)} cycles, {int(self.is_whole.sum())} of them whole, absorb {total} J", heads, rows)


def cycles_of(force, elongation, along=None) -> Cycles:
    """Read the cycles of a loop.

    Arguments:
        force: [N], (m,).
        elongation: [m], (m,).
        along: The elongation whose cycles they are [m], (m,); by default `elongation`.  A prediction is evaluated over the
            cycles of the measurement.

    Returns:
        The measures of each cycle.  Slips, holds and missing rows do not make a cycle; a record that begins in the
        middle of a cycle has its first one there (`hsed_jax.measurements.turns.spans`).

    Raises:
        ValueError: The arrays differ in length, or a number is not finite.

    Example:
        >>> elongation = 0.01 * np.sin(np.linspace(0, 6 * np.pi, 301))
        >>> cycles = hx.cycles_of(2e6 * elongation, elongation)
        >>> len(cycles)
        3
    """
    force, elongation = np.asarray(force, dtype=float), np.asarray(elongation, dtype=float)
    along = elongation if along is None else np.asarray(along, dtype=float)
    if not force.shape == elongation.shape == along.shape or force.ndim != 1:
        raise ValueError(
            f"force, elongation and along have the shapes {force.shape}, {elongation.shape}, {along.shape}"
        )
    if not (np.isfinite(force).all() and np.isfinite(elongation).all() and np.isfinite(along).all()):
        raise ValueError("force and elongation must be finite numbers; leave out the samples that are not")
    found = spans(along)
    begin, end, is_whole, is_fragment, is_about_zero = (np.asarray(column) for column in zip(*found, strict=True))
    at = _peaks(elongation, found)
    is_peak = _is_reversal(elongation, at) & (_is_on_its_side(elongation, at) | ~is_about_zero) & ~is_fragment
    near = _nearness(elongation)
    at_peak = np.asarray([[_force(force, elongation, span, a, side, near) for span, a in zip(found, row.tolist(), strict=True)]
                          for side, row in zip(SIDES, at, strict=True)])  # fmt: skip
    is_whole = is_whole & is_peak.all(axis=0)
    peaks, forces = np.where(is_peak, elongation[at], np.nan), np.where(is_peak, at_peak, np.nan)
    energy = np.asarray([*np.add.reduceat(np.diff(absorbed_energy(force, elongation), prepend=0.0), begin)])
    (rise,), (swing,) = np.diff(forces, axis=0), np.diff(peaks, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        secant = np.where(is_whole, rise / swing, np.nan)
        damping = np.where(is_whole, energy / (0.5 * np.pi * rise * swing), np.nan)
    unloading, reloading, residual = _slopes(force, elongation, at, forces, is_peak)
    group = _groups(np.fmax(*np.abs(peaks)))
    return Cycles(begin, end, is_whole, peaks, forces, at, energy, secant, damping, unloading, reloading, residual,
                  _strength_loss(forces, group), group)  # fmt: skip


def returned(cycles: Cycles, elongation: np.ndarray, force: np.ndarray) -> list[int]:
    """Numbers, from 1, of the whole cycles that return more energy than they received, which no specimen does.

    The noise of the samples gives a cycle an energy of either sign; an energy within this noise is not a doubt.

    Arguments:
        cycles: of the loop.
        elongation, force: of the loop [m], [N], (m,).
    """
    (swing,) = np.diff(cycles.elongation, axis=0)
    parts = [slice(a, b) for a, b in zip(cycles.begin, cycles.end, strict=True)]
    ranges = np.asarray([np.ptp(force[part]) for part in parts])
    least = _RETURNED * np.where(cycles.is_whole, swing, 0.0) * ranges
    samples = np.arange(len(force), dtype=float)
    noise = [float(np.nan_to_num(noise_estimate(samples, channel))) for channel in (elongation, force)]
    chance = _SURPRISE * np.asarray([_energy_of_noise(elongation[part], force[part], *noise) for part in parts])
    is_negative = cycles.is_whole & (cycles.energy < -np.maximum(least, chance))
    # The last cycle may end before it has absorbed energy.
    return [int(i) + 1 for i in np.flatnonzero(is_negative[:-1])]


def _energy_of_noise(elongation: np.ndarray, force: np.ndarray, of_elongation: float, of_force: float) -> float:
    """Standard deviation of the energy of a cycle from the noise of both channels: of each on the steps of the other."""
    steps = [np.sum(np.gradient(channel) ** 2) if len(channel) > 1 else 0.0 for channel in (elongation, force)]
    return float(np.sqrt(of_force**2 * steps[0] + of_elongation**2 * steps[1]))


def _peaks(elongation: np.ndarray, found: Sequence[Span]) -> np.ndarray:
    """Samples of the smallest and the largest elongation of each cycle, (2, c)."""
    return np.asarray(
        [[span.begin + int(np.argmax(side * elongation[span.begin : span.end])) for span in found] for side in SIDES]
    )


def _is_reversal(elongation: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Whether the elongation reaches each peak from a smaller magnitude, (2, c)."""
    reached = elongation[at]
    furthest = np.maximum(
        reached - np.minimum.accumulate(elongation)[at], np.maximum.accumulate(elongation)[at] - reached
    )
    return furthest > _REACHED * np.abs(reached)


def _is_on_its_side(elongation: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Whether each peak lies on its own side of zero, (2, c)."""
    low, high = elongation[at]
    least = 0.02 * np.maximum(np.abs(low), np.abs(high))
    return np.stack([low < -least, high > least])


def _nearness(elongation: np.ndarray) -> float:
    """Distance by which the noise shifts a peak [m]."""
    return _NOISE * noise_estimate(np.arange(elongation.size), elongation) if elongation.size >= 8 else 0.0


def _force(force: np.ndarray, elongation: np.ndarray, span: Span, at: int, side: float, near: float) -> float:
    """The largest force towards a side near the peak there."""
    part = slice(span.begin, span.end)
    reach = float(np.ptp(elongation[part]))
    is_near = side * elongation[part] >= side * elongation[at] - np.clip(near, _NEAR[0] * reach, _NEAR[1] * reach)
    top = at - span.begin
    is_near[max(top - _BEFORE, 0) : top + 1] = True
    return side * float(np.max(side * force[part][is_near]))


def _slopes(
    force: np.ndarray, elongation: np.ndarray, at: np.ndarray, forces: np.ndarray, is_peak: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unloading stiffness, reloading stiffness and residual elongation of each peak, (2, c) each."""
    unloading, reloading, residual = (np.full(at.shape, np.nan) for _ in range(3))
    order = np.sort(at[is_peak])
    for row, cycle in np.argwhere(is_peak):
        top, peak = int(at[row, cycle]), float(forces[row, cycle])
        side = 1.0 if peak > 0 else -1.0
        place = int(np.searchsorted(order, top))
        before = int(order[place - 1]) if place else 0
        after = int(order[place + 1]) if place + 1 < order.size else force.size - 1
        # The unloading path passes the share where it is above it for the last time.
        down = slice(top, after + 1)
        high, low, zero = (
            _crossing(side * force[down], elongation[down], share * abs(peak)) for share in (*_UNLOADING, 0.0)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = np.divide(side * (_UNLOADING[0] - _UNLOADING[1]) * abs(peak), high - low)
        # An unloading path with a growing elongation is noise.
        unloading[row, cycle] = slope if slope > 0 else np.nan
        residual[row, cycle] = zero
        up = slice(before, top + 1)
        begin = _crossing(side * force[up][::-1], elongation[up][::-1], 0.0)
        if np.isnan(begin) and before == 0:
            begin = float(elongation[0])  # it starts from rest
        with np.errstate(divide="ignore", invalid="ignore"):
            reloading[row, cycle] = np.divide(peak, elongation[top] - begin)
    return unloading, reloading, residual


def _crossing(force: np.ndarray, elongation: np.ndarray, level: float) -> float:
    """Elongation at which a force that starts above a level first falls to it; NaN if it does not."""
    below = np.flatnonzero(force <= level)
    if not below.size:
        return float("nan")
    i = int(below[0])
    if i == 0:
        return float(elongation[0])
    share = (force[i - 1] - level) / (force[i - 1] - force[i])
    return float(elongation[i - 1] + share * (elongation[i] - elongation[i - 1]))


def _groups(amplitude: np.ndarray) -> np.ndarray:
    """Number of the amplitude of each cycle: consecutive cycles that differ little share one."""
    group, first, numbers = -1, np.nan, []
    for value in amplitude:
        if not abs(value - first) <= _SAME * first:
            group, first = group + 1, value
        numbers.append(group)
    return np.asarray(numbers)


def _strength_loss(forces: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Loss against the first cycle of the same amplitude, (2, c)."""
    first = forces[:, np.searchsorted(group, group)]
    towards = first * np.asarray(SIDES)[:, None] > 0
    return np.where(towards, 1 - forces / np.where(towards, first, 1.0), np.nan)
