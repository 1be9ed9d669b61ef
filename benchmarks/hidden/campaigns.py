"""Campaigns with a hidden effect, as a laboratory would hand them in, and the truth in another place.

`make(Case(...), folder, truth)` writes campaign.yaml, experiments.csv, records/ and study.yaml into `folder`, and the answer as
JSON into `truth` (noise-free histories beside it, .npz).  No code of `hsed_jax` is used.
"""

import csv
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import yaml
from scipy.signal import lfilter

from . import opensees
from .cases import Case, Hidden, Measured, Plan, draw, scales_of
from .catalogue import FAMILIES
from .sensors import Program, Reading
from .specimen import DURATION, Frame, Scales, Specimen, pull, shake

SAMPLES, SPACING = 400, 0.025  # of the records: number, and distance [s]
FINE, COARSE = 1.0e-3, 2.5e-3  # steps of the final runs and of the search [s]
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")


class TooSmall(ValueError):
    """At its physical bound the effect changes the response by less than half of what was asked."""


def respond(plan: Plan, deltas, scales: Scales, experiments: int, step: float) -> Measured:
    """Readings of the first `experiments` experiments, without noise.

    Arguments:
        plan: what was drawn.
        deltas: amplitudes, shape (effects, sizes).
        scales: characteristic values that the effects use.
        experiments: how many.
        step: of the integration [s].
    """
    deltas = np.atleast_2d(np.asarray(deltas, float))
    sizes = deltas.shape[1]
    lanes = np.repeat(deltas, experiments, axis=1)
    x, y = np.tile(plan.inputs[:experiments], (sizes, 1)).T
    of = {place: [] for place in ("specimen", "frame", "sensor", "opensees")}
    for item, delta in zip(plan.hidden, lanes, strict=False):
        of[item.formula.place].append((item, delta))
    specimen = Specimen(np.full(x.size, plan.A), np.full(x.size, plan.beta), scales)
    specimen.acts = [
        (item.formula.act, {"delta": delta, **item.drawn}, item.formula.states) for item, delta in of["specimen"]
    ]
    unit = scales.elongation / scales.rate
    if plan.kind == "component":
        program = Program(x, y, DURATION)
        for item, delta in of["sensor"]:
            if item.formula.drive is not None:
                is_time = item.formula.physical[1] == "s"
                program = item.formula.drive(program, delta * unit if is_time else delta)
        run = pull(specimen, program, step)
        u, force = program.recorded(run.time[:, None]), run.force
        for item, delta in of["opensees"]:
            force = opensees.pull(item.formula.act, u, plan.A, plan.beta, delta, item.drawn, scales)
    else:
        frame = Frame.nominal()
        for item, delta in of["frame"]:
            frame = item.formula.act(frame, delta)
        run = shake(specimen, frame, x, y, step)
        u, force = run.u, run.force
    reading = Reading(run.time, u, force, scales.force, unit)
    for number, (item, delta) in enumerate(of["sensor"]):
        if item.formula.drive is None or plan.kind != "component":
            reading = item.formula.act(reading, delta, np.random.default_rng([plan.seed, 2, number]))
    every = round(SPACING / step)
    kept = slice(0, SAMPLES * every, every)
    shape = (-1, sizes, experiments)
    with np.errstate(all="ignore"):
        energy = np.sum(0.5 * (reading.force[1:] + reading.force[:-1]) * np.diff(reading.u, axis=0), axis=0)
    quantities = np.stack([np.abs(reading.force).max(0), np.abs(reading.u).max(0), energy])
    return Measured(
        run.time[kept], reading.u[kept].reshape(shape), reading.force[kept].reshape(shape), quantities.reshape(shape)
    )


def change(plan: Plan, measured: Measured) -> np.ndarray:
    """Relative change of the response against size 0, which has no effect, shape (sizes,); NaN where it diverged."""
    with np.errstate(all="ignore"):
        if plan.kind == "quantities":
            return np.sqrt(np.mean((measured.quantities / measured.quantities[:, :1] - 1) ** 2, axis=(0, 2)))
        # The elongation of a component test is imposed: only its force responds.
        channels = [measured.force] if plan.kind == "component" else [measured.force, measured.u]
        squares = [np.mean((c - c[:, :1]) ** 2, axis=(0, 2)) / np.mean(c[:, :1] ** 2) for c in channels]
        return np.sqrt(np.mean(squares, axis=0))


