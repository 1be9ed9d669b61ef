r"""The predicted gain of free functions beside a fitted model: the evidence of a Gaussian process at every place, in closed
form.

To first order the coefficients c of a function move the standardised outputs along their slopes J.  Let M be the projection
by which the parameters of the model adjust, and c normal with deviations S. The gain of log evidence of the function is

$$\tfrac12\,b^\top S(I+SGS)^{-1}S\,b-\tfrac12\log|I+SGS|,\qquad G=J^\top MJ,\quad b=J^\top Mr .$$

M removes the directions of the parameters of the model, so a function that they can replace has no gain.  The gain must
exceed that of chance with the same flexibility: the same function with the coordinates of *another* experiment.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.special import logsumexp

from hsed_jax.diagnosis.batch import Predictions
from hsed_jax.diagnosis.fit_state import Submodel
from hsed_jax.diagnosis.scores import Linearisation
from hsed_jax.discovery.places import Place, Reaches
from hsed_jax.physics.effects.free_function import COUNTS, POWERS, deviations, power, powers_of

# Lengths in θ, of which the reach of a coordinate is π, and sizes of a function, over F_c or as the logarithm of a factor.
_LENGTHS = (0.4, 1.0, 2.5)
_SIZES = (0.03, 0.1, 0.3, 1.0)
_ACROSS = 1.5
# Step of a coefficient for slopes: a function of this size is small.
_STEP = 1e-2


class PlaceGain(NamedTuple):
    """The predicted gain of a place.

    Attributes:
        place: the place.
        gain: log evidence, over all lengths and sizes.
        chance: the largest gain of the same function with the coordinates of another experiment.
        deviations: of the coefficients, at the best length and size, (m,).
        coefficients: the most probable ones then, (m,).
    """

    place: Place
    gain: float
    chance: float
    deviations: Float[np.ndarray, " m"]
    coefficients: Float[np.ndarray, " m"]


class Learned(NamedTuple):
    """The result of the normal equations for a process: its evidence over all lengths and sizes, and the best of these."""

    gain: float
    deviations: Float[np.ndarray, " m"]
    coefficients: Float[np.ndarray, " m"]


def screened(
    linearisation: Linearisation,
    submodel: Submodel,
    names: Sequence[str],
    chosen: Sequence[Place],
    reaches: Reaches,
    experiments: int,
) -> list[PlaceGain]:
    """The predicted gains of places, largest first.

    Arguments:
        linearisation: the fitted model.
        submodel: of that fit.
        names: of all parameters; those of the free function with their owner in front.
        chosen: the places.
        reaches: of their coordinates.
        experiments: how many the fit has.
    """
    found = []
    for place in chosen:
        columns, at = located(place, names, reaches)
        points = []
        for column in columns:
            x = linearisation.origin
            x[column] += _STEP
            points.append((x, submodel.beside(np.asarray([column]), at)))
        slopes = linearisation.across(points)[0] / _STEP
        own = linearisation.own(slopes)
        known = learned(own @ own.T, own @ linearisation.residual, place)
        chance = _chance(linearisation, slopes, place, experiments)
        found.append(PlaceGain(place, known.gain, chance, known.deviations, known.coefficients))
    return sorted(found, key=lambda one: -one.gain)


def located(place: Place, names: Sequence[str], reaches: Reaches) -> tuple[np.ndarray, dict[int, float]]:
    """Columns of the coefficients of a place, and the fixed values of other parameters of the free function, by column."""
    index = {name.rpartition(".")[2]: k for k, name in enumerate(names) if name.rpartition(".")[0] == "learned"}
    columns = np.asarray([index[power(m, n)] for m, n in place.degrees])
    return columns, {index[name]: value for name, value in place.held(reaches.of(place)).items()}


class ByPolynomials:
    """Batch whose free function has coefficients of polynomials instead of powers.

    Arguments:
        batch: that are given powers.
        names: of all parameters.
    """

    def __init__(self, batch: Predictions, names: Sequence[str]):
        self._batch = batch
        self._columns = [names.index(f"learned.{name}") for name in POWERS]

    def __call__(
        self,
        thetas: Float[np.ndarray, "L P"],
        experiments: Int[np.ndarray, " L"],
        samples: Int[np.ndarray, " L"] | None = None,
    ) -> tuple[Float[np.ndarray, "L J"], Float[np.ndarray, " L"]]:
        """As those of `hsed_jax.diagnosis.batch.Batch`."""
        thetas = thetas.copy()
        thetas[:, self._columns] = powers_of(thetas[:, self._columns])
        return self._batch(thetas, experiments, samples)


def learned(strength: Float[np.ndarray, "m m"], along: Float[np.ndarray, " m"], place: Place) -> Learned:
    """The evidence of a process at a place from G and b, over all lengths and sizes, and at the best of these."""
    grid = [process(place, length, size) for length in _LENGTHS for size in _SIZES]
    found = [evidence(strength, along, own) for own in grid]
    gains = [gain for gain, _ in found]
    best = int(np.argmax(gains))
    return Learned(float(logsumexp(gains) - np.log(len(gains))), grid[best], found[best][1])


def evidence(
    strength: Float[np.ndarray, "m m"], along: Float[np.ndarray, " m"], own: Float[np.ndarray, " m"]
) -> tuple[float, Float[np.ndarray, " m"]]:
    """Log evidence gained, from G and b, by coefficients with these deviations, and the most probable coefficients."""
    lower = np.linalg.cholesky(np.eye(len(own)) + own[:, None] * strength * own)
    half = np.linalg.solve(lower, own * along)
    return float(0.5 * half @ half - np.sum(np.log(np.diag(lower)))), own * np.linalg.solve(lower.T, half)


def process(place: Place, length: float, size: float) -> Float[np.ndarray, " m"]:
    """Deviations of the coefficients of a place, in their order."""
    first = deviations(length, size, COUNTS[0])
    if len(place.of) == 1:
        return first
    # A direction has two values: a part that is the same for both, and one that is not.
    across = np.full(2, math.sqrt(0.5)) if place.of[1] == "direction" else deviations(_ACROSS, 1.0, len(COUNTS))
    return np.asarray([first[m] * across[n] for m, n in place.degrees])


def _chance(linearisation: Linearisation, slopes: np.ndarray, place: Place, experiments: int) -> float:
    """The largest gain of the function with the coordinates of another experiment, or, for a single experiment, of
    another time.
    """
    shape = (len(slopes), experiments, -1)
    gains = []
    for shift in {1, max(experiments // 2, 1)} if experiments > 1 else (1, 2):
        if experiments > 1:
            moved = np.roll(slopes.reshape(shape), shift, axis=1)
        else:
            moved = np.roll(slopes, shift * slopes.shape[1] // 3, axis=1)
        own = linearisation.own(moved.reshape(len(slopes), -1))
        gains.append(learned(own @ own.T, own @ linearisation.residual, place).gain)
    return max(gains)
