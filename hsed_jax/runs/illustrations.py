"""Computations for the figures of a run alone, by group of `results.nc`; the figures use these and the results."""

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr

from hsed_jax.criticism.error_map import error_map
from hsed_jax.design.over_inputs import estimates_alone, excitations, responses
from hsed_jax.laboratories.virtual import VirtualLaboratory
from hsed_jax.left_out import LeftOut
from hsed_jax.physics.names import of_each
from hsed_jax.physics.simulator import Simulator
from hsed_jax.reporting.design_figures import CHANNELS
from hsed_jax.runs.outcome import Outcome

EXCITATION = "illustrations/excitation"
ESTIMATES_ALONE = "illustrations/estimates_alone"
ERROR_MAP = "illustrations/error_map"
SPECIMEN, MODEL, MODEL_AT_TRUTH = (f"illustrations/responses/{of}" for of in ("specimen", "model", "model_at_truth"))
_AT = (0.5, 0.85, 0.3)
"""Inputs of the shown responses: the middle of the distributions of the inputs, and two distant quantiles."""


def illustrations(
    outcome: Outcome, left_out: LeftOut, report: Callable[[str], None] = lambda name: None
) -> dict[str, xr.Dataset]:
    """Compute all illustrations that the outcome allows.

    Arguments:
        outcome: of the run.
        left_out: notes the tables that cannot be computed.
        report: receives the name of each group before it is made.
    """
    made = {}
    for name, compute in _computations(outcome):
        report(name)
        if (table := left_out.attempt(f"data of the figure {name}", compute, None)) is not None:
            made[name] = table
    return made


def _computations(outcome: Outcome) -> Iterator[tuple[str, Callable[[], xr.Dataset | None]]]:
    space, laboratory, model, pair = outcome.space, outcome.laboratory, outcome.model, outcome.campaign.pair
    if laboratory is not None and model.excitation is not None and space.names:
        yield EXCITATION, lambda: excitations(model, space, pair)
        yield from _responses(outcome, laboratory)
    # Thousands of calibrations: with a program, each simulation would be a process, and they would take a day.
    is_quick = isinstance(model, Simulator) and len(space.names) == 2
    if is_quick and (design := outcome.design) is not None and laboratory is not None and not laboratory.channels:
        yield ESTIMATES_ALONE, lambda: estimates_alone(design, laboratory, outcome.units)
    if (comparison := outcome.comparison) is not None:
        yield ERROR_MAP, lambda: error_map(comparison, outcome.campaign)


def _responses(outcome: Outcome, laboratory: VirtualLaboratory) -> Iterator[tuple[str, Callable[[], xr.Dataset]]]:
    """The specimen, the calibrated model, and, if the model differs only by effects, the model with the parameters of
    the specimen.
    """
    space, model, simulator = outcome.space, outcome.model, laboratory.simulator
    cube = np.repeat(np.asarray(_AT)[:, None], len(space.names), axis=1)
    channels, pair = of_each(model.owners, CHANNELS), outcome.campaign.pair
    same = (
        model if isinstance(model, Simulator) and not model.effects and model.elements == simulator.elements else None
    )
    if same is not None or outcome.fit is not None:
        yield SPECIMEN, lambda: responses(simulator, laboratory.parameters, space, cube, channels, pair)
    if same is not None:
        of_effects = tuple(f"{effect}." for effect in simulator.effects)
        # Fixed parameters of the model are constants of its program, as in the calibrated model, so that both share the
        # program.
        held = dict(same.constants)
        truth = {n: v for n, v in laboratory.parameters.items() if not n.startswith(of_effects) and held.get(n) != v}
        yield MODEL_AT_TRUTH, lambda: responses(same, truth, space, cube[:1], channels, pair)
    if outcome.fit is not None:
        estimates = {n: value for n, value in outcome.fit.map.items() if not n.startswith("error.")}
        yield MODEL, lambda: responses(model, estimates, space, cube, channels, pair)
