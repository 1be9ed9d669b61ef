"""Characteristic values of a study: as given, else from the campaign, else from the plain model."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.inference.observation import conditions_of
from hsed_jax.physics.names import named, of_each
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.response import Response
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Simulator
from hsed_jax.study.specimens import effects_of

if TYPE_CHECKING:
    from hsed_jax.study.build import Built


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
        simulator = Simulator(
            structure=built.structure, excitation=built.excitation, timeline=built.timeline, elements=built.elements
        )
        middle = {
            named(element.name, name): getattr(law, name)
            for element, law in zip(built.elements, built.laws, strict=True)
            for name in parameters_of(law)
        }
        plain = _simulated(simulator, middle, _conditions(built))
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
    has_effects = bool(effects_of(built.study) or (virtual and virtual.effects))
    return has_effects and built.study.scales is None and None in _told(built)


def _conditions(built: "Built") -> list[Conditions]:
    """The training experiments as they were excited, or else one in the middle of the inputs."""
    if built.measured is not None and len(built.measured.train):
        train = built.taken(built.measured.train.experiments)
        return [conditions_of(e, built.measured, built.grid, built.excitation) for e in train]
    return [Conditions(built.space.middle())]


def _simulated(plain: Simulator, middle: Mapping[str, float], experiments: Sequence[Conditions]) -> Scales:
    """What the model without effects does in the middle of its priors, the median over experiments, to two digits.

    Of several specimens the most.

    Raises:
        UserError: it does nothing, or its simulation diverges.
    """
    owners, rows = plain.owners, []
    for conditions in experiments:
        response = plain.respond(middle, conditions, of_each(owners, ("elongation_rate",)))

        def most(quantity: str, found: Response = response) -> float:
            return max(float(found.quantities[name]) for name in of_each(owners, (quantity,)))

        rate = max(float(np.abs(values).max()) for values in response.channels.values())
        rows.append([most("peak_force"), most("peak_elongation"), rate, most("dissipated_energy")])
    found = [float(f"{value:.2g}") for value in np.median(rows, axis=0)]
    if not all(math.isfinite(value) and value > 0 for value in found):
        raise UserError(
            "scales: in the middle of its priors the model without effects stays at rest or diverges, so nothing tells "
            "the characteristic values of effects; check structure and priors, or give scales"
        )
    return Scales(*found)
