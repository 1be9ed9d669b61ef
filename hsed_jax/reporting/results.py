"""`results.nc`: posterior, statistics of the sampler, predictions, design and surrogate as one xarray DataTree.

The groups `posterior`, `sample_stats` and `observed_data` are ArviZ's, so ArviZ opens the file as it is.
"""

import jax.numpy as jnp
import numpy as np
import xarray as xr

from hsed_jax.physics.outputs import output
from hsed_jax.reporting.outcome import Outcome

_GRID = 41


def results_tree(outcome: Outcome) -> xr.DataTree:
    """Collect the results of a run; groups of steps that did not run are absent."""
    groups: dict[str, xr.Dataset] = {}
    if outcome.fit is not None:
        groups |= _posterior(outcome)
    if outcome.state is not None:
        groups |= _experiments(outcome)
        if outcome.steps:
            groups["design"] = _design(outcome)
            groups["surrogate"] = _surrogate(outcome)
    tree = xr.DataTree.from_dict(groups)
    tree.attrs["study"] = outcome.study
    return tree


def _posterior(outcome: Outcome) -> dict[str, xr.Dataset]:
    assert outcome.fit is not None
    chains = outcome.fit.chains
    dims = ("chain", "draw")
    draws = {
        name: (dims, np.asarray(chains.theta[..., i]), {"units": outcome.units.get(name, "1")})
        for i, name in enumerate(outcome.posterior.names)
    }
    stats = {
        "lp": (dims, np.asarray(chains.log_density)),
        "diverging": (dims, np.asarray(chains.diverging)),
        "n_steps": (dims, np.asarray(chains.steps)),
    }
    shape = np.shape(chains.diverging)
    coords = {"chain": np.arange(shape[0]), "draw": np.arange(shape[1])}
    return {"posterior": xr.Dataset(draws, coords), "sample_stats": xr.Dataset(stats, coords)}


def _experiments(outcome: Outcome) -> dict[str, xr.Dataset]:
    state = outcome.state
    assert state is not None
    space = outcome.design.space
    declared = space.declared(state.cube[: state.count])
    names = [f"E{i + 1:02d}" for i in range(state.count)]
    coords: dict = {"experiment": names}
    coords |= {name: ("experiment", declared[:, i], {"units": space.units[name]}) for i, name in enumerate(space.names)}

    def quantities(values: np.ndarray) -> xr.Dataset:
        columns = {
            name: ("experiment", values[:, j], {"units": output(name).unit})
            for j, name in enumerate(outcome.quantities)
        }
        return xr.Dataset(columns, coords)

    groups = {"observed_data": quantities(state.outputs[: state.count])}
    if outcome.fit is not None:
        groups["predictions"] = quantities(outcome.predicted)
    return groups


def _design(outcome: Outcome) -> xr.Dataset:
    names = list(outcome.posterior.names)
    steps = outcome.steps
    table = {
        "max_expected_improvement": ("step", [step["max_expected_improvement"] for step in steps]),
        "acquisition": ("step", [step["acquisition"] for step in steps]),
        "log_evidence": ("step", [step["log_evidence"] for step in steps]),
        "divergences": ("step", [step["divergences"] for step in steps]),
        "map": (("step", "parameter"), [[step["map"][n] for n in names] for step in steps]),
    }
    for statistic in ("mean", "sd", "q05", "q95", "ess_bulk", "rhat"):
        table[statistic] = (("step", "parameter"), [[step["posterior"][n][statistic] for n in names] for step in steps])
    return xr.Dataset(table, {"step": np.arange(len(steps)), "parameter": names})


def _surrogate(outcome: Outcome) -> xr.Dataset:
    """The last Kriging of the discrepancy on a grid of the inputs (up to two) or at its training points."""
    design, state = outcome.design, outcome.state
    assert state is not None
    last = outcome.steps[-1]
    kriging = design.surrogate(state, last["discrepancy"], last["kriging"]["lengths"], last["kriging"]["nugget"])
    space = design.space
    hyper = {
        "length": ("input", np.asarray(kriging.lengths)),
        "nugget": ((), float(kriging.nugget)),
        "process_variance": ((), float(kriging.process_variance)),
    }
    if len(space.names) > 2:
        return xr.Dataset(hyper, {"input": list(space.names)})
    axis = (np.arange(_GRID) + 0.5) / _GRID
    mesh = np.stack(np.meshgrid(*[axis] * len(space.names), indexing="ij"), axis=-1)
    mean, variance = kriging.predict(jnp.asarray(mesh.reshape(-1, len(space.names))))
    along = space.declared(np.repeat(axis[:, None], len(space.names), axis=1))
    coords: dict = {name: (name, along[:, i], {"units": space.units[name]}) for i, name in enumerate(space.names)}
    shape = (_GRID,) * len(space.names)
    maps = {
        "discrepancy_mean": (space.names, np.asarray(mean).reshape(shape)),
        "discrepancy_sd": (space.names, np.sqrt(np.asarray(variance)).reshape(shape)),
    }
    return xr.Dataset(hyper | maps, coords | {"input": list(space.names)})
