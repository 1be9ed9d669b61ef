"""Do the estimates depend on where a design has tested?

The best parameters of a model that lacks an effect differ over the inputs, and a design tests where the error of the model is
largest.  Its estimate therefore belongs to the tested inputs, and not to all inputs.  A second estimate weights each
experiment by the probability of the inputs that are nearest to it. Experiments in a cluster then have small weights, and the
estimate is approximately that of evenly spread experiments.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Noise does not explain a difference of this many standard deviations.
_APART = 2.0


def shares(tested: Float[np.ndarray, "n d"], points: Float[np.ndarray, "M d"]) -> Float[np.ndarray, " n"]:
    """The share of the input space of each experiment: the share of the points to which it is the nearest; the sum is 1.

    Arguments:
        tested: in the unit cube.
        points: spread evenly over the unit cube.
    """
    from scipy.spatial import KDTree

    nearest = KDTree(tested).query(points)[1]
    return np.bincount(nearest, minlength=len(tested)) / len(points)


class Drift(NamedTuple):
    """The estimate of a design, and that over all inputs.

    Attributes:
        designed: θ_MAP by name, SI, with equal weights.
        over_inputs: the same, weighted by the share of the input space of each experiment.
        sd: of the first.
    """

    designed: dict[str, float]
    over_inputs: dict[str, float]
    sd: dict[str, float]

    def sentence(self, units: Mapping[str, str]) -> str | None:
        """The warning about parameters that differ by more than two standard deviations; None without them."""
        moved = [n for n, sd in self.sd.items() if abs(self.over_inputs[n] - self.designed[n]) > _APART * sd]
        if not moved:
            return None
        said = [
            f"{name} is {self.over_inputs[name]:.3g} instead of {self.designed[name]:.3g} ± {self.sd[name]:.1g}"
            + (f" {units[name]}" if units.get(name, "1") != "1" else "")
            for name in moved
        ]
        return (
            "the estimates depend on the tested inputs: with every experiment weighted by the part of the inputs that is "
            f"nearest to it, {', '.join(said)}; the error of the model differs over the inputs"
        )
