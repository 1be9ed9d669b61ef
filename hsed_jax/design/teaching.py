"""What an experiment that a design chose is expected to teach, in words."""

import math
from collections.abc import Sequence

from hsed_jax.tables import odds


def lesson(acquisition: str, value: float, discrepancies: Sequence[float | None]) -> str:
    """What an experiment is expected to teach, in a clause; empty where it was chosen without regard to that.

    Arguments:
        acquisition: what it was chosen by.
        value: of that, at the input.
        discrepancies: of the experiments before it; None or NaN where there is none.
    """
    if acquisition == "discriminate":
        return f"a log Bayes factor of {value:.3g} between the explanations that are left: odds of {odds(value)}"
    known = [one for one in discrepancies if one is not None and math.isfinite(one)]
    if acquisition == "max_variance":
        return "how wrong the model is where that is known least"
    if acquisition != "expected_improvement" or not known or not max(known) > 0:
        return ""
    share = 100 * value / max(known)
    return f"whether the model is wrong by more than anywhere so far: by {share:.3g} % of that, on average"