def amplitude(plan: Plan, target: float, scales: Scales) -> tuple[float, Scales]:
    """The amplitude of the plan's one effect that changes the response as much as asked, and the scales with it.

    Raises:
        TooSmall: not half of it is reached at the effect's cap.
    """
    item, train = plan.hidden[0], plan.train
    cap = item.formula.largest

    def trial(sizes, scales):
        deltas = item.sign * np.concatenate([[0.0], sizes])
        measured = respond(plan, deltas, scales, len(plan.inputs), COARSE)
        return sizes, change(plan, measured)[1:], measured

    sizes, changes, measured = trial(np.geomspace(1e-5 * cap, cap, 24), scales)
    for _ in range(2):  # the scales follow the size
        known = np.isfinite(changes)
        reached = np.flatnonzero(known & (changes >= target))
        if reached.size:
            last = int(reached[0])
        else:
            last = int(np.argmax(np.where(known, changes, -1.0)))
            if changes[last] < 0.5 * target:
                raise TooSmall(
                    f"{item.effect} ({item.name}), {plan.kind}: at most a change of {changes[last]:.3g} at its bound "
                    f"(amplitude {sizes[last]:.3g}), asked for {target:g}"
                )
        old, scales = scales, measured.scales(last + 1, train)
        if not reached.size or last == 0:
            return float(item.sign * sizes[last]), scales
        # The same physical amplitudes in the new scales.
        one = item.formula.physical[2]
        first, second = np.array([sizes[last - 1], sizes[last]]) * one(old) / one(scales)
        sizes, changes, measured = trial(np.linspace(0.9 * first, min(1.1 * second, cap), 5), scales)
    upto = int(np.argmax(changes >= target)) if np.any(changes >= target) else len(sizes) - 1
    upto = max(upto, 1)
    found = np.interp(target, changes[upto - 1 : upto + 1], sizes[upto - 1 : upto + 1])
    return float(item.sign * found), scales


def make(case: Case, folder: Path, truth: Path) -> None:
    """Write the campaign and its study into `folder`, and what is hidden in it into `truth` (JSON).

    Raises:
        ValueError: an effect that cannot show in this kind of campaign, or is not known.
        TooSmall: the effect cannot be as large as asked.
    """
    plan = draw(case)
    count = len(plan.inputs)
    alone = [Plan(plan.kind, plan.inputs, plan.A, plan.beta, (h,), plan.seed, plan.train) for h in plan.hidden]
    scales = respond(plan, np.zeros((0, 1)), Scales(1, 1, 1, 1), plan.train, COARSE).scales(0, plan.train)
    found = [amplitude(one, case.size, scales) for one in alone]
    deltas = np.array([delta for delta, _ in found])
    if len(found) == 1:
        scales = found[0][1]
    elif found:
        # Dimensionless amplitudes, each in its own scales, for the scales of both; the physical ones stay.
        joint = respond(plan, deltas[:, None], scales, plan.train, COARSE).scales(0, plan.train)
        units = [h.formula.physical[2] for h in plan.hidden]
        deltas = np.array([d * one(own) / one(joint) for (d, own), one in zip(found, units, strict=True)])
        scales = joint
    for attempt in range(3):
        table = np.stack([0 * deltas, deltas], axis=1) if found else np.zeros((0, 1))
        measured = respond(plan, table, scales, count, FINE)
        together = float(change(plan, measured)[-1])
        # Of a pair each alone has its size; one effect is corrected for what the coarse step did to it.
        if len(found) != 1 or abs(together / case.size - 1) < 0.05 or attempt == 2:
            break
        cap = plan.hidden[0].formula.largest
        deltas = np.clip(deltas * case.size / max(together, 1e-12), -cap, cap)
    if len(alone) == 1:
        reached = [together]
    else:
        reached = [
            float(change(one, respond(one, row, scales, count, COARSE))[-1])
            for one, row in zip(alone, table, strict=True)
        ]
    measured = measured.sampled(case.every)
    noisy = _noisy(measured, plan, case, np.random.default_rng([case.seed, 3]))
    _write_campaign(case, plan, noisy, Path(folder))
    observed = scales_of(noisy["time"], noisy["u"][:, : plan.train], noisy["force"][:, : plan.train])
    _write_truth(case, plan, deltas, reached, together, scales, observed, measured, Path(truth))


def coloured(random: np.random.Generator, shape: tuple[int, ...], memory: float) -> np.ndarray:
    """Gaussian noise of variance one along axis 0, stationary, each sample correlated by `memory` with the one before."""
    white = random.standard_normal(shape)
    if memory == 0:
        return white
    white[1:] *= np.sqrt(1 - memory**2)
    return lfilter([1.0], [1.0, -memory], white, axis=0)


def _noisy(measured: Measured, plan: Plan, case: Case, random) -> dict[str, np.ndarray]:
    """What the laboratory reads, by name: records (samples, experiments), quantities (3, experiments)."""

    def disturbed(values):
        return values + case.noise * np.sqrt(np.mean(values**2, axis=0)) * coloured(random, values.shape, case.memory)

    u, force, q = measured.u[:, -1], measured.force[:, -1], measured.quantities[:, -1]
    return {
        "time": measured.time,
        # Of a component test the elongation is the command, known exactly.
        "u": u if plan.kind == "component" else disturbed(u),
        "force": disturbed(force),
        "quantities": q * (1 + case.noise * random.standard_normal(q.shape)),
    }


