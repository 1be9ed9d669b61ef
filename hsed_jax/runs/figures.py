"""The figures of a run, drawn from its outcome and its illustrations into its folder."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path

import xarray as xr

from hsed_jax.design.sequential import DesignState
from hsed_jax.inference.fit import Fit
from hsed_jax.left_out import LeftOut
from hsed_jax.physics.names import of_each
from hsed_jax.reporting import behaviour_figures, design_figures, diagnosis_figures, figures
from hsed_jax.reporting.cycle_figures import cycles
from hsed_jax.reporting.discovery_figures import learned
from hsed_jax.reporting.misfit_figures import misfit_drawings
from hsed_jax.reporting.population_figures import population
from hsed_jax.reporting.posterior_figures import posterior
from hsed_jax.reporting.saving import Writer
from hsed_jax.reporting.style import Drawing, Picture
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
"""The results of `hsed_jax.runs.illustrations`, by group."""


def draw(
    outcome: Outcome,
    tables: Tables,
    folder: Path,
    writer: Writer,
    left_out: LeftOut,
    report: Callable[[str], None] = lambda name: None,
) -> None:
    """Write every figure that has data, as PNG and SVG.

    Arguments:
        outcome: of the run.
        tables: data for the figures alone.
        folder: of the figures.
        writer: writes the files.
        left_out: notes the figures that cannot be drawn.
        report: receives the name of each.
    """
    groups: dict[str, Callable[[], Iterator[Drawing]]] = {
        "design": partial(_design_drawings, outcome, tables),
        "misfit": partial(_misfit_drawings, outcome, tables),
        "diagnosis": partial(diagnosis_drawings, outcome),
        "posterior": partial(_posterior_drawings, outcome),
    }
    asked: dict[str, Future[None] | None] = {}
    for group, drawings in groups.items():
        for name, make in left_out.attempt(f"set of figures of the {group}", lambda of=drawings: [*of()], []):
            report(name)
            asked[name] = left_out.attempt(f"figure {name}", partial(_asked, make, writer, folder, name), None)
    for name, written in asked.items():
        if written is not None:
            left_out.attempt(f"figure {name}", written.result, None)


def _asked(make: Callable[[], Picture | None], writer: Writer, folder: Path, name: str) -> Future[None] | None:
    picture = make()
    return None if picture is None else writer.write(picture.figure, picture.caption, picture.alt, folder, name)


def _design_drawings(outcome: Outcome, tables: Tables) -> Iterator[Drawing]:
    """The paper's figures: a pulse, a design, a virtual specimen."""
    if EXCITATION in tables:
        yield "fig3_excitation", partial(design_figures.excitations, tables[EXCITATION], outcome.campaign.pair)
    if MODEL_AT_TRUTH in tables:
        of = (tables[SPECIMEN], tables[MODEL_AT_TRUTH])
        for owner in outcome.model.owners:
            yield _file("fig4_loops_and_energy", owner), partial(design_figures.loops_and_energy, *of, owner)
    if ESTIMATES_ALONE in tables:
        yield "fig4bis_one_experiment_map", partial(design_figures.estimate_maps, tables[ESTIMATES_ALONE])
    if outcome.state is not None:
        yield "fig6_exploration", partial(exploration, outcome, outcome.state)
        if outcome.steps:
            yield "fig5_expected_improvement", partial(expected_improvement, outcome)
            yield "fig7_estimates", partial(estimates, outcome)
    if MODEL in tables:
        of = (tables[SPECIMEN], tables[MODEL])
        for owner in outcome.model.owners:
            if {*of_each([owner], design_figures.CHANNELS)} <= {*tables[MODEL]}:
                yield _file("fig8_responses", owner), partial(design_figures.responses, *of, owner)


def exploration(outcome: Outcome, state: DesignState) -> Picture:
    """Fig. 6 of a run with a design."""
    space = outcome.space
    return figures.exploration_order(space.declared(state.cube), outcome.initial, space.bounds(), space.units)


def expected_improvement(outcome: Outcome) -> Picture:
    """Fig. 5 of a run with steps of a design."""
    return figures.expected_improvement_history(outcome.improvements)


def estimates(outcome: Outcome) -> Picture:
    """Fig. 7 of a run with steps of a design, the parameters of a virtual specimen as reference."""
    names = outcome.posterior.reported
    units = [outcome.units.get(name, "1") for name in names]
    return figures.estimate_history(
        outcome.estimates, outcome.band("q05"), outcome.band("q95"), names, units, outcome.truth
    )


def _misfit_drawings(outcome: Outcome, tables: Tables) -> Iterator[Drawing]:
    comparison, better = outcome.comparison, outcome.improved_comparison
    if comparison is None:
        return
    yield from misfit_drawings(comparison, outcome.location, tables.get(ERROR_MAP), outcome.campaign)
    yield "cycles", partial(cycles, better or comparison, outcome.campaign, None if better is None else comparison)


def diagnosis_drawings(outcome: Outcome) -> Iterator[Drawing]:
    """Every figure of the diagnosis and the improvement that has data."""
    diagnosis, trail = outcome.diagnosis, outcome.trail
    if diagnosis is not None and diagnosis.behaviour.curves:
        yield "behaviour", partial(behaviour_figures.behaviour, diagnosis.behaviour)
    if diagnosis is not None and diagnosis.ranking:
        yield "ranking", partial(diagnosis_figures.ranking, diagnosis)
    if outcome.discovery is not None and outcome.discovery.found:
        yield "learned", partial(learned, outcome.discovery, outcome.campaign)
    if trail is not None and len(trail.steps) > 1:
        yield "error_fall", partial(diagnosis_figures.error_fall, trail)
    if outcome.comparison is not None and outcome.improved_comparison is not None:
        both = (outcome.comparison, outcome.improved_comparison)
        yield "before_after", partial(diagnosis_figures.before_after, *both, outcome.campaign)
    if outcome.fit is not None and outcome.improved is not None:
        yield "parameters_before_after", partial(_parameters, outcome, outcome.fit, outcome.improved)


def _parameters(outcome: Outcome, fit: Fit, improved: Fit) -> Picture | None:
    return diagnosis_figures.parameters_before_after(
        fit.summary(), improved.summary(), improved.units, outcome.truth, outcome.catalogue
    )


def _posterior_drawings(outcome: Outcome) -> Iterator[Drawing]:
    if outcome.fit is not None:
        better = outcome.improved
        before = None if better is None else outcome.fit
        fit = better or outcome.fit
        yield "posterior", partial(posterior, fit, before, outcome.truth)
        for level, parameters in fit.levels().items():
            yield _file("population", level), partial(population, level, parameters, fit.units)


def _file(name: str, owner: str) -> str:
    """The name of a figure of a specimen."""
    return f"{name}_{owner}" if owner else name
