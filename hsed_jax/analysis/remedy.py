"""The Python interface, second half: find the missing physical effect, add it, and compare the errors."""

import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.analysis.calibration import Calibration, calibrate_built, compare
from hsed_jax.analysis.specimens import over_specimens
from hsed_jax.config.schema import Study
from hsed_jax.criticism.compare import Comparison
from hsed_jax.criticism.improve import Step, Trail, step_of
from hsed_jax.diagnosis import diagnose as diagnosing
from hsed_jax.diagnosis.candidates import problem_of, with_effects
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.diagnosis.fit_state import FitState, Submodel, Target, Task
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.diagnosis.score import largest_alike
from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.inference.expansion import expand
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Campaign
from hsed_jax.physics.effects.forms import default_form
from hsed_jax.plain import dump_yaml
from hsed_jax.study.build import Built
from hsed_jax.tables import Table, Tabular

# Number of candidates of a design among which the best separation of rivals is searched; the first part of a Sobol' set.
_DISCRIMINATED = 512
# Samples of a record of a component test that a diagnosis uses; an improvement is fitted to all.  With more of them, further
# effects mend a formula that is not the specimen's (benchmarks/opensees_files.py).
_SAMPLES = 400
# Largest number of draws of each chain for the improved model, for intervals and the expected error.
_DRAWS = 250
# Distance of the first model from its best fit [nats] that starts a new search, or replaces the fit.
_APART = 2.0


def diagnose(calibration: Calibration, campaign: Campaign | None = None, watch: Watch | None = None) -> Diagnosis:
    """The physical effects of the catalogue that the calibrated model lacks.

    Arguments:
        calibration: the calibrated model.
        campaign: experiments to look at; by default those it was calibrated on.  Only the training split is fitted.
        watch: follows the search.
    """
    campaign = calibration.campaign if campaign is None else campaign
    watch = watch or Watch()
    built = calibration.built
    leaning = [one.parameter for one in calibration.fit.leaning if one.parameter in built.mechanics.parameters[0]]
    excludes = bool(leaning) and not compare(calibration, campaign).adequate

    def problem_with(some: Campaign) -> Problem:
        large = problem_of(built, some, samples=_SAMPLES)
        return large.calibrated(calibration.map, calibration.apart(some), leaning, excludes, watch)

    problem = problem_with(campaign)
    found = diagnosing.diagnose(problem, watch.report, watch.lead)
    return over_specimens(found, problem, problem_with, built, campaign, watch.report)


def separations(built: Built, campaign: Campaign) -> Float[Array, " m"]:
    """Log of the expected log Bayes factor between rivals of each of the first candidates, in addition to that of the pending
    experiments.

    Arguments:
        built: the study, with a design.
        campaign: the experiments so far.
    """
    cube, factors = np.asarray(built.design.sequential.candidate_set[:_DISCRIMINATED]), built.experiments.space.factors
    out = [
        built.experiments.space.located({name: value / factors[name] for name, value in one.inputs.items()}).cube
        for one in campaign
        if one.status == "pending"
    ]
    problem = problem_of(built, campaign, cube=np.concatenate([cube, *(one[None] for one in out)]))
    found = diagnosing.diagnose(problem._replace(pending=len(out)))
    return jnp.log(jnp.asarray(np.maximum(found.separation, 1e-300)))


def verdict_of(built: Built, campaign: Campaign) -> str:
    """The verdict of a diagnosis of the experiments so far.

    Arguments:
        built: the study.
        campaign: the experiments so far.
    """
    return diagnosing.diagnose(problem_of(built, campaign)).verdict


@dataclass(frozen=True, repr=False)
class Improvement(Tabular):
    """A model with effects added, calibrated again.

    Attributes:
        study: with the effects in its model, ready to run or to improve again.
        original: the calibrated model that was improved.
        calibration: of the improved model.
        before, after: the first model and the improved one, compared with the same measurements.
        trail: the error after each added effect.
    """

    study: Study
    original: Calibration
    calibration: Calibration
    before: Comparison
    after: Comparison
    trail: Trail

    def write(self, path: str | Path) -> None:
        """Write the improved study as YAML, with comments, its paths relative to the file."""
        path, pair = Path(path), self.original.built.mechanics.pair
        plain = self.study.written()
        model, experiments = plain["model"], plain["experiments"]

        def beside(name: str) -> str:
            return os.path.relpath(name, path.parent.absolute())

        if "campaign" in experiments:
            experiments["campaign"] = beside(experiments["campaign"])
        for settings in plain.get("excitation", {}).values():
            if isinstance(settings, dict) and "file" in settings:
                settings["file"] = beside(settings["file"])
        for spring in (model["spring"], experiments.get("virtual", {}).get("spring")):
            if isinstance(spring, dict):
                spring["file"] = beside(spring["file"])
        model["own_effects"] = [beside(name) for name in model["own_effects"]]
        comments = {
            "study": [
                f"The study {self.original.built.study.study!r} with {' and '.join(self.trail.steps[-1].effects)} added to its "
                f"model: {self.trail.sentence}.",
                f"Run it with:  hsed run {path.name}   (every default is written out)",
            ],
            "model": ["{} after an effect: the priors of the catalogue (hsed effects NAME shows them)"],
            "experiments": ["relative paths start at the folder of this file"],
            "scales": [
                "amplitudes of effects are relative to these characteristic values: force "
                f"[{pair.force_unit}], elongation [{pair.elongation_unit}], rate [{pair.unit('m/s')}], absorbed energy "
                f"[{pair.energy_unit}]"
            ],
        }
        lines = []
        for line in dump_yaml(plain, inline_leaves=True).splitlines():
            about = comments.get(line.partition(":")[0], ())
            lines += [*(f"# {part}" for text in about for part in textwrap.wrap(text, 120)), line]
        write_whole(path, "\n".join(lines) + "\n")

    def _table(self) -> Table:
        warning = self.calibration.fit.warning
        doubts = [f"the draws of the improved model have not converged: {warning}"] if warning else []
        return replace(
            self.trail._table(), notes=[self.after.verdict, *self.trail.notes, *self.after.warnings, *doubts]
        )


