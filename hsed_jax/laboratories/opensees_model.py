"""A script that shakes a structure in OpenSees: it reads a request in its folder and writes record and quantities there.

It does not use the package, so the Python with openseespy needs nothing else.  Everything is SI.
"""

import bisect
import csv
import json
import math
import runpy
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

ops: Any = import_module("openseespy.opensees")  # an optional extra: its names are known when it runs

_SPECIMEN, _FIRST_LINK = 1, 1_000_001  # tags; a user's own material may use those between
_TOLERANCE = 1e-9
_SUBSTEPS = 20


def main(folder: Path) -> int:
    """Perform the request in the folder; returns the exit status."""
    request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    model = json.loads((folder / "model.json").read_text(encoding="utf-8"))
    with (folder / "ground_motion.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))[1:]
    ground = [[float(cell) for cell in row] for row in rows]
    build(model, ground)
    history, quantities = shake(model, ground, request["record"])
    names = list(request["channels"])
    with (folder / "record.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([repr(sample[name]) for name in names] for sample in history)
    (folder / "quantities.json").write_text(json.dumps(quantities), encoding="utf-8")
    return 0


def build(model: dict, ground: list[list[float]]) -> None:
    """Define the model: point masses on a line, links between them, the specimen, and the motion of the ground."""
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.node(0, 0.0)
    ops.fix(0, 1)
    for number, mass in enumerate(model["masses"], 1):
        ops.node(number, 0.0)
        ops.mass(number, mass)
    define(model["material"])
    ops.element("zeroLength", _SPECIMEN, *model["specimen"], "-mat", _SPECIMEN, "-dir", 1)
    for tag, (first, second, stiffness, damping) in enumerate(model["links"], _FIRST_LINK):
        ops.uniaxialMaterial("Elastic", tag, stiffness, damping)
        ops.element("zeroLength", tag, first, second, "-mat", tag, "-dir", 1)
    time, acceleration = zip(*ground, strict=True)
    ops.timeSeries("Path", 1, "-dt", time[1], "-values", *acceleration)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    unbalance = _TOLERANCE * sum(model["masses"]) * max(map(abs, acceleration))
    ops.constraints("Plain")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.test("NormUnbalance", max(unbalance, 1e-9), 50)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")


def define(material: dict) -> None:
    """Define the specimen's material."""
    if "name" in material:
        ops.uniaxialMaterial(material["name"], _SPECIMEN, *material["values"])
        return
    file, parameters = material["file"], material["parameters"]
    if file.endswith(".py"):
        runpy.run_path(file)["specimen"](ops, _SPECIMEN, **parameters)
        return
    # openseespy has no Tcl interpreter; the commands that define a material are the same.
    import tkinter

    tcl = tkinter.Tcl()
    for name, value in {"tag": _SPECIMEN, **parameters}.items():
        tcl.eval(f"set {name} {value!r}")
    tcl.createcommand("uniaxialMaterial", lambda *words: ops.uniaxialMaterial(*map(_word, words)))
    tcl.call("source", file)


def _word(text: str) -> str | int | float:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def shake(model: dict, ground: list[list[float]], record: dict) -> tuple[list[dict], dict]:
    """Shake the model; returns its history at the times of the record, and peaks and work of all steps."""
    substeps = max(1, math.ceil(record["step"] / model["step"] - 1e-9))
    step = record["step"] / substeps
    force = elongation = energy = 0.0
    peaks = {"force": 0.0, "elongation": 0.0}
    history = [_sample(model, 0.0, ground, energy)]
    for number in range(1, record["samples"]):
        for _ in range(substeps):
            advance(step)
            before, force = force, _force()
            past, elongation = elongation, _elongation(model, ops.nodeDisp)
            energy += 0.5 * (before + force) * (elongation - past)
            peaks["force"] = max(peaks["force"], abs(force))
            peaks["elongation"] = max(peaks["elongation"], abs(elongation))
        history.append(_sample(model, number * record["step"], ground, energy))
    quantities = {
        "peak_force": peaks["force"],
        "peak_elongation": peaks["elongation"],
        "dissipated_energy": energy,
    }
    return history, quantities


def advance(step: float) -> None:
    """One step of the analysis; if Newton's method fails, in small steps with the initial stiffness."""
    if ops.analyze(1, step) == 0:
        return
    for _ in range(_SUBSTEPS):
        if ops.analyze(1, step / _SUBSTEPS) == 0:
            continue
        ops.algorithm("ModifiedNewton", "-initial")
        failed = ops.analyze(1, step / _SUBSTEPS)
        ops.algorithm("Newton")
        if failed:
            sys.exit(f"OpenSees did not converge at t = {ops.getTime():g} s")


def _sample(model: dict, time: float, ground: list[list[float]], energy: float) -> dict[str, float]:
    """Every channel at one instant."""
    shaking = _between(ground, time)
    values = {
        "time": time,
        "ground_acceleration": shaking,
        "elongation": _elongation(model, ops.nodeDisp),
        "elongation_rate": _elongation(model, ops.nodeVel),
        "force": _force() if time else 0.0,
        "energy": energy,
    }
    for mass in range(1, len(model["masses"]) + 1):
        acceleration = ops.nodeAccel(mass, 1) if time else -shaking
        values[f"displacement_{mass}"] = ops.nodeDisp(mass, 1)
        values[f"velocity_{mass}"] = ops.nodeVel(mass, 1)
        values[f"acceleration_{mass}"] = acceleration
        values[f"acceleration_{mass}_absolute"] = acceleration + shaking
    return values


def _force() -> float:
    return ops.eleResponse(_SPECIMEN, "material", 1, "stress")[0]


def _elongation(model: dict, of_node) -> float:
    first, second = model["specimen"]
    return of_node(second, 1) - of_node(first, 1)


def _between(ground: list[list[float]], time: float) -> float:
    right = min(max(bisect.bisect_left(ground, [time]), 1), len(ground) - 1)
    (t0, a0), (t1, a1) = ground[right - 1], ground[right]
    return a0 + (a1 - a0) * (time - t0) / (t1 - t0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
