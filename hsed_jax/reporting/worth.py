"""What a probability of an effect says: it is one among the formulas that are listed, and a specimen follows none of them."""

AMONG = "among the listed formulas"

_WORTH = ((0.9, 0.8), (0.5, 0.5))
"""From which probability on, which share of the effects that were named with it was right on specimens whose formula is not
listed: 17 of 21 and 4 of 8 names in 34 mixtures of formulas (`benchmarks/hidden_effects_scored.json`)."""

EXPLAINED = (
    f"Probabilities are {AMONG}. If the formula of a specimen is not listed, the named effect is right in "
    + " and in ".join(f"about {100 * right:.0f} % of the cases above {least:g}" for least, right in _WORTH)
    + "."
)


def worth(probability: float) -> float | None:
    """How often an effect that is given such a probability was right where its formula is not listed; None: nothing is known."""
    return next((right for least, right in _WORTH if probability >= least), None)


def shown(probability: float, is_named: bool = False) -> str:
    """A probability in a table.  An effect that is named never has none: where its number is negligible, words stand for it."""
    if probability < 5e-4:
        return "by prediction" if is_named else "< 0.001"
    return "> 0.999" if probability > 0.9995 else f"{probability:.3f}"


def worth_text(probability: float) -> str:
    """`worth` in a table."""
    right = worth(probability)
    return "–" if right is None else f"about {right:.2g}"