def improve(
    calibration: Calibration,
    found: Diagnosis | Campaign | None = None,
    *,
    campaign: Campaign | None = None,
    effects: Sequence[str] | None = None,
    forms: Mapping[str, str] | None = None,
    start: Mapping[str, float] | None = None,
    own_effects: Sequence[str | Path] = (),
    watch: Watch | None = None,
) -> Improvement:
    """Add effects to a calibrated model and calibrate it again, MAP and posterior.

    One start of every model is the estimate of the previous model, so that its error does not rise.  If this shows a better
    fit of the first model, the first model is calibrated again from there.

    Arguments:
        calibration: the first model.
        found: a diagnosis, whose effects are added in the forms that it found, without the last ones if these raise the error on
            experiments that were not fitted materially; or the campaign, with the effects named.
        campaign: experiments; by default those it was calibrated on.
        effects: names of effects of the catalogue, in the order to add them; by default those of the diagnosis.
        forms: labels of their forms, where these are not the default ones: `Diagnosis.forms`.
        start: parameters of the model with them, by name, SI, to start one of the searches from: `Diagnosis.optimum`, so that
            the improvement reaches the fit of the diagnosis.
        own_effects: Python files with your effects that the study does not name yet, such as the file that `Discovery.write`
            writes.
        watch: follows the fits and the calibration.

    Raises:
        UserError: no effect is given, or one is unknown, there already, or given twice.

    Example:
        ```python
        better = hx.improve(fit, diagnosis)
        better = hx.improve(fit, effects=["pinching"])  # an effect of your choice
        ```
    """
    is_proposed = isinstance(found, Diagnosis) and effects is None
    if isinstance(found, Diagnosis):
        effects = found.effects if effects is None else effects
        if list(effects) == found.effects:
            forms = found.forms if forms is None else forms
            start = found.optimum if start is None else start
    elif found is not None:
        campaign = found
    campaign = calibration.campaign if campaign is None else campaign
    if own_effects:
        calibration = replace(calibration, built=_with_files(calibration.built, own_effects))
    if not effects:
        raise UserError("there is no effect to add; name at least one (hsed effects lists the catalogue)")
    study = _improved(calibration.built, effects, forms)
    watch = watch or Watch()
    watch.report("the model with the effects")
    forms = {effect: default_form(calibration.built.mechanics.catalogue[effect]).label for effect in effects} | dict(
        forms or {}
    )
    known, apart = calibration.map, calibration.apart(campaign)
    problem = problem_of(calibration.built, campaign, effects, forms=forms).calibrated(known, apart, watch=watch)
    before = compare(calibration, campaign)
    train = problem.train
    assert problem.start is not None
    models = problem.models
    law = models.submodel(problem.law)
    predicted = models.predict([(problem.start, law)], np.arange(len(train.values)))[0][0]
    # With the weights of the calibration, from its residual.
    target = train.standard(predicted, train.used[None]).target
    plain = _best(problem, target, law, [], problem.start)
    notes = []
    if target.misfit(0, predicted) - target.misfit(0, plain.predicted) > _APART:
        again = calibrate_built(
            calibration.built, campaign, start=_parameters(problem, plain, calibration.built), watch=watch
        )
        # The posterior weighs autocorrelated residuals differently, so its best fit may be the earlier one.
        of, stood = again.fit.posterior, calibration.fit.maximum.theta
        (around,) = expand(of, again.fit.data, [np.asarray(of.unconstrain(stood))])
        if again.fit.maximum.log_posterior - around.log_posterior > _APART:
            calibration, before = again, compare(again)
            notes.append(
                "the calibration of the first model had not reached the best fit, so it was repeated from there"
            )
    places = [problem.effects[name][forms[name]] for name in effects]

    def with_first(count: int) -> Submodel:
        added = places[:count]
        free = np.concatenate([problem.law, *(form.columns for form in added)]).astype(int)
        return models.submodel(free, {k: value for form in added for k, value in form.held.items()})

    if start is not None:
        # With the errors that the first model leaves, none of the others would follow the data as closely as it can.
        found_there, ok = models.predict(
            [(problem.point(start), with_first(len(effects)))], np.arange(len(train.values))
        )
        target = train.standard(found_there[0], train.used[None]).target if ok.all() else target
    steps, fits, dropped = [step_of([], before, calibration.map)], [plain], list[tuple[str, float | None]]()
    for count in range(1, len(effects) + 1):
        known_there = start if count == len(effects) else None
        fits.append(_best(problem, target, with_first(count), places[count - 1].columns, fits[-1].x, known_there))
        steps.append(_between(problem, fits[-1], effects[:count]))
    while True:
        built = Built(study, calibration.built.campaign)
        # An improvement reports its error.  Chains of a model with so many parameters take minutes: the study that is
        # written has them when it is run.
        settings = built.inference.settings
        if settings.sampler == "auto":
            settings = settings._replace(sampler="importance", draws=min(settings.draws, _DRAWS))
        start_at = _parameters(problem, fits[len(steps) - 1], built)
        # The search, and the fit of each step, have already searched for other modes.
        better = calibrate_built(built, campaign, start=start_at, starts=1, watch=watch, settings=settings)
        after = compare(better)
        steps[-1] = step_of(steps[-1].effects, after, better.map)
        if not (is_proposed and _is_worse(steps, after)):
            notes += [_not_added(*one, after) for one in dropped]
            return Improvement(study, calibration, better, before, after, Trail(steps, after.train.noise_floor, notes))
        # The diagnosis judged a thinned record, and with all samples the last effect does not predict.
        *kept, last = steps[-1].effects
        dropped.append((last, steps.pop().error_test))
        study = _improved(calibration.built, kept, {effect: forms[effect] for effect in kept})


