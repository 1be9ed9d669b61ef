"""Possible places of an unlisted effect: a slot of the law, and its coordinates."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import COUNTS, DEGREES, SLOTS
from hsed_jax.physics.scales import Scales

WORDS = {
    "force": "a force parallel to the element",
    "a": "a factor on the stiffness",
    "nu": "a factor on β and γ, which lowers the strength",
    "h": "a factor on the tangent of the loop",
}
"""Slots in words."""
# Time constants of fading coordinates, over u_c/v_c: a quarter of a cycle takes about one.
FADES = (0.7, 2.5, 9.0)
_ALONE = tuple(name for name in COORDINATES if name != "direction")
_IN_FORCE = (
    *(("elongation", other) for other in ("rate", "direction", "energy", "largest_elongation", "time")),
    *(
        (other, "direction")
        for other in ("energy", "path", "largest_elongation", "time", "since_reversal", "recent_path")
    ),
    ("recent_path", "elongation"),
    ("lagged_elongation", "elongation"),
)
_IN_FACTOR = (
    *((other, "direction") for other in ("elongation", "force")),
    ("rate", "energy"),
    ("elongation", "energy"),
    ("rate", "elongation"),
    ("recent_path", "energy"),
)


class Place(NamedTuple):
    """The place of a free function.

    Attributes:
        slot: of the law, or `force` beside it.
        of: its coordinates, one or two (`hsed_jax.physics.effects.coordinates`).
        fade: time constant of a fading coordinate, over u_c/v_c; one without it.
    """

    slot: str
    of: tuple[str, ...]
    fade: float = 1.0

    @property
    def words(self) -> str:
        """In a sentence."""
        return f"{WORDS[self.slot]} that depends on {' and '.join(COORDINATES[name].words for name in self.of)}"

    @property
    def degrees(self) -> list[tuple[int, int]]:
        """The degrees of the polynomials that its function has in either coordinate."""
        if len(self.of) == 1:
            return [(m, n) for m, n in DEGREES if n == 0]
        # A direction has two values.
        if self.of[1] == "direction":
            return [(m, n) for m, n in DEGREES if n < 2]
        return [(m, n) for m, n in DEGREES if m < COUNTS[-1]]

    @property
    def fades(self) -> bool:
        """Whether a coordinate fades."""
        return any(COORDINATES[name].fades for name in self.of)

    def held(self, reaches: Sequence[tuple[float, float]]) -> dict[str, float]:
        """The parameters that put the free function at this place, by name; from the range of each coordinate."""
        found = {f"in_{self.slot}": 1.0, "fade": self.fade}
        for number, (name, (low, high)) in enumerate(zip(self.of, reaches, strict=True), 1):
            ends = {f"middle_{number}": 0.5 * (low + high), f"half_{number}": 0.5 * (high - low)}
            found |= {f"of_{name}_{number}": 1.0, **ends}
        return found


def places(slots: Iterable[str], has_time: bool) -> list[Place]:
    """The places of a law with these slots; without a time scale only those that do not need it."""
    found = []
    for slot in (slot for slot in SLOTS if slot in slots):
        pairs = _IN_FORCE if slot == "force" else _IN_FACTOR
        for of in (*((name,) for name in _ALONE), *pairs):
            if not has_time and any(COORDINATES[name].needs_time for name in of):
                continue
            fades = FADES if any(COORDINATES[name].fades for name in of) else (1.0,)
            found += [Place(slot, of, fade) for fade in fades]
    return found


class Motion(NamedTuple):
    """The motion of a specimen in an experiment: time [s], elongation [m], its rate [m/s] and force [N], (T,) each."""

    time: Float[np.ndarray, " T"]
    elongation: Float[np.ndarray, " T"]
    rate: Float[np.ndarray, " T"]
    force: Float[np.ndarray, " T"]


def values(name: str, fade: float, motion: Motion, scales: Scales) -> Float[np.ndarray, " T"]:
    """A coordinate over a motion, dimensionless; of the element the whole force."""
    time, u, v, r = motion
    step = np.diff(time, prepend=time[:1])
    along = np.diff(u, prepend=u[:1])
    path = np.cumsum(np.abs(along))
    pace = float(np.median(np.diff(time))) * scales.rate / scales.elongation / fade
    if name == "energy":
        return np.cumsum(r * along) / scales.energy
    if name == "path":
        return path * scales.force / scales.energy
    if name == "largest_elongation":
        return np.maximum.accumulate(np.abs(u)) / scales.elongation
    if name == "time":
        return np.cumsum(step) * scales.rate / scales.elongation
    if name == "since_reversal":
        return _since_reversal(u) / scales.elongation
    if name in ("recent_path", "lagged_elongation"):
        from scipy.signal import lfilter  # imported here: it takes half a second to load, and is rarely needed

        fed = np.abs(along) if name == "recent_path" else pace * u
        return np.asarray(lfilter([1.0], [1.0, -(1.0 - min(pace, 1.0))], fed)) / scales.elongation
    direction = np.sign(v)
    plain = {
        "elongation": u / scales.elongation,
        "rate": v / scales.rate,
        "direction": direction,
        "force": r / scales.force,
    }
    return plain.get(name, r / scales.force * direction)


def _since_reversal(u: np.ndarray) -> np.ndarray:
    moving = np.sign(np.diff(u, prepend=u[:1]))
    turned = np.flatnonzero(moving[1:] * moving[:-1] < 0)
    last = np.zeros(len(u), dtype=int)
    last[turned + 1] = turned
    return np.abs(u - u[np.maximum.accumulate(last)])


class Reaches:
    """Ranges of coordinates over several motions, dimensionless.

    Arguments:
        motions: of a specimen.
        scales: characteristic values.
    """

    def __init__(self, motions: Sequence[Motion], scales: Scales):
        self._motions, self._scales = motions, scales
        self._known: dict[tuple[str, float], tuple[float, float]] = {}

    def of(self, place: Place) -> tuple[tuple[float, float], ...]:
        """Lowest and highest value of each coordinate of a place."""
        return tuple(self._reach(name, place.fade if COORDINATES[name].fades else 1.0) for name in place.of)

    def _reach(self, name: str, fade: float) -> tuple[float, float]:
        if (name, fade) not in self._known:
            every = np.concatenate([values(name, fade, motion, self._scales) for motion in self._motions])
            low, high = float(every.min()), float(every.max())
            self._known[name, fade] = (low, high) if high - low > 1e-9 else (low - 0.5, low + 0.5)
        return self._known[name, fade]
