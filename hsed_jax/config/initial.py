"""A ready study for a campaign of measurements: priors and values from the data, each with a comment that says from where."""

import json
import math
import os
import re
from pathlib import Path

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, characteristics, parse_unit
from hsed_jax.measurements.units import TIME, VELOCITY

# Words that YAML reads as something else than a text.
_WORDS = ("y", "n", "yes", "no", "on", "off", "true", "false", "null", ".inf", ".nan")


def initial_study(campaign: Campaign, folder: Path, output: Path) -> str:
    """The text of a study file.

    Arguments:
        campaign: the measurements.
        folder: where they are.
        output: where the study will be; the path to the campaign is written relative to it.

    Raises:
        UserError: the campaign has no completed training experiment, or nothing that tells stiffness and strength.
    """
    if not len(campaign.train):
        raise UserError(f"{folder}: there is no completed training experiment to start a study from")
    where = os.path.relpath(folder, output.parent)
    found = characteristics(campaign)
    histories = any(e.record is not None for e in campaign.train) and any(
        c not in ("time", "ground_acceleration") for c in campaign.channels
    )
    force, elongation = found.force, found.elongation
    stiffness = found.stiffness
    source = "slope of the first loading up to a tenth of the largest elongation, median over experiments"
    if not math.isfinite(stiffness):
        stiffness, source = 2 * force / elongation, "twice the largest force over the largest elongation"
    if not (math.isfinite(stiffness) and math.isfinite(force) and stiffness > 0 and force > 0):
        raise UserError(
            f"{folder}: force and elongation were not both measured, so nothing tells the specimen's stiffness and "
            "strength; write the study by hand (configs/ has examples)"
        )
    if campaign.protocol == "displacement" and not histories:
        raise UserError(
            f"{folder}: the protocol is displacement, but no experiment has a record of the elongation that was imposed "
            "and the force that was measured"
        )
    lines = [
        f"# A study of {' '.join(campaign.name.split())}, written by `hsed init` from the data in {where}.",
        "# Every number below can be changed; the comments say where it comes from.",
        f"study: {_text(_name(folder))}",
        "seed: 0",
        "",
        *_structure(campaign, stiffness),
        *_excitation(campaign),
        *_inputs(campaign),
        "model:",
        "  spring: bouc_wen",
        "  parameters:",
        f"    # initial stiffness [N/m]: {_round(stiffness)} is the {source};",
        "    # within a factor of 4 with 95 %",
        f"    A: {{lognormal: [{math.log(stiffness):.3f}, 0.7]}}",
        f"    # stiffness over strength [1/m]: the strength A/beta is about the largest force, {_round(force)} N (median over",
        "    # experiments); within a factor of 4 with 95 %",
        f"    beta: {{lognormal: [{math.log(stiffness / force):.3f}, 0.7]}}",
        "    gamma: 0.0                              # symmetric loading and unloading: the usual first assumption",
        "    n: 1.0                                  # the smoothest yielding: the usual first assumption",
        "  effects: {}                               # none assumed; `hsed effects` lists the catalogue",
        "",
        "experiments:",
        f"  campaign: {_text(where)}",
        "",
        f"observe: {'histories' if histories else 'quantities'}",
    ]
    if not histories:
        lines.append(f"quantities: [{', '.join(campaign.quantities)}]")
    declared = [c for c in (campaign.channels if histories else campaign.quantities).values() if c.noise is not None]
    if declared:
        lines.append(f"# as the campaign declares it for {', '.join(c.name for c in declared)}; inferred otherwise")
    else:
        lines.append("# the campaign declares no noise, so it is inferred from the residual, per output")
    lines += [
        "error: {inflate: true}                      # what the model leaves beyond it counts as error, too",
        "",
        "steps: [calibrate, compare, diagnose, improve]   # how wrong, where, which effect is missing; add it",
        "",
    ]
    return "\n".join(lines)


def _name(folder: Path) -> str:
    return "".join(c if c.isalnum() or c in "_.-" else "_" for c in folder.resolve().name)


