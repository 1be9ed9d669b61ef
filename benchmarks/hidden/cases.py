"""What a case of the benchmark is, and everything random in it but the noise."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from . import degrading as degrading  # these six register their formulas
from . import effects as effects
from . import forces as forces
from . import loops as loops
from . import real as real
from . import sensors as sensors
from .catalogue import FAMILIES, KINDS, Formula, applicable, formula
from .mixtures import mixture
from .specimen import Scales


@dataclass(frozen=True)
class Case:
    """What to hide.

    Attributes:
        kind: `shaken`, `component` or `quantities`.
        effects: (effect, formula) each; none is a control.  Of a pair each alone has the size.
        size: relative change of the response by one effect alone, at the same A and β.
        noise: standard deviation over the RMS of a channel, or over the value of a quantity.
        experiments, test: how many to train with, how many to hold out.
        seed: of everything drawn.
        memory: correlation of the noise of neighbouring samples of a record (AR(1)); the campaign declares the size alone.
        every: of the samples of a record only each so many is kept.
    """

    kind: str
    effects: tuple[tuple[str, str], ...]
    size: float
    noise: float
    experiments: int
    test: int
    seed: int
    memory: float = 0.0
    every: int = 1


@dataclass(frozen=True)
class Hidden:
    """An effect with its formula, its sign, and its further parameters as drawn."""

    effect: str
    name: str
    formula: Formula
    sign: float
    drawn: dict[str, float]


@dataclass(frozen=True)
class Plan:
    """What was drawn for a case: inputs (n, 2), parameters, effects."""

    kind: str
    inputs: np.ndarray
    A: float
    beta: float
    hidden: tuple[Hidden, ...]
    seed: int
    train: int


@dataclass(frozen=True)
class Measured:
    """Noise-free records (samples, sizes, experiments) and quantities (3, sizes, experiments)."""

    time: np.ndarray
    u: np.ndarray
    force: np.ndarray
    quantities: np.ndarray

    def sampled(self, every: int) -> "Measured":
        """Only each so many of the samples of the records; the quantities were read continuously."""
        return replace(self, time=self.time[::every], u=self.u[::every], force=self.force[::every])

    def scales(self, size: int, train: int) -> Scales:
        """Medians over the training experiments of largest force, largest elongation, high rate, absorbed energy."""
        return scales_of(self.time, self.u[:, size, :train], self.force[:, size, :train])


def scales_of(time, u, force) -> Scales:
    """Characteristic values of records (samples, experiments), as the package defines them."""
    rate = np.quantile(np.abs(np.gradient(u, time, axis=0)), 0.98, axis=0)
    values = np.abs(force).max(0), np.abs(u).max(0), rate, np.abs(np.trapezoid(force, u, axis=0))
    return Scales(*(float(np.median(v)) for v in values))


def draw(case: Case) -> Plan:
    """Everything random in a case but the noise.

    Raises:
        ValueError: no such kind, effect or formula, or the effect does not show in this kind.
    """
    if case.kind not in KINDS:
        raise ValueError(f"no kind {case.kind!r}; kinds are {', '.join(KINDS)}")
    random = np.random.default_rng([case.seed, 1])
    A, beta = 5e5 * random.uniform(0.8, 1.2), random.uniform(0.8, 1.2)
    low, high = ([1.5, 0.5], [3.0, 1.5]) if case.kind != "component" else ([0.15, 0.3], [0.45, 0.8])
    inputs = [
        qmc.scale(qmc.LatinHypercube(2, rng=random).random(count), low, high)
        for count in (case.experiments, case.test)
        if count
    ]
    hidden = []
    for effect, name in case.effects:
        if effect not in FAMILIES:
            raise ValueError(f"no effect {effect!r}; effects are {', '.join(FAMILIES)}")
        if not applicable(effect, case.kind):
            raise ValueError(f"{effect!r} cannot show in a campaign of kind {case.kind!r}")
        chosen = mixture(effect, name) if " + " in name else formula(effect, name)
        if chosen.place == "opensees" and (case.kind != "component" or len(case.effects) != 1):
            raise ValueError(f"{effect!r} by OpenSees is for component tests with this one effect")
        sign = random.choice([-1.0, 1.0]) if chosen.is_signed else 1.0
        drawn = {key: float(random.uniform(*bounds)) for key, bounds in chosen.draws.items()}
        hidden.append(Hidden(effect, name, chosen, float(sign), drawn))
    return Plan(case.kind, np.concatenate(inputs), A, beta, tuple(hidden), case.seed, case.experiments)
