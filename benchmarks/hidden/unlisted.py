r"""Terms that no form of the catalogue holds, each at its place, and campaigns that hide one of them.

A term is a function of one or two coordinates of the specimen, all SI, at a slot of the law of `.specimen`: `force` is an addend
[N], `a`, `nu` and `h` are factors.  `make(Case(...), folder, truth)` writes a campaign as `.campaigns` does.
"""

import inspect
import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from . import cases
from .campaigns import COARSE, FINE, _noisy, _write_campaign, change, respond
from .catalogue import Formula
from .degrading import sigmoid
from .specimen import Point, Scales, Slots

NOISE = 0.02
STICKING = 0.02  # rate at which the direction of motion turns over, in v_c
CATCHING_UP = 0.005  # time constant with which a mark follows the specimen to its next turning point [s]


@dataclass(frozen=True)
class Case:
    """A term by name, hidden in a campaign of six experiments and four held out; `seed` of everything drawn."""

    term: str
    seed: int


class Place(NamedTuple):
    """A slot of the law and the coordinates on which what stands there depends."""

    slot: str
    of: frozenset[str]

    def __str__(self) -> str:
        return f"{self.slot} of {' × '.join(sorted(self.of))}"


@dataclass(frozen=True)
class Term:
    """What is hidden.

    Attributes:
        name: of the term.
        kind: of the campaign that shows it, `shaken` or `component`.
        place: where it is.
        right: the places that count as right.
        value: of the coordinates by name, SI: the addend [N] or the factor.
        memory: time constant of the recent path or of the lagged elongation [s].
    """

    name: str
    kind: str
    place: Place
    right: frozenset[Place]
    value: Callable[..., np.ndarray]
    memory: float


TERMS: dict[str, Term] = {}


def _term(kind: str, slot: str, also: Iterable[tuple[str, str]] = (), memory: float = 1.0) -> Callable:
    """Registers a function of coordinates under its name; `also`: further right places, (slot, names of coordinates)."""

    def put(value):
        place = Place(slot, frozenset(inspect.signature(value).parameters))
        right = frozenset([place, *(Place(other, frozenset(names.split())) for other, names in also)])
        TERMS[value.__name__] = Term(value.__name__, kind, place, right, value, memory)
        return value

    return put


# ---- forces -----------------------------------------------------------------------------------------------------------


@_term("component", "force")
def sine(elongation):
    """Teeth that slide over one another: a force that waves with the elongation."""
    return 1.2e4 * np.sin(2 * np.pi * elongation / 0.25)


@_term("shaken", "force")
def bump(elongation):
    """A ridge at one elongation, which is climbed from either side."""
    return 4.0e4 * np.exp(-(((elongation - 0.2) / 0.06) ** 2))


# The rate knows the direction.
@_term("component", "force", also=[("force", "elongation rate")])
def friction_of_position(elongation, direction):
    """A wedge on one side: friction that is small up to the middle and grows from there on."""
    return 1.0e4 * direction * (0.3 + np.log1p(np.exp(elongation / 0.05)) / 3)


@_term("shaken", "force")
def relief_damper(rate):
    """A damper that acts one way only, from some speed on, and then gives the same force at any speed."""
    return 2.5e4 * (sigmoid((rate - 1.0) / 0.2) - sigmoid(-5.0))


# Not a Maxwell element, whose force is linear in the elongation and in what lags behind it.
@_term("shaken", "force", memory=0.3)
def lagging_push(lagged_elongation):
    """A force to one side, whichever way the specimen was bent a while ago."""
    return 1.5e4 * lagged_elongation**2 / (lagged_elongation**2 + 0.1**2)


# The rate knows the direction.
@_term("component", "force", also=[("force", "rate since_reversal")])
def breakaway(direction, since_reversal):
    """Friction that rises to a peak after each reversal and is gone once the specimen slides."""
    return 1.2e4 * direction * since_reversal / 0.05 * np.exp(1 - since_reversal / 0.05)


# ---- stiffness and strength -------------------------------------------------------------------------------------------

# Factors on A and on the whole tangent, A − νβ|z|, differ by the second part alone, which is small as long as the force is small
# against the strength: in the paper's specimen no experiment separates them well, and an engineer calls both stiffness.


@_term("shaken", "a", also=[("h", "recent_path")], memory=1.0)
def recovery(recent_path):
    """Stiffness falls with the path of the last second or so, and comes back with rest."""
    return 1 / (1 + (recent_path / 2.0) ** 2)


@_term("shaken", "a", also=[("h", "time")])
def curing(time):
    """Stiffness grows with time and then no more: a grout that sets."""
    return 1 + 0.2 * sigmoid((time - 3.0) / 0.5)


@_term("shaken", "nu")
def overspeed(rate):
    """Strength falls, to a fifth, where the specimen moves faster than it can follow."""
    return 1 + 4 * sigmoid((np.abs(rate) - 1.5) / 0.2)


@_term("shaken", "nu")
def worn_when_fast(rate, energy):
    """Strength falls with the rate once the specimen has absorbed energy, and with neither of them alone."""
    return 1 + 1.5 * np.abs(rate) * sigmoid((energy - 1.0e4) / 3.0e3)


