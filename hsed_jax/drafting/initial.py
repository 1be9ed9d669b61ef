"""A ready study for a campaign of measurements: priors and values from the data, each with a comment on its source."""

import json
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hsed_jax.drafting.floors import floor_count, floors_of
from hsed_jax.errors import UserError
from hsed_jax.measurements import Campaign, characteristics, parse_unit
from hsed_jax.measurements.pairs import check_masses
from hsed_jax.measurements.units import TIME, VELOCITY
from hsed_jax.physics.outputs import is_driver

# Words that YAML reads as something else than a text.
_WORDS = ("y", "n", "yes", "no", "on", "off", "true", "false", "null", ".inf", ".nan")
# Mass of a floor [kg] if it is unknown.
_MASS = 1000.0


_GRAVITY = 9.80665


class Frame(NamedTuple):
    """Known data of a frame: masses of its floors from the lowest up [kg], height of a storey [m]; zero if unknown."""

    masses: tuple[float, ...] = ()
    height: float = 0.0


class _Guess(NamedTuple):
    """A number for the first model, and its source."""

    value: float
    source: str


def text_of_study(
    campaign: Campaign,
    folder: Path,
    output: Path,
    frame: Frame | None = None,
    taken: Sequence[str] = (),
    model: Sequence[str] = (),
) -> str:
    """The text of a study file.

    Arguments:
        campaign: the measurements.
        folder: where they are.
        output: folder of the study; the path to the campaign is written relative to it.
        frame: known data of a shaken frame.
        taken: sources of the campaign, lines for the head of the file.
        model: lines of a model that has no effects, instead of a spring law.

    Raises:
        UserError: the campaign has no completed training experiment, or no data for stiffness and strength; or it was shaken,
            and the pair of the specimen is not elongation and force; or the frame does not fit the sensors.
    """
    pair, frame = campaign.pair, frame or Frame()
    _check_frame(campaign, folder, frame)
    if campaign.protocol == "ground_motion":
        check_masses(str(folder), pair)
    if not len(campaign.train):
        raise UserError(f"{folder}: there is no completed training experiment to start a study from")
    where = os.path.relpath(folder, output.parent)
    histories = any(e.record is not None for e in campaign.train) and any(not is_driver(c) for c in campaign.channels)
    stiffness, strength, mass = _guesses(campaign, folder, frame)
    if campaign.protocol == "displacement" and not histories:
        raise UserError(
            f"{folder}: the protocol is displacement, but no experiment has a record of the {pair.elongation} that was imposed "
            f"and the {pair.force} that was measured"
        )
    lines = [
        f"# A study of {' '.join(campaign.name.split())}, written by `hsed init` from the data in {where}.",
        *(f"# {line}" for line in taken),
        "# Every number below can be changed; the comments give the sources.",
        f"study: {_text(_name(folder))}",
        "seed: 0",
        "",
        *_structure(campaign, stiffness.value, mass, frame),
        *_excitation(campaign),
        *_inputs(campaign),
        *(model or _spring(campaign, stiffness, strength, frame)),
        "",
        "experiments:",
        f"  campaign: {_text(where)}",
        "",
        *_height(frame),
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
        "error: {inflate: true}                      # the residual beyond it counts as error too",
        "",
        "calibration: {seconds: 10}                  # time limit of NUTS, used where importance sampling is unreliable",
        "steps: [calibrate, compare]                 # a diagnosis needs a spring law (model.spring)"
        if model
        else "steps: [calibrate, compare, diagnose, improve]   # find the error, its location and the missing effect",
        "",
    ]
    return "\n".join(lines)


