"""The parts of a study, built: priors, errors, structure, excitation, parameters; each fault names its key."""

import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hsed_jax.config.experiments import VirtualEntry
from hsed_jax.config.schema import ExcitationEntry, ModelEntry, StructureEntry
from hsed_jax.config.sections import ErrorEntry, NoiseEntry
from hsed_jax.design.space import InputSpace
from hsed_jax.errors import UserError
from hsed_jax.inference.likelihood import Error
from hsed_jax.inference.priors import Prior
from hsed_jax.measurements import parse_unit, read_at2
from hsed_jax.measurements.units import TIME, VELOCITY
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.excitations import NearFaultPulse, RecordedMotion
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.outputs import is_quantity, output, quantity
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.simulator import Parametrised, Timeline
from hsed_jax.physics.specimen import unserved
from hsed_jax.physics.structures import OWNER, ModalDamping, RayleighDamping, Spring, Structure, parameter_of

# The integration resolves the shortest period with this many steps; peaks are then good to 1e-4 (tests/test_response.py).
_STEPS_PER_PERIOD = 24
_MOST_STEPS = 1_000_000
_VIRTUAL_SAMPLES = 400


def structure(entry: StructureEntry) -> Structure:
    """The numerical substructure; what has a prior is at its median."""
    priors = structure_priors(entry)

    def number(name: str, given: Any) -> float:
        return float(priors[f"{OWNER}.{name}"].quantile(0.5)) if isinstance(given, dict) else float(given)

    stiffness = entry.damping.specimen_stiffness
    reference = 1.0 if stiffness == "model" else float(stiffness)
    numbers = {name: number(name, given) for name, (_, given) in _numbers(entry).items()}
    if entry.damping.rayleigh is not None:
        damping: Any = RayleighDamping(numbers["alpha"], numbers["beta"], reference)
    elif isinstance(ratios := entry.damping.modal, list):
        if len(ratios) != len(entry.masses):
            raise UserError(
                f"structure.damping.modal: {len(ratios)} ratios for {len(entry.masses)} modes; give one, or one per mode"
            )
        damping = ModalDamping(jnp.asarray([numbers[f"ratio_{i + 1}"] for i in range(len(ratios))]), reference)
    else:
        damping = ModalDamping(jnp.asarray(numbers["ratio"]), reference)
    masses = [numbers[f"mass_{i + 1}"] for i in range(len(entry.masses))]
    springs = [Spring(ends(s.between), numbers[f"stiffness_{i + 1}"]) for i, s in enumerate(entry.springs)]
    try:
        return Structure(masses, springs, ends(entry.specimen.between), damping)
    except ValueError as error:
        raise UserError(f"structure: {error}") from None


def structure_priors(entry: StructureEntry) -> dict[str, Prior]:
    """Priors of the numbers of the structure that are calibrated, by the name of the parameter."""
    priors = {}
    for name, (where, given) in _numbers(entry).items():
        if not isinstance(given, dict):
            continue
        known = parameter_of(name)
        made = priors[f"{OWNER}.{name}"] = prior(where, given)
        # With a negative mass or stiffness there is no structure; a mass that a billionth of the prior puts there never occurs.
        lowest, highest = (float(made.quantile(share)) for share in (1e-9, 1 - 1e-9))
        if lowest < known.lower or highest > known.upper or (name.startswith("mass_") and not lowest > 0):
            allowed = "positive" if name.startswith("mass_") else _possible(known)
            raise UserError(f"{where}: this prior reaches from {lowest:.3g} to {highest:.3g}; it must be {allowed}")
    return priors


def stiffest(of_structure: Mapping[str, Prior]) -> dict[str, float]:
    """Numbers of a structure at which its periods are shortest: the stiffest springs, the lightest masses that priors allow."""
    return {
        name.removeprefix(f"{OWNER}."): float(prior.quantile(0.001 if "mass_" in name else 0.999))
        for name, prior in of_structure.items()
        if name.startswith((f"{OWNER}.mass_", f"{OWNER}.stiffness_"))
    }


def _numbers(entry: StructureEntry) -> dict[str, tuple[str, Any]]:
    """The numbers of a structure by the names of their parameters: where each stands, and what was given."""
    damping = entry.damping
    found: dict[str, tuple[str, Any]]
    found = {f"mass_{i}": (f"structure.masses[{i}]", given) for i, given in enumerate(entry.masses, 1)}
    for i, spring in enumerate(entry.springs, 1):
        found[f"stiffness_{i}"] = (f"structure.springs[{i}].stiffness", spring.stiffness)
    if damping.rayleigh is not None:
        shares = damping.rayleigh
        found |= {name: (f"structure.damping.rayleigh.{name}", getattr(shares, name)) for name in ("alpha", "beta")}
    elif isinstance(damping.modal, list):
        found |= {f"ratio_{i}": (f"structure.damping.modal[{i}]", given) for i, given in enumerate(damping.modal, 1)}
    else:
        found["ratio"] = ("structure.damping.modal", damping.modal)
    return found


