"""Measured records in a study: what thinning took, and what a run will cost."""

from typing import TYPE_CHECKING

from hsed_jax.backend import cores
from hsed_jax.config.functions import FunctionEntry
from hsed_jax.measurements import Campaign
from hsed_jax.measurements.thinning import loss

if TYPE_CHECKING:
    from hsed_jax.study.build import Built

# Seconds for each step of each experiment on one core, by step of a study, as measured on the project's campaigns; and of
# compiling.  What a search needs depends on the data by a factor of three.
_SECONDS = {"calibrate": 3e-4, "compare": 2e-5, "diagnose": 2e-2, "discover": 3e-3, "improve": 1.2e-3}
_COMPILING = 15.0
# Experiments that a diagnosis searches, at most.
_SEARCHED = 6
# Memory [B]: of the program; on each core, of a step in a tile of lanes and of a number in a chunk of them; of a number of each
# experiment in a search, which holds a batch of them at most.
_PROGRAM, _TILE, _CHUNK, _SEARCH, _BATCH = 0.7e9, 64 * 32, 256 * 24, 1500 * 8, 0.5e9


def thinning_notes(built: "Built", campaign: Campaign) -> list[str]:
    """What the records of a campaign lost by thinning, in a sentence each; nothing of those that are as they were."""
    full = campaign.completed.experiments
    pairs = [(a.id, a.scored, b.scored) for a, b in zip(full, built.taken(full), strict=True) if a is not b]
    return [f"{id} is {loss(a, b)}" for id, a, b in pairs if a is not None and b is not None]


def forecast(built: "Built", campaign: Campaign) -> str:
    """Time and memory that a run of measured experiments will take, in a sentence."""
    if isinstance(built.study.model, FunctionEntry):
        return f"{len(campaign.completed)} experiments; how long they take is up to the model's {built.study.model.described[0]}"
    steps, count = built.timeline.steps, len(campaign.completed)
    columns = len(built.observation.groups)
    available = cores()
    counts = {"diagnose": min(count, _SEARCHED)}
    work = sum(counts.get(step, count) * _SECONDS.get(step, 0.0) for step in built.study.steps)
    seconds = _COMPILING + steps * work / available
    memory = _PROGRAM + available * (_TILE * steps + _CHUNK * columns)
    if "diagnose" in built.study.steps:
        memory += min(_SEARCH * count * columns, _BATCH)
    duration = f"{seconds / 60:.0f} minutes" if seconds > 90 else "a minute"
    experiments = f"{count} experiments of {steps} steps each" if count > 1 else f"1 experiment of {steps} steps"
    return (
        f"{experiments}: expect about {duration} on {available} cores, to a factor of three, and {memory / 1e9:.1f} GB"
    )
