"""Doubts of units that need a study: a drift needs its height, a period its masses, a motion its excitation."""

# JAX gives its devices no type, so the functions that make arrays have none.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterator

import jax
import numpy as np

from hsed_jax.config.functions import CalledEntry
from hsed_jax.measurements import Campaign, Finding, Record
from hsed_jax.measurements.unit_doubts import mixed
from hsed_jax.measurements.units import LENGTH, channel_dimension
from hsed_jax.physics.display import amount
from hsed_jax.physics.excitations.base import channels_of
from hsed_jax.physics.names import named
from hsed_jax.physics.outputs import loops
from hsed_jax.study.advice import frequency_of
from hsed_jax.study.build import Built

DRIFT = (1e-6, 0.5)
"""Plausible largest drift ratio; a frame has collapsed long before 0.5, and below 1e-6 no sensor sees a loop."""
PERIOD = (1e-3, 20.0)
"""Plausible first period [s]; the tallest buildings and seismic isolation end near 10 s, stiff machines begin near 1e-3 s."""
EVERY = "all"
"""Name instead of an experiment in a doubt of the structure."""
_MOMENTS = 4000  # samples of a planned motion, to find its peak


def unit_doubts(built: Built) -> list[Finding]:
    """Doubts of units of a study, besides those of its data.

    Arguments:
        built: the study; measurements whose data have errors are left out.
    """
    campaign = built.experiments.measured
    found = [*period_doubts(built)]
    if campaign is not None:
        height = built.study.measurements.height
        found += [*(drift_doubts(campaign, height) if height is not None else ()), *planned_doubts(built, campaign)]
    return found


def drift_doubts(campaign: Campaign, height: float) -> Iterator[Finding]:
    """Implausible drift ratios.

    Arguments:
        campaign: the measurements.
        height: over which the elongation is a drift [m].
    """
    seen: list[Record] = []
    for experiment in campaign.completed:
        record = experiment.record
        if record is None or record in seen or campaign.pair.elongation_unit != LENGTH.si:
            continue
        seen.append(record)
        for owner in loops(record.channels):
            name = named(owner, "elongation")
            peak = int(np.argmax(np.abs(record[name])))
            size = float(np.abs(record[name][peak]))
            if DRIFT[0] <= size / height <= DRIFT[1] or size == 0:
                continue
            message = (
                f"its largest magnitude, {amount(campaign.pair, name, size)}, is a drift ratio of {size / height:.2g} of the "
                f"height of {height:g} m; structures have {DRIFT[0]:g} to {DRIFT[1]:g}: is a unit wrong?"
            )
            at, span = float(record.time[peak]), ((peak, peak + 1),)
            yield Finding("doubt", experiment.id, name, at, message, "unit", campaign.has_time, span)


def period_doubts(built: Built) -> Iterator[Finding]:
    """An implausible first period in the middle of the priors."""
    mechanics = built.mechanics
    structure = mechanics.structure
    if structure is None or isinstance(built.study.model, CalledEntry):
        return
    frequency = frequency_of(mechanics, structure, 0.5)
    if frequency > 0 and not PERIOD[0] <= 1 / frequency <= PERIOD[1]:
        message = (
            f"its first period is {1 / frequency:.3g} s with the masses [kg] and stiffnesses [N/m] in the middle of their "
            f"priors; structures have {PERIOD[0]:g} to {PERIOD[1]:g} s: is a unit wrong?"
        )
        yield Finding("doubt", EVERY, "structure", None, message, "unit")


def planned_doubts(built: Built, campaign: Campaign) -> Iterator[Finding]:
    """Measured motions whose peak differs from that of the excitation of the study by the factor between two units."""
    planned = built.experiments.excitation
    if planned is None:
        return
    for experiment in campaign.completed:
        record = experiment.record
        if record is None:
            continue
        excitation = planned(experiment.inputs)
        times = jax.device_put(np.linspace(0.0, float(excitation.duration), _MOMENTS))
        motions = {name: np.asarray(v) for name, v in channels_of(jax.vmap(excitation.sample)(times)).items()}
        for name in motions.keys() & record.channels.keys():
            measured, wanted = (float(np.abs(values).max()) for values in (record[name], motions[name]))
            if wanted > 0 and (said := mixed(channel_dimension(name, campaign.pair), measured / wanted)):
                message = (
                    f"it goes to {amount(campaign.pair, name, measured)}, by the excitation of the study and the inputs to "
                    f"{amount(campaign.pair, name, wanted)}: are {said[1]} mixed?"
                )
                yield Finding("doubt", experiment.id, name, None, message, "unit", campaign.has_time)