# ---- the coordinates --------------------------------------------------------------------------------------------------


def _since_reversal(x: Point, w, memory):
    # A mark per direction stays at the turning point where that motion began, and runs along with the other motion.
    up, down = x.v > 0, x.v < 0
    rates = [np.where(other, x.v + (x.u - mark) / CATCHING_UP, 0.0) for other, mark in zip((down, up), w, strict=True)]
    return np.abs(x.u - np.where(up, w[0], w[1])), rates


# Number of states that the simulator adds, and (point, states, time constant) -> (value, derivatives of the states).
COORDINATES: dict[str, tuple[int, Callable]] = {
    "elongation": (0, lambda x, w, memory: (x.u, [])),
    "rate": (0, lambda x, w, memory: (x.v, [])),
    "direction": (0, lambda x, w, memory: (np.tanh(x.v / (STICKING * x.scales.rate)), [])),
    "energy": (0, lambda x, w, memory: (x.energy, [])),
    "time": (1, lambda x, w, memory: (w[0], [np.ones_like(w[0])])),
    "since_reversal": (2, _since_reversal),
    "recent_path": (1, lambda x, w, memory: (w[0], [np.abs(x.v) - w[0] / memory])),
    "lagged_elongation": (1, lambda x, w, memory: (w[0], [(x.u - w[0]) / memory])),
}


def _formula(term: Term) -> Formula:
    """The term as a formula of the simulator, whose amplitude is 1, or 0 without it."""

    def act(x: Point, s: Slots, p):
        coordinates, row = {}, 0
        for name in sorted(term.place.of):
            count, coordinate = COORDINATES[name]
            coordinates[name], rates = coordinate(x, x.w[row : row + count], term.memory)
            s.rates += rates
            row += count
        value = term.value(**coordinates)
        if term.place.slot == "force":
            s.force = s.force + p["delta"] * value
        else:
            setattr(s, term.place.slot, getattr(s, term.place.slot) * (1 + p["delta"] * (value - 1)))

    return Formula("specimen", act, 1.0, states=sum(COORDINATES[name][0] for name in term.place.of))


def histories(time: np.ndarray, u: np.ndarray, force: np.ndarray, memory: float) -> dict[str, np.ndarray]:
    """Every coordinate that a place may name along records (samples, experiments), SI: what the campaign visited.

    Made of the samples alone: to compare two functions of the coordinates it matters where they are, not when.  The force is
    that of the whole specimen.
    """
    step, start = time[1] - time[0], np.zeros_like(u[:1])
    rate = np.gradient(u, step, axis=0)
    moved = np.concatenate([start, np.diff(u, axis=0)])
    worked = np.concatenate([start, 0.5 * (force[1:] + force[:-1])]) * moved
    since = np.empty_like(u)
    turning = u[0]
    for i in range(len(u)):
        if i > 1:
            turning = np.where(moved[i] * moved[i - 1] < 0, u[i - 1], turning)
        since[i] = np.abs(u[i] - turning)
    kept = np.exp(-step / memory)
    return {
        "elongation": u,
        "rate": rate,
        "direction": np.sign(rate),
        "force": force,
        "force_along_motion": force * np.sign(rate),
        "energy": np.cumsum(worked, axis=0),
        "path": np.cumsum(np.abs(moved), axis=0),
        "largest_elongation": np.maximum.accumulate(np.abs(u), axis=0),
        "time": np.broadcast_to(time[:, None], u.shape),
        "since_reversal": since,
        "recent_path": lfilter([1.0], [1.0, -kept], np.abs(moved), axis=0),
        "lagged_elongation": lfilter([1 - kept], [1.0, -kept], u, axis=0),
    }


def make(case: Case, folder: Path, truth: Path) -> None:
    """Write the campaign and its study into `folder`, and what is hidden in it into `truth` (JSON; histories beside it, .npz)."""
    term = TERMS[case.term]
    plain = cases.Case(term.kind, (), 0.0, NOISE, 6, 4, case.seed)
    plan = replace(cases.draw(plain), hidden=(cases.Hidden(term.name, "unlisted", _formula(term), 1.0, {}),))
    scales = respond(plan, np.zeros((0, 1)), Scales(1, 1, 1, 1), plan.train, COARSE).scales(0, plan.train)
    measured = respond(plan, [[0.0, 1.0]], scales, len(plan.inputs), FINE)
    _write_campaign(plain, plan, _noisy(measured, plan, plain, np.random.default_rng([case.seed, 3])), Path(folder))
    content = {
        "case": asdict(case),
        "slot": term.place.slot,
        "of": sorted(term.place.of),
        "description": term.value.__doc__,
        "A": plan.A,
        "beta": plan.beta,
        "change": float(change(plan, measured)[-1]),
    }
    truth.parent.mkdir(parents=True, exist_ok=True)
    truth.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    np.savez_compressed(
        truth.with_suffix(".npz"), time=measured.time, elongation=measured.u[:, -1], force=measured.force[:, -1]
    )
