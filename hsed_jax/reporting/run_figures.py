"""The figures of a run, drawn from its outcome into its folder."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.physics.simulator import Conditions, Simulator
from hsed_jax.physics.spectra import response_spectrum
from hsed_jax.reporting import figures
from hsed_jax.reporting.figures import Picture
from hsed_jax.reporting.outcome import Outcome

_MOTIONS = 200
_MAP_SIDE = 13
_CHANNELS = ("elongation", "force", "energy")


def draw(outcome: Outcome, folder: Path) -> None:
    """Write every figure that the outcome has the material for, as PNG and SVG."""
    for name, picture in _pictures(outcome):
        figures.save(picture, folder, name)


def _pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    space = outcome.design.space
    yield "fig3_ground_motions", _ground_motions(outcome)
    truth = _law_only(outcome.laboratory.parameters)
    middle = space.declared(np.full((1, len(space.names)), 0.5))[0]
    yield (
        "fig4_loops_and_energy",
        figures.loops_and_energy(_measured(outcome, middle), _response(outcome.simulator, truth, outcome, middle)),
    )
    if outcome.state is None:
        return
    if len(space.names) == 2:
        yield "fig4bis_one_experiment_map", _estimate_maps(outcome)
    if outcome.steps:
        values = [step["max_expected_improvement"] for step in outcome.steps]
        yield "fig5_expected_improvement", figures.expected_improvement_history(values)
    declared = space.declared(outcome.state.cube[: outcome.state.count])
    yield "fig6_exploration", figures.exploration_order(declared, outcome.initial, space.bounds(), space.units)
    if outcome.steps:
        names = outcome.posterior.names
        yield (
            "fig7_estimates",
            figures.estimate_history(
                outcome.estimates,
                outcome.band("q05"),
                outcome.band("q95"),
                names,
                [outcome.units.get(name, "1") for name in names],
                outcome.laboratory.parameters,
            ),
        )
    if outcome.fit is not None:
        yield "fig8_responses", _responses(outcome)


def _ground_motions(outcome: Outcome) -> Picture:
    space, simulator = outcome.design.space, outcome.simulator
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


def _estimate_maps(outcome: Outcome) -> Picture:
    """MAP of the parameters from a single experiment, over the two inputs."""
    design, laboratory = outcome.design, outcome.laboratory
    axis = (np.arange(_MAP_SIDE) + 0.5) / _MAP_SIDE
    starts = outcome.posterior.starts(4)
    values = np.full((len(outcome.posterior.names), _MAP_SIDE, _MAP_SIDE), np.nan)
    for i, first in enumerate(axis):
        for j, second in enumerate(axis):
            cube = [first, second]
            si = design.space.si(design.space.declared(np.asarray([cube])))
            measured = laboratory.exact({name: float(x[0]) for name, x in si.items()})
            data = design.data(design.tell(design.init(), cube, [measured[q] for q in outcome.quantities]))
            values[:, i, j] = np.asarray(design.maximise(data, starts).theta)
    along = design.space.declared(np.stack([axis, axis], axis=1))
    names = outcome.posterior.names
    units = [outcome.units.get(name, "1") for name in names]
    return figures.estimate_maps((along[:, 0], along[:, 1]), values, names, units, design.space.units)


def _responses(outcome: Outcome) -> Picture:
    """The calibrated model against the specimen at two inputs: the strongest and the mildest of a spread."""
    assert outcome.fit is not None
    space = outcome.design.space
    declared = space.declared(np.asarray([np.full(len(space.names), q) for q in (0.85, 0.3)]))
    cases = []
    for inputs in declared:
        title = ", ".join(f"{name} = {value:.3g} {space.units[name]}" for name, value in zip(space.names, inputs, strict=True))
        predicted = _response(outcome.simulator, outcome.fit.map, outcome, inputs)
        cases.append((title, _measured(outcome, inputs), predicted))
    return figures.response_comparison(cases)


def _measured(outcome: Outcome, declared: np.ndarray) -> dict[str, np.ndarray]:
    laboratory = outcome.laboratory
    return _response(laboratory.simulator, laboratory.parameters, outcome, declared)


def _response(
    simulator: Simulator, parameters: Mapping[str, float], outcome: Outcome, declared: np.ndarray
) -> dict[str, np.ndarray]:
    si = outcome.design.space.si(declared[None])
    conditions = Conditions({name: jnp.asarray(values[0]) for name, values in si.items()})
    known = {name: jnp.asarray(value) for name, value in parameters.items() if not name.startswith("error.")}
    channels = _simulate(simulator, known, conditions)
    step, steps, _ = simulator.timeline
    return {"time": step * np.arange(steps + 1), **{name: np.asarray(values) for name, values in channels.items()}}


def _simulate(simulator: Simulator, parameters, conditions):
    return jax.jit(lambda p, c: simulator.respond(p, c, _CHANNELS).channels)(parameters, conditions)


def _law_only(parameters: Mapping[str, float]) -> dict[str, float]:
    """The parameters of the law without those of effects."""
    return {name: value for name, value in parameters.items() if "." not in name}


