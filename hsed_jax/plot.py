"""Pictures of the results for a notebook or a script: each function draws one figure and returns its axes.

The axes are those of matplotlib, for further editing; the figure behind them is `axes.figure`, and of several axes
`axes[0].figure`.  A notebook shows it by itself, a script after `matplotlib.pyplot.show()`.  The house style applies to these
figures alone.
"""

from collections.abc import Mapping

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.registry import BackendFilter, backend_registry

from hsed_jax.analysis.calibration import Calibration, compare, locate
from hsed_jax.analysis.remedy import Improvement
from hsed_jax.config.schema import Study
from hsed_jax.criticism.error_map import error_map as error_map_of
from hsed_jax.design import over_inputs
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.discovery.findings import Discovery
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign
from hsed_jax.reporting import (
    behaviour_figures,
    cycle_figures,
    design_figures,
    diagnosis_figures,
    discovery_figures,
    misfit_figures,
    misfit_maps,
    population_figures,
    posterior_figures,
    request_figures,
)
from hsed_jax.reporting.style import Picture
from hsed_jax.runs import figures as run_figures
from hsed_jax.runs.ask_tell import AskTell
from hsed_jax.runs.outcome import Outcome
from hsed_jax.runs.workflow import Run
from hsed_jax.study.build import Built

# The excitation of a study.


def ground_motions(study: Study) -> np.ndarray:
    """The ground motions that a study's inputs make, and their response spectra (5 % damping); or the forces or elongations.

    Grey: 200 random realisations of the inputs; red: the inputs at the middle of their distributions.

    Arguments:
        study: with an excitation.

    Returns:
        Axes of the accelerations over time and of the spectra, (2,); of forces or elongations over time, (1,).
    """
    built = Built(study)
    if built.experiments.excitation is None or not built.experiments.space.names:
        raise UserError(f"the study {study.study!r} has no excitation with inputs to draw")
    found = over_inputs.excitations(built.simulation.planned_simulator, built.experiments.space, built.mechanics.pair)
    return _several(design_figures.excitations(found, built.mechanics.pair))


# A calibrated model and its measurements.


def histories(calibration: Calibration, experiment: str, campaign: Campaign | None = None) -> np.ndarray:
    """One experiment over time: measured, predicted at the MAP and the 90 % predictive band; its hysteresis loop.

    Arguments:
        calibration: a model calibrated on time histories.
        experiment: its id.
        campaign: where the experiment is; by default the campaign of the calibration.

    Returns:
        Axes of the observed channels in order, and of the loop where force and elongation are known.

    Raises:
        UserError: there is no such completed experiment, or quantities were observed.
    """
    comparison, campaign = _compared(calibration, campaign, "histories")
    if campaign[experiment].status != "completed":
        raise UserError(f"the experiment {experiment!r} is {campaign[experiment].status}; there is nothing to draw")
    for _, split, prediction in comparison.splits():
        ids = [one.id for one in prediction.experiments]
        if experiment in ids:
            errors = split.per_experiment.get(experiment, {})
            return _several(misfit_figures.overlay(prediction, ids.index(experiment), errors, campaign))
    raise UserError(f"no observed output was measured in the experiment {experiment!r}")


def loops(calibration: Calibration, campaign: Campaign | None = None) -> np.ndarray:
    """The hysteresis loops of the experiments, measured and predicted, the largest error of the force first.

    Arguments:
        calibration: a model calibrated on time histories with force and elongation.
        campaign: the experiments; by default those of the calibration.

    Returns:
        Axes, one per experiment, at most nine.

    Raises:
        UserError: force and elongation are not both known, or quantities were observed.
    """
    comparison, campaign = _compared(calibration, campaign, "histories")
    missing = "force and elongation were not both measured; there is no loop to draw"
    return _several(_there(misfit_figures.loops(comparison, campaign), missing))


def cycles(calibration: Calibration, campaign: Campaign | None = None, before: Calibration | None = None) -> np.ndarray:
    """Energy and secant stiffness of each cycle, and the backbone, measured and predicted: a row per experiment.

    Arguments:
        calibration: a model calibrated on time histories with force and elongation.
        campaign: the experiments; by default those of the calibration.  Held-out ones come first; at most three are shown.
        before: a model drawn beneath in red, as `improvement.original`.

    Returns:
        Axes, three per experiment.

    Raises:
        UserError: force and elongation are not both known, or quantities were observed.
    """
    comparison, campaign = _compared(calibration, campaign, "histories")
    earlier = None if before is None else compare(before, campaign)
    missing = "force and elongation were not both measured; there is no cycle to read"
    return _several(_there(cycle_figures.cycles(comparison, campaign, earlier), missing))


