"""What an experiment that a design chose is expected to teach, in words."""

import math
from collections.abc import Sequence

from hsed_jax.tables import odds

# An improvement below this share of the largest is none: what a surrogate says there is its tail, and nothing that was measured.
_NONE = 1e-6


def told(improvements: Sequence[float]) -> list[float]:
    """Expected improvements as they are shown: 0 below a millionth of the largest.

    Arguments:
        improvements: the largest of each step.
    """
    least = _NONE * max(improvements, default=0.0)
    return [value if value >= least else 0.0 for value in improvements]


def lesson(acquisition: str, value: float, discrepancies: Sequence[float | None]) -> str:
    """What an experiment is expected to teach, in a clause; empty where it was chosen without regard to that.

    Arguments:
        acquisition: what it was chosen by.
        value: of that, at the input.
        discrepancies: of the experiments before it; None or NaN where there is none.
    """
    if acquisition == "discriminate":
        return f"a log Bayes factor of {value:.3g} between the remaining explanations: odds of {odds(value)}"
    known = [one for one in discrepancies if one is not None and math.isfinite(one)]
    if acquisition == "max_variance":
        return "the error of the model where it is known least"
    if acquisition != "expected_improvement" or not known or not max(known) > 0:
        return ""
    share = 100 * value / max(known) if value >= _NONE * max(known) else 0.0
    return f"whether the discrepancy exceeds the largest one so far: by {share:.3g} % of it, on average"
