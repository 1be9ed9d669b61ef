"""Advice on a study before it runs: whether its priors allow the measured motion, and the cost of a run."""

import math

from hsed_jax.backend import cores
from hsed_jax.config.functions import CalledEntry
from hsed_jax.drafting.floors import floors_of, top_channel
from hsed_jax.measurements import Campaign
from hsed_jax.physics.names import OWNER, by_owner, own_name, owner_of
from hsed_jax.physics.parameters import parameters_of
from hsed_jax.physics.structures import Structure
from hsed_jax.study.inference import Inference
from hsed_jax.study.mechanics import AbstractMechanics

# Central share of the priors that should contain the measured value: 95 %.
_LOW, _HIGH = 0.025, 0.975
# A yielding specimen moves at this share of its virgin frequency or more, and never faster; records show a frequency to 5 %.
_YIELDED, _OFF = 0.7, 1.05
# Seconds for each step of each experiment on one core, by step of a study, measured on the project's campaigns; and seconds of
# compiling.  The cost of a search depends on the data, by a factor of three.
_SECONDS = {"calibrate": 3e-4, "compare": 2e-5, "diagnose": 2e-2, "discover": 3e-3, "improve": 1.2e-3}
_COMPILING = 15.0
# Experiments that a diagnosis searches, at most.
_SEARCHED = 6
# Memory [B]: of the program; on each core, of a step in a tile of a batch and of a number in a chunk of them; of a number of each
# experiment in a search, which holds a batch of them at most.
_PROGRAM, _TILE, _CHUNK, _SEARCH, _BATCH = 0.95e9, 64 * 32, 256 * 24, 1500 * 8, 0.5e9


def frequency_doubts(mechanics: AbstractMechanics, campaign: Campaign) -> list[str]:
    """At most one sentence: the priors exclude the first frequency of the structure that the sensors show.

    If the noise is inferred, no other check finds this: a prior that excludes the stiffness causes a larger noise.
    """
    structure = mechanics.structure
    if isinstance(mechanics.study.model, CalledEntry) or structure is None:
        return []
    on_ground = any(None in ends for ends in structure.specimens)
    if top_channel(campaign) == "elongation" and not on_ground:
        return []  # not the frequency of a floor
    if (floors := floors_of(campaign)) is None:
        return []
    low, middle, high = (frequency_of(mechanics, structure, share) for share in (_LOW, 0.5, _HIGH))
    if not middle > 0 or _YIELDED * low / _OFF <= floors.frequency <= high * _OFF:
        return []
    free, _ = mechanics.parameters
    priors = [name for name in free if _is_stiffness(mechanics, name)]
    what = f"with structure.masses, structure.springs and {' and '.join(priors) or 'a specimen'} as they are given"
    factor = (floors.frequency / middle) ** 2
    return [
        f"the sensors show a first frequency of {floors.frequency:.3g} Hz; {what} it lies between {low:.3g} and {high:.3g} Hz "
        f"(95 %): other masses need other stiffnesses, here by a factor of about {factor:.2g}"
        f"{_remedy(mechanics, priors, factor)}"
    ]


def frequency_of(mechanics: AbstractMechanics, structure: Structure, share: float) -> float:
    """First frequency of the structure [Hz] at a quantile of the stiffnesses and the opposite quantile of the masses;
    zero if the structure is loose.
    """
    free, _ = mechanics.parameters
    numbers = {
        own_name(name): float(prior.quantile(1 - share if own_name(name).startswith("mass_") else share))
        for name, prior in free.items()
        if owner_of(name) == OWNER and own_name(name).startswith(("mass_", "stiffness_"))
    }
    stiffness: list[float] = []
    for element in mechanics.elements:
        quantiles = {known.name: share for known in parameters_of(element.law).values() if known.unit == "N/m"}
        values = element.parameters(by_owner(mechanics.naming.middle(mechanics.parameters, quantiles)))
        stiffness.append(float(element.law(**values).stiffness))
    return float(structure.told(numbers).frequencies(stiffness)[0])


def _is_stiffness(mechanics: AbstractMechanics, name: str) -> bool:
    known = mechanics.naming.of_laws.get(name)
    return known is not None and known.unit == "N/m"


def _remedy(mechanics: AbstractMechanics, priors: list[str], factor: float) -> str:
    """The prior to write instead, if the present one is of the kind that `hsed init` writes."""
    free, _ = mechanics.parameters
    said: list[str] = []
    for name in priors:
        if free[name].name == "lognormal":
            middle, spread = free[name].arguments
            said.append(f"{name}: {{lognormal: [{middle + math.log(factor):.3f}, {spread:g}]}}")
    return f", such as {', '.join(said)}" if said else ""


def forecast(inference: Inference, campaign: Campaign) -> str:
    """Estimated time and RAM of a run of measured experiments, in a sentence."""
    model, asked, count = inference.study.model, inference.study.steps, len(campaign.completed)
    if isinstance(model, CalledEntry):
        return f"{count} experiments; their time depends on the model's {model.described[0]}"
    timeline = inference.simulation.timeline
    assert timeline is not None
    steps, columns = timeline.steps, len(inference.observation.groups)
    available = cores()
    counts = {"diagnose": min(count, _SEARCHED)}
    work = sum(counts.get(step, count) * _SECONDS.get(step, 0.0) for step in asked)
    seconds = _COMPILING + steps * work / available
    memory = _PROGRAM + available * (_TILE * steps + _CHUNK * columns)
    if "diagnose" in asked:
        memory += min(_SEARCH * count * columns, _BATCH)
    duration = f"{seconds / 60:.0f} minutes" if seconds > 90 else "a minute"
    experiments = f"{count} experiments of {steps} steps each" if count > 1 else f"1 experiment of {steps} steps"
    return (
        f"{experiments}: expect about {duration} on {available} cores, to a factor of three, and {memory / 1e9:.1f} GB"
    )
