"""The figures of a run, drawn from its outcome into its folder."""

from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path

from hsed_jax.reporting.cycle_figures import cycles
from hsed_jax.reporting.design_figures import design_pictures
from hsed_jax.reporting.diagnosis_figures import diagnosis_pictures
from hsed_jax.reporting.figures import save
from hsed_jax.reporting.misfit_figures import misfit_pictures
from hsed_jax.reporting.outcome import Outcome
from hsed_jax.reporting.posterior_figures import posterior
from hsed_jax.reporting.style import Picture


def draw(outcome: Outcome, folder: Path, report: Callable[[str], None] = lambda name: None) -> None:
    """Write every figure that the outcome has the material for, as PNG and SVG; `report` hears the name of each."""
    for name, picture in chain(
        design_pictures(outcome), _misfit_pictures(outcome), diagnosis_pictures(outcome), _posterior_pictures(outcome)
    ):
        report(name)
        save(picture, folder, name)


def _misfit_pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    comparison, better = outcome.comparison, outcome.improved_comparison
    if comparison is None:
        return
    yield from misfit_pictures(comparison, outcome.location, outcome.campaign)
    read = cycles(better or comparison, outcome.campaign, None if better is None else comparison)
    if read is not None:
        yield "cycles", read


def _posterior_pictures(outcome: Outcome) -> Iterator[tuple[str, Picture]]:
    if outcome.fit is not None:
        truth = {} if outcome.laboratory is None else outcome.laboratory.parameters
        better = outcome.improved
        yield "posterior", posterior(better or outcome.fit, None if better is None else outcome.fit, truth)
