"""The figures of a run, drawn from its outcome and its illustrations into its folder."""

from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from pathlib import Path

import xarray as xr

from hsed_jax.design.sequential import DesignState
from hsed_jax.physics.outputs import of_each
from hsed_jax.reporting import design_figures, diagnosis_figures, figures
from hsed_jax.reporting.cycle_figures import cycles
from hsed_jax.reporting.discovery_figures import learned
from hsed_jax.reporting.misfit_figures import misfit_pictures
from hsed_jax.reporting.population_figures import population
from hsed_jax.reporting.posterior_figures import posterior
from hsed_jax.reporting.style import Picture
from hsed_jax.runs.illustrations import (
    ERROR_MAP,
    ESTIMATES_ALONE,
    EXCITATION,
    MODEL,
    MODEL_AT_TRUTH,
    SPECIMEN,
)
from hsed_jax.runs.outcome import Outcome

Tables = Mapping[str, xr.Dataset]
"""What `hsed_jax.runs.illustrations` made, by group."""


def draw(outcome: Outcome, tables: Tables, folder: Path, report: Callable[[str], None] = lambda name: None) -> None:
    """Write every figure that there is material for, as PNG and SVG; `report` hears the name of each."""
    for name, picture in chain(
        _design_pictures(outcome, tables),
        _misfit_pictures(outcome, tables),
        diagnosis_pictures(outcome),
        _posterior_pictures(outcome),
    ):
        report(name)
        figures.save(picture, folder, name)


def _design_pictures(outcome: Outcome, tables: Tables) -> Iterator[tuple[str, Picture]]:
    """The paper's figures, by file name: a pulse, a design, a virtual specimen."""
    if EXCITATION in tables:
        yield "fig3_excitation", design_figures.excitations(tables[EXCITATION], outcome.campaign.pair)
    if MODEL_AT_TRUTH in tables:
        for owner in outcome.model.owners:
            picture = design_figures.loops_and_energy(tables[SPECIMEN], tables[MODEL_AT_TRUTH], owner)
            yield _file("fig4_loops_and_energy", owner), picture
    if ESTIMATES_ALONE in tables:
        yield "fig4bis_one_experiment_map", design_figures.estimate_maps(tables[ESTIMATES_ALONE])
    if outcome.state is not None:
        yield "fig6_exploration", exploration(outcome, outcome.state)
        if outcome.steps:
            yield "fig5_expected_improvement", expected_improvement(outcome)
            yield "fig7_estimates", estimates(outcome)
    if MODEL in tables:
        for owner in outcome.model.owners:
            if {*of_each([owner], design_figures.CHANNELS)} <= {*tables[MODEL]}:
                picture = design_figures.responses(tables[SPECIMEN], tables[MODEL], owner)
                yield _file("fig8_responses", owner), picture


def exploration(outcome: Outcome, state: DesignState) -> Picture:
    """Fig. 6 of a run with a design."""
    space = outcome.space
    return figures.exploration_order(space.declared(state.cube), outcome.initial, space.bounds(), space.units)


def expected_improvement(outcome: Outcome) -> Picture:
    """Fig. 5 of a run with steps of a design."""
    return figures.expected_improvement_history([step["max_expected_improvement"] for step in outcome.steps])


def estimates(outcome: Outcome) -> Picture:
    """Fig. 7 of a run with steps of a design, the parameters of a virtual specimen as reference."""
    names = outcome.posterior.reported
    units = [outcome.units.get(name, "1") for name in names]
    return figures.estimate_history(
        outcome.estimates, outcome.band("q05"), outcome.band("q95"), names, units, outcome.truth
    )


def _misfit_pictures(outcome: Outcome, tables: Tables) -> Iterator[tuple[str, Picture]]:
    comparison, better = outcome.comparison, outcome.improved_comparison
    if comparison is None:
        return
    yield from misfit_pictures(comparison, outcome.location, tables.get(ERROR_MAP), outcome.campaign)
    read = cycles(better or comparison, outcome.campaign, None if better is None else comparison)
    if read is not None:
        yield "cycles", read


def diagnosis_pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    """Every figure of the diagnosis and the improvement that there is material for, with the name of its file."""
    diagnosis, trail = outcome.diagnosis, outcome.trail
    if diagnosis is not None and diagnosis.ranking:
        yield "ranking", diagnosis_figures.ranking(diagnosis)
    if outcome.discovery is not None and outcome.discovery.found:
        yield "learned", learned(outcome.discovery, outcome.campaign)
    if trail is not None and len(trail.steps) > 1:
        yield "error_fall", diagnosis_figures.error_fall(trail)
    if outcome.comparison is not None and outcome.improved_comparison is not None:
        picture = diagnosis_figures.before_after(outcome.comparison, outcome.improved_comparison, outcome.campaign)
        if picture is not None:
            yield "before_after", picture
    if outcome.fit is not None and outcome.improved is not None:
        picture = diagnosis_figures.parameters_before_after(
            outcome.fit.summary(), outcome.improved.summary(), outcome.improved.units, outcome.truth, outcome.catalogue
        )
        if picture is not None:
            yield "parameters_before_after", picture


def _posterior_pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    if outcome.fit is not None:
        better = outcome.improved
        before = None if better is None else outcome.fit
        fit = better or outcome.fit
        yield "posterior", posterior(fit, before, outcome.truth)
        for level, parameters in fit.levels().items():
            yield _file("population", level), population(level, parameters, fit.units)


def _file(name: str, owner: str) -> str:
    """The name of a figure of a specimen."""
    return f"{name}_{owner}" if owner else name
