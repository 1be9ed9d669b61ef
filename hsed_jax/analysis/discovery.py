"""Learn an effect that the catalogue does not hold: from a calibrated model to an effect of a user's own."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain, count

import numpy as np
from scipy.special import softmax

from hsed_jax.analysis.calibration import Calibration
from hsed_jax.analysis.remedy import diagnose
from hsed_jax.diagnosis.candidates import problem_of, with_effects
from hsed_jax.diagnosis.diagnose import noise_explains
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.diagnosis.problem import Problem
from hsed_jax.discovery.effect_file import source_of, source_of_curve
from hsed_jax.discovery.findings import EFFECT, Curve, Discovery, Tried
from hsed_jax.discovery.fitted_formulas import FormulaFits
from hsed_jax.discovery.formulas import formulas, in_text
from hsed_jax.discovery.places import Motion, Reaches, places
from hsed_jax.discovery.search import Fitted, HeldOutError, PlaceSearch
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import conditions_of
from hsed_jax.inference.watch import Watch
from hsed_jax.measurements import Campaign
from hsed_jax.physics.effects import AbstractEffect
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import FreeForce, FreeFunction
from hsed_jax.physics.simulator import Simulator
from hsed_jax.study.build import Built

# Formulas that are fitted inside the simulation.
_FORMULAS = 8
# Posterior odds that a place needs against the first model and against chance with the same flexibility.
_ODDS = 10.0
# Least share of the squared held-out error, minus the noise, that it must remove.
_MATERIAL = 0.1
# Largest log-evidence difference [nats] between the curve and an accepted formula.
_WORSE = 10.0
# A place with this share of the probability of the best is as likely.
_LIKELY = 0.05


def discover(
    calibration: Calibration,
    campaign: Campaign | None = None,
    diagnosis: Diagnosis | None = None,
    watch: Watch | None = None,
) -> Discovery:
    """The missing effect of a calibrated model that is not in the catalogue: a free function at a place, and its formula.

    The catalogue comes first. If its best model leaves more than the noise, free functions are tried at all places of the
    law: with the law alone, and, if that is not enough, together with the effects that the diagnosis names. The best function
    is fitted in the simulation together with the law. It must predict held-out experiments better, and its gain must exceed
    that of the same function with the coordinates of another experiment.

    Arguments:
        calibration: the calibrated model.
        campaign: experiments to look at; by default those it was calibrated on.  Only the training split is fitted.
        diagnosis: of it; made where it is not given.
        watch: follows the search.

    Raises:
        UserError: the model is a function, or has several specimens.
    """
    campaign, watch = calibration.campaign if campaign is None else campaign, watch or Watch()
    if not isinstance(calibration.built.simulation.simulator, Simulator):
        raise UserError("discover: it needs a spring law, but the model of this study is a function")
    if any(element.name for element in calibration.built.mechanics.elements):
        raise UserError("discover: it works with one specimen, but this study has named specimens")
    diagnosis = diagnosis or diagnose(calibration, campaign, watch)
    if diagnosis.verdict == "adequate":
        return Discovery(False, "the noise explains the residual", error=diagnosis.error)
    if diagnosis.effects and diagnosis.is_explained:
        named = " and ".join(diagnosis.effects)
        return Discovery(False, f"the catalogue explains the residual: {named}", error=diagnosis.error)
    alone = _Beside(calibration, campaign, (), {}, watch)
    if not diagnosis.effects or alone.is_enough:
        return alone.discovery()
    # Effects that were named without the learned one are not needed together with it.
    with_named = _Beside(calibration, campaign, diagnosis.effects, diagnosis.forms, watch)
    return min(alone, with_named, key=lambda one: one.best.error).discovery()


class _Beside:
    """The search beside a law and named effects.

    Arguments:
        calibration: of the law.
        campaign: the experiments.
        effects, forms: of the catalogue, to stand beside.
        watch: follows it.
    """

    def __init__(
        self,
        calibration: Calibration,
        campaign: Campaign,
        effects: Sequence[str],
        forms: Mapping[str, str],
        watch: Watch,
    ):
        built = calibration.built
        self._built = Built(with_effects(built, effects, forms), built.campaign) if effects else built
        self._campaign, self._effects, self._forms, self._watch = campaign, effects, forms, watch
        self._known, self._apart = calibration.map, calibration.apart(campaign)
        has_inner = set(FreeFunction.slots[1:]) <= set(built.mechanics.elements[0].law.slots)
        kind = FreeFunction if has_inner else FreeForce
        self.problem = self._problem(kind)
        self._reaches = Reaches(self._motions(), self.problem.scales)
        self._search = PlaceSearch(self.problem, self._reaches, watch.report)
        has_time = campaign.has_time or not built.experiments.component_test or built.simulation.grid is None
        self._search.run(places(kind.slots, has_time))
        self._before = self._search.held_out_error(None)

    @property
    def is_enough(self) -> bool:
        """Whether the noise explains the residual of the best place."""
        return noise_explains(self.problem, self._search.fitted[0].fit)

    @cached_property
    def best(self) -> HeldOutError:
        """Predictions of held-out data with the best place; the model is fitted again for every part that is left out."""
        return self._search.held_out_error(self._search.fitted[0])

    def discovery(self) -> Discovery:
        """The result of the search."""
        search, problem = self._search, self.problem
        best, gains = search.fitted[0], np.asarray([one.log_evidence for one in search.fitted]) - search.log_evidence
        shares = np.asarray(softmax([one.log_posterior for one in search.fitted]))
        ranking = [
            Tried(one.place, float(gain), float(share), problem.train.error(one.fit.predicted))
            for one, gain, share in zip(search.fitted, gains, shares, strict=True)
        ]
        found = Discovery(
            False,
            ranking=ranking,
            error=(problem.train.error(search.base.predicted), self._before.error),
            noise_floor=problem.train.noise,
            scales=problem.scales,
            effects=list(self._effects),
            forms=dict(self._forms),
            effect=self._name,
        )
        reason = self._too_little(best, ranking[0].log_evidence_gain) or self._holds_not(best, self.best)
        if reason:
            return replace(found, reason=reason)
        shown, after = self._shown(found, best)
        if reason := self._holds_not(best, after):
            return replace(found, reason=reason)
        return replace(shown, found=True, probability=ranking[0].probability, notes=self._notes(best, ranking))

    def _too_little(self, best: Fitted, gain: float) -> str:
        """The reason why the evidence of a place is not sufficient, in a sentence; empty if it is."""
        predicted_gain, words = best.predicted_gain, best.place.words
        if gain < math.log(_ODDS * len(self._search.predicted_gains)):
            return f"the best place, {words}, gains only {gain:.1f} nats"
        if predicted_gain.gain < predicted_gain.chance + math.log(_ODDS):
            return f"{words} gains no more than chance does with the same flexibility"
        return ""

    def _holds_not(self, best: Fitted, now: HeldOutError) -> str:
        """The reason why the predictions with a place are not sufficient, in a sentence; empty if they are."""
        words, before, floor = best.place.words, self._before, self.problem.train.noise**2
        if not now.error < before.error or before.error**2 - now.error**2 < _MATERIAL * (before.error**2 - floor):
            change = f"from {before.error:.3f} to {now.error:.3f}"
            return f"{words} reduces the error on experiments that were not fitted only {change}"
        if not now.gain.total > now.gain.standard_error:
            return (
                f"{words} reduces the squared error on experiments that were not fitted by only {now.gain.total:.2g} ± "
                f"{now.gain.standard_error:.2g}"
            )
        return ""

    def _shown(self, found: Discovery, best: Fitted) -> tuple[Discovery, HeldOutError]:
        """The function as a formula, or as a curve, with its file, its errors and its predictions."""
        place, reaches, train = best.place, best.reaches, self.problem.train
        curve = Curve(place, reaches, best.coefficients, best.covariance)
        self._watch.report("formulas")
        tried = formulas(place, reaches, best.coefficients, best.normal_equations[0], _FORMULAS)
        fits = FormulaFits(tried, reaches, self._problem, self._search.target, self._law())
        if (chosen := fits.best) is not None and chosen.log_evidence > best.log_evidence - _WORSE:
            formula, after = chosen.formula, fits.held_out_error(chosen)
            shown = replace(
                found,
                place=formula.place,
                formula=in_text(formula, [COORDINATES[name].text for name in place.of]),
                curve=replace(curve, formula=formula),
                source=source_of(formula, reaches, self._name),
                error_train=train.error(chosen.fit.predicted),
                error_test=after.error,
            )
            return shown, after
        after = self.best
        shown = replace(
            found,
            place=place,
            formula="a smooth curve without a formula of the grammar",
            curve=curve,
            source=source_of_curve(place, reaches, best.coefficients, self._name),
            error_train=train.error(best.fit.predicted),
            error_test=after.error,
        )
        return shown, after

    @property
    def _name(self) -> str:
        """A name for the learned effect that is not in the catalogue."""
        names = chain([EFFECT], (f"{EFFECT}_{number}" for number in count(2)))
        return next(name for name in names if name not in self._built.mechanics.catalogue)

    def _law(self) -> dict[str, float]:
        """Parameters of the first model, by name, SI."""
        theta = self._search.models.theta(self._search.base.x, self._search.base.submodel)
        return {self.problem.names[k]: float(theta[k]) for k in self.problem.law}

    def _notes(self, best: Fitted, ranking: Sequence[Tried]) -> list[str]:
        ends = zip(best.place.of, best.reaches, strict=True)
        reach = " and ".join(f"{COORDINATES[name].text} from {low:.3g} to {high:.3g}" for name, (low, high) in ends)
        alike = [one.place.words for one in ranking[1:] if one.probability > _LIKELY * ranking[0].probability]
        return [
            f"the measurements cover {reach}; beyond this range the function is constant",
            *([f"these measurements do not exclude {'; '.join(alike)}"] if alike else []),
        ]

    def _problem(self, *kinds: type[AbstractEffect]) -> Problem:
        """The problem with these effects as candidates."""
        built = Built(self._built.study.with_own_effects(*kinds), self._built.campaign)
        names = [kind.name for kind in kinds]
        return problem_of(built, self._campaign, names).calibrated(self._known, self._apart, watch=self._watch)

    def _motions(self) -> list[Motion]:
        """The states of the first model in the training experiments."""
        built, found = self._built, []
        middle = {name: float(prior.quantile(0.5)) for name, prior in built.mechanics.parameters[0].items()}
        known = {**built.mechanics.parameters[1], **middle, **self._known}
        for experiment in self.problem.experiments:
            conditions = conditions_of(experiment, self._campaign, built.simulation.grid, built.experiments.excitation)
            channels = built.simulation.simulator.respond(
                known, conditions, ("elongation", "elongation_rate", "force")
            ).channels
            time = (
                built.simulation.simulator.times(conditions.inputs)
                if experiment.record is None
                else experiment.record.time
            )
            found.append(Motion(np.asarray(time), *map(np.asarray, channels.values())))
        return found
