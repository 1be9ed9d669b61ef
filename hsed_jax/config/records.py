"""Measured records in a study: what thinning took, steps divided where the specimen yields within one, what a run will cost."""

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hsed_jax.config.functions import FunctionEntry
from hsed_jax.errors import UserError
from hsed_jax.inference.observation import Grid
from hsed_jax.measurements import Campaign, Characteristics, Record
from hsed_jax.measurements.thinning import loss
from hsed_jax.physics.laws import AbstractSpringLaw
from hsed_jax.physics.systems import RESOLVED

if TYPE_CHECKING:
    from hsed_jax.config.build import Built

# A step of an imposed elongation is at most this share of the yield elongation, where that takes no more divisions than these;
# and at most the yield elongation, however many it takes.
STEP_PER_YIELD = 0.2
_DIVISIONS = 20
# Seconds for each step of each experiment on one core, by step of a study, as measured on the project's campaigns; and of
# compiling.  What a search needs depends on the data by a factor of three.
_SECONDS = {"calibrate": 3e-4, "compare": 2e-5, "diagnose": 5e-3, "improve": 1.2e-3}
_COMPILING = 30.0
# Memory [B]: of the program; on each core, of a step in a tile of lanes and of a number in a chunk of them; of a number of each
# experiment in a search, which holds a batch of them at most.
_PROGRAM, _TILE, _CHUNK, _SEARCH, _BATCH = 0.7e9, 64 * 32, 256 * 24, 1500 * 8, 0.5e9


def measured(built: "Built") -> list[Record]:
    """Records of the measured experiments, as they are taken; none where nothing was measured.

    Raises:
        UserError: there is a campaign, and no experiment of it is completed.
    """
    campaign = built.measured
    if campaign is None:
        return []
    if not len(campaign.completed):
        raise UserError(f"the campaign {campaign.name!r} has no completed experiment")
    return [e.record for e in built.taken(campaign.completed.experiments) if e.record is not None]


def divided(samples: int, needed: float, least: float = 1.0) -> Grid:
    """The grid of records: as many steps per sample as are needed, within reason, and never less than the least."""
    steps = min(max(math.ceil(needed - 1e-9), 1), _DIVISIONS)
    return Grid(samples, max(steps, math.ceil(least - 1e-9)))


def imposed_grid(
    records: Sequence[Record],
    found: Characteristics,
    middle: AbstractSpringLaw,
    steepest: AbstractSpringLaw,
) -> Grid:
    """The grid of imposed elongations.

    Arguments:
        records: the longest first or not, each with its elongation.
        found: characteristic values of the campaign.
        middle, steepest: the law in the middle of its priors, and where they make it yield soonest.
    """
    steps = [
        float(np.max(np.abs(np.diff(r["elongation"])), initial=0.0)) for r in records if "elongation" in r.channels
    ]
    yields = [found.force / found.stiffness, float(middle.yield_elongation)]
    yielding = min((value for value in yields if math.isfinite(value) and value > 0), default=math.inf)
    longest = max(steps, default=0.0)
    needed = max(longest / (STEP_PER_YIELD * yielding), longest * float(steepest.steepness) / RESOLVED)
    return divided(max(len(record) for record in records), needed, longest / yielding)


def thinning_notes(built: "Built", campaign: Campaign) -> list[str]:
    """What the records of a campaign lost by thinning, in a sentence each; nothing of those that are as they were."""
    full = campaign.completed.experiments
    pairs = [(a.id, a.record, b.record) for a, b in zip(full, built.taken(full), strict=True) if a is not b]
    return [f"{id} is {loss(a, b)}" for id, a, b in pairs if a is not None and b is not None]


def forecast(built: "Built", campaign: Campaign) -> str:
    """Time and memory that a run of measured experiments will take, in a sentence."""
    if isinstance(built.study.model, FunctionEntry):
        return f"{len(campaign.completed)} experiments; how long they take is up to the model's {built.study.model.described[0]}"
    steps, count = built.timeline.steps, len(campaign.completed)
    columns = len(built.observation.groups)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    seconds = _COMPILING + count * steps * sum(_SECONDS.get(step, 0.0) for step in built.study.steps) / cores
    memory = _PROGRAM + cores * (_TILE * steps + _CHUNK * columns)
    if "diagnose" in built.study.steps:
        memory += min(_SEARCH * count * columns, _BATCH)
    duration = f"{seconds / 60:.0f} minutes" if seconds > 90 else "a minute"
    return (
        f"{count} experiments of {steps} steps each: expect about {duration} on {cores} cores, to a factor of three, and "
        f"{memory / 1e9:.1f} GB"
    )
