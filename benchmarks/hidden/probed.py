"""The hidden specimen under imposed elongations, histories as lanes, with steps of their own lengths.  NumPy alone."""

import numpy as np

from .cases import Plan
from .specimen import Scales, Specimen, driven_rates


def forces(plan: Plan, deltas, scales: Scales, elongation, rate, lengths) -> np.ndarray:
    """Force at the start and at the ends of the steps [N], (B, n+1).

    Arguments:
        plan: what was drawn; only effects in the specimen count.
        deltas: their amplitudes, one for each hidden effect.
        scales: characteristic values that the effects use.
        elongation, rate: on the half-step grid [m], [m/s], (B, 2n+1).
        lengths: of the steps [s], (B, n).
    """
    lanes, steps = lengths.shape
    specimen = Specimen(np.full(lanes, plan.A), np.full(lanes, plan.beta), scales)
    specimen.acts = [
        (item.formula.act, {"delta": np.full(lanes, float(delta)), **item.drawn}, item.formula.states)
        for item, delta in zip(plan.hidden, deltas, strict=True)
        if item.formula.place == "specimen"
    ]
    rates = driven_rates(specimen)
    state, reach = np.zeros((specimen.rows, lanes)), np.zeros((2, lanes))
    kept = np.zeros((lanes, steps + 1))
    with np.errstate(all="ignore"):
        for i in range(steps + 1):
            u, v = elongation[:, 2 * i], rate[:, 2 * i]
            reach = np.maximum(reach, [u, -u])
            kept[:, i] = specimen(u, v, state, reach)[0]
            if i == steps:
                break
            h = lengths[:, i]
            first, middle, last = ((elongation[:, k], rate[:, k]) for k in range(2 * i, 2 * i + 3))
            a = rates(state, first, reach)
            b = rates(state + 0.5 * h * a, middle, reach)
            c = rates(state + 0.5 * h * b, middle, reach)
            d = rates(state + h * c, last, reach)
            state = state + h / 6 * (a + 2 * (b + c) + d)
    return kept
