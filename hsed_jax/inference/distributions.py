"""numpyro's distributions by name, their inverse distribution functions, and maps to their supports."""

import inspect
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.plain import in_range, shown

with warnings.catch_warnings():
    # numpyro loads the progress bar of tqdm for notebooks, which without widgets falls back to text with a warning.
    warnings.filterwarnings("ignore", "IProgress not found")
    import numpyro.distributions as dist
    from numpyro.distributions.transforms import AffineTransform, ComposeTransform, SoftplusTransform, biject_to

_SPELLINGS = {
    "lognormal": "LogNormal",
    "loguniform": "LogUniform",
    "halfnormal": "HalfNormal",
    "truncated": "TruncatedNormal",
}


def inverted(distribution: dist.Distribution, probability: Any) -> Any:
    """Inverse distribution function.

    It takes hundreds of operations, so they are compiled together, for one size of any argument with several numbers.
    """
    asked = jnp.asarray(probability)
    if not asked.ndim:
        return _inverse(distribution, asked)
    padded = jnp.pad(asked.ravel(), (0, -asked.size % 512), constant_values=0.5)
    return _inverse(distribution, padded)[: asked.size].reshape(asked.shape)


@jax.jit
def _inverse(distribution: dist.Distribution, probability: Any) -> Any:
    return distribution.icdf(probability)


@jax.jit
def density_at(distribution: dist.Distribution, value: Any) -> Any:
    """Log density: a dozen operations, compiled together."""
    return distribution.log_prob(value)


def distribution_of(name: str, arguments: Any) -> dist.Distribution:
    """The distribution of a name and arguments as a study gives them.

    Raises:
        UserError: no such distribution, wrong arguments, or not scalar and continuous.
    """
    kind = _kind(name)
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
        made = member(name, tuple(map(str, arguments)) if by_name else (), numbers, validate_args=True)
    except TypeError:
        raise wrong from None
    except ValueError as error:
        reason = re.sub(r"\s+", " ", str(error))
        raise UserError(f"{name}: {shown(arguments)} does not fit this distribution ({reason})") from None
    scalar = isinstance(made, dist.Distribution) and not made.batch_shape and not made.event_shape
    if not scalar or made.support is None or made.support.is_discrete:
        raise UserError(f"{name} is not a scalar continuous distribution")
    if isinstance(made, dist.Delta):
        raise UserError(f"{name}: write a known value as a plain number")
    low, high = limits(made)
    if low is not None and high is not None and not low < high:
        raise UserError(f"{name}: the lower bound {low:g} must lie below the upper bound {high:g}")
    return made


def member(name: str, keys: tuple[str, ...], numbers: Sequence[Any], **options: Any) -> dist.Distribution:
    """The distribution of a name and of numbers, which may be traced: the arguments of these names, or in numpyro's order."""
    kind = _kind(name)
    return kind(**dict(zip(keys, numbers, strict=True)), **options) if keys else kind(*numbers, **options)


def _kind(name: str) -> Any:
    """numpyro's class or function of a name."""
    words = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    return getattr(dist, _SPELLINGS.get(name.lower().replace("_", ""), words), None)


def _signature(kind: Any) -> tuple[list[str], int]:
    """Names of the arguments of a distribution, and how many of them a location-scale or bounded family needs."""
    try:
        parameters = inspect.signature(kind).parameters.values()
    except (TypeError, ValueError):
        return [], 1
    names = [p.name for p in parameters if p.name != "validate_args"]
    # numpyro has a default for nearly every argument, but a prior without its bounds or spread is a mistake.
    pairs = ({"low", "high"}, {"loc", "scale"})
    return names, 2 if any(pair <= set(names) for pair in pairs) else 1


def limits(made: dist.Distribution) -> tuple[float | None, float | None]:
    """Limits of the support; None for a missing limit."""
    low, high = (getattr(made.support, side, None) for side in ("lower_bound", "upper_bound"))
    return (None if low is None else float(low)), (None if high is None else float(high))


def map_to(distribution: dist.Distribution, scaling: Sequence[Any] = ()) -> Any:
    """The map from numbers of order one to the support of a distribution.

    Arguments:
        distribution: any.
        scaling: middle and spread of these numbers along the real line, where they are not of order one by themselves.  With a
            third number, a size, the map to the positive numbers is the inverse of a logarithm far below it, and straight far
            above it.
    """
    if not scaling:
        return biject_to(distribution.support)
    middle, spread, *size = scaling
    inner = ComposeTransform([SoftplusTransform(), AffineTransform(0.0, *size)]) if size else map_to(distribution)
    return ComposeTransform([AffineTransform(middle, spread), inner])


def of_order_one(
    quantile: Callable[[float], Any], distribution: dist.Distribution, size: tuple[float, ...] = ()
) -> tuple[float, ...]:
    """The scaling of `map_to` from the quantiles of a prior."""
    with jax.ensure_compile_time_eval():
        inner = map_to(distribution, (0.0, 1.0, *size))
        below, middle, above = (float(np.asarray(inner.inv(quantile(share)))) for share in (0.16, 0.5, 0.84))
    return (middle, 0.5 * (above - below), *size)