def _write_campaign(case: Case, plan: Plan, noisy: dict, folder: Path) -> None:
    (folder / "records").mkdir(parents=True, exist_ok=True)
    noise = {"noise": {"relative": case.noise}} if case.noise else {}
    is_component, is_quantities = plan.kind == "component", plan.kind == "quantities"
    declared: dict = {
        "name": folder.name,
        "protocol": "displacement" if is_component else "ground_motion",
        "inputs": {} if is_component else {"V_P": "m/s", "T_P": "s"},
    }
    if is_quantities:
        units = dict(zip(QUANTITIES, ("kN", "mm", "kJ"), strict=True))
        declared["quantities"] = {name: {"column": name, "unit": unit, **noise} for name, unit in units.items()}
    else:
        declared["channels"] = {
            "time": {"column": "t", "unit": "s"},
            "elongation": {"column": "du", "unit": "mm", **({} if is_component else noise)},
            "force": {"column": "F", "unit": "kN", **noise},
        }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(declared, sort_keys=False))
    with (folder / "experiments.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        names = ["amplitude_m", "frequency_Hz"] if is_component else ["V_P", "T_P"]
        writer.writerow(["id", *names, "split", *(QUANTITIES if is_quantities else [])])
        for i, row in enumerate(plan.inputs):
            values = noisy["quantities"][:, i] * [1e-3, 1e3, 1e-3] if is_quantities else []
            split = "train" if i < plan.train else "test"
            writer.writerow([_label(i), *(repr(float(v)) for v in row), split, *(f"{v:.9g}" for v in values)])
            if not is_quantities:
                record = np.column_stack([noisy["time"], 1e3 * noisy["u"][:, i], 1e-3 * noisy["force"][:, i]])
                target = folder / "records" / f"{_label(i)}.csv"
                np.savetxt(target, record, fmt="%.9g", delimiter=",", header="t,du,F", comments="")
    (folder / "study.yaml").write_text(yaml.safe_dump(_study(case, plan, folder.name), sort_keys=False))


def _study(case: Case, plan: Plan, name: str) -> dict:
    study: dict = {"study": name, "seed": case.seed}
    if plan.kind != "component":
        study["structure"] = {
            "masses": [8.0e3, 9.0e3],
            "springs": [{"between": ["ground", 1], "stiffness": 4.0e5}, {"between": [2, "ground"], "stiffness": 1.0e6}],
            "specimen": {"between": [1, 2]},
            "damping": {"modal": 0.05, "specimen_stiffness": 5.0e5},
        }
        study["excitation"] = {
            "near_fault_pulse": {"V_P": "V_P", "T_P": "T_P", "gamma": 2.0, "nu": 0.1},
            "duration": DURATION,
        }
        study["inputs"] = {
            "V_P": {"uniform": [1.5, 3.0], "unit": "m/s"},
            "T_P": {"uniform": [0.5, 1.5], "unit": "s"},
        }
    priors = {"A": {"uniform": [2.0e5, 9.0e5]}, "beta": {"uniform": [0.4, 2.5]}, "gamma": 0.0, "n": 1.0}
    study["model"] = {"spring": "bouc_wen", "parameters": priors}
    study["experiments"] = {"campaign": "."}
    study["observe"] = "quantities" if plan.kind == "quantities" else "histories"
    if plan.kind == "quantities":
        study["quantities"] = list(QUANTITIES)
    study["steps"] = ["calibrate", "compare"]
    return study


def _write_truth(case, plan, deltas, reached, together, used, observed, measured, path) -> None:
    effects = []
    for item, delta, alone in zip(plan.hidden, deltas, reached, strict=True):
        physical = {}
        for key, value in {"delta": float(delta), **item.drawn}.items():
            name, unit, one = item.formula.physical if key == "delta" else item.formula.also.get(key, (key, "1", None))
            physical[name] = {"value": value * (one(used) if one else 1.0), "unit": unit}
            # What the amplitude is in units of the measured campaign's own scales, which the package sees.
            physical[name]["dimensionless"] = value * (one(used) / one(observed) if one else 1.0)
        effects.append(
            {"effect": item.effect, "family": FAMILIES[item.effect], "formula": item.name, "place": item.formula.place}
            | {"change": alone, "parameters": physical, "description": _described(item)}
        )
    content = {
        "case": asdict(case),
        "effects": effects,
        "deltas": [float(delta) for delta in deltas],
        "names": [e["effect"] for e in effects],
        "families": [e["family"] for e in effects],
        "A": plan.A,
        "beta": plan.beta,
        "change": together if plan.hidden else 0.0,
        "scales": {"used": used._asdict(), "measured": observed._asdict()},
        "noise_free": path.with_suffix(".npz").name,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n")
    ids = np.array([_label(i) for i in range(len(plan.inputs))])
    q = measured.quantities[:, -1]
    np.savez_compressed(
        path.with_suffix(".npz"), id=ids, time=measured.time, elongation=measured.u[:, -1], force=measured.force[:, -1],
        quantities=q, plain_elongation=measured.u[:, 0], plain_force=measured.force[:, 0],
    )  # fmt: skip


def _described(item: Hidden) -> str:
    if item.formula.place == "opensees":
        return f"OpenSees materials, {item.formula.act}"
    return item.formula.act.__doc__ or ("as in the catalogue" if item.name == "same" else "")


def _label(i: int) -> str:
    return f"E{i + 1:02d}"
