"""The paper's campaign as a careful expert would script it: SciPy's least squares, scikit-learn, and a fast simulator.

Steps 1 to 8 of the paper with the MAP alone.  The expert takes the initial design and the candidates from the study, and knows
what a script of an afternoon may know: to start each search from the last MAP, to simulate all differences in one call, and that
matrices this small are for one thread.
"""

from collections.abc import Callable

import numpy as np
from case import ETA, Numbers, numbers
from peers import surrogate
from scipy.optimize import least_squares

from hsed_jax.study.build import Built

_DIFFERENCE = 1e-6
_SPREAD = 256  # inputs over which the variance of Eq. 12 is taken


def campaign(case: Built, simulate: Callable[..., np.ndarray], iterations: int) -> dict[str, float]:
    """The MAP, by name, after the initial and so many chosen experiments."""
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    with threadpool_limits(1):
        return _campaign(case, simulate, iterations)


def _campaign(case, simulate, iterations) -> dict[str, float]:
    plain, priors = numbers(case), case.posterior.priors
    low, high = np.array([prior.bounds for prior in priors.values()], float).T
    truth = [np.array([case.laboratory.parameters[name]]) for name in priors]
    relative = np.asarray([error.size for error in case.errors], float)

    def inputs(cube):
        si = case.space.si(case.space.declared(cube))
        return si["V_P"], si["T_P"]

    cube = case.space.initial_design(case.study.design.initial)
    candidates = np.asarray(case.design.candidate_set)
    over = inputs(case.space.spread(_SPREAD))
    measured = simulate(plain, *inputs(cube), *(np.repeat(x, len(cube)) for x in truth), ETA)
    u = np.full(len(low), 0.5)
    for step in range(iterations + 1):
        u = _maximum(plain, simulate, inputs(cube), measured, relative, low, high, u)
        theta = low + (high - low) * u
        if step == iterations:
            return dict(zip(priors, theta.tolist(), strict=True))
        here, there = (_predicted(plain, simulate, theta[None], at)[0] for at in (inputs(cube), over))
        norms = np.sum((measured - here) ** 2 / there.var(axis=0), axis=1)
        hoped = surrogate.improvement(surrogate.fitted(cube, norms), candidates)
        distance = np.abs(candidates[:, None] - cube).max(axis=-1).min(axis=1)
        chosen = candidates[np.argmax(np.where(distance > 1e-6, hoped, -1.0))][None]
        measured = np.vstack([measured, simulate(plain, *inputs(chosen), *truth, ETA)])
        cube = np.vstack([cube, chosen])
    raise AssertionError("the last step returns")


def _maximum(plain, simulate, inputs, measured, relative, low, high, start) -> np.ndarray:
    """The MAP in shares of the priors' ranges, which are uniform: least squares within bounds, the scale of the error given."""

    def of_predicted(predicted):
        return ((predicted / measured - 1) / relative).reshape(len(predicted), -1)

    def residuals(u):
        return of_predicted(_predicted(plain, simulate, (low + (high - low) * u)[None], inputs))[0]

    def jacobian(u):
        steps = np.where(u + _DIFFERENCE > 1, -_DIFFERENCE, _DIFFERENCE)
        moved = low + (high - low) * np.vstack([u, u + np.diag(steps)])
        found = of_predicted(_predicted(plain, simulate, moved, inputs))
        return ((found[1:] - found[0]) / steps[:, None]).T

    return least_squares(residuals, np.clip(start, 1e-6, 1 - 1e-6), jacobian, bounds=(0, 1)).x


def _predicted(plain: Numbers, simulate, thetas: np.ndarray, inputs) -> np.ndarray:
    """Quantities (parameter vectors, experiments, 3), in one call."""
    count = len(inputs[0])
    columns = (np.repeat(column, count) for column in thetas.T)
    values = simulate(plain, *(np.tile(x, len(thetas)) for x in inputs), *columns, 0.0)
    return values.reshape(len(thetas), count, -1)
