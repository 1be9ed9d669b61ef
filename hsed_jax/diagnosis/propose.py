"""Which effects are worth a fit beside a fitted model, in what simplest shape and from where."""

from collections.abc import Mapping, Sequence

import numpy as np

from hsed_jax.diagnosis.fit_state import FitState, Target
from hsed_jax.diagnosis.fits import Choice
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Forms
from hsed_jax.diagnosis.scores import Linearisation, PredictedGain, telling

# Effects that are fitted, and beside the default driver of each the drivers with the largest predicted gains.
_REACH, _DRIVERS = 8, 2
# Starts of each.
_STARTS = 2

Proposals = Mapping[Choice, list[np.ndarray]]
"""Choices to fit, and the points to fit them from."""


def beside(
    models: NestedModels, target: Target, fit: FitState, top: Choice, effects: Mapping[str, Forms], is_best: bool
) -> Proposals:
    """One effect beside a fitted model: the effects with the largest predicted gains, by their best drivers.

    Arguments:
        models: of the fit.
        target: what was fitted.
        fit: the model.
        top: its effects in their forms.
        effects: the candidates.
        is_best: it is the best model so far; of another one, a part of the best, fewer are proposed: what stands in place of the
            rest is looked at closely once it leads.
    """
    predicted_gains = predicted_gains_of(models, target, fit, effects)
    ranked = list(predicted_gains)
    reach, starts, drivers = (_REACH, _STARTS, _DRIVERS) if is_best else (_REACH // 2, 1, 1)
    chosen: dict[Choice, list[np.ndarray]] = {}
    for effect in ranked[:reach]:
        default, *further = predicted_gains[effect]
        # A poor trial does not rule a driver out, so the default driver is always among the proposals.
        further.sort(key=lambda label: -predicted_gains[effect][label][0].gain)
        for label in (default, *further[:drivers]):
            chosen[top | {(effect, label)}] = [p.start for p in predicted_gains[effect][label][:starts]]
    return chosen


def pairs(
    models: NestedModels,
    target: Target,
    singles: Sequence[tuple[Choice, FitState]],
    effects: Mapping[str, Forms],
    each: int,
) -> Proposals:
    """Pairs of effects: beside each fitted single effect those with the largest predicted gains, in their default forms.

    Arguments:
        models: of the fits.
        target: what was fitted.
        singles: models of one effect.
        effects: the candidates.
        each: how many are proposed beside each.
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
    models: NestedModels, target: Target, fit: FitState, effects: Mapping[str, Forms]
) -> dict[str, dict[str, list[PredictedGain]]]:
    """The predicted gains of each effect by its drivers, the largest first."""
    found = Linearisation(models, target, fit, telling(target, fit)).of_places(effects)
    return dict(sorted(found.items(), key=lambda one: -max(best.gain for best, *_ in one[1].values())))