def _spring(campaign: Campaign, stiffness: _Guess, strength: _Guess, frame: Frame) -> list[str]:
    """The spring law that fits the records, with priors around their estimates."""
    # It loads JAX, which a study with another model does not need.
    from hsed_jax.drafting.first_law import residuals

    pair, initial = campaign.pair, stiffness.value + _of_gravity(frame)
    left = residuals(campaign, initial, strength.value)
    of_stiffness = [
        f"    # initial stiffness [{pair.unit('N/m')}]: {_round(stiffness.value)} is the {pair.words(stiffness.source)};",
        "    # within a factor of 4 with 95 %"
        + (", plus the reduction by gravity" if frame.masses and frame.height else ""),
    ]
    of_strength = f"{pair.words(strength.source)}, {_round(strength.value)} {pair.force_unit} (median over experiments)"
    if left is not None and left.is_steel:
        return [
            "model:",
            f"  # fits of the force leave {100 * left.steel:.2g} % of it with this law, "
            f"{100 * left.simplest:.2g} % with bouc_wen",
            "  spring: menegotto_pinto",
            "  parameters:",
            *of_stiffness,
            f"    k: {{lognormal: [{math.log(initial):.3f}, 0.7]}}",
            f"    # yield force [{pair.force_unit}]: about {of_strength};",
            "    # within a factor of 4 with 95 %",
            f"    F_y: {{lognormal: [{math.log(strength.value):.3f}, 0.7]}}",
            "    b: {uniform: [0.0, 0.2]}                # stiffness after yielding over initial stiffness",
            "    R0: {truncated_normal: {loc: 15.0, scale: 20.0, low: 1.0, high: 200.0}}  # sharpness of the first yielding",
            "    cR1: {uniform: [0.0, 0.97]}             # the share of the sharpness that plastic excursions take",
            "    cR2: 0.15                               # the value of most studies",
            *_effects(frame),
        ]
    # Quantities of whole experiments hardly show how sharply a specimen yields.
    is_seen = left is not None
    return [
        "model:",
        "  spring: bouc_wen",
        "  parameters:",
        *of_stiffness,
        f"    A: {{lognormal: [{math.log(initial):.3f}, 0.7]}}",
        f"    # stiffness over strength [{pair.unit('1/m')}]: the strength A/beta is about {of_strength};",
        "    # within a factor of 4 with 95 %",
        f"    beta: {{lognormal: [{math.log(initial / strength.value):.3f}, 0.7]}}",
        "    gamma: 0.0                              # symmetric loading and unloading: the usual first assumption",
        "    n: 1.0                                  # the smoothest yielding: the usual first assumption",
        *_effects(frame, is_seen),
    ]


def _name(folder: Path) -> str:
    return "".join(c if c.isalnum() or c in "_.-" else "_" for c in folder.resolve().name)


def _check_frame(campaign: Campaign, folder: Path, frame: Frame) -> None:
    """Refuse masses and a height that do not fit the measurements.

    Raises:
        UserError: with the allowed values.
    """
    if not frame.masses and not frame.height:
        return
    if not all(mass > 0 and math.isfinite(mass) for mass in frame.masses) or not 0 <= frame.height < math.inf:
        raise UserError("masses and the height of a storey are greater than zero")
    if campaign.protocol == "displacement":
        if frame.masses:
            raise UserError(f"{folder}: the elongation was imposed on the specimen alone; masses are of a shaken frame")
        if campaign.pair.elongation_unit != "m":
            raise UserError(
                f"{folder}: --height is that of an elongation; here the {campaign.pair.elongation} is measured"
            )
        return
    if frame.height and not frame.masses:
        raise UserError("--height needs --masses: gravity acts on the drift by the weight above it")
    if (count := floor_count(campaign)) > 1 and len(frame.masses) != count:
        raise UserError(
            f"{folder}: sensors are on {count} floors, and {len(frame.masses)} masses are given; give one for each"
        )


def _of_gravity(frame: Frame) -> float:
    """The reduction of the stiffness of the lowest storey by gravity [N/m]: weight above it over its height."""
    return sum(frame.masses) * _GRAVITY / frame.height if frame.masses and frame.height else 0.0


def _effects(frame: Frame, has_sharpness: bool = False) -> list[str]:
    lines: list[str] = []
    if has_sharpness:
        lines.append(
            "    yield_sharpness: {}                     # how sharply it yields is calibrated: the exponent is n plus this"
        )
    if reduction := _of_gravity(frame):
        lines += [
            f"    # P-Delta: the weight of all floors, {_round(sum(frame.masses) * _GRAVITY)} N, over the height of the storey, "
            f"{frame.height:g} m, as a",
            "    # stiffness that is known and not calibrated; where masses change, it changes with them",
            f"    hardening: {{k: {-reduction:.4g}}}",
        ]
    if not lines:
        return ["  effects: {}                               # none assumed; `hsed effects` lists the catalogue"]
    return [
        "  effects:                                  # none assumed beside these; `hsed effects` lists the catalogue",
        *lines,
    ]


def _height(frame: Frame) -> list[str]:
    if not frame.height:
        return []
    return [f"measurements: {{height: {frame.height:g}}}              # m: hsed check judges the drift ratio by it", ""]


