"""The draws of a calibration as ArviZ reads them: the groups `posterior` and `sample_stats`."""

from typing import Any

import numpy as np
import xarray as xr

from hsed_jax.inference.fit import Fit


def draws_of(fit: Fit) -> dict[str, xr.Dataset]:
    """Draws of every parameter (SI, the unit as an attribute) and statistics of the sampler, by chain and draw."""
    chains = fit.chains
    dims = ("chain", "draw")
    draws: dict[str, Any] = {
        name: (dims, np.asarray(chains.theta)[..., i], {"units": fit.units.get(name, "1")})
        for i, name in enumerate(fit.names)
    }
    stats = {
        "lp": (dims, np.asarray(chains.log_density)),
        "diverging": (dims, np.asarray(chains.diverging)),
        "n_steps": (dims, np.asarray(chains.steps)),
    }
    shape = np.shape(chains.diverging)
    coords: dict = {"chain": np.arange(shape[0]), "draw": np.arange(shape[1])}
    for level, own in zip(fit.posterior.population.levels, fit.of_members, strict=True):
        for v in level.varying:
            about = {"units": fit.units.get(v.name, "1")}
            draws[f"{level.name}.{v.name}"] = ((*dims, level.name), own[..., v.column], about)
        coords[level.name] = list(level.members)
    of_stats = {name: coords[name] for name in dims}
    return {"posterior": xr.Dataset(draws, coords), "sample_stats": xr.Dataset(stats, of_stats)}
