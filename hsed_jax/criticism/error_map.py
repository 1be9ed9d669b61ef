"""The error over the inputs: of each experiment, and by Kriging in between."""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Float

from hsed_jax.criticism.compare import Comparison
from hsed_jax.design.kriging import fit_kriging
from hsed_jax.measurements import Campaign, Experiment

# Fewer experiments give no map, and with more Kriging takes minutes.
_FEWEST, _MOST = 5, 300
_GRID = 61


def error_map(comparison: Comparison, campaign: Campaign) -> xr.Dataset | None:
    """Squared error of each experiment over the inputs that vary, and its Kriging in between.

    Arguments:
        comparison: of at least two experiments.
        campaign: the units of its inputs.

    Returns:
        By `experiment` its `split`, `squared_error` relative to the variance of the measurement, and inputs `at` (experiment,
        input); `squared_error_mean` and `squared_error_sd` on a grid of the inputs, if the number of experiments is suitable.
        None unless one or two inputs vary.
    """
    found = list(_squared_errors(comparison))
    inputs = {n: np.asarray([campaign.unit(n).from_si(e.inputs[n]) for e, _, _ in found]) for n in campaign.inputs}
    inputs = {name: values for name, values in inputs.items() if values.size and np.ptp(values) > 0}
    if len(inputs) not in (1, 2):
        return None
    names, points = list(inputs), np.stack(list(inputs.values()), axis=1)
    errors = np.asarray([error for _, _, error in found])
    said = {"units": "1", "long_name": "squared error over the variance of the measurement"}
    low, span = points.min(axis=0), np.ptp(points, axis=0)
    # A little larger than the range of the experiments.
    grid = [np.linspace(a - 0.06 * s, a + 1.06 * s, _GRID) for a, s in zip(low, span, strict=True)]
    table: dict[str, Any] = {
        "at": (("experiment", "input"), points, {"long_name": "inputs in their declared units"}),
        "split": ("experiment", [split for _, split, _ in found]),
        "squared_error": ("experiment", errors, said),
    }
    if _FEWEST <= errors.size <= _MOST:
        mean, sd = _kriged(
            (points - low) / span, errors, [(g - a) / s for g, a, s in zip(grid, low, span, strict=True)]
        )
        table["squared_error_mean"] = (names, mean, said | {"long_name": "Kriging mean of the squared error"})
        table["squared_error_sd"] = (names, sd, said | {"long_name": "Kriging standard deviation of the squared error"})
    axes = {n: (n, along, {"units": campaign.unit(n).text}) for n, along in zip(names, grid, strict=True)}
    return xr.Dataset(table, axes | {"experiment": [e.id for e, _, _ in found], "input": names})


def _squared_errors(comparison: Comparison) -> Iterator[tuple[Experiment, str, float]]:
    """Every experiment, its split and its squared error, averaged over the outputs; experiments without an error are
    left out.
    """
    reference = comparison.train.per_output
    for name, split, prediction in comparison.splits():
        histories = prediction.groups.size > len(prediction.outputs)
        for experiment in prediction.experiments:
            squares = []
            for output, values in split.per_experiment.get(experiment.id, {}).items():
                # A history is relative to itself; a quantity to its spread over the training experiments, in both splits.
                scale = values["scale"] if histories else reference.get(output, values)["scale"]
                squares.append((values["nrmse"] * values["scale"] / scale) ** 2)
            if squares and np.isfinite(squares).all():
                yield experiment, name, float(np.mean(squares))


def _kriged(
    points: Float[np.ndarray, "n d"], errors: Float[np.ndarray, " n"], grid: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Kriging mean and sd of the squared errors on a grid, both in the unit cube of the experiments."""
    mesh = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1)
    known = jnp.ones(errors.size, dtype=bool)
    model = fit_kriging(jnp.asarray(points), jnp.asarray(errors), known, key=jax.random.key(0))
    mean, variance = model.predict(jnp.asarray(mesh.reshape(-1, points.shape[1])))
    # A squared error is not negative, but a Gaussian process may be.
    mean, sd = np.maximum(np.asarray(mean), 0.0), np.sqrt(np.asarray(variance))
    return mean.reshape(mesh.shape[:-1]), sd.reshape(mesh.shape[:-1])
