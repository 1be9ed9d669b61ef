"""The parts of a study, built: priors, errors, structure, excitation, parameters; each fault names its key."""

import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from hsed_jax.config.experiments import VirtualEntry
from hsed_jax.config.schema import ExcitationEntry, ModelEntry
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import parse_unit, read_at2
from hsed_jax.measurements.units import TIME, VELOCITY
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.excitations import NearFaultPulse, RecordedMotion
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.pairs import Pair
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.simulator import Parametrised, Timeline
from hsed_jax.physics.specimen import unserved
from hsed_jax.physics.structures import OWNER, Structure, parameter_of

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


def model_parameters(
    model: ModelEntry, law: type[AbstractSpringLaw], catalogue: Catalogue, of_structure: Mapping[str, Prior], pair: Pair
) -> tuple[dict[str, Prior], dict[str, float]]:
    """Free parameters of the model with their priors, those of the structure last, and the fixed ones with their values."""
    of_law = parameters_of(law)
    check_names("model.parameters", model.parameters, of_law)
    given: dict[str, tuple[str, Parameter, Any]] = {}
    for name, known in of_law.items():
        if name in model.parameters:
            given[name] = (f"model.parameters.{name}", known, model.parameters[name])
        elif known.neutral is None:
            meaning = f"{pair.words(known.meaning)}, {pair.unit(known.unit)}"
            raise UserError(f"model.parameters.{name}: this key is required ({meaning})")
    for effect, entries in model.effects.items():
        forms = effect_parameters("model.effects", effect, entries, law, catalogue)
        named = {forms[name].name for name in entries}
        for name, entry in entries.items():
            given[f"{effect}.{name}"] = (f"model.effects.{effect}.{name}", forms[name], entry)
        for known in parameters_of(catalogue[effect]).values():
            if known.name not in named:
                assert known.prior is not None
                given[f"{effect}.{known.name}"] = ("", known, dict(known.prior))
    free, fixed = {}, {}
    for name, (where, known, entry) in given.items():
        if entry == {}:
            if known.prior is None:
                raise UserError(f"{where}: there is no default prior for it; give one, such as {{uniform: [1.0, 2.0]}}")
            where, entry = "", dict(known.prior)
        if isinstance(entry, dict):
            free[name] = prior(where, entry)
            # A prior of the catalogue is right by definition; a lognormal one reaches to a bound of 0.01 with no mass there.
            for bound in free[name].bounds if where else ():
                if bound is not None:
                    within(where, bound, known)
        else:
            fixed[name] = within(where, float(entry), known)
    highest = dict(fixed) | {name: math.inf if p.bounds[1] is None else p.bounds[1] for name, p in free.items()}
    _check_possible("model.parameters", law, highest)
    free |= of_structure
    if not free:
        first = next(iter(of_law))
        raise UserError(
            f"model.parameters: at least one parameter needs a prior, such as {first}: {{uniform: [2.0e5, 9.0e5]}}"
        )
    return free, fixed


def true_parameters(entry: VirtualEntry, law: type[AbstractSpringLaw], catalogue: Catalogue) -> dict[str, float]:
    """The parameters of a virtual specimen."""
    of_law, where = parameters_of(law), "experiments.virtual"
    check_names(f"{where}.parameters", entry.parameters, of_law)
    truth = {
        name: within(f"{where}.parameters.{name}", value, of_law[name]) for name, value in entry.parameters.items()
    }
    for name, known in of_law.items():
        if known.neutral is None and name not in truth:
            raise UserError(f"{where}.parameters.{name}: this key is required ({known.meaning})")
    _check_possible(f"{where}.parameters", law, truth)
    for effect, values in entry.effects.items():
        forms = effect_parameters(f"{where}.effects", effect, values, law, catalogue)
        for name, value in values.items():
            truth[f"{effect}.{name}"] = within(f"{where}.effects.{effect}.{name}", value, forms[name])
    return truth


def _check_possible(where: str, law: type[AbstractSpringLaw], highest: Mapping[str, float]) -> None:
    """Refuse what the law says is impossible wherever the parameters are; parts of a prior are failures of those simulations."""
    if fault := law.impossible(highest):
        name, words = fault
        raise UserError(f"{where}.{name}: {words}")


def parameter_units(
    names: tuple[str, ...],
    constants: Mapping[str, float],
    law: type[AbstractSpringLaw],
    catalogue: Catalogue,
    pair: Pair,
) -> dict[str, str]:
    """SI unit of every named parameter of a specimen that is measured in a pair."""
    units = {}
    for name in names:
        effect, _, rest = name.rpartition(".")
        if effect == OWNER:
            units[name] = parameter_of(rest).unit
            continue
        known = parameters_of(catalogue[effect]) if effect else parameters_of(law)
        physical = {p.physical.name: p.physical.unit for p in known.values() if p.physical is not None}
        unit = known[rest].unit if rest in known else physical[rest]
        # With n = 1 the unit of β and γ is an ordinary one.
        unit = "1/m" if unit == "N^(1-n)/m" and constants.get("n", 1.0) == 1 and "n" not in names else unit
        units[name] = pair.unit(unit)
    return units


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


def law_parameters(
    parameters: tuple[Mapping[str, Prior], Mapping[str, float]], quantiles: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Parameters of the law in the middle of their priors, or where quantiles are given at these; the fixed ones as they are.

    Arguments:
        parameters: free ones of the model with their priors, and fixed ones; those of effects are left out.
        quantiles: by name.
    """
    free, fixed = parameters
    values = {
        name: float(prior.quantile((quantiles or {}).get(name, 0.5))) for name, prior in free.items() if "." not in name
    }
    return values | {name: value for name, value in fixed.items() if "." not in name}


def longest_step(
    structure: Structure, steepest: AbstractSpringLaw, entry: ExcitationEntry | None, space: InputSpace
) -> float:
    """The step that resolves the structure, its specimen at the upper end of its stiffness, and the pulse [s]."""
    stiffest = float(steepest.stiffness)
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


def effect_parameters(
    where: str, effect: str, entries: Mapping[str, Any], law: type[AbstractSpringLaw], catalogue: Catalogue
) -> dict[str, Parameter]:
    """Parameters of an effect under both their names, the dimensionless and the physical one.

    Raises:
        UserError: there is no such effect or parameter, or the law cannot have the effect.
    """
    if effect not in catalogue:
        close = difflib.get_close_matches(effect, catalogue, n=1)
        hint = f" (did you mean {close[0]}?)" if close else ""
        raise UserError(f"{where}.{effect}: there is no such effect{hint}; the catalogue has {', '.join(catalogue)}")
    if missing := unserved(catalogue[effect], law):
        raise UserError(f"{where}.{effect}: {missing}")
    known = parameters_of(catalogue[effect])
    forms = {**known, **{p.physical.name: p for p in known.values() if p.physical is not None}}
    check_names(f"{where}.{effect}", entries, forms)
    for name in entries:
        same = [other for other in entries if forms[other].name == forms[name].name]
        if len(same) > 1:
            raise UserError(f"{where}.{effect}: {' and '.join(same)} are two forms of one parameter; give one of them")
    return forms


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
