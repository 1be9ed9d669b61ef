"""The paper's case, as a study builds it, and in plain numbers for those who do not know the package."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg

from hsed_jax import load_study
from hsed_jax.backend import prepare
from hsed_jax.study.build import Built

prepare()  # some rows compute before they build a study

PAPER = Path(__file__).resolve().parents[1] / "configs" / "paper.yaml"
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")
ETA = 2.0e-5  # 1/J
GAMMA, NU = 2.0, 0.10
EXPERIMENTS = 43


def built(*overrides: str) -> Built:
    """What the paper's study builds."""
    return Built(load_study(PAPER, overrides))


def degrading(*overrides: str) -> Built:
    """The paper's study with the specimen's degradation in the model."""
    return built(f"model.effects.stiffness_degradation.eta={ETA}", *overrides)


@dataclass(frozen=True)
class Numbers:
    """The two masses in numbers: mass [kg], outer springs [N/m], damping matrix [N·s/m], step [s] and number of steps."""

    masses: np.ndarray
    springs: np.ndarray
    damping: np.ndarray
    step: float
    steps: int

    @property
    def packed(self) -> np.ndarray:
        """What the peers need: 1/m₁, 1/m₂, k₁, k₂, c₁₁, c₁₂, c₂₁, c₂₂."""
        return np.concatenate([1 / self.masses, self.springs, self.damping.ravel()])


def numbers(case: Built) -> Numbers:
    """The numbers of a study; the damping by its own formula, C = 2ζ M √(M⁻¹K)."""
    entry = case.study.structure
    masses = np.asarray(entry.masses, float)
    springs = np.asarray([spring.stiffness for spring in entry.springs], float)
    specimen = entry.damping.specimen_stiffness
    stiffness = np.diag(springs) + specimen * np.array([[1.0, -1.0], [-1.0, 1.0]])
    root = scipy.linalg.sqrtm(np.diag(1 / masses) @ stiffness)
    damping = 2 * entry.damping.modal * np.diag(masses) @ np.real(root)
    return Numbers(masses, springs, damping, *case.simulation.timeline[:2])


def lanes(case: Built, count: int, seed: int) -> dict[str, np.ndarray]:
    """Random inputs and parameters over their whole ranges, by name, each (count,)."""
    random = np.random.default_rng(seed)
    priors = {**case.experiments.space.priors, **case.mechanics.parameters[0]}
    return {name: np.asarray(prior.quantile(random.uniform(size=count)), float) for name, prior in priors.items()}


def columns(values: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """V_P, T_P, A, beta, as the peers take them."""
    return tuple(np.ascontiguousarray(values[name]) for name in ("V_P", "T_P", "A", "beta"))


def measured(case: Built, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A space-filling campaign of the virtual laboratory: points of the unit cube (count, d), quantities (count, 3)."""
    cube = case.experiments.space.initial_design(count)
    si = case.experiments.space.si(case.experiments.space.declared(cube))
    exact = [case.site.laboratory.exact({k: float(v[i]) for k, v in si.items()}) for i in range(count)]
    return cube, np.asarray([[row[name] for name in QUANTITIES] for row in exact])
