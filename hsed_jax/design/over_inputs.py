"""Tables of a study over the space of its inputs: the excitation of the experiments, the responses of specimen and model, the
estimate from one experiment alone, and the surrogate of the discrepancy.

Every table is an `xarray.Dataset` whose variables have their units and meanings as attributes; the run stores them, and
figures draw them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Array, Float

from hsed_jax.design.sequential import DesignState, SequentialDesign
from hsed_jax.design.space import InputSpace
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.posterior import Posterior
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.physics.excitations import channels_of
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.simulator import AbstractModel, Conditions
from hsed_jax.physics.spectra import response_spectrum
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.programs import program

_REALISATIONS = 200
_PERIODS = np.linspace(0.05, 3.0, 60)
_MAP_SIDE = 13
_GRID = 41
_TIME = {"units": "s", "long_name": "time"}


def excitations(model: AbstractModel, space: InputSpace, pair: Pair) -> xr.Dataset:
    """The excitation: `ground_acceleration` with its `spectrum`, or another channel alone.

    Arguments:
        model: with an excitation.
        space: of its inputs.
        pair: that the specimens are measured in.

    Returns:
        In single precision the channel (realisation, sample); `time` (sample) or, where how long it lasts depends on the
        inputs, (realisation, sample), and for ground motions the pseudo-acceleration `spectrum` (realisation, period) at 5 %
        damping.  The first realisation is at the middle of the inputs' distributions, the others are spread as these are.
    """
    assert model.excitation is not None and model.timeline is not None
    excitation = model.excitation
    step, steps, _ = model.timeline
    # At half steps, as the integrator sees it.
    half = Timeline(None if step is None else 0.5 * step, 2 * steps)

    @jax.jit
    @jax.vmap
    def motions(inputs):
        one = excitation(inputs)
        time = times(one.step_length(half), 1, half.samples)
        return time, channels_of(jax.vmap(one.sample)(time))

    middle = np.full((1, len(space.names)), 0.5)
    declared = space.declared(np.concatenate([middle, space.spread(_REALISATIONS)]))
    time, found = motions({k: jnp.asarray(v) for k, v in space.si(declared).items()})
    ((channel, values),) = found.items()
    dims, time = ("realisation", "sample"), np.asarray(time)
    table: dict[str, Any] = {
        "time": ("sample", time[0], _TIME) if (time == time[0]).all() else (dims, time.astype(np.float32), _TIME),
        channel: (dims, np.asarray(values, dtype=np.float32), _said(pair, channel)),
    }
    coords = _at(space, declared, "realisation")
    if channel == "ground_acceleration":
        assert half.step is not None
        spectra = jax.jit(jax.vmap(lambda one: response_spectrum(one, half.step, jnp.asarray(_PERIODS))))(values)
        said = {"units": "m/s^2", "long_name": "pseudo-acceleration at 5 % damping"}
        table["spectrum"] = (("realisation", "period"), np.asarray(spectra), said)
        coords["period"] = ("period", _PERIODS, {"units": "s", "long_name": "natural period"})
    return xr.Dataset(table, coords)


def responses(
    model: AbstractModel,
    parameters: Mapping[str, float],
    space: InputSpace,
    cube: Float[np.ndarray, "n d"],
    channels: Sequence[str],
    pair: Pair,
) -> xr.Dataset:
    """The response of a model at some points of its input space.

    Arguments:
        model: with an excitation.
        parameters: by name, SI.
        space: of its inputs.
        cube: the points, in the unit cube.
        channels: histories to keep; those that the model does not have are left out.
        pair: that the specimens are measured in.

    Returns:
        `time` and the channels, SI, (point, sample).
    """
    wanted = tuple(name for name in channels if model.gives(name))
    known = {name: jnp.asarray(value) for name, value in parameters.items()}
    declared, histories = space.declared(cube), []
    for point in range(len(cube)):
        si = space.si(declared[point : point + 1])
        conditions = Conditions({name: jnp.asarray(values[0]) for name, values in si.items()})
        time = model.times(conditions.inputs)
        histories.append({"time": time, **model.respond(known, conditions, wanted).channels})
    table = {
        name: (("point", "sample"), np.stack([np.asarray(one[name]) for one in histories]), about)
        for name, about in {"time": _TIME, **{name: _said(pair, name) for name in wanted}}.items()
    }
    return xr.Dataset(table, _at(space, declared, "point"))


def estimates_alone(design: SequentialDesign, laboratory: VirtualLaboratory, units: Mapping[str, str]) -> xr.Dataset:
    """The estimate of each parameter from one experiment alone, without noise, over two inputs.

    Arguments:
        design: of two inputs, of quantities.
        laboratory: the specimen.
        units: SI unit by parameter.

    Returns:
        `map` (parameter, first input, second input), SI: a calibration for each point of the grid.
    """
    axis = (np.arange(_MAP_SIDE) + 0.5) / _MAP_SIDE
    space, posterior, alone = design.space, design.posterior, replace(design, size=1)
    starts, nothing = posterior.starts(4), alone.init()

    def data(cube: tuple[float, float]) -> Data:
        point = space.point(np.asarray(cube))
        return alone.data(alone.tell(nothing, cube, list(laboratory.exact(point.si).values())))

    everywhere = jax.tree.map(lambda *leaves: np.stack(leaves), *(data(cube) for cube in product(axis, axis)))
    thetas = np.asarray(_estimates(posterior, everywhere, starts))
    values = thetas.T.reshape(-1, _MAP_SIDE, _MAP_SIDE)
    said = {"long_name": "most probable value from one experiment alone, in the unit of the parameter"}
    names = list(posterior.names)
    coords = _grid(space, axis) | {
        "parameter": names,
        "unit": ("parameter", [units.get(name, "1") for name in names]),
    }
    return xr.Dataset({"map": (("parameter", *space.names), values, said)}, coords)


@program
def _estimates(posterior: Posterior, experiments: Data, starts: Float[Array, "s p"]) -> Float[Array, "m p"]:
    """The MAP of each of m experiments by itself."""
    import optimistix as optx  # imported here, because only figures need it

    # A contour needs only three digits, without evidence and covariance: this costs a tenth of `maximise`.
    def descend(data: Data, start: Array) -> tuple[Array, Array]:
        solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-5)
        end = optx.least_squares(
            lambda u, _: posterior.residuals(u, data), solver, start, max_steps=60, throw=False
        ).value
        return end, jnp.sum(posterior.residuals(end, data) ** 2)

    def estimate(data: Data) -> Array:
        ends, squares = jax.lax.map(lambda start: descend(data, start), starts)
        return posterior.constrain(ends[jnp.nanargmin(squares)])

    return jax.lax.map(estimate, experiments)


def surrogate(design: SequentialDesign, state: DesignState, step: Mapping[str, Any]) -> xr.Dataset:
    """The Kriging of the discrepancy at a step, on a grid of the inputs (up to two) or by its hyper-parameters alone.

    Arguments:
        design, state: whose step it was.
        step: as in the journal.
    """
    kriging = design.surrogate(state, step["discrepancy"], step["kriging"]["lengths"], step["kriging"]["nugget"])
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
    mean, variance = kriging.predict(jax.device_put(mesh.reshape(-1, len(space.names))))
    shape = (_GRID,) * len(space.names)
    mean, sd = (np.asarray(values).reshape(shape) for values in (mean, np.sqrt(np.asarray(variance))))
    said = {"units": "1", "long_name": "Kriging mean of the discrepancy (Eq. 12)"}
    maps = {
        "discrepancy_mean": (space.names, mean, said),
        "discrepancy_sd": (space.names, sd, said | {"long_name": "standard deviation of the Kriging"}),
    }
    return xr.Dataset(hyper | maps, _grid(space, axis) | {"input": list(space.names)})


def _said(pair: Pair, name: str) -> dict[str, str]:
    """Unit and meaning of a channel."""
    known = pair.output(name)
    return {"units": known.unit, "long_name": known.meaning}


def _at(space: InputSpace, declared: np.ndarray, dimension: str) -> dict[str, Any]:
    """The inputs of rows of a table, in their declared units."""
    return {name: (dimension, declared[:, i], {"units": space.units[name]}) for i, name in enumerate(space.names)}


def _grid(space: InputSpace, axis: np.ndarray) -> dict[str, Any]:
    """The inputs along the axes of a grid, in their declared units."""
    along = space.declared(np.repeat(axis[:, None], len(space.names), axis=1))
    return {name: (name, along[:, i], {"units": space.units[name]}) for i, name in enumerate(space.names)}
