"""The parts of a study, built: priors, errors, structure, excitation, parameters; each fault names its key."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from hsed_jax.config.schema import ExcitationEntry
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import parse_unit, read_at2
from hsed_jax.measurements.units import TIME, VELOCITY
from hsed_jax.physics.excitations import NearFaultPulse, RecordedMotion
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.parameters import Parameter
from hsed_jax.physics.simulator import Parametrised, Timeline
from hsed_jax.physics.structures import Structure

# The integration resolves the shortest period with this many steps; peaks are then good to 1e-4 (tests/test_response.py).
_STEPS_PER_PERIOD = 24
_MOST_STEPS = 1_000_000
_VIRTUAL_SAMPLES = 400


def excitation(entry: ExcitationEntry | None, inputs: Mapping[str, Any], folder: Path) -> Parametrised | None:
    """From inputs to a ground motion; None where every experiment brings its record."""
    if entry is None or (entry.near_fault_pulse is None and entry.recorded is None):
        return None
    if entry.near_fault_pulse is not None:
        made = Parametrised(NearFaultPulse, tuple(entry.near_fault_pulse.model_dump().items()))
    else:
        assert entry.recorded is not None
        time, acceleration = recorded_motion(entry, folder)

        def scaled(scale):
            return RecordedMotion(time, scale * acceleration)

        made = Parametrised(scaled, (("scale", entry.recorded.scale),))

    where = f"excitation.{'recorded' if entry.near_fault_pulse is None else 'near_fault_pulse'}"
    arguments: dict[str, Any] = dict(made.arguments)
    for name, value in arguments.items():
        if isinstance(value, str) and value not in inputs:
            known = ", ".join(inputs) or "none"
            raise UserError(f"{where}.{name}: it refers to {value!r}, which is no input; inputs are {known}")
    for name, dimension in (("V_P", VELOCITY), ("T_P", TIME)):
        if isinstance(value := arguments.get(name), str):
            at(f"inputs.{value}.unit", parse_unit, inputs[value].unit, dimension)
    period, gamma = arguments.get("T_P", 1.0), arguments.get("gamma", 2.0)
    if isinstance(period, str):
        lowest = float(prior(f"inputs.{period}", inputs[period].prior).quantile(1e-9))
        if not lowest > 0:
            raise UserError(f"inputs.{period}: a period is positive, but this distribution reaches {lowest:.3g}")
    elif period <= 0:
        raise UserError(f"{where}.T_P: a period is positive, but it is {period:g}")
    if not isinstance(gamma, str) and (gamma <= 0 or gamma == 1):
        raise UserError(f"{where}.gamma: the number of oscillations is positive and not 1, but it is {gamma:g}")
    return made


def recorded_motion(entry: ExcitationEntry, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and accelerations [m/s²] of the accelerogram that a study names."""
    assert entry.recorded is not None
    step, acceleration = read_at2(folder / entry.recorded.file)
    return step * np.arange(len(acceleration)), acceleration


def planned_timeline(entry: ExcitationEntry, folder: Path, step: float, histories: bool) -> Timeline:
    """The grid of the integration for an experiment without a record.

    Arguments:
        entry: of the excitation.
        folder: of the study.
        step: at most so long [s].
        histories: whether samples of histories are kept.
    """
    duration = float(recorded_motion(entry, folder)[0][-1]) if entry.duration is None else entry.duration
    if step > duration:
        raise UserError(f"excitation.step: {step:g} s is longer than the duration, {duration:g} s")
    steps = math.ceil(duration / step - 1e-9)
    if steps > _MOST_STEPS:
        raise UserError(
            f"excitation: {steps} steps of {step:.3g} s are too many (at most {_MOST_STEPS}); the shortest period of "
            "structure and excitation sets the step, unless excitation.step is given"
        )
    every = 1
    if histories:
        every = max(1, round(steps / _VIRTUAL_SAMPLES))
        steps = every * math.ceil(steps / every)
    return Timeline(duration / steps, steps, every)


def longest_step(
    structure: Structure, steepest: Sequence[AbstractSpringLaw], entry: ExcitationEntry | None, space: InputSpace
) -> float:
    """The step that resolves the structure, its specimens at the upper ends of their stiffness, and the pulse [s]."""
    stiffest = [float(law.stiffness) for law in steepest]
    # Compiled: one program is ready sooner than each of its operations.
    periods = [1 / float(jax.jit(lambda: structure.frequencies(stiffest))()[-1])]
    pulse = entry.near_fault_pulse if entry else None
    if pulse is not None:
        shortest = pulse.T_P
        if isinstance(shortest, str) and shortest in space.names:
            shortest = float(space.priors[shortest].quantile(1e-9)) * space.factors[shortest]
        if not isinstance(shortest, str):
            periods.append(shortest)
    return min(periods) / _STEPS_PER_PERIOD


def check_names(where: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Refuse a name that is not known, and say which are."""
    for name in given:
        if name not in known:
            raise UserError(f"{where}.{name}: there is no such parameter; allowed here are {', '.join(known)}")


def within(where: str, value: float, known: Parameter) -> float:
    """A fixed value, if it is possible."""
    if not known.lower <= value <= known.upper:
        raise UserError(f"{where}: {value:g} is outside what is possible, {possible(known)}")
    return value


def possible(known: Parameter) -> str:
    """The bounds of a parameter, in words."""
    low = "" if known.lower == -float("inf") else f"at least {known.lower:g}"
    high = "" if known.upper == float("inf") else f"at most {known.upper:g}"
    return " and ".join(side for side in (low, high) if side)


def prior(where: str, entry: Mapping[str, Any]) -> Prior:
    """A prior, its faults with the key in front."""
    ((name, arguments),) = entry.items()
    return at(where, Prior, str(name), arguments)


def at(where: str, make: Callable[..., Any], *arguments: Any) -> Any:
    """Call, and put the place in front of what is wrong."""
    try:
        return make(*arguments)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None
