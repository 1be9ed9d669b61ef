"""Absent effects are not computed: a batch of simulations takes each branch together.

One compiled program may hold every effect of the catalogue.  An operand, the same for all simulations of the batch, states
whether an effect acts.  Under `jax.vmap`, a choice per simulation computes both sides, and a choice for the whole batch is a
branch.
"""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

BATCH_AXIS = "batch"
"""The axis of `jax.vmap` over what runs together, where effects are gated."""

# Every gate costs a test, so effects share a gate in groups of this size.
_GROUP = 6


def gated[T](acts: Bool[Array, ""] | None, there: Callable[[], T], absent: Callable[[], T]) -> T:
    """One of two trees of numbers of the same structure.

    Arguments:
        acts: which; None where the first one is known to be.
        there, absent: compute them.
    """
    if acts is None:
        return there()

    def numbers_there() -> T:
        return _arrays(there())

    def numbers_absent() -> T:
        return _arrays(absent())

    return cast(T, jax.lax.cond(acts, numbers_there, numbers_absent))


def in_any_simulation(happens: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether an event happens in any simulation of the batch."""
    return cast(Array, jax.lax.pmax(jnp.asarray(happens, int), BATCH_AXIS)) > 0


class Acts(NamedTuple):
    """The action of an effect in simulations that run together.

    Attributes:
        acts: whether it acts in any of them.
        is_shaped: whether its shape differs from the simplest one in any of them.
    """

    acts: Bool[Array, ""]
    is_shaped: Bool[Array, ""]


class Contributor(NamedTuple):
    """One of several that contribute numbers.

    Attributes:
        names: gives the names of all that it may contribute; asked for behind a gate only.
        contribute: gives some of them, by name.
    """

    names: Callable[[], tuple[str, ...]]
    contribute: Callable[[], Mapping[str, Any]]


def gathered(
    contributors: Sequence[Contributor],
    acting: Sequence[Bool[Array, ""]] | None,
    merged: Callable[[Iterable[Mapping[str, Any]]], dict[str, Any]],
    neutral: Callable[[str], Any],
) -> dict[str, Any]:
    """Merge the contributions of those that act.

    Arguments:
        contributors: of which some may be absent.
        acting: whether each acts; None where all do.
        merged: makes one contribution of several.
        neutral: value of a name without a contribution.
    """
    if acting is None:
        return merged([one.contribute() for one in contributors])

    def behind(acts: Bool[Array, ""], one: Contributor) -> Mapping[str, Any]:
        def absent() -> dict[str, Any]:
            return {name: neutral(name) for name in one.names()}

        return gated(acts, lambda: absent() | dict(one.contribute()), absent)

    able = [(acts, one) for acts, one in zip(acting, contributors, strict=True) if one.names()]
    found: list[Mapping[str, Any]] = []
    for start in range(0, len(able), _GROUP):
        group = able[start : start + _GROUP]
        names = tuple(dict.fromkeys(name for _, one in group for name in one.names()))

        def own_names(own: tuple[str, ...] = names) -> tuple[str, ...]:
            return own

        def own(pairs: Sequence[tuple[Bool[Array, ""], Contributor]] = group) -> dict[str, Any]:
            return merged([behind(acts, one) for acts, one in pairs])

        found.append(behind(jnp.any(jnp.stack([acts for acts, _ in group])), Contributor(own_names, own)))
    return merged(found)


def _arrays[T](tree: T) -> T:
    def array(value: Any) -> Array:
        return jnp.asarray(float(value) if isinstance(value, int) else value)

    return jax.tree.map(array, tree)
