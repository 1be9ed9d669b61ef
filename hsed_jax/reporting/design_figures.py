"""The paper's figures of a run, from its outcome."""

from collections.abc import Iterator, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.design.sequential import DesignState, SequentialDesign
from hsed_jax.design.space import InputSpace
from hsed_jax.inference.fit import Fit
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.physics.simulator import Conditions, Simulator
from hsed_jax.physics.spectra import response_spectrum
from hsed_jax.reporting import figures
from hsed_jax.reporting.figures import Picture
from hsed_jax.reporting.outcome import Outcome

_MOTIONS = 200
_MAP_SIDE = 13
_CHANNELS = ("elongation", "force", "energy")


def design_pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    """The paper's figures, by file name, as far as the outcome has the material: a pulse, a design, a virtual specimen."""
    space, laboratory = outcome.space, outcome.laboratory
    has_motion = outcome.simulator.excitation is not None and bool(space.names)
    if laboratory is not None and has_motion:
        yield "fig3_ground_motions", ground_motions(outcome.simulator, space)
        yield from _of_specimen(outcome, laboratory)
    if outcome.design is not None and outcome.state is not None:
        if laboratory is not None and len(space.names) == 2 and not laboratory.channels:
            yield "fig4bis_one_experiment_map", _estimate_maps(outcome, outcome.design, laboratory)
        yield "fig6_exploration", exploration(outcome, outcome.state)
        if outcome.steps:
            yield "fig5_expected_improvement", expected_improvement(outcome)
            yield "fig7_estimates", estimates(outcome)
    if outcome.fit is not None and laboratory is not None and has_motion:
        yield "fig8_responses", _responses(outcome, laboratory, outcome.fit)


def _of_specimen(outcome: Outcome, laboratory: VirtualLaboratory) -> Iterator[tuple[str, Picture]]:
    space = outcome.space
    middle = space.declared(np.full((1, len(space.names)), 0.5))[0]
    truth = {name: value for name, value in laboratory.parameters.items() if "." not in name}
    if not outcome.simulator.effects:
        measured = _response(laboratory.simulator, laboratory.parameters, space, middle)
        predicted = _response(outcome.simulator, truth, space, middle)
        yield "fig4_loops_and_energy", figures.loops_and_energy(measured, predicted)


def exploration(outcome: Outcome, state: DesignState) -> Picture:
    """Fig. 6 of a run with a design."""
    space = outcome.space
    declared = space.declared(state.cube[: state.count])
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


def ground_motions(simulator: Simulator, space: InputSpace) -> Picture:
    """Fig. 3 of a model with an excitation: what its inputs' distribution makes of the ground motion."""
    assert simulator.excitation is not None
    excitation = simulator.excitation
    step, steps, _ = simulator.timeline
    # Half a step finer than the integration: what the integrator sees.
    time = 0.5 * step * jnp.arange(2 * steps + 1)
    periods = jnp.linspace(0.05, 3.0, 60)

    @jax.jit
    def motion(inputs):
        acceleration = jax.vmap(excitation(inputs).acceleration)(time)
        return acceleration, response_spectrum(acceleration, 0.5 * step, periods)

    spread = space.si(space.declared(space.spread(_MOTIONS)))
    everyone = jax.vmap(motion)({name: jnp.asarray(values) for name, values in spread.items()})
    middle = space.si(space.declared(np.full((1, len(space.names)), 0.5)))
    central = motion({name: jnp.asarray(values[0]) for name, values in middle.items()})
    return figures.ground_motions(
        np.asarray(time), np.asarray(everyone[0]), np.asarray(central[0]), np.asarray(periods), np.asarray(everyone[1]),
        np.asarray(central[1]),
    )  # fmt: skip


def _estimate_maps(outcome: Outcome, design: SequentialDesign, laboratory: VirtualLaboratory) -> Picture:
    """MAP of the parameters from a single experiment, over the two inputs."""
    axis = (np.arange(_MAP_SIDE) + 0.5) / _MAP_SIDE
    starts = outcome.posterior.starts(4)
    values = np.full((len(outcome.posterior.names), _MAP_SIDE, _MAP_SIDE), np.nan)
    for i, first in enumerate(axis):
        for j, second in enumerate(axis):
            cube = [first, second]
            si = design.space.si(design.space.declared(np.asarray([cube])))
            measured = laboratory.exact({name: float(x[0]) for name, x in si.items()})
            data = design.data(design.tell(design.init(), cube, list(measured.values())))
            values[:, i, j] = np.asarray(design.maximise(data, starts).theta)
    along = design.space.declared(np.stack([axis, axis], axis=1))
    names = outcome.posterior.names
    units = [outcome.units.get(name, "1") for name in names]
    return figures.estimate_maps((along[:, 0], along[:, 1]), values, names, units, design.space.units)


def _responses(outcome: Outcome, laboratory: VirtualLaboratory, fit: Fit) -> Picture:
    """The calibrated model against the specimen at two inputs far apart."""
    space = outcome.space
    declared = space.declared(np.asarray([np.full(len(space.names), q) for q in (0.85, 0.3)]))
    estimates = {name: value for name, value in fit.map.items() if not name.startswith("error.")}
    cases = []
    for inputs in declared:
        values = zip(space.names, inputs, strict=True)
        title = ", ".join(f"{name} = {value:.3g} {space.units[name]}" for name, value in values)
        measured = _response(laboratory.simulator, laboratory.parameters, space, inputs)
        cases.append((title, measured, _response(outcome.simulator, estimates, space, inputs)))
    return figures.response_comparison(cases)


def _response(
    simulator: Simulator, parameters: Mapping[str, float], space: InputSpace, declared: np.ndarray
) -> dict[str, np.ndarray]:
    conditions = Conditions({name: jnp.asarray(values[0]) for name, values in space.si(declared[None]).items()})
    known = {name: jnp.asarray(value) for name, value in parameters.items()}
    channels = jax.jit(lambda p, c: simulator.respond(p, c, _CHANNELS).channels)(known, conditions)
    step, steps, every = simulator.timeline
    time = step * every * np.arange(steps // every + 1)
    return {"time": time, **{name: np.asarray(values) for name, values in channels.items()}}
