"""Whether the structure and the priors of a study fit the measured motion: a number changed alone may exclude it."""

import math
from typing import TYPE_CHECKING

from hsed_jax.config.functions import FunctionEntry
from hsed_jax.measurements import Campaign
from hsed_jax.physics.names import OWNER, by_owner, own_name, owner_of
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.study.floors import floors_of, top_channel

if TYPE_CHECKING:
    from hsed_jax.study.build import Built

# Central share of the priors that should hold what is measured: 95 %.
_LOW, _HIGH = 0.025, 0.975
# A specimen that yields moves at this share of its virgin frequency, or more, and never faster; records tell a frequency to 5 %.
_YIELDED, _OFF = 0.7, 1.05


def frequency_doubts(built: "Built", campaign: Campaign) -> list[str]:
    """At most one sentence: the first frequency of the structure, within the priors, is not the one that the sensors show.

    Where the noise is inferred, nothing else tells: a prior that excludes the stiffness leaves a larger noise.
    """
    if isinstance(built.study.model, FunctionEntry) or built.structure is None:
        return []
    on_ground = any(None in ends for ends in built.structure.specimens)
    if top_channel(campaign) == "elongation" and not on_ground:
        return []  # that of no floor
    if (floors := floors_of(campaign)) is None:
        return []
    low, middle, high = (_frequency(built, share) for share in (_LOW, 0.5, _HIGH))
    if not middle > 0 or _YIELDED * low / _OFF <= floors.frequency <= high * _OFF:
        return []
    free, _ = built.parameters
    priors = [name for name in free if _is_stiffness(built, name)]
    what = f"with structure.masses, structure.springs and {' and '.join(priors) or 'a specimen'} as they are given"
    factor = (floors.frequency / middle) ** 2
    return [
        f"the sensors show a first frequency of {floors.frequency:.3g} Hz; {what} it lies between {low:.3g} and {high:.3g} Hz "
        f"(95 %): where masses are changed, stiffnesses change with them, here by a factor of about {factor:.2g}"
        f"{_remedy(built, priors, factor)}"
    ]


def _frequency(built: "Built", share: float) -> float:
    """First frequency of the structure [Hz] at a quantile of stiffnesses and the opposite one of masses; zero of a loose one."""
    assert built.structure is not None
    free, _ = built.parameters
    numbers = {
        own_name(name): float(prior.quantile(1 - share if own_name(name).startswith("mass_") else share))
        for name, prior in free.items()
        if owner_of(name) == OWNER and own_name(name).startswith(("mass_", "stiffness_"))
    }
    stiffness = []
    for element in built.elements:
        quantiles = {known.name: share for known in parameters_of(element.law).values() if known.unit == "N/m"}
        values = element.parameters(by_owner(built.naming.middle(built.parameters, quantiles)))
        stiffness.append(float(element.law(**values).stiffness))
    return float(built.structure.told(numbers).frequencies(stiffness)[0])


def _is_stiffness(built: "Built", name: str) -> bool:
    known = built.naming.of_laws.get(name)
    return known is not None and known.unit == "N/m"


def _remedy(built: "Built", priors: list[str], factor: float) -> str:
    """What to write, where the prior is of the kind that `hsed init` writes."""
    free, _ = built.parameters
    said = []
    for name in priors:
        if free[name].name == "lognormal":
            middle, spread = free[name].arguments
            said.append(f"{name}: {{lognormal: [{middle + math.log(factor):.3f}, {spread:g}]}}")
    return f", such as {', '.join(said)}" if said else ""
