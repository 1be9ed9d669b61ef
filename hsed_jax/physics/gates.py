"""What is absent is not computed: branches that are taken by all lanes of a batch together.

One compiled program may hold every effect of the catalogue.  Whether an effect acts is then an operand, the same for all lanes
that run together: under `jax.vmap` a choice by lane computes both sides, and a choice for all lanes is a branch.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

LANES = "lanes"
"""The axis of `jax.vmap` over what runs together, where effects are gated."""

# A gate that is shut costs as much as ten multiplications, so effects stand behind a common gate in groups of about so many.
_GROUP = 6


def gated(acts: Bool[Array, ""] | None, there: Callable[[], PyTree], absent: Callable[[], PyTree]) -> Any:
    """One of two trees of numbers of the same structure.

    Arguments:
        acts: which; None where the first one is known to be.
        there, absent: compute them.
    """
    if acts is None:
        return there()
    return jax.lax.cond(acts, lambda: _arrays(there()), lambda: _arrays(absent()))


def in_any_lane(happens: Bool[Array, ""]) -> Bool[Array, ""]:
    """Whether something happens in any of the lanes that run together."""
    return jax.lax.pmax(jnp.asarray(happens, int), LANES) > 0


class Part(NamedTuple):
    """One of several that say numbers.

    Attributes:
        names: of all that it may say.
        say: some of them, by name.
    """

    names: tuple[str, ...]
    say: Callable[[], Mapping[str, Any]]


def gathered(
    parts: Sequence[Part],
    acting: Sequence[Bool[Array, ""]] | None,
    merged: Callable[[Iterable[Mapping[str, Any]]], dict[str, Any]],
    neutral: Callable[[str], Any],
) -> dict[str, Any]:
    """Merge what those of several parts say that act.

    Arguments:
        parts: of which some are absent.
        acting: whether each acts; None where all do.
        merged: makes one of several.
        neutral: what a part that is absent says of a name.
    """
    if acting is None:
        return merged([part.say() for part in parts])

    def told(acts: Bool[Array, ""], part: Part) -> Mapping[str, Any]:
        def silent() -> dict[str, Any]:
            return {name: neutral(name) for name in part.names}

        return gated(acts, lambda: silent() | dict(part.say()), silent)

    speaking = [(acts, part) for acts, part in zip(acting, parts, strict=True) if part.names]
    found = []
    for start in range(0, len(speaking), _GROUP):
        group = speaking[start : start + _GROUP]
        names = tuple(dict.fromkeys(name for _, part in group for name in part.names))
        together = Part(names, lambda own=group: merged([told(*one) for one in own]))
        found.append(told(jnp.any(jnp.stack([acts for acts, _ in group])), together))
    return merged(found)


def _arrays(tree: PyTree) -> PyTree:
    return jax.tree.map(lambda value: jnp.asarray(float(value) if isinstance(value, int) else value), tree)
