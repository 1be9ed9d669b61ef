"""Estimates on a bound of their prior. If the bound is not a physical limit, the prior excludes the values that fit the data
best.

A truncated posterior does not show how wrong the bound is, and an effect that replaces the excluded values gains evidence
from it.  Therefore the warning is the first result of a calibration, and a diagnosis names an effect only after it has
removed the bound.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hsed_jax.inference.priors import Prior

Range = tuple[float, float]
ANYTHING: Range = (-math.inf, math.inf)
"""The possible range of a parameter without known limits."""

# As shares of the width of the prior: an estimate on a bound, to the accuracy of a search; and an estimate near a bound, if the
# posterior reaches the bound within so many of its standard deviations.
_ON, _NEAR, _REACHES = 1e-4, 0.01, 2.0
# Number of estimates outside their intervals that are named.
_NAMED = 3
# The width of a prior with one bound or none is the width of this central share.
_WIDTH = 0.9


class Leaning(NamedTuple):
    """An estimate on a bound of its prior that is not a physical limit.

    Attributes:
        parameter: its name.
        value: θ_MAP, SI.
        bound: that it leans on, SI.
        side: `lower` or `upper`.
        prior: both bounds, SI; infinite without one.
    """

    parameter: str
    value: float
    bound: float
    side: str
    prior: Range

    def summary(self) -> dict[str, Any]:
        """As in `summary.json`; a missing bound is null."""
        bounds = [bound if math.isfinite(bound) else None for bound in self.prior]
        return {**self._asdict(), "prior": bounds}


def leaning(
    priors: Mapping[str, Prior],
    possible: Mapping[str, Range],
    estimates: Mapping[str, float],
    posterior: Mapping[str, Mapping[str, float]],
) -> tuple[Leaning, ...]:
    """The estimates on a bound of their prior that is not a physical limit.

    Arguments:
        priors: of the parameters, by name.
        possible: physically possible range of each, SI. A parameter without an entry has no known limits, and zero counts as
            a limit of a prior without another bound.
        estimates: θ_MAP by name, SI, of the parameters to look at.
        posterior: `sd` of each, the standard deviation, SI.
    """
    found = []
    for name, value in estimates.items():
        prior = priors[name]
        for side, bound in touched(prior, value, posterior[name]["sd"]):
            if not _is_limit(side, bound, prior, possible.get(name)):
                low, high = prior.bounds
                ends = (-math.inf if low is None else low, math.inf if high is None else high)
                found.append(Leaning(name, value, bound, side, ends))
    return tuple(found)


def opened(prior: Prior) -> Prior:
    """A prior of the same location without the bounds: log-normal over a positive range, else normal, as wide as the range."""
    low, high = (float(prior.quantile(share)) for share in (0.01, 0.99))
    if low > 0:
        return Prior("lognormal", [0.5 * math.log(low * high), max(math.log(high / low), 1.0)])
    return Prior("normal", [0.5 * (low + high), high - low])


def touched(prior: Prior, value: float, deviation: float) -> Iterator[tuple[str, float]]:
    """The bounds of a prior that an estimate lies on, physical limits or not: `lower` or `upper`, and the bound."""
    low, high = prior.bounds
    if low is not None and high is not None:
        width = high - low
    else:
        outside = 0.5 * (1 - _WIDTH)
        width = float(prior.quantile(1 - outside) - prior.quantile(outside))
    reach = max(_ON * width, min(_NEAR * width, _REACHES * deviation))
    for side, bound in (("lower", low), ("upper", high)):
        if bound is not None and abs(value - bound) <= reach:
            yield side, bound


def _is_limit(side: str, bound: float, prior: Prior, possible: Range | None) -> bool:
    if possible is None:
        return bound == 0 and None in prior.bounds
    limit = possible[0 if side == "lower" else 1]
    return bool(np.isclose(bound, limit, rtol=1e-9, atol=0.0))


def caution(
    leaning: Sequence[Leaning],
    priors: Mapping[str, Prior],
    estimates: Mapping[str, float],
    posterior: Mapping[str, Mapping[str, float]],
    units: Mapping[str, str],
) -> str | None:
    """The warnings before any use of the estimates: those on a bound, and those outside their own 90 % interval.

    Arguments:
        leaning: the estimates on bounds.
        priors: by name.
        estimates: θ_MAP of the model's own parameters by name, SI.
        posterior: `sd`, `q05` and `q95` of each, SI.
        units: SI units by name.
    """
    said = [_leaning_words(leaning, units)] if leaning else []
    # An estimate on a bound, even on a physical limit, lies outside every interval with equal tails.
    outside = [
        f"{name} = {_quantity(name, value, units)} ({known['q05']:.4g} to {known['q95']:.4g})"
        for name, value in estimates.items()
        if not (known := posterior[name])["q05"] <= value <= known["q95"]
        and not any(touched(priors[name], value, known["sd"]))
    ]
    if outside:
        more = f" and {len(outside) - _NAMED} more" if len(outside) > _NAMED else ""
        lie = "lies" if len(outside) == 1 else "lie"
        said.append(
            f"the most probable {', '.join(outside[:_NAMED])}{more} {lie} outside the 90 % interval: the posterior is skewed or "
            "has another mode, or its draws miss a part"
        )
    return "; ".join(said) or None


def _leaning_words(found: Sequence[Leaning], units: Mapping[str, str]) -> str:
    what, excluding, them = (
        ("estimates are on bounds of their priors that are not physical limits", "these priors exclude", "them")
        if len(found) > 1
        else ("an estimate is on a bound of its prior that is not a physical limit", "this prior excludes", "it")
    )
    each = ", ".join(
        f"{one.parameter} = {_quantity(one.parameter, one.value, units)} on the {one.side} bound of {_range(one.prior)}"
        for one in found
    )
    return f"{what}: {each}; {excluding} values that fit better: widen {them} and calibrate again before an effect is named"


def _quantity(name: str, value: float, units: Mapping[str, str]) -> str:
    return f"{value:.4g}" if units.get(name, "1") == "1" else f"{value:.4g} {units[name]}"


def _range(bounds: Range) -> str:
    low, high = bounds
    if math.isinf(high):
        return f"at least {low:.4g}"
    return f"at most {high:.4g}" if math.isinf(low) else f"{low:.4g} to {high:.4g}"
