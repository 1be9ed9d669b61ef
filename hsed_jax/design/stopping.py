"""Rules that stop a design, from the results of its steps; each rule has the name of its reason."""

from collections.abc import Sequence
from typing import Any, NamedTuple

_STABLE_FOR = 3  # consecutive steps


class StopRules(NamedTuple):
    """Rules that end a design before its iterations are used up; None: not requested.

    Attributes:
        expected_improvement: stop when the largest expected improvement falls below this.
        stable_map: stop when no parameter of θ_MAP moved by more than this share of itself over three steps.
        posterior_width: stop when the 90 % interval of every parameter is narrower than this share of its mean.
        verdict: stop when the diagnosis names a missing effect.
    """

    expected_improvement: float | None = None
    stable_map: float | None = None
    posterior_width: float | None = None
    verdict: bool = False


def stop_reason(rules: StopRules, steps: Sequence[dict[str, Any]]) -> str | None:
    """The name of the rule that is met by the last step, or None.

    Arguments:
        rules: the requested ones.
        steps: the results of each step, as in the journal.
    """
    if not steps:
        return None
    last = steps[-1]
    if rules.expected_improvement is not None and last["max_expected_improvement"] < rules.expected_improvement:
        return "expected_improvement"
    if rules.stable_map is not None and len(steps) > _STABLE_FOR:
        before = steps[-1 - _STABLE_FOR : -1]
        moved = max(
            abs(step["map"][name] / value - 1) if value else 0.0
            for step in before
            for name, value in last["map"].items()
        )
        if moved < rules.stable_map:
            return "stable_map"
    if rules.posterior_width is not None:
        widths = [
            (s["q95"] - s["q05"]) / abs(s["mean"]) if s["mean"] else float("inf") for s in last["posterior"].values()
        ]
        if max(widths) < rules.posterior_width:
            return "posterior_width"
    if rules.verdict and last.get("verdict") in ("missing_effects", "ambiguous"):
        return "verdict"
    return None
