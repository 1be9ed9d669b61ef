"""The paper's figures of a run, from its outcome."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hsed_jax.design.sequential import DesignState, SequentialDesign
from hsed_jax.design.space import InputSpace
from hsed_jax.inference.fit import Fit
from hsed_jax.inference.likelihood import Data
from hsed_jax.inference.maximum import least_squares
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.physics.excitations import channels_of
from hsed_jax.physics.outputs import named, of_each
from hsed_jax.physics.simulator import AbstractModel, Conditions, Simulator
from hsed_jax.physics.spectra import response_spectrum
from hsed_jax.physics.timeline import Timeline, times
from hsed_jax.reporting import excitation_figures, figures
from hsed_jax.reporting.figures import Picture
from hsed_jax.reporting.outcome import Outcome

_MOTIONS = 200
_MAP_SIDE = 13
_CHANNELS = ("elongation", "force", "energy")


def design_pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    """The paper's figures, by file name, as far as the outcome has the material: a pulse, a design, a virtual specimen."""
    space, laboratory = outcome.space, outcome.laboratory
    has_motion = outcome.model.excitation is not None and bool(space.names)
    if laboratory is not None and has_motion:
        yield "fig3_excitation", excitations(outcome.model, space)
        yield from _of_specimen(outcome, laboratory)
    if outcome.design is not None and outcome.state is not None:
        # Thousands of calibrations: of a program each would be a day's work.
        quick = isinstance(outcome.model, Simulator)
        if quick and laboratory is not None and len(space.names) == 2 and not laboratory.channels:
            yield "fig4bis_one_experiment_map", _estimate_maps(outcome, outcome.design, laboratory)
        yield "fig6_exploration", exploration(outcome, outcome.state)
        if outcome.steps:
            yield "fig5_expected_improvement", expected_improvement(outcome)
            yield "fig7_estimates", estimates(outcome)
    if outcome.fit is not None and laboratory is not None and has_motion:
        for owner in outcome.model.owners:
            if all(map(outcome.model.gives, of_each([owner], _CHANNELS))):
                yield _file("fig8_responses", owner), _responses(outcome, laboratory, outcome.fit, owner)


def _of_specimen(outcome: Outcome, laboratory: VirtualLaboratory) -> Iterator[tuple[str, Picture]]:
    space = outcome.space
    middle = space.declared(np.full((1, len(space.names)), 0.5))[0]
    of_effects = tuple(f"{effect}." for effect in laboratory.simulator.effects)
    truth = {name: value for name, value in laboratory.parameters.items() if not name.startswith(of_effects)}
    model = outcome.model
    if isinstance(model, Simulator) and not model.effects and model.elements == laboratory.simulator.elements:
        for owner in model.owners:
            measured = _response(laboratory.simulator, laboratory.parameters, space, middle, owner)
            predicted = _response(model, truth, space, middle, owner)
            yield _file("fig4_loops_and_energy", owner), figures.loops_and_energy(measured, predicted)


def exploration(outcome: Outcome, state: DesignState) -> Picture:
    """Fig. 6 of a run with a design."""
    space = outcome.space
    declared = space.declared(state.cube)
    return figures.exploration_order(declared, outcome.initial, space.bounds(), space.units)


def expected_improvement(outcome: Outcome) -> Picture:
    """Fig. 5 of a run with steps of a design."""
    return figures.expected_improvement_history([step["max_expected_improvement"] for step in outcome.steps])


def estimates(outcome: Outcome) -> Picture:
    """Fig. 7 of a run with steps of a design, the parameters of a virtual specimen as reference."""
    names = outcome.posterior.names
    units = [outcome.units.get(name, "1") for name in names]
    truth = {} if outcome.laboratory is None else outcome.laboratory.parameters
    return figures.estimate_history(outcome.estimates, outcome.band("q05"), outcome.band("q95"), names, units, truth)


