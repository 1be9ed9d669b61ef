r"""What candidates promise before they are fitted: Rao's score test of each amplitude, around any model that was fitted.

A test of the residual's size asks whether anything at all is wrong, and spreads its power over all samples.  A score test asks
in one direction only, the derivative of the outputs with respect to the amplitude, and sees there what is a hundred times
smaller.  With K candidates the smallest of K p-values counts as $1-(1-p)^K$ (Šidák 1967).
"""

from collections.abc import Mapping

import numpy as np
from scipy.special import chdtrc

from hsed_jax.diagnosis.nested import Descent, NestedModels, Target

# Of a difference, in coordinates of order one.
_STEP = 1e-3


def score_tests[T](
    models: NestedModels, target: Target, fit: Descent, amplitudes: Mapping[T, tuple[int, Mapping[int, float]]]
) -> dict[T, float]:
    r"""Rao's score statistic of amplitudes at their neutral values, $\chi^2_1$ where an effect is absent.

    Arguments:
        models: of the fit.
        target: what was fitted.
        fit: the model without these effects; its free parameters are projected out.
        amplitudes: the index of each, and what other parameters are held at beside it.

    Source: Rao 1948.
    """
    x = models.neutral.copy()
    x[fit.free] = fit.x[fit.free]
    points, steps = [(x, fit.member)], []
    for k, held in (*((int(k), {}) for k in fit.free), *amplitudes.values()):
        moved = x.copy()
        steps.append(-_STEP if moved[k] + _STEP > models.box.high[k] else _STEP)
        moved[k] += steps[-1]
        points.append((moved, fit.member.beside(k, held)))
    rows = np.arange(len(target.values))
    outputs, ok = models.predict(points, rows)
    residual = target.standardised(fit.use, rows, target.values - outputs[0]).ravel()
    slopes = target.standardised(fit.use, rows, (outputs[1:] - outputs[0]) * ok[1:, :, None])
    slopes = slopes.reshape(len(steps), -1) / np.asarray(steps)[:, None]
    basis, _ = np.linalg.qr(slopes[: len(fit.free)].T)
    found = {}
    for effect, slope in zip(amplitudes, slopes[len(fit.free) :], strict=True):
        own = slope - basis @ (basis.T @ slope)
        power = float(own @ own)
        is_told = power > 1e-12 * float(slope @ slope) and power > 0
        found[effect] = float(own @ residual) ** 2 / power if is_told else 0.0
    return found


def score_p_value(statistic: float, candidates: int = 1) -> float:
    """Probability of a score statistic like this, as the largest of so many, where the effects are absent."""
    one = float(chdtrc(1, statistic))
    return 1.0 if one >= 1 else float(-np.expm1(candidates * np.log1p(-one)))