def where(calibration: Calibration, campaign: Campaign | None = None) -> np.ndarray:
    """Where the model fails: share of the squared error over time, cycle, amplitude, energy, rate, inputs and so on.

    Bars are the error, the black line the samples; red is the part with the largest information, with its rank in `locate`.

    Arguments:
        calibration: a model calibrated on time histories.
        campaign: experiments to look at; by default those that were fitted.

    Returns:
        Axes, one per coordinate.

    Raises:
        UserError: quantities were observed, or nothing varies.
    """
    location = locate(calibration, campaign)
    if location.samples is None:
        raise UserError("quantities were observed, not time histories; plot.error_map shows where the error is")
    picture = misfit_maps.residual_coordinates(location, campaign or calibration.campaign)
    return _several(_there(picture, "no input varies, so the error cannot be drawn"))


def error_map(calibration: Calibration, campaign: Campaign | None = None) -> Axes:
    """The squared error of each experiment over the inputs, and a Kriging model of it in between.

    Arguments:
        calibration: the calibrated model.
        campaign: the experiments; by default those of the calibration.

    Raises:
        UserError: not one or two inputs vary.
    """
    campaign = calibration.campaign if campaign is None else campaign
    missing = "the error is drawn over one or two inputs that vary, but the campaign has none or more than two"
    if (found := error_map_of(compare(calibration, campaign), campaign)) is None:
        raise UserError(missing)
    return _one(misfit_maps.error_map(found))


def measured_against_predicted(calibration: Calibration, campaign: Campaign | None = None) -> np.ndarray:
    """Predicted against measured quantities with 90 % predictive bars; filled: fitted, open: held out.

    Arguments:
        calibration: a model calibrated on quantities.
        campaign: the experiments; by default those of the calibration.

    Returns:
        Axes, one per quantity.

    Raises:
        UserError: time histories were observed.
    """
    comparison, campaign = _compared(calibration, campaign, "quantities")
    return _several(misfit_figures.measured_against_predicted(comparison, campaign))


def posterior(
    calibration: Calibration, before: Calibration | None = None, truth: Mapping[str, float] | None = None
) -> np.ndarray:
    """The posterior: histograms of the parameters, and below them the draws of every pair; the MAP is marked.

    Arguments:
        calibration: the calibrated model; of more than six parameters the first six are shown.
        before: a model drawn beneath in red, as `improvement.original`.
        truth: values to be drawn as dashed lines, by name, SI.

    Returns:
        Axes of the lower triangle, row by row, (p(p+1)/2,).
    """
    earlier = None if before is None else before.fit
    return _several(posterior_figures.posterior(calibration.fit, earlier, truth or {}))


def population(calibration: Calibration, level: str | None = None) -> np.ndarray:
    """The parameters that vary between specimens: every member with its 90 % interval, and its population.

    Arguments:
        calibration: of a study with `model.levels`.
        level: the column that distinguishes the specimens; by default the last one of the study.

    Returns:
        Axes, one for each parameter that varies with the level, (K,).

    Raises:
        UserError: the study has no such level.
    """
    levels = calibration.fit.levels()
    if not levels or (level is not None and level not in levels):
        raise UserError(
            f"there is no level {level or 'to draw'}; the study has {', '.join(levels) or 'none (model.levels)'}"
        )
    level = level or list(levels)[-1]
    return _several(population_figures.population(level, levels[level], calibration.fit.units))


# The missing effect, and the improvement.


def ranking(diagnosis: Diagnosis) -> Axes:
    """The candidates for the missing effect: the errors with them as bars, with their probabilities; named effects in blue.

    Raises:
        UserError: the diagnosis considered no candidate, because the noise explains the residual.
    """
    if not diagnosis.ranking:
        raise UserError(f"there is no candidate to draw: {diagnosis.sentence}")
    return _one(diagnosis_figures.ranking(diagnosis))


def behaviour(diagnosis: Diagnosis) -> np.ndarray:
    """The behaviour of the specimen along the test, without and with the named effects: an axis for each changing quantity.

    Raises:
        UserError: no quantity changes.
    """
    return _several(_there(behaviour_figures.behaviour(diagnosis.behaviour), "no quantity of the specimen changes"))


def learned(discovery: Discovery, campaign: Campaign) -> Axes:
    """The learned function over its first coordinate: the curve with its 90 % band, and the formula dashed. A function of two
    coordinates has one curve for each direction, or for the ends and the middle of the range of the second.

    Arguments:
        discovery: of `hx.discover`.
        campaign: that it was made of, whose units are shown.

    Raises:
        UserError: nothing was learned.
    """
    if not discovery.found:
        raise UserError(f"there is no function to draw: {discovery.sentence}")
    return _one(discovery_figures.learned(discovery, campaign))


