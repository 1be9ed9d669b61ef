"""The paper's figures of a run, from its stored results over the inputs (`hsed_jax.design.over_inputs`)."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from hsed_jax.physics.names import named
from hsed_jax.physics.pairs import Pair
from hsed_jax.reporting import excitation_figures, figures
from hsed_jax.reporting.style import Picture

CHANNELS = ("elongation", "force", "energy")
"""The contents of figures 4 and 8 for a specimen."""


def excitations(stored: xr.Dataset, pair: Pair) -> Picture:
    """Fig. 3: the excitations at the distributions of the inputs."""
    (channel,) = (str(name) for name in stored.data_vars if name not in ("time", "spectrum"))
    values = stored[channel].values
    time = np.broadcast_to(stored["time"].values, values.shape)
    if channel != "ground_acceleration":
        return excitation_figures.histories(channel, time, values, pair)
    spectra = stored["spectrum"].values
    return figures.ground_motions(time[0], values[1:], values[0], stored["period"].values, spectra[1:], spectra[0])


def loops_and_energy(measured: xr.Dataset, predicted: xr.Dataset, owner: str) -> Picture:
    """Fig. 4 of a specimen: measured and predicted with the same parameters, at the first point."""
    return figures.loops_and_energy(_history(measured, 0, owner), _history(predicted, 0, owner))


def responses(measured: xr.Dataset, predicted: xr.Dataset, owner: str) -> Picture:
    """Fig. 8 of a specimen: measured and predicted by the calibrated model, at all points but the first."""
    cases = []
    for point in range(1, measured.sizes["point"]):
        title = ", ".join(
            f"{name} = {float(values[point]):.3g} {values.attrs['units']}" for name, values in measured.coords.items()
        )
        title = f"{owner}: {title}" if owner else title
        cases.append((title, _history(measured, point, owner), _history(predicted, point, owner)))
    return figures.response_comparison(cases)


def estimate_maps(stored: xr.Dataset) -> Picture:
    """Fig. 4bis: the estimate of each parameter from one experiment alone."""
    _, *inputs = (str(name) for name in stored["map"].dims)
    x, y = (stored[name].values for name in inputs)
    names, units = stored["parameter"].values.tolist(), stored["unit"].values.tolist()
    labels = {name: stored[name].attrs["units"] for name in inputs}
    return figures.estimate_maps((x, y), stored["map"].values, names, units, labels)


def _history(stored: xr.Dataset, point: int, owner: str) -> Mapping[str, np.ndarray]:
    """The histories of a specimen at a point, by the names of an only specimen; a missing channel is left out."""
    columns = {"time": "time"} | {name: named(owner, name) for name in CHANNELS}
    return {name: stored[column].values[point] for name, column in columns.items() if column in stored}