def _guesses(campaign: Campaign, folder: Path, frame: Frame) -> tuple[_Guess, _Guess, _Guess]:
    """Stiffness [N/m] and strength [N] of the specimen, and the mass of a floor [kg].

    Raises:
        UserError: stiffness and strength cannot be estimated.
    """
    found = characteristics(campaign)
    stiffness = _Guess(
        found.stiffness, "slope of the first loading up to a tenth of the largest elongation, median over experiments"
    )
    if not math.isfinite(found.stiffness):
        stiffness = _Guess(2 * found.force / found.elongation, "twice the largest force over the largest elongation")
    strength = _Guess(found.force, "the largest force")
    if all(math.isfinite(guess.value) and guess.value > 0 for guess in (stiffness, strength)):
        return stiffness, strength, _given(frame) or _mass(campaign, stiffness.value)
    is_of_all = len(frame.masses) == floor_count(campaign)
    floors = floors_of(campaign, frame.masses if is_of_all else ()) if campaign.protocol == "ground_motion" else None
    if floors is None or not floors.strength > 0:
        raise UserError(
            f"{folder}: neither force and elongation nor the motion of a floor on a shake table were measured, so stiffness "
            "and strength of the specimen are unknown; write the study by hand (configs/ has examples)"
        )
    mass = _given(frame) or _Guess(
        _MASS, "a placeholder, because no force was measured; A and the strength are proportional to it"
    )
    if found.force > 0 and not frame.masses:
        mass = _Guess(found.force / floors.strength, "largest force over largest accelerations")
    way = f"stiffness of storeys whose first frequency is {floors.frequency:.3g} Hz, that of the largest response at the top"
    return (
        _Guess(mass.value * floors.stiffness, way),
        _Guess(mass.value * floors.strength, "the masses times their largest accelerations"),
        mass,
    )


def _given(frame: Frame) -> _Guess | None:
    """The mean mass of the floors that were given."""
    return _Guess(float(np.mean(frame.masses)), "as given") if frame.masses else None


def _structure(campaign: Campaign, stiffness: float, mass: _Guess, frame: Frame) -> list[str]:
    if campaign.protocol == "displacement":
        return [f"# structure: none, the {campaign.pair.elongation} was imposed on the specimen alone", ""]
    count = len(frame.masses) or floor_count(campaign)
    masses = [f"{value:.6g}" for value in frame.masses] or [f"{mass.value:.4g}"] * count
    springs = [f"{{between: [{i}, {i + 1}], stiffness: {stiffness:.4g}}}" for i in range(1, count)]
    guess = "one mass on the specimen" if count == 1 else f"{count} equal storeys, the specimen the lowest"
    return [
        f"structure:                                  # a guess: {guess}; describe yours here",
        f"  masses: [{', '.join(masses)}]  # kg: {mass.source}",
        "  # linear springs, such as {between: [ground, 1], stiffness: 4.0e5}",
        f"  springs: [{', '.join(springs)}]",
        "  specimen: {between: [ground, 1]}",
        "  # damping of the structure besides the specimen: 2 % is common for bare frames",
        f"  damping: {{modal: 0.02, specimen_stiffness: {stiffness:.4g}}}",
        "",
    ]


def _mass(campaign: Campaign, stiffness: float) -> _Guess:
    """Mass of one degree of freedom, from force and absolute acceleration, or from the dominant frequency."""
    for experiment in campaign.train:
        record = experiment.record
        if record is None:
            continue
        force, absolute = record.channels.get("force"), record.channels.get("acceleration_1_absolute")
        if force is not None and absolute is not None and float(absolute @ absolute) > 0:
            mass = -float(force @ absolute) / float(absolute @ absolute)
            if mass > 0:
                return _Guess(mass, f"regression of force on absolute acceleration in {experiment.id}")
        elongation = record.channels.get("elongation")
        if elongation is not None and len(record) > 16 and np.ptp(elongation) > 0:
            turns = np.count_nonzero(np.diff(np.sign(elongation - elongation.mean())) != 0)
            frequency = max(turns, 2) / 2 / float(np.ptp(record.time))
            return _Guess(stiffness / (2 * math.pi * frequency) ** 2, f"from the dominant frequency of {experiment.id}")
    return _Guess(stiffness / (2 * math.pi) ** 2, "for a frequency of 1 Hz, a placeholder")


def _excitation(campaign: Campaign) -> list[str]:
    """A ground motion for experiments that bring none."""
    if campaign.protocol == "displacement" or all(
        e.record is not None and any(map(is_driver, e.record.channels)) for e in campaign.completed
    ):
        return []
    values = {}
    for name, dimension, otherwise in (("V_P", VELOCITY, 1.0), ("T_P", TIME, 1.0)):
        fitting = [i for i in campaign.inputs if campaign.unit(i).si == parse_unit(dimension.si).si]
        values[name] = name if name in fitting else fitting[0] if len(fitting) == 1 else otherwise
    guessed = [name for name, value in values.items() if not isinstance(value, str)]
    source = f"{' and '.join(guessed)}: placeholders" if guessed else "a name refers to an input"
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
