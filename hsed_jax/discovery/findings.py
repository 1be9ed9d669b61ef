"""The learned effect that is not in the catalogue, and its display."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from hsed_jax.criticism.prediction import error_cell, error_change
from hsed_jax.discovery.formulas import Formula
from hsed_jax.discovery.places import Place
from hsed_jax.drafts import write_whole
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import DEGREES
from hsed_jax.physics.scales import Scales
from hsed_jax.tables import Table, Tabular, cell

EFFECT = "learned_effect"
"""Name of the first learned effect."""
_POINTS = 101
# Standard deviations on both sides hold 90 %.
_90 = 1.6448536


@dataclass(frozen=True)
class Tried:
    """A place that was fitted.

    Attributes:
        place: the place.
        log_evidence_gain: over the first model.
        probability: among all that were fitted.
        error_train: normalised error with the function there.
    """

    place: Place
    log_evidence_gain: float
    probability: float
    error_train: float


class Line(NamedTuple):
    """A learned function along its first coordinate, SI.

    Attributes:
        x: the coordinate, (n,).
        at: value of the second one; None without one.
        mean, low, high: of the Gaussian process, with its 90 % band: a force [N], or a factor, (n,).
        formula: the same of the formula; None without one.
    """

    x: Float[np.ndarray, " n"]
    at: float | None
    mean: Float[np.ndarray, " n"]
    low: Float[np.ndarray, " n"]
    high: Float[np.ndarray, " n"]
    formula: Float[np.ndarray, " n"] | None


@dataclass(frozen=True)
class Curve:
    """A learned function over its coordinates.

    Attributes:
        place: where it is.
        reaches: of the coordinates, dimensionless.
        coefficients: of its polynomials, (m,).
        covariance: of these, (m, m).
        formula: of the function; None for a curve.
    """

    place: Place
    reaches: tuple[tuple[float, float], ...]
    coefficients: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m m"]
    formula: Formula | None = None

    def smooth(self, *x: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Mean and deviation of f at dimensionless coordinates: over F_c, or the logarithm of a factor."""
        along = []
        for values, (low, high) in zip(x, self.reaches, strict=True):
            xi = np.clip((values - 0.5 * (low + high)) / (0.5 * (high - low)), -1.0, 1.0)
            along.append(np.polynomial.chebyshev.chebvander(xi, max(m for m, _ in DEGREES)))
        degrees = np.asarray(self.place.degrees)
        columns = along[0][:, degrees[:, 0]]
        if len(along) > 1:
            columns = columns * along[1][:, degrees[:, 1]]
        return columns @ self.coefficients, np.sqrt(np.sum((columns @ self.covariance) * columns, axis=1))

    def value(self, *x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The contribution at dimensionless coordinates: over F_c, or a factor."""
        if self.formula is None:
            mean, _ = self.smooth(*x)
            return mean if self.place.slot == "force" else np.exp(mean)
        held = [np.clip(values, *reach) for values, reach in zip(x, self.reaches, strict=True)]
        return self.formula.value(*held)


@dataclass(frozen=True, repr=False)
class Discovery(Tabular):
    """The result of a discovery.

    Attributes:
        found: whether an effect was learned.
        reason: the reason if nothing was learned, in a sentence; otherwise empty.
        place: the place; None if nothing was learned.
        formula: in one line.
        probability: of the place among the fitted ones.
        error: normalised errors (train, test) before it.
        error_train, error_test: after; test: of held-out experiments, otherwise of those left out in turn.
        noise_floor: of the training experiments.
        ranking: the places that were fitted, the most probable first.
        curve: the function.
        source: of the Python file with the effect.
        scales: characteristic values that make coordinates dimensionless.
        effect: its name.
        effects, forms: of the catalogue, that it stands beside.
        notes: limits of the result.
    """

    found: bool
    reason: str = ""
    place: Place | None = None
    formula: str = ""
    probability: float = 0.0
    error: tuple[float, float] = (float("nan"), float("nan"))
    error_train: float = float("nan")
    error_test: float = float("nan")
    noise_floor: float = 0.0
    ranking: Sequence[Tried] = ()
    curve: Curve | None = None
    source: str = ""
    effect: str = EFFECT
    scales: Scales = field(default_factory=Scales)
    effects: Sequence[str] = ()
    forms: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()

    @property
    def file(self) -> str:
        """Name of the Python file with the effect."""
        return f"{self.effect}.py"

    @property
    def reach(self) -> dict[str, tuple[float, float]]:
        """The ranges of the coordinates, SI, by name."""
        if self.place is None or self.curve is None:
            return {}
        scales = {name: float(COORDINATES[name].scale(self.scales)) for name in self.place.of}
        return {
            name: (low * scales[name], high * scales[name])
            for name, (low, high) in zip(self.place.of, self.curve.reaches, strict=True)
        }

    def value(self, coordinates: Mapping[str, np.ndarray]) -> np.ndarray:
        """The contribution at coordinates by name, SI: a force [N], or a factor."""
        assert self.place is not None
        assert self.curve is not None
        x = [np.asarray(coordinates[n], float) / float(COORDINATES[n].scale(self.scales)) for n in self.place.of]
        size = float(self.scales.force) if self.place.slot == "force" else 1.0
        return size * self.curve.value(*x)

    def lines(self) -> list[Line]:
        """The function along its first coordinate, at the ends and the middle of the reach of the second."""
        assert self.place is not None
        assert self.curve is not None
        curve, scales = self.curve, [float(COORDINATES[name].scale(self.scales)) for name in self.place.of]
        x = np.linspace(*curve.reaches[0], _POINTS)
        ends: list[float | None] = [None]
        if len(self.place.of) == 2:
            low, high = curve.reaches[1]
            ends = [low, high] if self.place.of[1] == "direction" else [low, 0.5 * (low + high), high]
        is_force, found = self.place.slot == "force", []
        size = float(self.scales.force) if is_force else 1.0
        for end in ends:
            at = (x,) if end is None else (x, np.full(_POINTS, end))
            mean, deviation = curve.smooth(*at)
            ways = (mean, mean - _90 * deviation, mean + _90 * deviation)
            middle, lower, upper = (size * (y if is_force else np.exp(y)) for y in ways)
            formula = None if curve.formula is None else size * curve.value(*at)
            found.append(Line(x * scales[0], None if end is None else end * scales[1], middle, lower, upper, formula))
        return found

    def write(self, path: str | Path) -> None:
        """Write the effect as a Python file.

        Raises:
            ValueError: nothing was found.
        """
        if not self.found:
            raise ValueError(f"nothing was found: {self.reason}")
        write_whole(Path(path), self.source)

    @property
    def sentence(self) -> str:
        """The result, in words."""
        if not self.found:
            return f"nothing was learned: {self.reason}"
        assert self.place is not None
        beside = f" beside {' and '.join(self.effects)}" if self.effects else ""
        return (
            f"learned{beside}: {self.place.words}, {self.formula} (probability {cell(self.probability)}); the error on "
            f"experiments that were not fitted {error_change(error_cell(self.error[1]), error_cell(self.error_test))}"
        )

    def summary(self) -> dict[str, Any]:
        """The key `discovery` of `summary.json`."""
        if not self.found:
            return {"found": False, "reason": self.reason, "sentence": self.sentence}
        assert self.place is not None
        return {
            "found": True,
            "place": {"slot": self.place.slot, "of": list(self.place.of)},
            "formula": self.formula,
            "probability": self.probability,
            "error_train": self.error_train,
            "error_test": self.error_test,
            "file": self.file,
            "sentence": self.sentence,
            "reach": {name: list(reach) for name, reach in self.reach.items()},
            "ranking": [
                {
                    "place": {"slot": one.place.slot, "of": list(one.place.of)},
                    "words": one.place.words,
                    "probability": one.probability,
                    "log_evidence_gain": one.log_evidence_gain,
                    "error_train": one.error_train,
                }
                for one in self.ranking
            ],
            "notes": list(self.notes),
        }

    def _table(self) -> Table:
        rows = [
            (one.place.words, cell(one.probability), cell(one.log_evidence_gain, ".1f"), error_cell(one.error_train))
            for one in self.ranking[:6]
        ]
        return Table(self.sentence, ("place", "probability", "log-evidence", "error train"), rows, list(self.notes))
