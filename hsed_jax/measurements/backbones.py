r"""Backbones of a measured loop, and the idealised curves that design codes derive from them.

A backbone is the line through the largest forces of the excursions that exceed all before (FEMA 461; the envelope of ASTM
E2126).  The *first-cycle* backbone has the first of consecutive cycles of one amplitude, and the *stabilised* one has the last
(the third envelope of ISO 16670).  If the force falls before the peak of the elongation is reached, the peak is a further
point.

With the largest force $P$ and the elongation $\Delta_u$ at which the force has fallen to $0.8 P$ (or the last one):

* `eeep`: elastic to $P_y$, then constant until $\Delta_u$, with the area $A$ of the backbone and the stiffness
  $K_e = 0.4 P/\Delta_{0.4P}$: $P_y = K_e (\Delta_u - \sqrt{\Delta_u^2 - 2A/K_e})$, or $0.85 P$ if there is no root
  (ASTM E2126);
* `bilinear`: to $(\Delta_y, F_y)$ with the secant stiffness at $0.6 F_y$, then straight to the largest force, with the area
  of the backbone to there (ASCE/SEI 41, FEMA 356);
* `asce41`: the yield point of `bilinear`, $a = \Delta_u - \Delta_y$ until the strength is lost,
  $b = \Delta_{end} - \Delta_y$ until the end, and the residual strength $c = F_{end}/F_y$.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hsed_jax.measurements.cycles import SIDES, Cycles
from hsed_jax.tables import Table, Tabular, cell

Which = Literal["first", "stabilised"]

# A new peak of the backbone exceeds the earlier ones by this share.
_FURTHER = 0.02
# The force has fallen before the peak if the largest lies before this share of the elongation there.
_BEFORE = 0.95
_FAILED = 0.8
"""Share of the largest force at which a specimen has failed."""


@dataclass(frozen=True)
class Idealised:
    """An idealised backbone of one direction; magnitudes, SI.

    Attributes:
        yield_elongation, yield_force: where the first line ends [m], [N].
        peak_force: the largest of the backbone [N].
        ultimate_elongation, ultimate_force: where the second line ends [m], [N].
        stiffness: of the first line [N/m].
        failed: whether the force falls to 80 % of the largest in the test; otherwise the ultimate elongation is a lower
            bound.
    """

    yield_elongation: float
    yield_force: float
    peak_force: float
    ultimate_elongation: float
    ultimate_force: float
    stiffness: float
    failed: bool

    @property
    def ductility(self) -> float:
        """Ultimate elongation over yield elongation [1]."""
        return self.ultimate_elongation / self.yield_elongation


@dataclass(frozen=True)
class Component(Idealised):
    """The component backbone of ASCE/SEI 41, figure 7-1: A, B (yield), C (strength lost), E (end).

    Attributes:
        a, b: plastic elongation until the strength is lost, and until the end [m].
        c: residual force over yield force [1].
    """

    a: float
    b: float
    c: float


@dataclass(frozen=True, repr=False)
class Backbone(Tabular):
    """A backbone in both directions, from the smallest elongation to the largest, without the origin.

    Attributes:
        elongation, force: [m], [N], (p,) each.
    """

    elongation: np.ndarray
    force: np.ndarray

    def side(self, sign: float) -> tuple[np.ndarray, np.ndarray]:
        """Magnitudes of elongation [m] and force [N] in one direction, from the origin outwards, (q,) each.

        Arguments:
            sign: 1 or -1.
        """
        own = sign * self.elongation > 0
        order = np.argsort(np.abs(self.elongation[own]), kind="stable")
        return (
            np.concatenate([[0.0], np.abs(self.elongation[own])[order]]),
            np.concatenate([[0.0], (sign * self.force[own])[order]]),
        )

    def eeep(self, sign: float) -> Idealised | None:
        """The equivalent energy elastic-plastic curve of ASTM E2126 in one direction; None without three points."""
        u, f = self.side(sign)
        if not _tells(u, f):
            return None
        end, is_failed = _failure(u, f)
        u, f = _until(u, f, end)
        peak = float(f.max())
        stiffness = 0.4 * peak / _reaches(u, f, 0.4 * peak)
        root = end**2 - 2 * float(np.trapezoid(f, u)) / stiffness
        force = stiffness * (end - np.sqrt(root)) if root > 0 else 0.85 * peak
        return Idealised(force / stiffness, force, peak, end, force, stiffness, is_failed)

    def bilinear(self, sign: float) -> Idealised | None:
        """Two lines to the largest force in one direction, with the backbone's area; None without three points."""
        u, f = self.side(sign)
        if not _tells(u, f):
            return None
        top = u.size - 1 - int(np.argmax(f[::-1]))  # the end of a plateau
        peak, end = float(f[top]), float(u[top])
        area = float(np.trapezoid(f[: top + 1], u[: top + 1]))

        def excess(force: float) -> float:
            """Area below the two lines less that of the backbone."""
            at = _yield_elongation(u, f, force)
            return 0.5 * force * at + 0.5 * (force + peak) * (end - at) - area

        # The area grows with the yield force.  If every force gives that area, the backbone is straight until the largest force.
        low, high, nothing = 0.05 * peak, peak, 1e-12 * peak * end
        while high - low > 1e-12 * peak:
            force = 0.5 * (low + high)
            low, high = (force, high) if excess(force) <= nothing else (low, force)
        force = high
        at = _yield_elongation(u, f, force)
        return Idealised(at, force, peak, end, peak, force / at, _failure(u, f)[1])

    def asce41(self, sign: float) -> Component | None:
        """The a-b-c curve of ASCE/SEI 41 in one direction; None without three points."""
        lines = self.bilinear(sign)
        if lines is None:
            return None
        u, f = self.side(sign)
        lost, is_failed = _failure(u, f)
        at, force = lines.yield_elongation, lines.yield_force
        return Component(
            at, force, lines.peak_force, lost, float(np.interp(lost, u, f)), lines.stiffness, is_failed,
            a=lost - at, b=float(u[-1]) - at, c=float(f[-1]) / force,
        )  # fmt: skip

    def _table(self) -> Table:
        rows = []
        for sign, word in ((1.0, "positive"), (-1.0, "negative")):
            for name in ("eeep", "bilinear", "asce41"):
                one: Idealised | None = getattr(self, name)(sign)
                if one is not None:
                    numbers = (one.yield_elongation, one.yield_force, one.stiffness, one.ultimate_elongation)
                    rows.append([word, name, *(cell(n, ".4g") for n in numbers), cell(one.ductility, ".3g")])
        heads = ("side", "curve", "yield [m]", "yield force [N]", "stiffness [N/m]", "ultimate [m]", "ductility")
        return Table(f"a backbone of {self.elongation.size} points", heads, rows)


