"""The remainder: what a model of a component test leaves of the measured force, learned as a function of the path.

The elongation of a component test is imposed. The force of any rate-independent specimen is therefore a function of the path of
the elongation so far, and so is the residual of its model, whatever physics the model lacks. A Kriging model describes this
residual over features of the path and predicts it on similar paths, with a band. On paths unlike the fitted ones it returns to
the mean residual, and its band is as wide as the residual.

The features are the elongation, the direction of motion, the last two turning points, the largest and the smallest elongation so
far, and the length of the path so far. Each has its own correlation length.

The remainder has no name: it corrects predictions, and it does not state an effect. Source: Kennedy & O'Hagan 2001,
doi:10.1111/1467-9868.00294, whose model discrepancy is learned together with the parameters; here the parameters stay.
"""

from dataclasses import dataclass, replace
from typing import final

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.criticism.prediction import Band, Prediction, noise_sizes
from hsed_jax.design.kriging import Kriging, condition, fit_kriging
from hsed_jax.errors import UserError
from hsed_jax.measurements import Experiment
from hsed_jax.measurements.turns import with_slips

_FEATURES = 7
# Samples that determine the correlation lengths, and samples that the prediction uses.  The first cost the cube of their number
# at each step of the search.  1000 of the second lower the errors of two walls from 0.026 to 0.023 and from 0.046 to 0.045.
_SEARCHED, _CONDITIONED = 200, 400
# Samples that are predicted together: one program serves campaigns of all lengths.
_BLOCK = 1024
_LEAST = 20
"""Fewer fitted samples determine no correlation lengths."""


@final
@dataclass(frozen=True)
class Remainder:
    """The residual of a model as a function of the path of the elongation.

    Attributes:
        kriging: of measured minus predicted force [N], over features in the unit cube of the fitted ones.
        low, reach: smallest value and range of each feature of the fitted samples, (7,).
        declared: whether the noise of the force is declared.
    """

    kriging: Kriging
    low: np.ndarray
    reach: np.ndarray
    declared: bool

    def corrected(self, prediction: Prediction) -> Prediction:
        """Predictions with the remainder added.

        The part `model` of the band becomes that of the remainder. It replaces the error that was inferred from the residual of
        the model. `without` is the band before.
        """
        features = (_features_of(prediction) - self.low) / self.reach
        recorded = np.isfinite(features[..., 0])
        correction, variance = np.zeros(recorded.shape), np.zeros(recorded.shape)
        correction[recorded], variance[recorded] = self._at(features[recorded])
        noise = noise_sizes(prediction, prediction.outputs[0], self.declared)
        parts = {**prediction.parts, "noise": noise, "model": np.sqrt(np.maximum(variance - noise**2, 0.0))}
        return replace(
            prediction,
            predicted=prediction.predicted + correction,
            mean=prediction.mean + correction,
            sd=np.sqrt(sum(part**2 for part in parts.values())),
            parts=parts,
            without=Band(prediction.mean, dict(prediction.parts)),
        )

    def _at(self, features: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean [N] and variance [N²] of a measurement at features in the unit cube, (m,) each."""
        size = len(features)
        blocks = np.split(np.pad(features, ((0, -size % _BLOCK), (0, 0))), -(-size // _BLOCK))
        found = [self.kriging.predict(jnp.asarray(block)) for block in blocks]
        mean, variance = (np.concatenate(part)[:size] for part in zip(*found, strict=True))
        return mean, variance + float(self.kriging.nugget * self.kriging.process_variance)


def can_be_learned(fitted: Prediction) -> bool:
    """Whether there are 20 fitted samples of one force, and elongations without gaps."""
    is_recorded = all(np.isfinite(_elongation(experiment)).all() for experiment in fitted.experiments)
    return len(fitted.outputs) == 1 and is_recorded and int(_learned_from(fitted).sum()) >= _LEAST


def remainder_of(fitted: Prediction, declared: bool) -> Remainder:
    """Learn the remainder from the fitted experiments.

    Arguments:
        fitted: predictions of the force of component tests, one output.
        declared: whether its noise is declared; otherwise it is what the records show.

    Raises:
        UserError: `can_be_learned` is false.
    """
    if not can_be_learned(fitted):
        raise UserError(
            f"a remainder is learned from at least {_LEAST} fitted samples of one force whose elongation was recorded without "
            "gaps"
        )
    rows = np.flatnonzero(_learned_from(fitted))
    every = _features_of(fitted).reshape(-1, _FEATURES)
    low, high = every[rows].min(axis=0), every[rows].max(axis=0)
    reach = np.where(high > low, high - low, 1.0)
    inputs, residual = (every - low) / reach, -fitted.residual.ravel()

    def part(size: int) -> tuple[jax.Array, jax.Array, jax.Array]:
        # Padded: campaigns of all lengths share the programs.
        chosen = rows[np.unique(np.linspace(0, rows.size - 1, min(size, rows.size)).astype(int))]
        empty = size - chosen.size
        return (
            jnp.asarray(np.pad(inputs[chosen], ((0, empty), (0, 0)))),
            jnp.asarray(np.pad(residual[chosen], (0, empty))),
            jnp.asarray(np.arange(size) < chosen.size),
        )

    found = fit_kriging(*part(_SEARCHED), starts=1, key=jax.random.key(0))
    return Remainder(condition(*part(_CONDITIONED), found.lengths, found.nugget), low, reach, declared)


def _features_of(prediction: Prediction) -> np.ndarray:
    """Features of the path at every column of every experiment, (n, J, 7); NaN beyond the end of a record."""
    found = np.full((*prediction.used.shape, _FEATURES), np.nan)
    for row, experiment in enumerate(prediction.experiments):
        features = path_features(_elongation(experiment))
        found[row, : len(features)] = features
    return found


def _elongation(experiment: Experiment) -> np.ndarray:
    """The elongation of an experiment; NaN if it was not recorded."""
    record = experiment.record
    return np.full(2, np.nan) if record is None else record.channels.get("elongation", np.full(len(record), np.nan))


def _learned_from(fitted: Prediction) -> np.ndarray:
    """The fitted samples, (n, J)."""
    return fitted.used & ~fitted.diverged[:, None]


def path_features(elongation: np.ndarray) -> np.ndarray:
    """Features of the path of an elongation at each sample, (m, 7).

    The elongation [m]; the direction of motion; the last two turning points [m]; the largest and the smallest elongation so far
    [m]; the length of the path so far [m]. Turns are those that exceed the noise of the record.
    """
    ends = with_slips(elongation)
    # A turning point is the end of the branch before it, on which its force still is.
    which = np.clip(np.searchsorted(ends, np.arange(elongation.size)) - 1, 0, ends.size - 2)
    points = elongation[ends]
    ways, last = np.diff(points), points[which]
    behind = np.concatenate([[0.0], np.cumsum(np.abs(ways))])[which]
    return np.column_stack(
        [
            elongation,
            np.sign(ways)[which],
            last,
            np.concatenate([[0.0], points])[which],
            np.maximum.accumulate(elongation),
            np.minimum.accumulate(elongation),
            behind + np.abs(elongation - last),
        ]
    )
