"""A material of OpenSees as a function: from parameters and the elongation of an experiment to the force."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hsed_jax.laboratories.base import ExperimentFailed
from hsed_jax.models.opensees import MATERIALS
from hsed_jax.models.opensees.workers import workers

FINEST = 100
"""No step of OpenSees is longer than the largest elongation over this number: materials with curves are of first order in it."""


@dataclass(frozen=True)
class Simulated:
    """The force of a material along the elongation of an experiment, and the numbers that follow from both.

    Attributes:
        material: its name.
    """

    material: str

    def __call__(self, parameters: Mapping[str, float], inputs: Mapping[str, Any]) -> dict[str, Any]:
        """Channels `force` and `energy` (n,), and quantities, SI.

        Raises:
            ExperimentFailed: OpenSees gave no finite forces.
            UserError: openseespy cannot be imported.
        """
        elongation = np.asarray(inputs["elongation"], dtype=float)
        path, at = finely(elongation)
        arguments = MATERIALS[self.material].arguments(parameters)
        force = workers().forces(self.material, arguments, path)[at]
        if not np.isfinite(force).all():
            raise ExperimentFailed(f"a force of {self.material} is no finite number")
        work = 0.5 * (force[1:] + force[:-1]) * np.diff(elongation)
        energy = np.concatenate([[0.0], np.cumsum(work)])
        return {
            "force": force,
            "energy": energy,
            "peak_force": float(np.max(np.abs(force))),
            "peak_elongation": float(np.max(np.abs(elongation))),
            "dissipated_energy": float(energy[-1]),
        }


def finely(elongation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The path that OpenSees follows: from zero through the samples, in short steps.

    Arguments:
        elongation: samples (n,) [m].

    Returns:
        Elongations (N,) [m], and where the samples are among them (n,).
    """
    corners = np.concatenate([[0.0], elongation])
    longest = float(np.max(np.abs(corners))) / FINEST or 1.0
    counts = np.maximum(1, np.ceil(np.abs(np.diff(corners)) / longest - 1e-9)).astype(int)
    ends = np.cumsum(counts)
    path = np.interp(np.arange(1, ends[-1] + 1), np.concatenate([[0], ends]), corners)
    path[ends - 1] = elongation
    return path, ends - 1
