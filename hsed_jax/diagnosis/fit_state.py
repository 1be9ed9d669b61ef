"""A fit: what is fitted, of which model and from where, and where it is."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from hsed_jax.inference.likelihood import whitened


class Target(NamedTuple):
    """What is fitted: measured values and their errors, SI, and the weights of several uses of the same experiments.

    Attributes:
        values, sigma: (n, J).
        weights: (M, n, J); a task says which of the M it fits.
        memory: correlation of the noise with that of the sample before, (n, J).
        samples: how many samples of its histories each use has to know of each experiment, (M, n); None for all.
    """

    values: Float[np.ndarray, "n J"]
    sigma: Float[np.ndarray, "n J"]
    weights: Float[np.ndarray, "M n J"]
    memory: Float[np.ndarray, "n J"]
    samples: Int[np.ndarray, "M n"] | None = None

    def samples_of(self, use: int, rows: Int[np.ndarray, " r"]) -> Int[np.ndarray, " r"] | None:
        """So many samples a use has to know of these experiments; None for all."""
        return None if self.samples is None else self.samples[use][rows]

    def rows(self, use: int) -> Int[np.ndarray, " r"]:
        """The experiments that a use has weights for."""
        return np.flatnonzero(self.weights[use].any(axis=1))

    def misfit(self, use: int, outputs: Float[np.ndarray, "... r J"]) -> Float[np.ndarray, "..."]:
        """Half the weighted sum of squares of outputs of those experiments, SI."""
        rows = self.rows(use)
        residual = self.standardised(use, rows, outputs - self.values[rows])
        return np.asarray(0.5 * np.sum(residual**2, axis=(-2, -1)))

    def standardised(
        self, use: int, rows: Int[np.ndarray, " r"], difference: Float[np.ndarray, "... r J"]
    ) -> Float[np.ndarray, "... r J"]:
        """√w times what is new in differences of outputs, SI, in units of their errors."""
        used = self.weights[use][rows]
        return np.sqrt(used) * whitened((used > 0) * difference / self.sigma[rows], self.memory[rows])


class Submodel(NamedTuple):
    """One of the nested models.

    Attributes:
        free: the free coordinates, (p,).
        held: parameters of the large model where they are not free, (P,).
    """

    free: Int[np.ndarray, " p"]
    held: Float[np.ndarray, " P"]

    def beside(self, more: Int[np.ndarray, " q"], held: Mapping[int, float]) -> "Submodel":
        """The model with further coordinates free, and further parameters held."""
        values = self.held.copy()
        for column, value in held.items():
            values[column] = value
        return Submodel(np.append(self.free, more), values)


class Task(NamedTuple):
    """One fit to make.

    Attributes:
        submodel: the model.
        start: where to start.
        use: which of the target's weights to fit.
        rivals: tasks of one number, if not negative, are starts of one fit: those that fall behind are given up.
        known: a fit of the same model that ended at the start; its use has weights for these experiments, too.
        stays: it is judged anew where it is, and goes no further.
    """

    submodel: Submodel
    start: Float[np.ndarray, " P"]
    use: int = 0
    rivals: int = -1
    known: "FitState | None" = None
    stays: bool = False


@dataclass
class FitState:
    """A fit, while it is made and afterwards.

    Attributes:
        submodel: the model.
        x: where it is, (P,).
        cost: φ there; infinite where the simulation diverged.
        predicted: outputs of all experiments of the target, SI, (n, J); zero where the use has no weight.
        gradient, hessian: of φ in the free coordinates (Gauss–Newton), (p,) and (p, p).
        slopes: derivatives of what is predicted, in the same coordinates, (p, n, J); nothing where they are too many to be kept.
        mended: so many steps were made since derivatives were differences, each of which mended them; −1: they are of no use.
        races: it is given up where it cannot catch up with other fits.
    """

    submodel: Submodel
    x: Float[np.ndarray, " P"]
    use: int
    cost: float = np.inf
    predicted: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    gradient: np.ndarray = field(default_factory=lambda: np.zeros(0))
    hessian: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    slopes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    damping: float = 1e-2
    done: bool = False
    mended: int = -1
    races: bool = False

    @property
    def free(self) -> Int[np.ndarray, " p"]:
        """Its free coordinates."""
        return self.submodel.free
