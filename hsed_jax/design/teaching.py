"""Expected improvements as they are shown."""

from collections.abc import Sequence

LEAST_SHARE = 1e-6
"""An improvement below this share of the largest is shown as none: it is the tail of the surrogate, not a measurement."""


def told(improvements: Sequence[float]) -> list[float]:
    """Expected improvements as they are shown: 0 below a millionth of the largest.

    Arguments:
        improvements: the largest of each step.
    """
    least = LEAST_SHARE * max(improvements, default=0.0)
    return [value if value >= least else 0.0 for value in improvements]
