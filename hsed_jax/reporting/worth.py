"""The meaning of a probability of an effect: it refers to the listed formulas, and a real specimen follows none of them."""

AMONG = "among the listed formulas"

_WORTH = ((0.9, 0.8), (0.5, 0.5))
"""Lower limits of a probability, with the share of right names for specimens whose formula is not listed: 17 of 21 and
4 of 8 names in 34 mixtures of formulas (`benchmarks/hidden_effects_scored.json`).
"""

EXPLAINED = (
    f"Probabilities are {AMONG}. If the formula of a specimen is not listed, the named effect is right in "
    + " and in ".join(f"about {100 * right:.0f} % of the cases above {least:g}" for least, right in _WORTH)
    + "."
)


def worth(probability: float) -> float | None:
    """The share of right names with such a probability if the formula is not listed; None: unknown."""
    return next((right for least, right in _WORTH if probability >= least), None)


def shown(probability: float, is_named: bool = False) -> str:
    """A probability in a table.  A named effect always has one: words replace a negligible number."""
    if probability < 5e-4:
        return "by prediction" if is_named else "< 0.001"
    return "> 0.999" if probability > 0.9995 else f"{probability:.3f}"


def worth_text(probability: float) -> str:
    """`worth` in a table."""
    right = worth(probability)
    return "–" if right is None else f"about {right:.2g}"
