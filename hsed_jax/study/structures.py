"""The numerical substructure of a study, and those of its numbers that are calibrated with the law."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from hsed_jax.config.mechanics import StructureEntry
from hsed_jax.errors import UserError
from hsed_jax.inference.priors import Prior
from hsed_jax.physics.names import OWNER, own_name
from hsed_jax.physics.structures import ModalDamping, RayleighDamping, Spring, Structure, parameter_of
from hsed_jax.study.parts import possible, prior, within


def structure(entry: StructureEntry) -> Structure:
    """The numerical substructure; numbers with a prior are at its median."""
    priors = priors_of(entry)

    def number(name: str, given: Any) -> float:
        return float(priors[f"{OWNER}.{name}"].quantile(0.5)) if isinstance(given, dict) else float(given)

    stiffness = entry.damping.specimen_stiffness
    reference: Any = 1.0 if stiffness == "model" else stiffness
    if isinstance(stiffness, dict):
        names = list(entry.specimens or {})
        if sorted(stiffness) != sorted(names):
            raise UserError(
                "structure.damping.specimen_stiffness: give one number, or one for each of several specimens: "
                f"{', '.join(names) or 'there are none'}"
            )
        reference = tuple(float(stiffness[name]) for name in names)
    elif stiffness == "model" and len(entry.places) > 1:
        reference = (1.0,) * len(entry.places)
    numbers = {name: number(name, given) for name, (_, given) in _numbers(entry).items()}
    if entry.damping.rayleigh is not None:
        damping: Any = RayleighDamping(numbers["alpha"], numbers["beta"], reference)
    elif isinstance(ratios := entry.damping.modal, list):
        if len(ratios) != len(entry.masses):
            raise UserError(
                f"structure.damping.modal: {len(ratios)} ratios for {len(entry.masses)} modes; give one, or one per mode"
            )
        damping = ModalDamping(np.asarray([numbers[f"ratio_{i + 1}"] for i in range(len(ratios))]), reference)
    else:
        damping = ModalDamping(np.asarray(numbers["ratio"]), reference)
    masses = [numbers[f"mass_{i + 1}"] for i in range(len(entry.masses))]
    springs = [Spring(ends(s.between), numbers[f"stiffness_{i + 1}"]) for i, s in enumerate(entry.springs)]
    try:
        return Structure(masses, springs, [ends(place) for place in entry.places], damping)
    except ValueError as error:
        raise UserError(f"structure: {error}") from None


def masses_of(structure: Structure | None) -> int:
    """Number of masses; zero for a specimen alone."""
    return 0 if structure is None else len(structure.masses)


def priors_of(entry: StructureEntry) -> dict[str, Prior]:
    """Priors of the numbers of the structure that are calibrated, by the name of the parameter."""
    priors: dict[str, Prior] = {}
    for name, (where, given) in _numbers(entry).items():
        if not isinstance(given, dict):
            continue
        known = parameter_of(name)
        made = priors[f"{OWNER}.{name}"] = prior(where, cast("dict[str, Any]", given))
        # A structure has no negative mass or stiffness; a prior may reach there with a billionth of its mass, which never occurs.
        lowest, highest = (float(made.quantile(share)) for share in (1e-9, 1 - 1e-9))
        if lowest < known.lower or highest > known.upper or (name.startswith("mass_") and not lowest > 0):
            allowed = "positive" if name.startswith("mass_") else possible(known)
            raise UserError(f"{where}: this prior reaches from {lowest:.3g} to {highest:.3g}; it must be {allowed}")
    return priors


def stiffest(structure: Structure | None, of_structure: Mapping[str, Prior]) -> Structure:
    """The structure with its shortest periods: the stiffest springs and the lightest masses that priors allow."""
    assert structure is not None
    numbers = {
        name: float(prior.quantile(0.001 if name.startswith("mass_") else 0.999))
        for name, prior in ((own_name(full), prior) for full, prior in of_structure.items())
        if name.startswith(("mass_", "stiffness_"))
    }
    return structure.told(numbers)


def _numbers(entry: StructureEntry) -> dict[str, tuple[str, Any]]:
    """The numbers of a structure by the names of their parameters: the place of each, and its value."""
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


def true_numbers(where: str, given: Mapping[str, float], of_structure: Mapping[str, Prior]) -> dict[str, float]:
    """The true numbers of the structure where a laboratory of this program performs an experiment, one for each prior.

    Arguments:
        where: the key in the study.
        given: by name.
        of_structure: the priors, by the names of parameters.

    Raises:
        UserError: one is missing, impossible, or has no prior.
    """
    calibrated = [own_name(name) for name in of_structure]
    for name in given:
        if name not in calibrated:
            known = f"with one are {', '.join(calibrated)}" if calibrated else "none has one"
            raise UserError(f"{where}.{name}: this is for numbers that the study gives priors; {known}")
    for name in calibrated:
        if name not in given:
            raise UserError(f"{where}.{name}: this key is required, as the study gives it a prior")
    return {name: within(f"{where}.{name}", value, parameter_of(name)) for name, value in given.items()}
