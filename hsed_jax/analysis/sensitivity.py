"""Global sensitivity: the influence of inputs and parameters on the quantities of a study (Sobol' indices)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float
from scipy.stats import qmc, sobol_indices

from hsed_jax.analysis.calibration import simulate
from hsed_jax.config.schema import Study
from hsed_jax.drafts import write_netcdf
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.memory import check_memory
from hsed_jax.reporting.style import Picture, save
from hsed_jax.reporting.sweep_figures import sensitivity_bars
from hsed_jax.study.build import Built
from hsed_jax.tables import Table, Tabular, cell

_RESAMPLES = 500
_CONFIDENCE = 0.9


@dataclass(frozen=True, repr=False)
class Sensitivity(Tabular):
    """Sobol' indices of quantities.

    Attributes:
        indices: `first_order` and `total_order`, each with its 90 % bootstrap interval (`first_order_low`,
            `first_order_high`, `total_order_low`, `total_order_high`), all (quantity, variable).
        simulations: their number.
    """

    indices: xr.Dataset
    simulations: int

    @property
    def negligible(self) -> list[str]:
        """Variables whose total-order index is below 5 % for every quantity, interval included."""
        above = self.indices["total_order_high"].max("quantity")
        return [str(name) for name in above["variable"].values[above.values < 0.05]]

    def write(self, folder: str | Path) -> None:
        """Write `indices.nc` and the figure, `sensitivity.png` and `.svg`, into a folder.

        Raises:
            UserError: it cannot be written to.
        """
        try:
            save(self.figure(), folder, "sensitivity")
            write_netcdf(Path(folder) / "indices.nc", self.indices)
        except OSError as error:
            raise UserError(f"{folder} cannot be written to ({error.strerror}); choose another folder") from None

    def figure(self) -> Picture:
        """The indices as bars, a panel per quantity."""
        return sensitivity_bars(self.indices)

    def _table(self) -> Table:
        indices = self.indices
        quantities = [str(name) for name in indices["quantity"].values]
        rows = []
        for name in indices["variable"].values:
            one = indices.sel(variable=name)
            cells = []
            for quantity in quantities:
                at = one.sel(quantity=quantity)
                low, high = (cell(float(at[f"total_order_{end}"]), ".2f") for end in ("low", "high"))
                cells.append(f"{cell(float(at['total_order']), '.2f')} ({low} to {high})")
            rows.append((str(name), *cells))
        small = ", ".join(self.negligible) or "none"
        sentence = (
            f"total-order Sobol' indices of {self.simulations} simulations; below 5 % for every quantity: {small}"
        )
        return Table(sentence, ("variable", *quantities), rows, ("in brackets the 90 % interval of the bootstrap",))


def sensitivity(study: Study, samples: int = 1024) -> Sensitivity:
    """Sobol' indices of a study's quantities over its inputs and its model's free parameters.

    The variables follow their distributions in the study (inputs, priors of parameters), independently of each other. The
    first-order index is the share of a quantity's variance that a variable explains alone. The total-order index is the
    remaining share if all other variables are known (Saltelli et al. 2010, by `scipy.stats.sobol_indices`).

    Arguments:
        study: with a ground motion; to hold a variable fixed, give it a number instead of its distribution.
        samples: N, a power of two; N (d + 2) simulations are made for d variables.

    Raises:
        UserError: nothing varies, the ground motion is missing, N is not a power of two or more than memory holds, or a
            simulation diverges.
    """
    built = Built(study)
    if built.experiments.excitation is None:
        raise UserError("excitation: Sobol' indices need an excitation of the experiments, such as near_fault_pulse")
    inputs, parameters = built.experiments.space.priors, built.mechanics.parameters[0]
    # An input and a parameter may have one name: gamma of the pulse and of the law.
    names = {name: f"{name} (law)" if name in inputs else name for name in parameters}

    def quantities(x: Float[np.ndarray, "d N"]) -> Float[np.ndarray, "s N"]:
        at_inputs = dict(zip(inputs, x, strict=False))
        at_parameters = dict(zip(parameters, x[len(inputs) :], strict=True))
        response = simulate(study, at_inputs, at_parameters, channels=())
        if diverged := int(np.sum(~np.asarray(response.ok))):
            raise UserError(
                f"{diverged} of {x.shape[1]} simulations diverge; narrow the distributions of {', '.join(names)}"
            )
        return np.stack([np.asarray(response.quantities[name]) for name in study.quantities])

    variables = {**inputs, **{names[name]: prior for name, prior in parameters.items()}}
    return indices_of(quantities, variables, study.quantities, samples, study.seed)


def indices_of(
    function: Callable[[Float[np.ndarray, "d N"]], Float[np.ndarray, "s N"]],
    variables: Mapping[str, Prior],
    quantities: list[str],
    samples: int,
    seed: int,
) -> Sensitivity:
    """Sobol' indices of any function.

    Arguments:
        function: from N points of the d variables, (d, N), to the s quantities, (s, N).
        variables: distribution by name.
        quantities: names of the outputs of the function.
        samples: N, a power of two.
        seed: of the points and of the bootstrap.

    Raises:
        UserError: there are no variables, N is not a power of two, or more than memory holds.
    """
    if not variables:
        raise UserError("nothing varies: the study has neither inputs nor free parameters")
    if samples < 2 or samples.bit_count() != 1:
        raise UserError(f"samples: this must be a power of two, such as 1024, but it is {samples}")
    random, d = np.random.default_rng(seed), len(variables)
    # The points three times (both samples, mixed, as values of the variables), the simulations, and the bootstrap.
    numbers = 3 * d * (d + 2) + len(quantities) * (d + 2) + _RESAMPLES
    check_memory(f"samples: {samples}", 8 * samples * numbers)
    cube = qmc.Sobol(2 * d, rng=random).random(samples).T
    a, b = cube[:d], cube[d:]
    # A, B, and for each variable A with the values of B.
    cubes = np.stack([a, b, *(np.where(np.arange(d)[:, None] == i, b, a) for i in range(d))], axis=1)
    points = [prior.quantile(row.ravel()) for prior, row in zip(variables.values(), cubes, strict=True)]
    values = np.asarray(function(np.stack(points))).reshape(len(quantities), d + 2, samples).transpose(1, 0, 2)
    found, again = _indices(values), random.integers(0, samples, (_RESAMPLES, samples))
    # SciPy's own bootstrap cannot be given a seed.
    spread = np.stack([_indices(values[..., chosen]) for chosen in again])
    low, high = np.quantile(spread, [(1 - _CONFIDENCE) / 2, (1 + _CONFIDENCE) / 2], axis=0)
    tables = {}
    for number, kind in enumerate(("first_order", "total_order")):
        tables |= {kind: found[number], f"{kind}_low": low[number], f"{kind}_high": high[number]}
    dims = ("quantity", "variable")
    indices = xr.Dataset(
        {name: (dims, table) for name, table in tables.items()},
        {"quantity": quantities, "variable": list(variables)},
    )
    return Sensitivity(indices, samples * (d + 2))


def _indices(values: Float[np.ndarray, "d_and_2 s N"]) -> Float[np.ndarray, "2 s d"]:
    """First-order and total-order indices from the quantities at A, at B, and at A with each variable's values of B."""
    at = {"f_A": values[0].copy(), "f_B": values[1].copy(), "f_AB": values[2:].copy()}
    found = sobol_indices(func=at, n=values.shape[-1])
    shape = (values.shape[1], values.shape[0] - 2)
    return np.stack([np.reshape(found.first_order, shape), np.reshape(found.total_order, shape)])