def _structure(campaign: Campaign, stiffness: float) -> list[str]:
    if campaign.protocol == "displacement":
        return ["# structure: none, the elongation was imposed on the specimen alone", ""]
    mass, source = _mass(campaign, stiffness)
    return [
        "structure:                                  # a guess: one mass on the specimen; describe yours here",
        f"  masses: [{mass:.4g}]                      # kg: {source}",
        "  springs: []                               # linear springs, such as {between: [ground, 1], stiffness: 4.0e5}",
        "  specimen: {between: [ground, 1]}",
        "  # damping of the structure besides the specimen: 2 % is common for bare frames",
        f"  damping: {{modal: 0.02, specimen_stiffness: {stiffness:.4g}}}",
        "",
    ]


def _mass(campaign: Campaign, stiffness: float) -> tuple[float, str]:
    """Mass of one degree of freedom, from force and absolute acceleration, or from the dominant frequency."""
    for experiment in campaign.train:
        record = experiment.record
        if record is None:
            continue
        force, absolute = record.channels.get("force"), record.channels.get("acceleration_1_absolute")
        if force is not None and absolute is not None and float(absolute @ absolute) > 0:
            mass = -float(force @ absolute) / float(absolute @ absolute)
            if mass > 0:
                return mass, f"regression of force on absolute acceleration in {experiment.id}"
        elongation = record.channels.get("elongation")
        if elongation is not None and len(record) > 16 and np.ptp(elongation) > 0:
            turns = np.count_nonzero(np.diff(np.sign(elongation - elongation.mean())) != 0)
            frequency = max(turns, 2) / 2 / float(np.ptp(record.time))
            return stiffness / (2 * math.pi * frequency) ** 2, f"from the dominant frequency of {experiment.id}"
    return stiffness / (2 * math.pi) ** 2, "for a frequency of 1 Hz, a mere placeholder"


def _excitation(campaign: Campaign) -> list[str]:
    """A ground motion for experiments that bring none."""
    if campaign.protocol == "displacement" or all(
        e.record is not None and "ground_acceleration" in e.record.channels for e in campaign.completed
    ):
        return []
    values = {}
    for name, dimension, otherwise in (("V_P", VELOCITY, 1.0), ("T_P", TIME, 1.0)):
        fitting = [i for i in campaign.inputs if campaign.unit(i).si == parse_unit(dimension.si).si]
        values[name] = name if name in fitting else fitting[0] if len(fitting) == 1 else otherwise
    guessed = [name for name, value in values.items() if not isinstance(value, str)]
    source = f"{' and '.join(guessed)}: mere placeholders" if guessed else "a name refers to an input"
    period = values["T_P"]
    longest = max(e.inputs[period] for e in campaign.experiments) if isinstance(period, str) else float(period)
    return [
        "excitation:                                 # no ground_acceleration was recorded; describe yours here",
        "  near_fault_pulse:",
        f"    V_P: {_text(values['V_P'])}                                # {source}",
        f"    T_P: {_text(values['T_P'])}",
        f"  duration: {math.ceil(6 * longest)}.0                             # s: six times the longest T_P",
        "",
    ]


def _inputs(campaign: Campaign) -> list[str]:
    if not campaign.inputs:
        return []
    lines = ["inputs:                                     # ranges of the experiments that were made"]
    for name in campaign.inputs:
        unit = campaign.unit(name)
        values = np.asarray(unit.from_si(np.asarray([e.inputs[name] for e in campaign.experiments])))
        low, high = float(values.min()), float(values.max())
        if low == high:
            low, high = low - abs(low or 1.0) / 2, high + abs(high or 1.0) / 2
        lines.append(f"  {_text(name)}: {{uniform: [{low:.6g}, {high:.6g}], unit: {_text(unit.text)}}}")
    return [*lines, ""]


def _text(value: str | float) -> str:
    """A text as YAML reads it back: in quotes unless it is a plain word."""
    if not isinstance(value, str) or (
        re.fullmatch(r"[A-Za-z_./][\w./ ^*-]*", value, re.ASCII) and value.lower() not in _WORDS
    ):
        return str(value)
    return json.dumps(value, ensure_ascii=False)


def _round(value: float) -> str:
    return f"{value:.3g}"
