"""Which effects are worth a fit beside a fitted model, in what simplest shape and from where."""

from collections.abc import Mapping, Sequence

import numpy as np

from hsed_jax.diagnosis.descent import Descent, Target
from hsed_jax.diagnosis.fits import Choice
from hsed_jax.diagnosis.nested import NestedModels
from hsed_jax.diagnosis.problem import Forms
from hsed_jax.diagnosis.scores import Around, Promise, telling

# Effects that are fitted, and beside the default driver of each the drivers that promise most.
_REACH, _DRIVERS = 8, 2
# Starts of each.
_STARTS = 2

Proposals = Mapping[Choice, list[np.ndarray]]
"""Choices to fit, and the points to fit them from."""


def beside(
    models: NestedModels, target: Target, fit: Descent, top: Choice, effects: Mapping[str, Forms], is_best: bool
) -> Proposals:
    """One effect beside a fitted model: the effects that promise most, by their best drivers.

    Arguments:
        models: of the fit.
        target: what was fitted.
        fit: the model.
        top: its effects in their forms.
        effects: the candidates.
        is_best: it is the best model so far; of another one, a part of the best, fewer are proposed: what stands in place of the
            rest is looked at closely once it leads.
    """
    promises = promises_of(models, target, fit, effects)
    ranked = list(promises)
    reach, starts, drivers = (_REACH, _STARTS, _DRIVERS) if is_best else (_REACH // 2, 1, 1)
    chosen = {}
    for effect in ranked[:reach]:
        default, *further = promises[effect]
        # A trial tells what there is to gain, and not what there is not: they need not promise more than the default one.
        further.sort(key=lambda label: -promises[effect][label][0].gain)
        for label in (default, *further[:drivers]):
            chosen[top | {(effect, label)}] = [p.start for p in promises[effect][label][:starts]]
    return chosen


def pairs(
    models: NestedModels,
    target: Target,
    singles: Sequence[tuple[Choice, Descent]],
    effects: Mapping[str, Forms],
    each: int,
) -> Proposals:
    """Pairs of effects: beside each fitted single one those that promise most, in their default forms.

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
        promises = promises_of(models, target, fit, {e: forms for e, forms in effects.items() if e not in own})
        defaults = [(effect, *next(iter(forms.items()))) for effect, forms in promises.items()]
        for effect, label, found in sorted(defaults, key=lambda one: -one[2][0].gain)[:each]:
            chosen.setdefault(top | {(effect, label)}, []).extend(p.start for p in found[:_STARTS])
    return chosen


def promises_of(
    models: NestedModels, target: Target, fit: Descent, effects: Mapping[str, Forms]
) -> dict[str, dict[str, list[Promise]]]:
    """What each effect promises by its drivers, the most promising effect first."""
    found = Around(models, target, fit, telling(target, fit)).of_places(effects)
    return dict(sorted(found.items(), key=lambda one: -max(promises[0].gain for promises in one[1].values())))