def _improved(built: Built, effects: Sequence[str], forms: Mapping[str, str] | None) -> Study:
    """The study with effects in its model, under the name of an improved one."""
    study = with_effects(built, effects, forms)
    return study.model_copy(update={"study": f"{study.study.removesuffix('_improved')}_improved"})


def _not_added(effect: str, error: float | None, after: Comparison) -> str:
    """The sentence on an effect that is left out, with its error on held-out experiments and that of the model without it."""
    assert error is not None and after.test is not None
    without = f"{after.test.error:.3f} without it"
    return f"{effect} is not added: the error on experiments that were not fitted is {error:.3f} with it and {without}"


def _is_worse(steps: Sequence[Step], after: Comparison) -> bool:
    """Whether the last of several effects raises the error on experiments that were not fitted materially."""
    errors = [step.error_test for step in steps if step.error_test is not None]
    if len(errors) < 3 or after.test is None:
        return False
    return errors[-1] > largest_alike(after.test.noise_floor, errors[0], errors[-2])


def _with_files(built: Built, files: Sequence[str | Path]) -> Built:
    """The study with further files of own effects."""
    study = built.study
    named = [*study.model.own_effects, *(str(Path(file).resolve()) for file in files)]
    model = study.model.model_copy(update={"own_effects": named})
    return Built(study.model_copy(update={"model": model}), built.campaign)


def _best(
    problem: Problem,
    target: Target,
    submodel: Submodel,
    new: Sequence[int] | np.ndarray,
    x: np.ndarray,
    known: Mapping[str, float] | None = None,
) -> FitState:
    """The best fit of a model with new parameters. It starts from the fit of the model without them, from there with
    the new parameters spread over their priors, and from known parameters.
    """
    models, columns = problem.models, np.asarray(new, dtype=int)
    tasks = [Task(submodel, x)]
    if known is not None:
        tasks.append(Task(submodel, problem.point(known)))
    if columns.size:
        starts = np.tile(x, (8, 1))
        shares = 0.1 + 0.8 * (np.arange(8)[:, None] * (0.5 + np.sqrt(np.arange(columns.size) + 2.0)) % 1.0)
        starts[:, columns] = models.box.quantiles(columns, shares)
        tasks += [Task(submodel, spread, rivals=0) for spread in starts]
    return min(models.fit(target, tasks), key=lambda f: f.cost)


def _parameters(problem: Problem, fit: FitState, built: Built) -> Array:
    """θ of a fit, in the order of the study that has its effects: those of a structure are after them."""
    theta = problem.models.theta(fit.x, fit.submodel)
    return jnp.asarray([theta[problem.names.index(name)] for name in built.mechanics.parameters[0]])


def _between(problem: Problem, fit: FitState, effects: Sequence[str]) -> Step:
    """A step of the trail between the first model and the improved one."""
    theta = problem.models.theta(fit.x, fit.submodel)
    rows = np.arange(problem.rows)
    outputs, _ = problem.models.batch(np.repeat(theta[None], len(rows), axis=0), rows)
    size = len(problem.train.values)
    test = None if problem.test is None else problem.test.error(outputs[size:])
    parameters = {problem.names[k]: float(theta[k]) for k in fit.free}
    return Step(list(effects), problem.train.error(outputs[:size]), test, parameters)
