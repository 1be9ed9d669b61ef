"""Priors: a distribution by name, and the functions that calibration needs of it.

A check of a study needs bounds and single quantiles.  For the usual families these have a closed form. numpyro takes as long
to load as the rest of a check, so it is loaded only for other functions, or to explain a fault.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from statistics import NormalDist
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.plain import in_range

Bounds = tuple[float | None, float | None]
_STANDARD = NormalDist()


class _Family(NamedTuple):
    """A family with bounds and quantiles in closed form.

    Attributes:
        arguments: their names, in numpyro's order.
        is_one: whether the arguments are valid.
        bounds: limits of the support.
        quantile: from the arguments and shares between 0 and 1, one number or an array.
        mode: the value with the largest density, and the log of that density.
    """

    arguments: tuple[str, ...]
    is_one: Callable[..., bool]
    bounds: Callable[..., Bounds]
    quantile: Callable[..., Any]
    mode: Callable[..., tuple[float, float]]


def _standard(share: Any) -> Any:
    """Quantiles of the standard normal distribution."""
    if isinstance(share, float):
        return _STANDARD.inv_cdf(share)
    from scipy.special import ndtri  # a check of a study asks for single numbers, and does not wait for SciPy

    return ndtri(share)


def _truncated(loc: float, scale: float, low: float, high: float, share: Any) -> Any:
    """Quantiles of a truncated normal distribution."""
    if low > loc:  # the lower tail has more digits
        return -_truncated(-loc, scale, -high, -low, 1 - share)
    below, above = (_STANDARD.cdf((end - loc) / scale) for end in (low, high))
    return loc + scale * _standard(below + share * (above - below))


def _largest(scale: float, share: float = 1.0) -> float:
    """Log density of a normal distribution at its mode, if this share of it is left."""
    return -math.log(scale * share * math.sqrt(2 * math.pi))


def _mode_of_truncated(loc: float, scale: float, low: float, high: float) -> tuple[float, float]:
    """Mode of a truncated normal distribution, and its log density there."""
    mode = min(max(loc, low), high)
    ends = [(end - loc) / scale for end in (low, high)]
    if low > loc:
        ends = [-end for end in ends[::-1]]
    below, above = map(_STANDARD.cdf, ends)
    return mode, _largest(scale, above - below) - 0.5 * ((mode - loc) / scale) ** 2


def _exponential(value: Any) -> Any:
    with np.errstate(over="ignore"):
        found = np.exp(value)
    return found if isinstance(value, np.ndarray) else float(found)


_FAMILIES = {
    "uniform": _Family(
        ("low", "high"),
        lambda low, high: low < high,
        lambda low, high: (low, high),
        lambda low, high, share: low + share * (high - low),
        lambda low, high: (low, -math.log(high - low)),
    ),
    "normal": _Family(
        ("loc", "scale"),
        lambda loc, scale: scale > 0,
        lambda loc, scale: (None, None),
        lambda loc, scale, share: loc + scale * _standard(share),
        lambda loc, scale: (loc, _largest(scale)),
    ),
    "lognormal": _Family(
        ("loc", "scale"),
        lambda loc, scale: scale > 0,
        lambda loc, scale: (0.0, None),
        lambda loc, scale, share: _exponential(loc + scale * _standard(share)),
        lambda loc, scale: (_exponential(loc - scale**2), _largest(scale) - loc + 0.5 * scale**2),
    ),
    "half_normal": _Family(
        ("scale",),
        lambda scale: scale > 0,
        lambda scale: (0.0, None),
        lambda scale, share: scale * _standard(0.5 + 0.5 * share),
        lambda scale: (0.0, _largest(scale, 0.5)),
    ),
    "truncated_normal": _Family(
        ("loc", "scale", "low", "high"),
        # Further out than this, the share between the bounds has few digits.
        lambda loc, scale, low, high: scale > 0 and low < high and max(low - loc, loc - high) < 5 * scale,
        lambda loc, scale, low, high: (low, high),
        _truncated,
        _mode_of_truncated,
    ),
}


class _Member(NamedTuple):
    """One of a family, by its arguments."""

    family: _Family
    arguments: tuple[float, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Prior:
    """A scalar continuous prior.

    Arguments:
        name: the distribution: `uniform`, `normal`, `lognormal`, `half_normal`, `truncated_normal` or any scalar
            continuous distribution of numpyro, in its own spelling or in snake case.
        arguments: one number, a list (in numpyro's order) or a mapping by keyword.

    Raises:
        UserError: no such distribution, wrong arguments, or not scalar and continuous.
    """

    name: str
    arguments: Any

    @cached_property
    def distribution(self) -> Any:
        """numpyro's."""
        from hsed_jax.inference.distributions import distribution_of  # loads numpyro

        return distribution_of(self.name, self.arguments)

    @cached_property
    def bounds(self) -> Bounds:
        """Limits of the support; None for a missing limit."""
        if (member := self._member) is not None:
            return member.family.bounds(*member.arguments)
        from hsed_jax.inference.distributions import limits

        return limits(self.distribution)

    @cached_property
    def _member(self) -> _Member | None:
        """The family member for the usual families; None for others, and if the arguments are not plainly right."""
        return _usual(self.name, self.arguments)

    def __post_init__(self):
        # The distribution itself reports the fault.
        assert self._member is not None or self.distribution is not None

    def log_density(self, value: Float[Array, "..."]) -> Any:
        """Log of the density at a value within the support."""
        from hsed_jax.inference.distributions import density_at

        return density_at(self.distribution, value)

    def quantile(self, probability: Any) -> Any:
        """The value below which this share of the prior lies; from samples where the distribution has no closed form."""
        is_one, member = isinstance(probability, float), self._member
        if member is not None and (isinstance(probability, np.ndarray) or (is_one and 0 < probability < 1)):
            return member.family.quantile(*member.arguments, probability)
        return _one_quantile(self, probability, jnp.result_type(float)) if is_one else self._quantile(probability)

    def _quantile(self, probability: Any) -> Any:
        from hsed_jax.inference.distributions import inverted

        try:
            return inverted(self.distribution, probability)
        except (NotImplementedError, ImportError):  # numpyro takes some quantiles from a package that may be absent
            draws = self.distribution.sample(jax.random.key(0), (4096,))
            return jnp.quantile(draws, jnp.asarray(probability))

    @cached_property
    def scaling(self) -> tuple[float, ...]:
        """Middle and spread of u, where the support is unbounded: an SI number may be 1e6, and so may its spread."""
        if None not in self.bounds:
            return ()
        from hsed_jax.inference.distributions import of_order_one

        return of_order_one(self.quantile, self.distribution)

    @property
    def to_support(self) -> Any:
        """The map from u to the support, with u of order one."""
        from hsed_jax.inference.distributions import map_to

        return map_to(self.distribution, self.scaling)

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the arguments; none if they are in numpyro's order."""
        return tuple(map(str, self.arguments)) if isinstance(self.arguments, Mapping) else ()

    @property
    def numbers(self) -> tuple[float, ...]:
        """The arguments."""
        given = self.arguments.values() if self.keys else self.arguments
        return tuple(map(float, given if self.keys or isinstance(given, list | tuple) else [given]))

    @cached_property
    def mode(self) -> tuple[float, float]:
        """The value of highest density and its log density; by search over the support where there is no closed form."""
        if (member := self._member) is not None:
            return member.family.mode(*member.arguments)
        with jax.ensure_compile_time_eval():
            grid = np.asarray(self.quantile(np.linspace(1e-4, 1 - 1e-4, 2001)))
            log_density = np.asarray(self.log_density(jnp.asarray(grid)))
        best = int(np.nanargmax(log_density))
        return float(grid[best]), float(log_density[best])

    def __repr__(self) -> str:
        return f"{self.name}({self.arguments})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Prior) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(repr(self))


def _usual(name: str, arguments: Any) -> _Member | None:
    family = _FAMILIES.get(name)
    if family is None:
        return None
    if isinstance(arguments, Mapping):
        if set(arguments) != set(family.arguments):
            return None
        arguments = [arguments[key] for key in family.arguments]
    given: list[Any] = (
        list(arguments) if isinstance(arguments, Sequence) and not isinstance(arguments, str) else [arguments]
    )
    if len(given) != len(family.arguments) or any(type(number) not in (int, float) for number in given):
        return None
    if not all(in_range(number) for number in given) or not family.is_one(*given):
        return None
    return _Member(family, tuple(map(float, given)))


@cache
def _one_quantile(prior: Prior, probability: float, precision: Any) -> Any:
    """One quantile of a prior, cached: it takes hundreds of single operations and is asked for often."""
    del precision  # two different numbers
    with jax.ensure_compile_time_eval():
        return prior._quantile(probability)
