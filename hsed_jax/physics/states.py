"""States of the spring that several effects use: each is declared here once, and integrated if an effect needs it."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Scalar = Float[Array, ""] | float


@dataclass(frozen=True)
class SharedState:
    """A state of the spring that follows from its motion alone, zero in a virgin spring.

    Attributes:
        name: in the memory of the spring.
        unit: SI.
        meaning: one line.
        rate: its time derivative, from the elongation [m] and its rate [m/s]; None: it changes at the ends of steps only.
        settled: its value after a step, from the value before it, the elongation [m] reached, and whether it turned within
            the step (the elongation is then that of the turn); None: the integrated value.
    """

    name: str
    unit: str
    meaning: str
    rate: Callable[[Scalar, Scalar], Scalar] | None = None
    settled: Callable[[Scalar, Scalar, Bool[Array, ""]], Scalar] | None = None


LARGEST_ELONGATION = SharedState(
    "largest_elongation",
    "m",
    "largest elongation reached, to either side",
    # Updated at the ends of steps, because a maximum has no rate.
    settled=lambda value, elongation, turned: jnp.maximum(value, jnp.abs(elongation)),
)

# One for each side: both grow from zero.
LARGEST_TENSION = SharedState(
    "largest_tension",
    "m",
    "largest elongation reached in tension",
    settled=lambda value, elongation, turned: jnp.maximum(value, elongation),
)

LARGEST_COMPRESSION = SharedState(
    "largest_compression",
    "m",
    "largest elongation reached in compression, its size",
    settled=lambda value, elongation, turned: jnp.maximum(value, -elongation),
)

TRAVEL = SharedState("travel", "m", "length of the path of the elongation", rate=lambda elongation, rate: jnp.abs(rate))

TIME = SharedState("time", "s", "time since the start", rate=lambda elongation, rate: jnp.ones_like(rate))

FATIGUE = SharedState(
    "fatigue",
    "m^2",
    "length of the path of the elongation, each part times the elongation there",
    rate=lambda elongation, rate: jnp.abs(elongation * rate),
)

LAST_REVERSAL = SharedState(
    "last_reversal",
    "m",
    "elongation at the last reversal",
    settled=lambda value, elongation, turned: jnp.where(turned, elongation, value),
)

REVERSALS = SharedState(
    "reversals",
    "1",
    "number of reversals of the elongation",
    settled=lambda value, elongation, turned: value + turned,
)
