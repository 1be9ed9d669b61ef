"""Priors: a numpyro distribution by name, and what calibration needs of it."""

import re
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions.transforms import biject_to

from hsed_jax.errors import UserError

_SPELLINGS = {"lognormal": "LogNormal", "loguniform": "LogUniform", "halfnormal": "HalfNormal", "truncated": "TruncatedNormal"}


class Prior:
    """A scalar continuous prior.

    Arguments:
        name: the distribution: `uniform`, `normal`, `lognormal`, `half_normal`, `truncated_normal` or any scalar
            continuous distribution of numpyro, in its own spelling or in snake case.
        arguments: one number, a list (in numpyro's order) or a mapping by keyword.

    Raises:
        UserError: no such distribution, wrong arguments, or not scalar and continuous.
    """

    def __init__(self, name: str, arguments: Any):
        self.name, self.arguments = name, arguments
        self.distribution = _build(name, arguments)
        self.to_support = biject_to(self.distribution.support)

    def log_density(self, value: Float[Array, "..."]) -> Float[Array, "..."]:
        """Log of the density at a value within the support."""
        return self.distribution.log_prob(value)

    def quantile(self, probability: Any) -> Any:
        """The value below which this share of the prior lies; from samples where the distribution has no closed form."""
        try:
            return self.distribution.icdf(jnp.asarray(probability))
        except NotImplementedError:
            draws = self.distribution.sample(jax.random.key(0), (4096,))
            return jnp.quantile(draws, jnp.asarray(probability))

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


def _build(name: str, arguments: Any) -> dist.Distribution:
    camel = _SPELLINGS.get(name.lower().replace("_", ""), "".join(part[:1].upper() + part[1:] for part in name.split("_")))
    kind = getattr(dist, camel, None)
    if not (isinstance(kind, type) and issubclass(kind, dist.Distribution)) and not callable(kind):
        raise UserError(
            f"there is no distribution {name!r}; allowed are uniform, normal, lognormal, half_normal, truncated_normal "
            "or any scalar continuous distribution of numpyro by its name"
        )
    try:
        if isinstance(arguments, Mapping):
            made = kind(**{str(k): float(v) for k, v in arguments.items()}, validate_args=True)
        else:
            numbers = arguments if isinstance(arguments, list | tuple) else [arguments]
            made = kind(*(float(number) for number in numbers), validate_args=True)
    except (TypeError, ValueError) as error:
        reason = re.sub(r"\s+", " ", str(error))
        raise UserError(f"{name}: {arguments!r} are no arguments of this distribution ({reason})") from None
    low, high = _limits(made)
    if made.batch_shape or made.event_shape or made.support.is_discrete:
        raise UserError(f"{name} is not a scalar continuous distribution")
    if low is not None and high is not None and not low < high:
        raise UserError(f"{name}: the lower bound {low:g} must lie below the upper bound {high:g}")
    return made


def _limits(made: dist.Distribution) -> tuple[float | None, float | None]:
    low, high = (getattr(made.support, side, None) for side in ("lower_bound", "upper_bound"))
    return (None if low is None else float(low)), (None if high is None else float(high))