def excitations(model: AbstractModel, space: InputSpace) -> Picture:
    """Fig. 3 of a model with an excitation: what its inputs' distribution makes of it."""
    assert model.excitation is not None and model.timeline is not None
    excitation = model.excitation
    step, steps, _ = model.timeline
    # Half a step finer than the integration: what the integrator sees.
    half = Timeline(None if step is None else 0.5 * step, 2 * steps)

    @jax.jit
    @jax.vmap
    def motions(inputs):
        one = excitation(inputs)
        time = times(one.step_length(half), 1, half.samples)
        return time, channels_of(jax.vmap(one.sample)(time))

    middle = np.full((1, len(space.names)), 0.5)
    inputs = space.si(space.declared(np.concatenate([middle, space.spread(_MOTIONS)])))
    time, found = motions({k: jnp.asarray(v) for k, v in inputs.items()})
    ((channel, values),) = found.items()
    if channel != "ground_acceleration":
        return excitation_figures.histories(channel, np.asarray(time), np.asarray(values))
    periods = jnp.linspace(0.05, 3.0, 60)
    assert half.step is not None
    spectra = jax.jit(jax.vmap(lambda one: response_spectrum(one, half.step, periods)))(values)
    values, spectra = np.asarray(values), np.asarray(spectra)
    return figures.ground_motions(
        np.asarray(time[0]), values[1:], values[0], np.asarray(periods), spectra[1:], spectra[0]
    )


def _estimate_maps(outcome: Outcome, design: SequentialDesign, laboratory: VirtualLaboratory) -> Picture:
    """MAP of the parameters from a single experiment, over the two inputs."""
    axis = (np.arange(_MAP_SIDE) + 0.5) / _MAP_SIDE
    posterior, alone = outcome.posterior, replace(design, size=1)
    starts, nothing = posterior.starts(4), alone.init()

    def data(cube: tuple[float, float]) -> Data:
        si = design.space.si(design.space.declared(np.asarray([cube])))
        measured = laboratory.exact({name: float(x[0]) for name, x in si.items()})
        return alone.data(alone.tell(nothing, cube, list(measured.values())))

    # Three digits make a contour, and no evidence or covariance: this costs a tenth of `maximise`.
    def descend(data: Data, start: Array) -> tuple[Array, Array]:
        end, _ = least_squares(posterior, data, start, 60, tolerance=1e-4)
        return end, jnp.sum(posterior.residuals(end, data) ** 2)

    def estimate(data: Data) -> Array:
        ends, squares = jax.lax.map(lambda start: descend(data, start), starts)
        return posterior.constrain(ends[jnp.nanargmin(squares)])

    everywhere = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(data(cube) for cube in product(axis, axis)))
    thetas = np.asarray(jax.jit(lambda experiments: jax.lax.map(estimate, experiments))(everywhere))
    values = thetas.T.reshape(-1, _MAP_SIDE, _MAP_SIDE)
    along = design.space.declared(np.stack([axis, axis], axis=1))
    names = outcome.posterior.names
    units = [outcome.units.get(name, "1") for name in names]
    return figures.estimate_maps((along[:, 0], along[:, 1]), values, names, units, design.space.units)


def _file(name: str, owner: str) -> str:
    """The name of a figure of a specimen."""
    return f"{name}_{owner}" if owner else name


def _responses(outcome: Outcome, laboratory: VirtualLaboratory, fit: Fit, owner: str) -> Picture:
    """The calibrated model against the specimen at two inputs far apart."""
    space = outcome.space
    declared = space.declared(np.asarray([np.full(len(space.names), q) for q in (0.85, 0.3)]))
    estimates = {name: value for name, value in fit.map.items() if not name.startswith("error.")}
    cases = []
    for inputs in declared:
        values = zip(space.names, inputs, strict=True)
        title = ", ".join(f"{name} = {value:.3g} {space.units[name]}" for name, value in values)
        title = f"{owner}: {title}" if owner else title
        measured = _response(laboratory.simulator, laboratory.parameters, space, inputs, owner)
        cases.append((title, measured, _response(outcome.model, estimates, space, inputs, owner)))
    return figures.response_comparison(cases)


def _response(
    model: AbstractModel, parameters: Mapping[str, float], space: InputSpace, declared: np.ndarray, owner: str
) -> dict[str, np.ndarray]:
    conditions = Conditions({name: jnp.asarray(values[0]) for name, values in space.si(declared[None]).items()})
    known = {name: jnp.asarray(value) for name, value in parameters.items()}
    # All specimens at once: one program serves each.
    wanted = tuple(name for name in of_each(model.owners, _CHANNELS) if model.gives(name))
    channels = model.respond(known, conditions, wanted).channels
    time = np.asarray(model.times(conditions.inputs))
    return {"time": time, **{name: np.asarray(channels[named(owner, name)]) for name in _CHANNELS}}
