"""Selection of the effects to fit beside a fitted model, in their forms with the fewest parameters, and of their starts."""

from collections.abc import Mapping, Sequence

import numpy as np

from hsed_jax.diagnosis.fit_state import FitState, Target
from hsed_jax.diagnosis.fits import Choice
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Forms
from hsed_jax.diagnosis.scores import Linearisation, PredictedGain, telling

# Number of effects to fit, and number of forms of each beside its default one; both have the largest predicted gains.
_REACH, _FORMS = 8, 2
# Number of starts of each fit.
_STARTS = 2

PredictedGains = Mapping[str, Mapping[str, list[PredictedGain]]]
"""Predicted gains by effect, the effect with the largest one first, and by form."""

Proposals = Mapping[Choice, list[np.ndarray]]
"""Choices to fit, and the starts of their fits."""


def beside(predicted_gains: PredictedGains, top: Choice, is_best: bool) -> Proposals:
    """Choices with one effect beside a fitted model: the effects with the largest predicted gains, in their best forms.

    Arguments:
        predicted_gains: of the candidates beside the model.
        top: the effects of the model, in their forms.
        is_best: whether the model is the best one so far.  Beside another model, a part of the best one, fewer effects are
            proposed, because a set with an exchanged effect is examined again when it is the best one.
    """
    ranked = list(predicted_gains)
    reach, starts, others = (_REACH, _STARTS, _FORMS) if is_best else (_REACH // 2, 1, 1)
    chosen: dict[Choice, list[np.ndarray]] = {}
    for effect in ranked[:reach]:
        default, *further = predicted_gains[effect]
        # A poor trial does not rule a form out, so the default one is always among the proposals.
        further.sort(key=lambda label: -predicted_gains[effect][label][0].gain)
        for label in (default, *further[:others]):
            chosen[top | {(effect, label)}] = [p.start for p in predicted_gains[effect][label][:starts]]
    return chosen


def pairs(
    models: NestedModels,
    target: Target,
    singles: Sequence[tuple[Choice, FitState]],
    effects: Mapping[str, Forms],
    each: int,
) -> Proposals:
    """Pairs of effects: beside each fitted single effect, those with the largest predicted gains, in their default forms.

    Arguments:
        models: of the fits.
        target: the data of the fits.
        singles: models with one effect.
        effects: the candidates.
        each: number of proposals beside each single effect.
    """
    chosen: dict[Choice, list[np.ndarray]] = {}
    for top, fit in singles:
        own = {effect for effect, _ in top}
        predicted_gains = predicted_gains_of(
            models, target, fit, {e: forms for e, forms in effects.items() if e not in own}
        )
        defaults = [(effect, *next(iter(forms.items()))) for effect, forms in predicted_gains.items()]
        for effect, label, found in sorted(defaults, key=lambda one: -one[2][0].gain)[:each]:
            chosen.setdefault(top | {(effect, label)}, []).extend(p.start for p in found[:_STARTS])
    return chosen


def predicted_gains_of(
    models: NestedModels, target: Target, fit: FitState, effects: Mapping[str, Forms], is_explained: bool = False
) -> PredictedGains:
    """The predicted gains of candidates beside a fitted model.

    Arguments:
        models: of the fit.
        target: the data of the fit.
        fit: the fit state of the model.
        effects: the candidates.
        is_explained: whether the noise explains the residual of the fit: then the effects are small, no experiment tells more
            than another one, and all are simulated.
    """
    rows = None if is_explained else telling(target, fit)
    found = Linearisation(models, target, fit, rows).of_places(effects, is_explained)
    return dict(sorted(found.items(), key=lambda one: -max(best.gain for best, *_ in one[1].values())))
