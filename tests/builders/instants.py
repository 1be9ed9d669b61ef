"""Random states of a spring, by the names of what a coordinate looks at."""

import numpy as np

from hsed_jax.physics.effects.base import SpringPoint
from hsed_jax.physics.scales import Scales

F, U, V, E = SCALES = Scales(force=1.2e5, elongation=0.25, rate=1.5, energy=2e4)
RANDOM = np.random.default_rng(8)


def point(at) -> SpringPoint:
    """Random states, (n,), by name of what a coordinate looks at."""
    count = at["u"].size
    scales = Scales(*(np.full(count, scale) for scale in SCALES))
    return SpringPoint(at["u"], at["v"], at["z"], at, scales, np.full(count, 6e4), np.full(count, 5e5))


def states(count=80):
    draw = np.random.default_rng(5)
    names = ("energy", "travel", "largest_elongation", "time", "last_reversal", "recent_path", "lagged_elongation")
    sizes = dict.fromkeys(names, 1.0) | {"energy": E, "travel": E / F, "largest_elongation": U, "last_reversal": U}
    found = {name: size * draw.exponential(size=count) for name, size in sizes.items()}
    return found | {
        "u": U * draw.normal(size=count),
        "v": V * draw.normal(size=count),
        "z": F * draw.normal(size=count),
    }
