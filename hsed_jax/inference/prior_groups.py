"""Independent priors as functions of arrays: priors of one family are computed together.

Their numbers are operands of a compiled program.  Studies whose priors differ in numbers only therefore share their programs,
and a program has each family once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hsed_jax.inference.priors import Prior


@dataclass(frozen=True)
class Described:
    """Priors for use outside of compiled programs.  All of them are equal, because no program depends on them."""

    priors: tuple[Prior, ...] = field(compare=False)


@final
class _Group(eqx.Module):
    """Priors of one family.

    Attributes:
        name, keys: of the family, and the names of its arguments (`hsed_jax.inference.distributions.member`).
        columns: places of the priors among all.
        numbers: their arguments, (k, a).
        scaling: of the maps from u to their supports (`hsed_jax.inference.distributions.map_to`), (k, s).
        mode, highest: the value with the largest density, and the log of that density, (k,).
    """

    name: str = eqx.field(static=True)
    keys: tuple[str, ...] = eqx.field(static=True)
    columns: tuple[int, ...] = eqx.field(static=True)
    numbers: Float[Array, "k a"]
    scaling: Float[Array, "k s"]
    mode: Float[Array, " k"]
    highest: Float[Array, " k"]

    def of_each(self, function: Callable[[Any, Any, Array], Array], values: Float[Array, " k"]) -> Float[Array, " k"]:
        """A function of the distribution, of its map to the support, and of a value, for each prior."""
        from hsed_jax.inference.distributions import map_to, member  # loads numpyro

        def one(numbers: Array, scaling: Array, value: Array) -> Array:
            distribution = member(self.name, self.keys, tuple(numbers))
            return function(distribution, map_to(distribution, tuple(scaling)), value)

        return jax.vmap(one)(self.numbers, self.scaling, values)


@final
class PriorGroups(eqx.Module):
    """Independent priors of q parameters, in any order of their families.

    Arguments:
        priors: of the parameters.
        scalings: of the maps from u to their supports.
    """

    groups: tuple[_Group, ...]
    _order: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, priors: Sequence[Prior], scalings: Sequence[tuple[float, ...]]):
        columns: dict[Any, list[int]] = {}
        for k, (prior, scaling) in enumerate(zip(priors, scalings, strict=True)):
            columns.setdefault((prior.name, prior.keys, len(prior.numbers), len(scaling)), []).append(k)
        groups: list[_Group] = []
        for (name, keys, *_), own in columns.items():
            numbers, scaling = (
                np.asarray([one[k] for k in own], dtype=float) for one in ([p.numbers for p in priors], scalings)
            )
            mode, highest = np.transpose([priors[k].mode for k in own])
            groups.append(_Group(name, keys, tuple(own), *jax.device_put((numbers, scaling, mode, highest))))
        self.groups = tuple(groups)
        self._order = tuple(np.argsort([k for own in columns.values() for k in own]).tolist())

    def supported(self, u: Float[Array, " q"]) -> Float[Array, " q"]:
        """The parameters at unconstrained coordinates."""
        return self._each(lambda group, x: group.of_each(lambda _, to_support, x: to_support(x), x), u)

    def unsupported(self, theta: Float[Array, " q"]) -> Float[Array, " q"]:
        """The unconstrained coordinates of parameters, infinite at the bounds."""
        return self._each(lambda group, x: group.of_each(lambda _, to_support, x: to_support.inv(x), x), theta)

    def log_jacobian(self, u: Float[Array, " q"]) -> Float[Array, " q"]:
        """Log of the slope of `supported` for each parameter."""

        def log_slope(_: Any, to_support: Any, x: Array) -> Array:
            return to_support.log_abs_det_jacobian(x, to_support(x))

        return self._each(lambda group, x: group.of_each(log_slope, x), u)

    def log_density(self, theta: Float[Array, " q"]) -> Float[Array, " q"]:
        """Log density of each parameter."""
        return self._each(_log_densities, theta)

    def residuals(self, theta: Float[Array, " q"]) -> Float[Array, " q"]:
        r"""$\pm\sqrt{2(\log p_{max}-\log p)}$ of each parameter, with the sign of θ − mode."""

        def one(group: _Group, theta: Array) -> Array:
            return jnp.sign(theta - group.mode) * root(2 * (group.highest - _log_densities(group, theta)))

        return self._each(one, theta)

    def _each(self, function: Callable[[_Group, Array], Array], values: Array) -> Array:
        """A function of each prior and its value, in the order of the priors."""
        found = jnp.concatenate([function(group, values[np.asarray(group.columns)]) for group in self.groups])
        return found[np.asarray(self._order)]


def root(value: Float[Array, "..."]) -> Float[Array, "..."]:
    """Square root with a finite derivative at zero; zero of negative numbers."""
    positive = value > 1e-12
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)


def _log_densities(group: _Group, theta: Array) -> Array:
    return group.of_each(lambda distribution, _, x: distribution.log_prob(x), theta)
