"""A fit: its data, its model, its start and its current state."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class Target:
    """The data of a fit: measured values and their errors, SI, and the weights of several uses of the same experiments.

    Attributes:
        values, sigma: (n, J).
        weights: (M, n, J); a task selects one of the M uses.
        memory: correlation of the noise of each sample with that of the previous sample, (n, J).
        samples: number of samples of its histories that each use needs of each experiment, (M, n); None for all.
    """

    values: Float[np.ndarray, "n J"]
    sigma: Float[np.ndarray, "n J"]
    weights: Float[np.ndarray, "M n J"]
    memory: Float[np.ndarray, "n J"]
    samples: Int[np.ndarray, "M n"] | None = None

    def samples_of(self, use: int, rows: Int[np.ndarray, " r"]) -> Int[np.ndarray, " r"] | None:
        """The number of samples that a use needs of these experiments; None for all."""
        return None if self.samples is None else self.samples[use][rows]

    def rows(self, use: int) -> Int[np.ndarray, " r"]:
        """Indices of the experiments that have a weight in a use."""
        return self._rows[use]

    def misfit(self, use: int, outputs: Float[np.ndarray, "... r J"]) -> Float[np.ndarray, "..."]:
        """Half the weighted sum of squares of the residual, for outputs of the experiments in `rows(use)`, SI."""
        rows = self.rows(use)
        residual = self.standardised(use, rows, outputs - self.values[rows])
        return np.asarray(0.5 * np.einsum("...ij,...ij", residual, residual))

    def standardised(
        self, use: int, rows: Int[np.ndarray, " r"], difference: Float[np.ndarray, "... r J"]
    ) -> Float[np.ndarray, "... r J"]:
        r"""√w times the innovations of differences d of outputs, SI, in units of their errors (`inference.likelihood.whitened`):

        $$\sqrt{w_k}\,\frac{d_k/\sigma_k - \rho_k\,d_{k-1}/\sigma_{k-1}}{\sqrt{1-\rho_k^2}}.$$

        The difference of a sample without weight counts as zero.
        """
        own, before = (factors[use][rows] for factors in self._factors)
        found = own * difference
        # The first sample of a history has no sample before it: its ρ is zero.
        found[..., 1:] -= before[..., 1:] * difference[..., :-1]
        return found

    @cached_property
    def _rows(self) -> list[Int[np.ndarray, " r"]]:
        """Indices of the experiments that have a weight, by use."""
        return [np.flatnonzero(weights.any(axis=1)) for weights in self.weights]

    @cached_property
    def _factors(self) -> tuple[Float[np.ndarray, "M n J"], Float[np.ndarray, "M n J"]]:
        """Factors of a difference and of the one before it: computed once, because a fit needs them for each simulation."""
        share = np.sqrt(self.weights / (1 - self.memory**2))
        scaled = (self.weights > 0) / self.sigma
        return share * scaled, share * self.memory * np.roll(scaled, 1, axis=-1)


class Submodel(NamedTuple):
    """One of the nested models.

    Attributes:
        free: indices of the free coordinates, (p,).
        held: values of the parameters of the large model that are not free, (P,).
    """

    free: Int[np.ndarray, " p"]
    held: Float[np.ndarray, " P"]

    def told(self, theta: Float[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
        """θ of the submodel: its free parameters are those of `theta`, the others have their held values."""
        whole = self.held.copy()
        whole[self.free] = theta[self.free]
        return whole

    def beside(self, more: Int[np.ndarray, " q"], held: Mapping[int, float]) -> "Submodel":
        """The submodel with further free coordinates and further held parameters."""
        values = self.held.copy()
        for column, value in held.items():
            values[column] = value
        return Submodel(np.append(self.free, more), values)


class Task(NamedTuple):
    """One fit to make.

    Attributes:
        submodel: the model.
        start: the starting point.
        use: index of the weights of the target.
        rivals: tasks with the same number, if it is not negative, are starts of one fit; starts that fall behind are stopped.
        known: a fit of the same model that ended at the start; its use has weights for the experiments of this task, too.
        stays: whether a fit with a `known` fit is only evaluated at its start, without steps.
    """

    submodel: Submodel
    start: Float[np.ndarray, " P"]
    use: int = 0
    rivals: int = -1
    known: "FitState | None" = None
    stays: bool = False


@dataclass
class FitState:
    """The state of a fit, during its iterations and afterwards.

    Attributes:
        submodel: the model.
        x: the current point, (P,).
        cost: φ at this point; infinite if the simulation diverged.
        predicted: outputs of all experiments of the target, SI, (n, J); zero where the use has no weight.
        gradient, hessian: of φ in the free coordinates (Gauss–Newton), (p,) and (p, p).
        slopes: derivatives of the predictions in the same coordinates, (p, n, J); empty if they are too many to store.
        mended: number of steps that updated the derivatives since the last finite differences; −1: the derivatives are invalid.
        steps: number of steps that were accepted, or that failed with updated derivatives.
        trials: number of steps that were rejected since the last accepted one.
        races: whether the fit is stopped if it cannot catch up with other fits.
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
    steps: int = 0
    trials: int = 0
    races: bool = False

    @property
    def free(self) -> Int[np.ndarray, " p"]:
        """Indices of its free coordinates."""
        return self.submodel.free
