"""Priors: a numpyro distribution by name, and what calibration needs of it."""

import inspect
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.errors import UserError
from hsed_jax.plain import in_range, shown

with warnings.catch_warnings():
    # numpyro loads tqdm's bar for notebooks, which without widgets is one for text and warns of it.
    warnings.filterwarnings("ignore", "IProgress not found")
    import numpyro.distributions as dist
    from numpyro.distributions.transforms import AffineTransform, ComposeTransform, biject_to

_SPELLINGS = {
    "lognormal": "LogNormal",
    "loguniform": "LogUniform",
    "halfnormal": "HalfNormal",
    "truncated": "TruncatedNormal",
}


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
    def distribution(self) -> dist.Distribution:
        """numpyro's."""
        return _build(self.name, self.arguments)

    @cached_property
    def bounds(self) -> tuple[float | None, float | None]:
        """Limits of the support; None where there is none."""
        return _limits(self.distribution)

    def __post_init__(self):
        # What is wrong with it is said where it is made.
        assert self.distribution is not None

    def log_density(self, value: Float[Array, "..."]) -> Any:
        """Log of the density at a value within the support."""
        return self.distribution.log_prob(value)

    def quantile(self, probability: Any) -> Any:
        """The value below which this share of the prior lies; from samples where the distribution has no closed form."""
        if not isinstance(probability, float):
            return self._quantile(probability)
        return _one_quantile(self, probability, jnp.result_type(float))

    def _quantile(self, probability: Any) -> Any:
        try:
            return _inverted(self.distribution, probability)
        except (NotImplementedError, ImportError):  # numpyro takes some quantiles from a package that may be absent
            draws = self.distribution.sample(jax.random.key(0), (4096,))
            return jnp.quantile(draws, jnp.asarray(probability))

    @cached_property
    def to_support(self) -> Any:
        """The map from u to the support, with u of order one: an unbounded SI number may be 1e6, and so may its spread."""
        to_support = biject_to(self.distribution.support)
        if None not in self.bounds:
            return to_support
        with jax.ensure_compile_time_eval():
            below, middle, above = (float(to_support.inv(self.quantile(share))) for share in (0.16, 0.5, 0.84))
        return ComposeTransform([AffineTransform(middle, 0.5 * (above - below)), to_support])

    @cached_property
    def mode(self) -> tuple[float, float]:
        """The value of highest density and its log density, by search over the support."""
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


@cache
def _one_quantile(prior: Prior, probability: float, precision: Any) -> Any:
    """A number of a prior, which is asked for again and again: hundreds of operations, each by itself."""
    del precision  # another one is another number
    with jax.ensure_compile_time_eval():
        return prior._quantile(probability)


def _inverted(distribution: dist.Distribution, probability: Any) -> Any:
    """Inverse distribution function: hundreds of operations, compiled (for one size) where more than one number is asked for."""
    asked = jnp.asarray(probability)
    if not asked.ndim:
        return distribution.icdf(asked)
    padded = jnp.pad(asked.ravel(), (0, -asked.size % 512), constant_values=0.5)
    return _inverse(distribution, padded)[: asked.size].reshape(asked.shape)


@jax.jit
def _inverse(distribution: dist.Distribution, probability: Any) -> Any:
    return distribution.icdf(probability)


def _build(name: str, arguments: Any) -> dist.Distribution:
    camel = _SPELLINGS.get(
        name.lower().replace("_", ""), "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    )
    kind: Any = getattr(dist, camel, None)
    if not (isinstance(kind, type) and issubclass(kind, dist.Distribution)) and not callable(kind):
        raise UserError(
            f"there is no distribution {name!r}; allowed are uniform, normal, lognormal, half_normal, truncated_normal "
            "or any scalar continuous distribution of numpyro by its name"
        )
    made: Any
    by_name = isinstance(arguments, Mapping)
    given = list(arguments.values() if by_name else arguments if isinstance(arguments, list | tuple) else [arguments])
    expected, required = _signature(kind)
    allowed = f"its arguments are {', '.join(expected)}, as numbers" if expected else "it takes numbers"
    wrong = UserError(f"{name}: {shown(arguments)} does not fit this distribution; {allowed}")
    if any(isinstance(number, bool) for number in given) or not required <= len(given):
        raise wrong
    try:
        numbers = [float(number) for number in given]
    except (TypeError, ValueError, OverflowError):
        raise wrong from None
    if not all(in_range(number) for number in numbers):
        raise UserError(f"{name}: {shown(arguments)} must be finite numbers of sensible size")
    try:
        if by_name:
            made = kind(**dict(zip(map(str, arguments), numbers, strict=True)), validate_args=True)
        else:
            made = kind(*numbers, validate_args=True)
    except TypeError:
        raise wrong from None
    except ValueError as error:
        reason = re.sub(r"\s+", " ", str(error))
        raise UserError(f"{name}: {shown(arguments)} does not fit this distribution ({reason})") from None
    scalar = isinstance(made, dist.Distribution) and not made.batch_shape and not made.event_shape
    if not scalar or made.support is None or made.support.is_discrete:
        raise UserError(f"{name} is not a scalar continuous distribution")
    if isinstance(made, dist.Delta):
        raise UserError(f"{name}: a value that is known is written as a plain number")
    low, high = _limits(made)
    if low is not None and high is not None and not low < high:
        raise UserError(f"{name}: the lower bound {low:g} must lie below the upper bound {high:g}")
    return made


def _signature(kind: Any) -> tuple[list[str], int]:
    """Names of a distribution's arguments, and how many of them a location-scale or bounded family must be told."""
    try:
        parameters = inspect.signature(kind).parameters.values()
    except (TypeError, ValueError):
        return [], 1
    names = [p.name for p in parameters if p.name != "validate_args"]
    # numpyro has a default for nearly everything; a prior whose bounds or spread were forgotten is a mistake, though.
    pairs = ({"low", "high"}, {"loc", "scale"})
    return names, 2 if any(pair <= set(names) for pair in pairs) else 1


def _limits(made: dist.Distribution) -> tuple[float | None, float | None]:
    low, high = (getattr(made.support, side, None) for side in ("lower_bound", "upper_bound"))
    return (None if low is None else float(low)), (None if high is None else float(high))