def backbone_of(force, elongation, cycles: Cycles, which: Which = "first") -> Backbone:
    """The backbone of a loop.

    Arguments:
        force, elongation: Of the loop [N], [m], (m,) each.
        cycles: Its cycles (`hsed_jax.measurements.cycles.cycles_of`).
        which: `first`: the first of consecutive cycles of one amplitude; `stabilised`: the last, if there are at least
            two.

    Returns:
        The points of both directions; if the elongation stays on one side, those of one direction.

    Example:
        >>> elongation = np.linspace(0.01, 0.03, 301) * np.sin(np.linspace(0, 6 * np.pi, 301))
        >>> force = 2e6 * elongation
        >>> backbone = hx.backbone_of(force, elongation, hx.cycles_of(force, elongation))
        >>> backbone.elongation.size
        6
    """
    force, elongation = np.asarray(force, dtype=float), np.asarray(elongation, dtype=float)
    found: list[tuple[float, float]] = []
    for row, side in enumerate(SIDES):
        size = np.where(np.isnan(cycles.elongation[row]), 0.0, side * cycles.elongation[row])
        before = np.concatenate([[0.0], np.maximum.accumulate(np.maximum(size, 0.0))[:-1]])
        for cycle in np.flatnonzero(size > (1 + _FURTHER) * before).tolist():
            if which == "first":
                found += _points(force, elongation, cycles, row, cycle, float(before[cycle]))
                continue
            last = int(np.flatnonzero(cycles.group == cycles.group[cycle])[-1])
            if last > cycle and np.isfinite(cycles.force[row, last]):
                found.append((float(cycles.elongation[row, last]), float(cycles.force[row, last])))
    points = np.asarray(sorted(found)).reshape(-1, 2)
    return Backbone(points[:, 0], points[:, 1])


def _points(
    force: np.ndarray, elongation: np.ndarray, cycles: Cycles, row: int, cycle: int, before: float
) -> list[tuple[float, float]]:
    """The points that one excursion adds: its largest force beyond all earlier elongations, and its peak if the force
    has fallen there.
    """
    side, top = SIDES[row], int(cycles.at[row, cycle])
    peak, at_peak = float(cycles.elongation[row, cycle]), float(cycles.force[row, cycle])
    part = slice(int(cycles.begin[cycle]), top + 1)
    size, towards = side * elongation[part], side * force[part]
    is_new = size > before
    if not is_new.any() or side * at_peak <= 0:
        return [(peak, at_peak)]
    largest = int(np.argmax(np.where(is_new, towards, -np.inf)))
    if size[largest] >= _BEFORE * side * peak or towards[largest] <= side * at_peak:
        return [(peak, side * max(side * at_peak, float(towards[largest])))]
    return [(side * float(size[largest]), side * float(towards[largest])), (peak, at_peak)]


def _tells(u: np.ndarray, f: np.ndarray) -> bool:
    """Whether a backbone of one direction has three points, with forces of the same direction."""
    return u.size >= 3 and float(f.max()) > 0


def _failure(u: np.ndarray, f: np.ndarray) -> tuple[float, bool]:
    """Elongation at which the force has fallen to 80 % of the largest (otherwise the last elongation), and whether it
    falls so far.
    """
    top = int(np.argmax(f))
    level = _FAILED * float(f[top])
    below = np.flatnonzero(f[top:] < level)
    if not below.size:
        return float(u[-1]), False
    i = top + int(below[0])
    return float(np.interp(level, [f[i], f[i - 1]], [u[i], u[i - 1]])), True


def _until(u: np.ndarray, f: np.ndarray, end: float) -> tuple[np.ndarray, np.ndarray]:
    """A backbone up to an elongation."""
    own = u < end
    return np.append(u[own], end), np.append(f[own], np.interp(end, u, f))


def _reaches(u: np.ndarray, f: np.ndarray, level: float) -> float:
    """Elongation at which the force first reaches a level within its range."""
    i = int(np.argmax(f >= level))
    return float(np.interp(level, [f[i - 1], f[i]], [u[i - 1], u[i]]))


def _yield_elongation(u: np.ndarray, f: np.ndarray, force: float) -> float:
    """Where the line through the backbone at 60 % of a force reaches that force."""
    return _reaches(u, f, 0.6 * force) / 0.6
