"""Probabilities of effects in tables and figures, and their meaning in words."""

from hsed_jax.behaviour.names import FAR, LATER_FAR, RIGHT, RIGHT_FAR

EXPLAINED = (
    f"The probability of an effect is at most {RIGHT:g}. If the error stays above {FAR:g} times the noise, it is at most "
    f"{RIGHT_FAR:g}, and {LATER_FAR:g} for the names after the first: of the names with the largest probability, so many are "
    "right on specimens whose formula is not in the catalogue."
)


def shown(probability: float, is_named: bool = False) -> str:
    """A probability in a table.  A named effect always has one: words replace a negligible number."""
    if probability < 5e-4:
        return "by prediction" if is_named else "< 0.001"
    return f"{probability:.3f}"
