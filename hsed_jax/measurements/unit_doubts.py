"""Doubts of units: magnitudes that no specimen has, and records that differ by the factor between two units.

A unit that is wrong for the whole record does not change the shape of a loop.  Three comparisons can find it: the largest force
over the largest elongation, the other experiments of the campaign, and an input that is the amplitude of the test.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hsed_jax.measurements.campaign import Campaign
from hsed_jax.measurements.experiment import Experiment, Record
from hsed_jax.measurements.findings import Finding
from hsed_jax.measurements.units import Dimension, channel_dimension, parse_unit
from hsed_jax.physics.display import amount
from hsed_jax.physics.names import named
from hsed_jax.physics.outputs import loops

STIFFNESS = {"m": (1e2, 2e11), "rad": (1.0, 1e13), "1": (1e4, 1.2e12)}
"""Plausible secant stiffness [SI] by the unit of the elongation; the sources are in `docs/measurements.md`.

* Force over elongation: the storeys of table-top models have some 1e2 N/m; a steel cube of 1 m (E = 2.1e11 Pa) has 2.1e11 N/m.
* Moment over rotation: small joints of timber and of furniture begin at some 1 N m/rad; foundations of buildings end at 1e12.
* Stress over strain: soft foams have some 1e4 Pa; diamond, the stiffest solid, has 1.2e12 Pa.
"""

MIXED: dict[str, dict[float, str]] = {
    "length": {10.0: "mm and cm", 25.4: "mm and inch", 1000.0: "mm and m"},
    "force": {9.80665: "N and kgf", 1000.0: "N and kN", 4448.22: "N and kip"},
    "angle": {10.0: "mrad and %", 1000.0: "mrad and rad"},
    "moment": {9.80665: "N m and kgf m", 1000.0: "kN m and kN mm"},
    "strain": {10.0: "mm/m and %", 1000.0: "mm/m and -"},
    "stress": {1000.0: "kPa and MPa"},
    "acceleration": {9.80665: "m/s^2 and g"},
}
"""Factor between two units that are taken for one another, by dimension."""

LARGE = 100.0  # specimens of one campaign differ by less
NEAR = {
    False: 1.15,
    True: 4.0,
}  # a ratio within this factor is that of two units; a large factor allows for differences of specimens
AMONG = 1.5  # the same for several experiments
ALIKE = {False: 1.35, True: 10.0}  # scatter of the ratios over the levels at which two experiments are compared
LEVELS = {"force": (0.3, 0.5, 0.7, 0.9), "elongation": (0.2, 0.3, 0.4, 0.5)}
"""Levels of the comparison, as shares of the common range; a plateau of the force carries no information on the
elongation.
"""
MOST = 15  # largest number of experiments for a comparison
SAME = 1.25  # peaks over their input differ by less where the input is the amplitude


class _Growth(NamedTuple):
    """The growth of the magnitude of one channel with that of the other: magnitudes reached so far, (g,) each."""

    levels: np.ndarray
    values: np.ndarray

    def at(self, levels: np.ndarray) -> np.ndarray:
        """The value reached when a level is first reached, on lines between the samples that reach further."""
        return np.interp(levels, self.levels, self.values)


def specimen_doubts(campaign: Campaign, id: str, record: Record) -> Iterator[Finding]:
    """An implausible secant stiffness."""
    low, high = STIFFNESS[campaign.pair.elongation_unit]
    for owner in loops(record.channels):
        name, other = named(owner, "force"), named(owner, "elongation")
        force, elongation = (float(np.abs(record[channel]).max()) for channel in (name, other))
        if not (force > 0 and elongation > 0) or low <= force / elongation <= high:
            continue
        unit = campaign.pair.unit("N/m")
        message = (
            f"its largest magnitude over that of the {campaign.pair.elongation}, {amount(campaign.pair, other, elongation)}, is "
            f"{force / elongation:.2g} {unit}; specimens have {low:.2g} to {high:.2g} {unit}: is a unit wrong?"
        )
        yield Finding("doubt", id, name, None, message, "unit")


def factor_doubts(campaign: Campaign) -> Iterator[Finding]:
    """Experiments that differ from most others, or from their input, by the factor between two units."""
    measured = _distinct(campaign)
    doubted: set[tuple[str, str]] = set()
    for finding in (*_against_inputs(campaign, measured), *_against_others(campaign, measured)):
        if (finding.experiment, finding.channel) not in doubted:
            doubted.add((finding.experiment, finding.channel))
            yield finding


def mixed(dimension: Dimension, ratio: float, near: float | None = None) -> tuple[float, str] | None:
    """The factor between two units that is near a ratio of magnitudes, and these units; None if there is none.

    Arguments:
        dimension: of the magnitudes.
        ratio: of one to the other, or of the other to the one.
        near: by which factor the ratio may differ from that of the units; by default as for two experiments.
    """
    if not 0 < ratio < np.inf:
        return None
    size = max(ratio, 1 / ratio)
    known = MIXED.get(dimension.name, {})
    found = [(f, units) for f, units in known.items() if _is_near(size, f, NEAR[f > LARGE] if near is None else near)]
    return min(found, key=lambda one: abs(np.log(size / one[0])), default=None)


def _is_near(one: float, other: float, factor: float) -> bool:
    return bool(abs(np.log(one / other)) < np.log(factor))


def _distinct(campaign: Campaign) -> list[Experiment]:
    """Completed experiments, each with its own record: windows of one record count as one experiment."""
    found: dict[int, Experiment] = {}
    for experiment in campaign.completed:
        if experiment.record is not None:
            found.setdefault(id(experiment.record), experiment)
    return list(found.values())


def _against_others(campaign: Campaign, measured: Sequence[Experiment]) -> Iterator[Finding]:
    owners = dict.fromkeys(owner for e in measured if e.record is not None for owner in loops(e.record.channels))
    for owner in owners:
        known = {e.id: growth for e in measured if (growth := _growth(e.record, owner))}
        names = list(known)
        for number, (id, own) in enumerate(known.items()):
            rest = names[:number] if len(known) == 2 else [other for other in names if other != id]
            others = {other: known[other] for other in rest[:: max(1, -(-len(rest) // MOST))]}
            for channel in LEVELS:
                name = named(owner, channel)
                compared = {
                    other: _compared(own[channel], growth[channel], channel) for other, growth in others.items()
                }
                found = _factor(channel_dimension(name, campaign.pair), list(compared.values()))
                if found is None:
                    continue
                factor, units = found
                # With other inputs, one of two experiments may differ by nature, as a damper under another tension does.
                if len(known) == 2 and factor < LARGE and len({tuple(campaign[k].inputs.values()) for k in known}) > 1:
                    continue
                nearest = min(compared, key=lambda other: abs(abs(np.log(compared[other].ratio)) - np.log(factor)))
                ratio = compared[nearest].ratio
                at = campaign.pair.elongation if channel == "force" else campaign.pair.force
                size = f"{ratio:.3g} times" if ratio > 1 else f"1/{1 / ratio:.3g} of"
                more = f", and as far from the {len(others) - 1} others" if len(others) > 1 else ""
                message = f"at the same {at} it is {size} that of {nearest}{more}: are {units} mixed?"
                yield Finding("doubt", id, name, None, message, "unit")
                break  # one of the two channels explains it


class _Compared(NamedTuple):
    """One channel of an experiment over that of another one, at equal levels of the other channel.

    Attributes:
        ratio: the median over the levels.
        scatter: the largest over the least.
        apart: the larger peak of the other channel over the smaller one.
    """

    ratio: float
    scatter: float
    apart: float

    def tells(self, factor: float) -> bool:
        """Whether the loops are alike except for the factor."""
        return self.scatter < ALIKE[factor > LARGE] and self.apart < factor**0.5


def _factor(dimension: Dimension, compared: Sequence[_Compared]) -> tuple[float, str] | None:
    """The factor by which an experiment differs from all others, and the units; None where it is among them."""
    middle = float(np.exp(np.median(np.log([one.ratio for one in compared])))) if compared else float("nan")
    several = len(compared) > 1
    said = mixed(dimension, middle, AMONG if several and max(middle, 1 / middle) < LARGE else None)
    if said is None:
        return None
    factor, side = said[0], np.sign(np.log(middle))
    is_away = [side * np.log(one.ratio) > 0.5 * np.log(factor) for one in compared]
    within = NEAR[True] if factor > LARGE else AMONG if several else NEAR[False]
    is_it = [one.tells(factor) and _is_near(one.ratio, factor**side, within) for one in compared]
    return said if all(is_away) and 2 * sum(is_it) > len(compared) else None


def _growth(record: Record | None, owner: str) -> dict[str, _Growth]:
    """By channel, its growth with the other channel of a loop; empty for a record without a loop."""
    names = {channel: named(owner, channel) for channel in LEVELS}
    if record is None or not {*names.values()} <= record.channels.keys():
        return {}
    reached = {channel: np.maximum.accumulate(np.abs(record[name])) for channel, name in names.items()}
    if not all(np.isfinite(values[-1]) and values[-1] > 0 for values in reached.values()):
        return {}
    found = {}
    for channel, other in (("force", "elongation"), ("elongation", "force")):
        further = np.flatnonzero(np.diff(reached[other], prepend=0.0) > 0)
        values = (np.concatenate([[0.0], reached[name][further]]) for name in (other, channel))
        found[channel] = _Growth(*values)
    return found


def _compared(one: _Growth, other: _Growth, channel: str) -> _Compared:
    tops = float(one.levels[-1]), float(other.levels[-1])
    at = np.asarray(LEVELS[channel]) * min(tops)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(one.at(at) / other.at(at))
    if not np.isfinite(logs).all():
        return _Compared(1.0, np.inf, np.inf)
    return _Compared(float(np.exp(np.median(logs))), float(np.exp(np.ptp(logs))), max(tops) / min(tops))


def _against_inputs(campaign: Campaign, measured: Sequence[Experiment]) -> Iterator[Finding]:
    """Peaks of the excitation against an input of the same dimension that is their amplitude."""
    driver = "elongation" if campaign.protocol == "displacement" else "ground_acceleration"
    if driver not in campaign.channels:
        return
    dimension = channel_dimension(driver, campaign.pair)
    for name in campaign.inputs:
        if campaign.unit(name).si != parse_unit(dimension.si).si:
            continue
        peaks = [(e.id, _peak(e.record, driver), abs(e.inputs[name])) for e in measured]
        known = [(id, peak, value) for id, peak, value in peaks if peak > 0 and value > 0]
        # A constant input may be any length of the specimen; an amplitude varies, and the peaks follow it.
        if len({round(np.log(value), 1) for _, _, value in known}) < 2 or len(known) < 3:
            continue
        usual = float(np.median([peak / value for _, peak, value in known]))
        follow = [_is_near(peak / value, usual, SAME) for _, peak, value in known]
        if 2 * sum(follow) <= len(known):
            continue
        for (id, peak, value), follows in zip(known, follow, strict=True):
            # If the records follow the input, all are wrong or none is; otherwise each is judged alone.
            said = mixed(dimension, peak / value if follows else peak / value / usual)
            if said is None or (not follows and not _is_near(usual, 1.0, SAME)):
                continue
            message = (
                f"it goes to {amount(campaign.pair, driver, peak)}, the input {name} is "
                f"{campaign.unit(name).from_si(value):.3g} {campaign.unit(name).text}: are {said[1]} mixed?"
            )
            yield Finding("doubt", id, driver, None, message, "unit")


def _peak(record: Record | None, channel: str) -> float:
    return 0.0 if record is None or channel not in record.channels else float(np.abs(record[channel]).max())
