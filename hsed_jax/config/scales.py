"""Characteristic values of a study: as given, else from the campaign, else from the plain model."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from hsed_jax.config import parts
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import conditions_of
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Parametrised, Simulator
from hsed_jax.physics.structures import Structure
from hsed_jax.physics.timeline import Timeline

if TYPE_CHECKING:
    from hsed_jax.config.build import Built


def scales_of(built: "Built") -> Scales:
    """The characteristic values that make amplitudes of effects dimensionless.

    Raises:
        UserError: nothing tells them, not even the model.
    """
    if built.study.scales is not None:
        return Scales(**built.study.scales.model_dump())
    told = _told(built)
    plain = Scales()
    if _are_missing(built):
        middle = parts.law_parameters(built.parameters)
        excited = _conditions(built)
        plain = _simulated(built.structure, built.excitation, built.timeline, built.law, middle, excited)
    return Scales(*(simulated if value is None else value for value, simulated in zip(told, plain, strict=True)))


def check_scales(built: "Built") -> None:
    """Build what the scales need, and compute nothing.

    Raises:
        UserError: they need a simulation, and its plan is missing.
    """
    if _are_missing(built):
        _ = built.timeline


def _told(built: "Built") -> list[float | None]:
    """Scales that the campaign tells; None for each that it does not."""
    found = [math.nan] * 4 if built.characteristics is None else built.characteristics[:4]
    return [value if math.isfinite(value) and value > 0 else None for value in found]


def _are_missing(built: "Built") -> bool:
    """Whether there are effects, and neither study nor campaign tell all that they need."""
    virtual = built.study.experiments.virtual
    has_effects = bool(built.study.model.effects or (virtual and virtual.effects))
    return has_effects and built.study.scales is None and None in _told(built)


def _conditions(built: "Built") -> list[Conditions]:
    """The training experiments as they were excited, or else one in the middle of the inputs."""
    if built.measured is not None and len(built.measured.train):
        train = built.taken(built.measured.train.experiments)
        return [conditions_of(e, built.measured, built.grid, built.excitation) for e in train]
    space = built.space
    middle = space.si(space.declared(np.full((1, len(space.names)), 0.5)))
    return [Conditions({name: jnp.asarray(values[0]) for name, values in middle.items()})]


def _simulated(
    structure: Structure | None,
    excitation: Parametrised | None,
    timeline: Timeline,
    law: type[AbstractSpringLaw],
    middle: Mapping[str, float],
    experiments: Sequence[Conditions],
) -> Scales:
    """What the model without effects does in the middle of its priors, the median over experiments, to two digits.

    Raises:
        UserError: it does nothing, or its simulation diverges.
    """
    plain, rows = Simulator(structure, excitation, timeline, law=law), []
    for conditions in experiments:
        response = plain.respond(middle, conditions, ("elongation_rate",))
        peaks = (response.quantities[name] for name in ("peak_force", "peak_elongation"))
        rate = np.abs(response.channels["elongation_rate"]).max()
        rows.append([float(value) for value in (*peaks, rate, response.quantities["dissipated_energy"])])
    found = [float(f"{value:.2g}") for value in np.median(rows, axis=0)]
    if not all(math.isfinite(value) and value > 0 for value in found):
        raise UserError(
            "scales: in the middle of its priors the model without effects stays at rest or diverges, so nothing tells "
            "the characteristic values of effects; check structure and priors, or give scales"
        )
    return Scales(*found)