def ends(between: tuple[Any, Any]) -> tuple[int | None, int | None]:
    """Ends as a user numbers them (masses from 1, or the ground) as a structure does (from 0, or None)."""
    first, second = (None if end == "ground" else int(end) - 1 for end in between)
    return first, second


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
    model: ModelEntry, law: type[AbstractSpringLaw], catalogue: Catalogue, of_structure: Mapping[str, Prior]
) -> tuple[dict[str, Prior], dict[str, float]]:
    """Free parameters of the model with their priors, those of the structure last, and the fixed ones with their values."""
    of_law = parameters_of(law)
    check_names("model.parameters", model.parameters, of_law)
    given: dict[str, tuple[str, Parameter, Any]] = {}
    for name, known in of_law.items():
        if name in model.parameters:
            given[name] = (f"model.parameters.{name}", known, model.parameters[name])
        elif known.neutral is None:
            raise UserError(f"model.parameters.{name}: this key is required ({known.meaning}, {known.unit})")
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


def true_parameters(
    entry: VirtualEntry, law: type[AbstractSpringLaw], catalogue: Catalogue, of_structure: Mapping[str, Prior]
) -> dict[str, float]:
    """The parameters of a virtual specimen and of the structure that it is in.

    Arguments:
        entry: of the virtual laboratory.
        law: of the specimen.
        catalogue: the effects there are.
        of_structure: priors of the structure's numbers that are calibrated: each needs a true value.
    """
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
    told = true_numbers(f"{where}.structure", entry.structure, of_structure)
    return truth | {f"{OWNER}.{name}": value for name, value in told.items()}


def true_numbers(where: str, given: Mapping[str, float], of_structure: Mapping[str, Prior]) -> dict[str, float]:
    """The true numbers of the structure where a laboratory of this program performs an experiment, for each with a prior."""
    calibrated = [name.removeprefix(f"{OWNER}.") for name in of_structure]
    for name in given:
        if name not in calibrated:
            known = f"with one are {', '.join(calibrated)}" if calibrated else "none has one"
            raise UserError(f"{where}.{name}: this is for numbers that the study gives priors; {known}")
    for name in calibrated:
        if name not in given:
            raise UserError(f"{where}.{name}: this key is required, as the study gives it a prior")
    return {name: within(f"{where}.{name}", value, parameter_of(name)) for name, value in given.items()}


def _check_possible(where: str, law: type[AbstractSpringLaw], highest: Mapping[str, float]) -> None:
    """Refuse what the law says is impossible wherever the parameters are; parts of a prior are failures of those simulations."""
    if fault := law.impossible(highest):
        name, words = fault
        raise UserError(f"{where}.{name}: {words}")


def parameter_units(
    names: tuple[str, ...], constants: Mapping[str, float], law: type[AbstractSpringLaw], catalogue: Catalogue
) -> dict[str, str]:
    """SI unit of every named parameter."""
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
        units[name] = "1/m" if unit == "N^(1-n)/m" and constants.get("n", 1.0) == 1 and "n" not in names else unit
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
        raise UserError(f"{where}: {value:g} is outside what is possible, {_possible(known)}")
    return value


def _possible(known: Parameter) -> str:
    low = "" if known.lower == -float("inf") else f"at least {known.lower:g}"
    high = "" if known.upper == float("inf") else f"at most {known.upper:g}"
    return " and ".join(side for side in (low, high) if side)


def per_output[Entry: NoiseEntry](
    where: str, entry: Entry | dict[str, Entry] | None, outputs: list[str]
) -> dict[str, Entry]:
    """One entry for all outputs, or one per output, as one per output."""
    if entry is None:
        return {}
    if isinstance(entry, NoiseEntry):
        return dict.fromkeys(outputs, entry)
    for name in entry:
        if name not in outputs:
            raise UserError(f"{where}.{name}: this is not observed; observed are {', '.join(outputs)}")
    return dict(entry)


def error(name: str, size: float | Prior, is_relative: bool, entry: ErrorEntry) -> Error:
    """The error of an output.

    Raises:
        UserError: it is relative to a quantity that may be negative or zero.
    """
    if is_relative and is_quantity(name) and quantity(name).is_signed:
        raise UserError(
            f"error.{name}: {name} may be negative or zero, and no error is relative to that; give it an absolute one "
            f"[{output(name).unit}], such as error: {{{name}: {{absolute: 0.001}}}}"
        )
    return Error(size, is_relative, entry.correlated, entry.inflate)


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
