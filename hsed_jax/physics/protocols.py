r"""Published loading protocols of component tests, as tables of steps.

An amplitude of a table is relative to a reference, which every protocol defines on its own (`Protocol.relative_to`).  For
CUREE, ISO 16670, ATC-24 and FEMA 461 it is a deformation: amplitudes are fractions or multiples of it.  For ACI 374, AISC 341
and SAC it is a length: their tables are drift angles [rad], and drift angle times height is the elongation.  For a rotation,
this length is 1.

Most protocols continue until the specimen fails, with a constant increment of the amplitude (`Protocol.increment`).  The
table here ends like the published one; `steps` shortens or continues it.

Nothing here needs JAX: `hsed_jax.physics.excitations.imposed` imposes the sequence, `protocol_history` is the command alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hsed_jax.errors import UserError

TRAILING = 0.75
"""Amplitude of a trailing cycle as a share of that of its primary cycle (CUREE)."""

_DRIFT = (
    "storey drift angle [rad]; the reference is the height that turns it into an elongation, 1 where that is a rotation"
)


class Step(NamedTuple):
    """Cycles of one amplitude, and smaller ones that follow.

    Attributes:
        amplitude: relative to the reference.
        cycles: full cycles at it; 1/4: pushed to it once.
        trailing: full cycles at `TRAILING` times the amplitude after them.
    """

    amplitude: float
    cycles: float
    trailing: int = 0


class Level(NamedTuple):
    """Quarters of a cycle at one amplitude, which is relative to the reference."""

    amplitude: float
    quarters: int


@dataclass(frozen=True)
class Protocol:
    """A published loading protocol.

    Attributes:
        title: of the protocol.
        relative_to: meaning of the reference.
        source: the document.
        table: the steps in order.
        increment: increment of the amplitude at every further step, relative to the reference; None: it ends with the table.
        note: choices of the table that the document leaves open; empty without them.
    """

    title: str
    relative_to: str
    source: str
    table: tuple[Step, ...]
    increment: float | None
    note: str = ""

    def steps(self, count: int | None = None) -> tuple[Step, ...]:
        """The first steps, as many as `count`; None: those of the table.  Further steps repeat the last one at larger amplitudes.

        Raises:
            UserError: the protocol has fewer steps.
        """
        count = len(self.table) if count is None else count
        beyond = range(1, count - len(self.table) + 1)
        if not beyond:
            return self.table[:count]
        if self.increment is None:
            raise UserError(f"{self.title} has {len(self.table)} step{'s' * (len(self.table) > 1)}, not {count}")
        last = self.table[-1]
        # Decimal tables have decimal sums.
        grown = (round(last.amplitude + i * self.increment, 12) for i in beyond)
        return self.table + tuple(last._replace(amplitude=amplitude) for amplitude in grown)

    def levels(self, count: int | None = None) -> tuple[Level, ...]:
        """Amplitudes in order, each with its quarters of a cycle: primary and trailing cycles apart.

        Raises:
            UserError: the protocol has fewer steps.
        """
        levels: list[Level] = []
        for step in self.steps(count):
            levels.append(Level(step.amplitude, round(4 * step.cycles)))
            if step.trailing:
                levels.append(Level(TRAILING * step.amplitude, 4 * step.trailing))
        return tuple(levels)

    def amplitudes(self) -> tuple[float, ...]:
        """Amplitudes of the full cycles of the table, in order; none of a single push."""
        return tuple(level.amplitude for level in self.levels() for _ in range(level.quarters // 4))

    def extent(self, count: int | None = None) -> str:
        """The number of cycles, and the largest amplitude."""
        levels = self.levels(count)
        quarters = sum(level.quarters for level in levels)
        cycles = "one push" if quarters == 1 else f"{quarters // 4} cycles"
        return f"{cycles} up to {max(level.amplitude for level in levels):g}"


def _same(cycles: float, *amplitudes: float) -> tuple[Step, ...]:
    return tuple(Step(amplitude, cycles) for amplitude in amplitudes)


_STEEL_CONNECTION = (*_same(6, 0.00375, 0.005, 0.0075), Step(0.01, 4), *_same(2, 0.015, 0.02, 0.03))

PROTOCOLS = {
    "curee": Protocol(
        "CUREE, basic loading history",
        "reference deformation, 0.6 of the deformation at which the force of a monotonic test has fallen to 0.8 of its largest",
        "Krawinkler et al. (2001), CUREE Publication W-02; ASTM E2126, Method C",
        (
            Step(0.05, 6),
            Step(0.075, 1, 6),
            Step(0.1, 1, 6),
            Step(0.2, 1, 3),
            Step(0.3, 1, 3),
            Step(0.4, 1, 2),
            Step(0.7, 1, 2),
            Step(1.0, 1, 2),
        ),
        0.5,
    ),
    "iso_16670": Protocol(
        "ISO 16670",
        "ultimate deformation of a monotonic test",
        "ISO 16670 (2003); ASTM E2126, Method B",
        (*_same(1, 0.0125, 0.025, 0.05, 0.075, 0.1), *_same(3, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2)),
        0.2,
    ),
    "atc_24": Protocol(
        "ATC-24, multiple step test",
        "yield deformation",
        "ATC-24 (1992), Guidelines for Cyclic Seismic Testing of Components of Steel Structures",
        (*_same(3, 0.5, 0.75, 1.0, 2.0, 3.0), *_same(2, 4.0, 5.0, 6.0)),
        1.0,
        "The guidelines ask for at least 6 cycles below yield; the amplitudes 0.5 and 0.75 are chosen here.  The steps go on "
        "until failure; the table ends at 6.",
    ),
    "fema_461": Protocol(
        "FEMA 461, quasi-static cyclic protocol",
        "targeted largest deformation, at which severe damage is expected",
        "FEMA 461 (2007), Interim Testing Protocols, Protocol I",
        _same(2, 0.048, 0.068, 0.095, 0.133, 0.186, 0.260, 0.364, 0.510, 0.714, 1.0),
        0.3,
    ),
    "aci_374": Protocol(
        "ACI 374.1",
        _DRIFT,
        "ACI 374.1-05, Acceptance Criteria for Moment Frames Based on Structural Testing",
        _same(3, 0.0020, 0.0025, 0.0035, 0.0050, 0.0075, 0.0100, 0.0140, 0.0175, 0.0220, 0.0275, 0.0350),
        None,
        "The criteria ask for 3 cycles at each drift, each drift 1.25 to 1.5 times the one before, up to 0.035 at least; the "
        "first one is elastic.  The drifts of the table are one sequence that meets this.",
    ),
    "aisc_341": Protocol(
        "AISC 341, beam-to-column moment connections",
        _DRIFT,
        "ANSI/AISC 341-16, Section K2.4b",
        (*_STEEL_CONNECTION, Step(0.04, 2)),
        0.01,
    ),
    "sac": Protocol(
        "SAC, basic loading history",
        _DRIFT,
        "Clark et al. (1997), SAC/BD-97/02",
        _STEEL_CONNECTION,
        0.01,
    ),
    "monotonic": Protocol(
        "monotonic",
        "deformation at which the test ends",
        "none",
        (Step(1.0, 0.25),),
        None,
        "The push is a quarter of a sine: the rate is largest at the beginning and zero at the end.",
    ),
}
"""Protocols by the names that a study gives them."""


def protocol(name: str) -> Protocol:
    """A protocol by its name.

    Raises:
        UserError: there is no protocol of this name.
    """
    if name not in PROTOCOLS:
        raise UserError(f"there is no loading protocol {name!r}; there are {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def protocol_history(
    name: str, reference: float, rate: float, *, points: int = 40, steps: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The history of the elongation that a loading protocol imposes: sines of the same peak rate at all amplitudes.

    Arguments:
        name: of the protocol, such as `curee` (`hsed protocols` lists them).
        reference: of its amplitudes; its unit is that of the elongation.
        rate: peak rate, in that unit per second; a cycle of amplitude a takes 2πa/rate.
        points: samples a full cycle, a multiple of 4, so that peaks are samples.
        steps: how many steps of the protocol; by default those of its table.

    Returns:
        Time [s] and elongation, (samples,) each; the first sample is zero.

    Raises:
        UserError: there is no such protocol, it has fewer steps, or a number is not allowed.

    Example:
        >>> time, elongation = hx.protocol_history("curee", reference=0.04, rate=0.005)
        >>> float(elongation.max())
        0.04
    """
    levels = protocol(name).levels(steps)
    for what, value in {"reference": reference, "rate": rate}.items():
        if not 0 < value < np.inf:
            raise UserError(f"{what}: it is positive and finite, but it is {value:g}")
    if points < 4 or points % 4:
        raise UserError(f"points: a positive multiple of 4, but it is {points}")
    counts = [level.quarters * points // 4 for level in levels]
    amplitude = reference * np.repeat([level.amplitude for level in levels], counts)
    phase = 2 * np.pi / points * np.arange(1, amplitude.size + 1)
    time = np.cumsum(amplitude * (2 * np.pi / points) / rate)
    return np.concatenate([[0.0], time]), np.concatenate([[0.0], amplitude * np.sin(phase)])
