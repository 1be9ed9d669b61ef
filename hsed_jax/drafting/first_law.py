"""The spring law of a first study: that of Bouc and Wen, which all effects can extend, or the steel of Menegotto and Pinto.

The laws are fitted to the measured forces along the measured elongations, without structure and test rig.  Any elastic force,
friction and dashpot may stand beside each, so the comparison concerns the hysteresis alone.  Steel yields sharply at first
and more roundly later. With the simplest law of Bouc and Wen, a diagnosis would explain this difference by effects that the
specimen does not have.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from hsed_jax.backend import prepare
from hsed_jax.measurements import Campaign
from hsed_jax.measurements.thinning import thinned
from hsed_jax.physics.laws import LAWS
from hsed_jax.physics.specimen import Specimen
from hsed_jax.programs import program

# So many experiments, those of the largest elongation, of about so many samples each.
_EXPERIMENTS, _SAMPLES = 4, 500
# Records are filled up to a multiple of so many samples.
_BLOCK = 256
# Parts of the way from one sample to the next, over which a differential equation is integrated.
_PARTS = 4
# Knots of the elastic force beside a law, which is linear between them; a force of the rate has half as many.
_KNOTS = 21
# Another law replaces the simplest one if its squared residual is at most this share of that of the simplest one, and if its
# residual is at most this share of the force.  A larger residual is pinching or damage, and more of their effects extend the
# simplest law.
_LEFT, _SMALL = 0.6, 0.05
# Parallel forces that differ by less than this share are one.
_RANK = 1e-8
# Step of a derivative, relative to the initial estimate.
_STEP = 1e-5


class _Law(NamedTuple):
    """A law and its free parameters: the first two are stiffness and strength, relative to their initial estimates."""

    name: str
    low: tuple[float, ...]
    start: tuple[float, ...]
    high: tuple[float, ...]
    parameters: Callable[[Sequence[Any], Any, Any], dict[str, Any]]


def _bouc_wen(x: Sequence[Any], k: Any, F: Any) -> dict[str, Any]:
    stiffness, strength, n, share = x[0] * k, x[1] * F, x[2], x[3]
    beta = stiffness / (strength**n * (1 + share))
    return {"A": stiffness, "beta": beta, "gamma": share * beta, "n": n}


def _steel(x: Sequence[Any], k: Any, F: Any) -> dict[str, Any]:
    return {"k": x[0] * k, "F_y": x[1] * F, "b": x[2], "R0": x[3], "cR1": x[4]}


# The bounds of the stiffness exclude friction that sticks first: it resembles a law that is much stiffer than the first loading.
_LAWS = {
    "simplest": _Law("bouc_wen", (0.25, 0.06), (1.0, 1.0), (4, 16), lambda x, k, F: _bouc_wen((*x, 1.0, 0.0), k, F)),
    # As effects of the catalogue change it: `yield_sharpness` changes n, `loop_shape` changes γ.
    "shaped": _Law("bouc_wen", (0.25, 0.06, 0.5, -0.9), (1.0, 1.0, 1.0, 0.0), (4, 16, 8, 5), _bouc_wen),
    "steel": _Law(
        "menegotto_pinto", (0.25, 0.06, 0.0, 1.0, 0.0), (1.0, 0.8, 0.02, 10.0, 0.8), (4, 16, 0.5, 25, 0.97), _steel
    ),
}


class Residuals(NamedTuple):
    """Normalised residuals of the laws.

    Attributes:
        simplest: Bouc and Wen with n = 1 and γ = 0.
        shaped: the same law with any n and γ.
        steel: Menegotto and Pinto.
    """

    simplest: float
    shaped: float
    steel: float

    @property
    def is_steel(self) -> bool:
        """Whether the residual of the law of Menegotto and Pinto is small, much smaller than that of the simplest law, and
        smaller than that of the shaped one.
        """
        return self.steel < min(_SMALL, math.sqrt(_LEFT) * self.simplest, self.shaped)


class _Paths(NamedTuple):
    """Records side by side, each followed by its last sample.

    Attributes:
        elongation: [m], (records, samples).
        force: over the guessed strength, (records, samples).
        beside: orthonormal forces whose sums may stand beside a law, (measured samples, terms): a projection is the best sum.
        is_measured: where there is a sample, (records, samples).
    """

    elongation: np.ndarray
    force: np.ndarray
    beside: np.ndarray
    is_measured: np.ndarray


def residuals(campaign: Campaign, stiffness: float, strength: float) -> Residuals | None:
    """The residual of each law in the measured forces.

    Arguments:
        campaign: the measurements.
        stiffness: a guess of the stiffness [N/m].
        strength: a guess of the strength [N].

    Returns:
        The normalised residuals; None if no experiment has a history of force and elongation.
    """
    prepare()
    paths = _paths(campaign, strength)
    return paths and Residuals(*(_residual(name, paths, stiffness, strength) for name in _LAWS))


def _paths(campaign: Campaign, strength: float) -> _Paths | None:
    records = []
    for experiment in campaign.train:
        if experiment.record is not None and {"elongation", "force"} <= experiment.record.channels.keys():
            record = thinned(experiment, _SAMPLES).record
            assert record is not None
            rate = np.abs(np.gradient(record["elongation"], record.time))
            table = np.stack([record["elongation"], record["force"], rate])
            records.append(table[:, np.isfinite(table).all(axis=0)])
    records = sorted((r for r in records if r.shape[1] > _KNOTS), key=lambda r: -float(np.ptp(r[0])))[:_EXPERIMENTS]
    if not records:
        return None
    # A few lengths, so that a program that was made serves other records.
    length = _BLOCK * math.ceil(max(r.shape[1] for r in records) / _BLOCK)
    filled = [np.pad(r, ((0, 0), (0, length - r.shape[1])), mode="edge") for r in records]
    elongation, force, rate = np.stack(filled, axis=1)
    is_measured = np.arange(length) < np.asarray([[r.shape[1]] for r in records])
    way = np.diff(elongation, prepend=0.0)
    beside, sizes, _ = np.linalg.svd(_beside(elongation, np.sign(way), rate)[is_measured], full_matrices=False)
    return _Paths(elongation, force / strength, beside[:, sizes > _RANK * sizes[0]], is_measured)


def _beside(elongation: np.ndarray, way: np.ndarray, rate: np.ndarray) -> Float[np.ndarray, "records samples terms"]:
    """Any elastic force, and any force of the rate, each as hat functions; a constant one of the rate is friction."""
    u, v = elongation / (np.max(np.abs(elongation)) or 1.0), rate / (np.max(rate) or 1.0)
    # Dashpots have powers below one, so the root is the better coordinate.
    return np.concatenate([_hats(u, -1.0, _KNOTS), way[..., None] * _hats(np.sqrt(v), 0.0, _KNOTS // 2)], axis=-1)


def _hats(x: np.ndarray, low: float, count: int) -> Float[np.ndarray, "... count"]:
    """Functions that are one at one of the knots between `low` and 1, zero at the others and linear between them."""
    knots = np.linspace(low, 1, count)
    return np.maximum(0.0, 1 - np.abs(x[..., None] - knots) / (knots[1] - knots[0]))


def _residual(name: str, paths: _Paths, stiffness: float, strength: float) -> float:
    """RMS residual of a fitted law with the best parallel forces, over the RMS of the force."""
    law, used = _LAWS[name], paths.is_measured
    beside, force = paths.beside, paths.force[used]

    def left(points: Float[np.ndarray, "batch p"]) -> Float[np.ndarray, "n batch"]:
        given = law.parameters(list(points.T), stiffness, strength)
        parameters = {key: np.broadcast_to(np.asarray(value, dtype=float), len(points)) for key, value in given.items()}
        found = np.asarray(_forces(law.name, parameters, paths.elongation))[:, used].T / strength
        # A diverged simulation counts as a large residual.
        rest = force[:, None] - np.where(np.abs(found) < 1e3, found, 1e3)
        return rest - beside @ (beside.T @ rest)

    def moved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A point, and points a little off it, away from the upper bound."""
        steps = np.where(x + _STEP > law.high, -_STEP, _STEP)
        return x + np.concatenate([np.zeros((1, len(x))), np.diag(steps)]), steps

    def slopes(x: np.ndarray) -> np.ndarray:
        points, steps = moved(x)
        here = left(points)
        return (here[:, 1:] - here[:, :1]) / steps

    bounds: Any = (law.low, law.high)
    jac: Any = slopes
    fit = least_squares(lambda x: left(moved(x)[0])[:, 0], law.start, jac, bounds, x_scale="jac", max_nfev=40)
    return math.sqrt(2 * fit.cost / float(force @ force))


@program
def _forces(name: str, parameters: Mapping[str, Any], elongation: Any) -> Array:
    """Forces [N] of a law with several parameters along several paths, (batch, records, samples)."""

    def along(own: Mapping[str, Any], path: Array) -> Any:
        specimen = Specimen(LAWS[name](**own))

        def step(carry: tuple[Any, Any], to: Array) -> tuple[tuple[Any, Any], Any]:
            at, memory = carry
            way = to - at
            for part in range(_PARTS):
                # The midpoint rule; along the path, time is the share of the way.
                slope = specimen.rates(at + way * part / _PARTS, way, memory)
                middle = {state: value + slope[state] / (2 * _PARTS) for state, value in memory.items()}
                slope = specimen.rates(at + way * (part + 0.5) / _PARTS, way, middle)
                memory = {state: value + slope[state] / _PARTS for state, value in memory.items()}
            force = specimen.force(to, way, memory)
            return (to, specimen.settle(to, way, memory, jnp.asarray(False))), force

        return jax.lax.scan(step, (jnp.zeros(()), specimen.start()), path)[1]

    return jax.vmap(jax.vmap(along, (None, 0)), (0, None))(parameters, elongation)
