"""Do the estimates depend on where a design has tested?

A model that lacks something has other best parameters at other inputs, and a design asks where the model is most wrong.  So its
estimate is one for the inputs that it asked, and not for all of them.  Counted for the part of the inputs that it stands for
(those that are nearer to it than to any other experiment, by their distribution), an experiment in a cluster counts for little;
the estimate is then about that of experiments spread evenly.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Noise does not explain a difference of this many standard deviations.
_APART = 2.0


def shares(tested: Float[np.ndarray, "n d"], points: Float[np.ndarray, "M d"]) -> Float[np.ndarray, " n"]:
    """The part of the inputs that each experiment stands for: that of the points to which it is the nearest; 1 in all.

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
        designed: θ_MAP by name, SI, every experiment counted alike.
        over_inputs: the same, each experiment counted for the part of the inputs that it stands for.
        sd: of the first.
    """

    designed: dict[str, float]
    over_inputs: dict[str, float]
    sd: dict[str, float]

    def sentence(self, units: Mapping[str, str]) -> str | None:
        """What is to be said of parameters that differ by more than two standard deviations; None where none does."""
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
