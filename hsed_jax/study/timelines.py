"""The grids of the integration: of planned experiments, and of measured records."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hsed_jax.config.excitation_entry import ExcitationEntry
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import Grid
from hsed_jax.measurements import Characteristics, Record
from hsed_jax.measurements.characteristics import from_unloaded
from hsed_jax.physics.excitations.base import AbstractExcitation, AbstractImposedElongation
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.outputs import driven_mass
from hsed_jax.physics.simulator import Parametrised
from hsed_jax.physics.structures import Structure
from hsed_jax.physics.systems import RESOLVED
from hsed_jax.physics.timeline import Timeline
from hsed_jax.study.excitations import LOWEST
from hsed_jax.study.experiments import Experiments
from hsed_jax.study.mechanics import AbstractMechanics

# The integration resolves the shortest period with this many steps; peaks are then good to 1e-4 (tests/physics/test_response.py).
_STEPS_PER_PERIOD = 24
_MOST_STEPS = 1_000_000
# Samples of a planned history; an imposed cycle has at least four per quarter.
_SAMPLES = 400
_SAMPLES_PER_BRANCH = 4
# Steps of a quarter of a cycle, if the spring needs no more to be stable.
_MOST_PER_BRANCH = 100
# A step of a measured elongation is at most this share of the yield elongation, within the given number of steps per sample; it
# is at most the yield elongation for any number of steps.
_STEP_PER_YIELD = 0.2
_DIVISIONS = 20
# The smallest size of a compiled program, and the ratio of successive sizes: campaigns of similar length share a program.
# Padding is not simulated.  A program that takes long to compile has fewer sizes.
_LEAST, _TIMES = 256, 2
_LEAST_SHARED, _TIMES_SHARED = 512, 4
TOLD = 1000
"""Number of samples of the excitation for a model without an integration in this package."""


def longest_step(structure: Structure, steepest: Sequence[AbstractSpringLaw], experiments: Experiments) -> float:
    """The step that resolves the structure, its specimens at the upper ends of their stiffness, and the excitation [s]."""
    stiffest = [float(law.stiffness) for law in steepest]
    periods = [1 / float(structure.frequencies(stiffest)[-1])]
    if experiments.excitation is not None:
        periods.append(float(experiments.excitation(experiments.quantile(LOWEST)).shortest_period))
    return min(periods) / _STEPS_PER_PERIOD


def required(experiments: Experiments) -> tuple[ExcitationEntry, Parametrised[AbstractExcitation]]:
    """The excitation of the planned experiments.

    Raises:
        UserError: the study has no excitation.
    """
    entry, excitation = experiments.study.excitation, experiments.excitation
    if entry is None or excitation is None:
        known = ", ".join(
            name for name in type(entry or ExcitationEntry()).model_fields if name not in ("duration", "step")
        )
        raise UserError(f"excitation: give one of {known}, because no record gives the excitation")
    return entry, excitation


def planned_timeline(experiments: Experiments, step: float) -> Timeline:
    """The grid of the integration for an experiment without a record, driven over time.

    Raises:
        UserError: the step [s] is longer than the experiment, or there are too many steps.
    """
    duration = experiments.duration
    if step > duration:
        raise UserError(f"excitation.step: {step:g} s is longer than the duration, {duration:g} s")
    steps = _checked(
        math.ceil(duration / step - 1e-9),
        f"steps of {step:.3g} s are too many (at most {_MOST_STEPS}); the shortest period of structure and excitation sets the "
        "step, unless excitation.step is given",
    )
    every = 1
    if experiments.study.observe == "histories":
        every = max(1, round(steps / _SAMPLES))
        steps = every * math.ceil(steps / every)
    return Timeline(duration / steps, steps, every)


def imposed_timeline(
    experiments: Experiments,
    excitation: Parametrised[AbstractExcitation],
    laws: Sequence[AbstractSpringLaw],
    steepest: Sequence[AbstractSpringLaw],
) -> Timeline:
    """The same number of steps for every branch; the largest branch resolves the spring that yields first, if any."""
    largest = excitation(experiments.quantile(1 - LOWEST))
    assert isinstance(largest, AbstractImposedElongation)
    wanted, least, stable = TOLD / largest.branches, 0.0, 0.0
    for middle, soonest in zip(laws, steepest, strict=True):
        wanted, least, stable = _divisions(float(largest.reach), [float(middle.yield_elongation)], soonest)
    per_branch = math.ceil(max(min(wanted, _MOST_PER_BRANCH), least, stable, _SAMPLES_PER_BRANCH) - 1e-9)
    every = 1
    if experiments.study.observe == "histories":
        every = min(max(1, round(per_branch * largest.branches / _SAMPLES)), per_branch // _SAMPLES_PER_BRANCH)
        per_branch = every * math.ceil(per_branch / every)
    steps = _checked(
        per_branch * largest.branches,
        f"steps are too many (at most {_MOST_STEPS}) for the largest amplitude and the spring of smallest yield elongation; "
        "narrow the distributions of both",
    )
    return Timeline(None, steps, every)


def measured_grid(experiments: Experiments, mechanics: AbstractMechanics, needed: Callable[[], float]) -> Grid | None:
    """Samples and steps per sample of the measured records; None without them.

    Arguments:
        experiments: of the study.
        mechanics: of a model of spring laws.
        needed: gives the longest step that resolves them in a structure [s].

    Raises:
        UserError: no experiment is completed, or a force was applied to a mass that does not exist.
    """
    records = experiments.records
    if not records:
        return None
    if experiments.component_test:
        assert experiments.characteristics is not None
        (middle,), (steepest,) = mechanics.laws, mechanics.steepest
        return imposed_grid(records, experiments.characteristics, middle, steepest, mechanics.is_shared)
    for name in dict.fromkeys(name for record in records for name in record.channels):
        check_mass(f"channels.{name}", name, mechanics.structure)
    longest = max(float(np.max(np.diff(record.time), initial=0.0)) for record in records)
    return _divided(records, longest / needed(), mechanics.is_shared)


def check_mass(where: str, channel: str, structure: Structure | None) -> None:
    """Refuse a force on a mass that does not exist."""
    mass, masses = driven_mass(channel), math.inf if structure is None else len(structure.masses)
    if mass is not None and mass > masses:
        raise UserError(f"{where}: there is no mass {mass}; the structure has {masses}")


def imposed_grid(
    records: Sequence[Record],
    found: Characteristics,
    middle: AbstractSpringLaw,
    steepest: AbstractSpringLaw,
    is_shared: bool = False,
) -> Grid:
    """The grid of measured elongations that were imposed: more steps where the elongation changes more.

    Arguments:
        records: each with its elongation.
        found: characteristic values of the campaign.
        middle, steepest: the law in the middle of its priors, and at the parameters with the earliest yielding.
        is_shared: the program takes long to make, as `padded` says.
    """
    samples = padded(max(len(record) for record in records), is_shared)
    records = [from_unloaded(record) for record in records if "elongation" in record.channels]
    path = max((float(np.sum(np.abs(np.diff(r["elongation"])))) for r in records), default=0.0)
    if not path > 0:
        return Grid(samples, 1)
    yields = [found.force / found.stiffness, float(middle.yield_elongation)]
    wanted, least, stable = _divisions(path, yields, steepest)
    count = max(min(max(wanted, stable), _DIVISIONS * (samples - 1)), least)
    grid = Grid(samples, 1, path / count)
    steps = max(int(grid.divisions(record).sum()) for record in records)
    return replace(grid, steps=padded(1 + steps, is_shared) - 1)


def _divisions(longest: float, yields: Sequence[float], steepest: AbstractSpringLaw) -> tuple[float, float, float]:
    """Numbers of steps for a path of an imposed elongation: for accuracy, the least number, and for a stable integration.

    Arguments:
        longest: the path [m].
        yields: elongations [m] at which the specimen may yield; values that are not positive are ignored.
        steepest: the law where its priors make it yield soonest.
    """
    yielding = min((value for value in yields if math.isfinite(value) and value > 0), default=math.inf)
    return longest / (_STEP_PER_YIELD * yielding), longest / yielding, longest * float(steepest.steepness) / RESOLVED


def _divided(records: Sequence[Record], needed: float, is_shared: bool) -> Grid:
    """The grid of records: as many steps per sample as are needed, within reason."""
    steps = min(max(math.ceil(needed - 1e-9), 1), _DIVISIONS)
    return Grid(padded(max(len(record) for record in records), is_shared), steps)


def padded(count: int, is_shared: bool = False) -> int:
    """The least size of a compiled program for so many samples; `is_shared`: a program that takes long to compile."""
    least, times = (_LEAST_SHARED, _TIMES_SHARED) if is_shared else (_LEAST, _TIMES)
    return least * times ** max(math.ceil(math.log(max(count, 1) / least, times) - 1e-9), 0)


def _checked(steps: int, words: str) -> int:
    if steps > _MOST_STEPS:
        raise UserError(f"excitation: {steps} {words}")
    return steps