def error_fall(improvement: Improvement) -> Axes:
    """The error after each added effect, of the fitted and of the held-out experiments, above the noise."""
    return _one(diagnosis_figures.error_fall(improvement.trail))


def before_after(improvement: Improvement) -> np.ndarray:
    """The experiment with the largest reduction of the error, if possible a held-out one: loops and histories before and
    after. For quantities: predicted against measured, before and after.

    Returns:
        Axes in the order of their letters.
    """
    before, after = improvement.before, improvement.after
    picture = diagnosis_figures.before_after(before, after, improvement.calibration.campaign)
    return _several(_there(picture, "no experiment has an error of its own to draw"))


def parameters(improvement: Improvement, truth: Mapping[str, float] | None = None) -> np.ndarray:
    """The parameters of the law before and after: posterior mean and 90 % interval.

    Arguments:
        improvement: of a model.
        truth: values to be drawn as dashed lines, by name, SI.

    Returns:
        Axes, one per parameter.

    Raises:
        UserError: no parameter of the law is free.
    """
    before, after = improvement.original.fit, improvement.calibration.fit
    picture = diagnosis_figures.parameters_before_after(
        before.summary(), after.summary(), after.units, truth or {}, improvement.original.built.mechanics.catalogue
    )
    return _several(_there(picture, "no parameter of the law is free; there is nothing to draw"))


# A sequential design.


def expected(design: AskTell, experiment: str) -> np.ndarray:
    """The expected response of a requested experiment over time, and its measurements if they are reported.

    Arguments:
        design: that asked.
        experiment: its id.

    Returns:
        Axes, one per channel.

    Raises:
        UserError: there is no such experiment.
    """
    asked = design.conduct.request(experiment)
    given = ", ".join(f"{n} = {v:.4g} {design.built.experiments.space.units[n]}" for n, v in asked.inputs.items())
    found = design.expected(asked)
    measured = design.campaign[experiment].record
    picture = request_figures.expected_response(
        f"{experiment} at {given}", found.time, found.channels, measured, design.built.mechanics.pair
    )
    return _several(picture)


def expected_improvement(run: Run) -> Axes:
    """The largest expected improvement of the discrepancy at each iteration of a design.

    Raises:
        UserError: the run has no steps of a design.
    """
    return _one(run_figures.expected_improvement(_design(run)))


def exploration(run: Run) -> Axes | np.ndarray:
    """When each region of the inputs was explored: squares are the initial design, the others were chosen one by one.

    Returns:
        One axes for one or two inputs, an array of them (by pairs of inputs) for more.

    Raises:
        UserError: the run has no steps of a design.
    """
    outcome = _design(run)
    assert outcome.state is not None
    axes = _several(run_figures.exploration(outcome, outcome.state))
    return axes[0] if axes.size == 1 else axes


def estimates(run: Run) -> np.ndarray:
    """The MAP estimates at each iteration of a design with their 90 % band; dashed: the virtual specimen's own values.

    Returns:
        Axes, one per parameter.

    Raises:
        UserError: the run has no steps of a design.
    """
    return _several(run_figures.estimates(_design(run)))


def _design(run: Run) -> Outcome:
    if not run.steps:
        raise UserError(f"the run of {run.study.study!r} has no steps of a design to draw")
    return run.outcome("complete")


def _compared(calibration: Calibration, campaign: Campaign | None, observed: str):
    """The comparison with a campaign, and the campaign, of a study that observes the drawn outputs."""
    if calibration.built.study.observe != observed:
        other = "plot.histories" if observed == "quantities" else "plot.measured_against_predicted"
        raise UserError(f"the study does not observe {observed}; {other} shows what it observes")
    campaign = calibration.campaign if campaign is None else campaign
    return compare(calibration, campaign), campaign


def _there(picture: Picture | None, missing: str) -> Picture:
    if picture is None:
        raise UserError(missing)
    return picture


def _several(picture: Picture) -> np.ndarray:
    """The axes of a picture in the order they were made, colour bars left out, its figure given to pyplot to show."""
    # Without a window or a notebook, nothing would close the figure: there it lives as long as its axes.
    if matplotlib.get_backend() not in backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE):
        plt.figure(picture.figure)
    panels = [panel for panel in picture.figure.axes if panel.get_label() != "<colorbar>"]
    axes = np.empty(len(panels), dtype=object)
    axes[:] = panels
    return axes


def _one(picture: Picture) -> Axes:
    (axes,) = _several(picture)
    return axes
