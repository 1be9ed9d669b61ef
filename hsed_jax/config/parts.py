"""The parts of a study, built: priors, parameters, effects; each fault names its key."""

import difflib
import math
from collections.abc import Callable, Mapping
from typing import Any

from hsed_jax.config.experiments import VirtualEntry
from hsed_jax.config.schema import ModelEntry
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.effects import Catalogue
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.parameters import Parameter, parameters_of
from hsed_jax.physics.specimen import unserved
from hsed_jax.physics.structures import OWNER, parameter_of


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
