"""Characteristic values of effects, from a campaign or from a simulation of the model without effects."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.inference.observation import Grid, conditions_of
from hsed_jax.measurements import Characteristics
from hsed_jax.physics.elements import Element
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.names import named, of_each
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.response import Response
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Simulator
from hsed_jax.study.experiments import Experiments


def told_scales(found: Characteristics | None) -> list[float | None]:
    """Scales from the characteristic values of a campaign; None for each that they do not determine."""
    values = [math.nan] * 4 if found is None else found[:4]
    return [value if math.isfinite(value) and value > 0 else None for value in values]


def law_parameters(elements: Sequence[Element], laws: Sequence[AbstractSpringLaw]) -> dict[str, float]:
    """The parameters of the laws of specimens, by name."""
    return {
        named(element.name, name): getattr(law, name)
        for element, law in zip(elements, laws, strict=True)
        for name in parameters_of(law)
    }


def conditions(experiments: Experiments, grid: Grid | None) -> list[Conditions]:
    """The measured conditions of the training experiments, or else one experiment in the middle of the inputs."""
    measured = experiments.measured
    if measured is not None and len(measured.train):
        train = experiments.taken(measured.train.experiments)
        return [conditions_of(e, measured, grid, experiments.excitation) for e in train]
    return [Conditions(experiments.space.middle())]


def simulated_scales(plain: Simulator, middle: Mapping[str, float], experiments: Sequence[Conditions]) -> Scales:
    """The response of the model without effects in the middle of its priors: the median over experiments, to two digits.

    With several specimens, the largest.

    Raises:
        UserError: the model stays at rest, or its simulation diverges.
    """
    owners, rows = plain.owners, list[list[float]]()
    for conditions in experiments:
        response = plain.respond(middle, conditions, of_each(owners, ("elongation_rate",)))

        def most(quantity: str, found: Response = response) -> float:
            return max(float(found.quantities[name]) for name in of_each(owners, (quantity,)))

        rate = max(float(np.abs(values).max()) for values in response.channels.values())
        rows.append([most("peak_force"), most("peak_elongation"), rate, most("dissipated_energy")])
    found = [float(f"{value:.2g}") for value in np.median(rows, axis=0)]
    if not all(math.isfinite(value) and value > 0 for value in found):
        raise UserError(
            "scales: in the middle of its priors the model without effects stays at rest or diverges, so "
            "the characteristic values of effects are unknown; check structure and priors, or give scales"
        )
    return Scales(*found)
