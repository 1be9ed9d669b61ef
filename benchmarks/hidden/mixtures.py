"""Mixtures of two formulas of an effect: as many as are asked for, of which nobody has seen any before.

A mixture is named by its parts, as `0.4 log + 0.6 three slopes`: each acts with its share of the amplitude.
"""

import numpy as np

from .catalogue import FORMULAS, Formula, formula


def mixable(effect: str) -> list[str]:
    """The formulas of an effect that can be parts: those that act in the specimen."""
    return [name for (e, name), known in FORMULAS.items() if e == effect and known.place == "specimen"]


def drawn(effect: str, seed: int) -> str:
    """The name of a mixture of two formulas, each with a share from 0.3 to 0.7."""
    random = np.random.default_rng([seed, 4])
    one, other = random.choice(mixable(effect), 2, replace=False)
    share = round(float(random.uniform(0.3, 0.7)), 2)
    return f"{share:.2f} {one} + {1 - share:.2f} {other}"


def mixture(effect: str, name: str) -> Formula:
    """The formula of that name.

    Raises:
        ValueError: it has no such parts.
    """
    parts = []
    for words in name.split(" + "):
        share, _, part = words.partition(" ")
        known = formula(effect, part)
        if known.place != "specimen":
            raise ValueError(f"{effect!r} ({part}) acts in the {known.place}, and is no part of a mixture")
        parts.append((float(share), known))

    def act(x, s, p):
        row, rows = 0, x.w
        for share, known in parts:
            x.w = rows[row : row + known.states]
            known.act(x, s, {**p, "delta": share * p["delta"]})
            row += known.states

    act.__doc__ = f"{name}, each as it is described."
    every = [known for _, known in parts]
    return Formula(
        "specimen",
        act,
        min(known.largest for known in every),
        draws={key: bounds for known in every for key, bounds in known.draws.items()},
        also={key: unit for known in every for key, unit in known.also.items()},
        states=sum(known.states for known in every),
        is_signed=any(known.is_signed for known in every),
    )
