"""Runs, in a copy of the package, what a test has added to the copy, and prints what came of it as JSON."""

import json
import runpy
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import hsed_jax as hx
from hsed_jax.discovery.grammar import SHAPES
from hsed_jax.discovery.places import Motion, places, values
from hsed_jax.measurements import Channel
from hsed_jax.models.opensees.simulated import Simulated
from hsed_jax.physics.effects.coordinates import COORDINATES
from hsed_jax.physics.effects.free_function import SLOTS
from hsed_jax.physics.scales import Scales

HERE = Path(__file__).parent
AMPLITUDE, STIFFNESS = 0.02, 2.0e6
CYCLES = {
    "study": "cycles",
    "excitation": {"imposed": {"amplitudes": [AMPLITUDE], "cycles": 1, "rate": 0.01}},
    "experiments": {"virtual": {"parameters": {"k": 1.0e6}}},
    "scales": {"force": 1.0e3, "elongation": 0.01, "rate": 0.01, "energy": 10.0},
}
SHAKEN = {
    "study": "shaken",
    "structure": {
        "masses": [1.0e4], "specimen": {"between": ["ground", 1]}, "damping": {"modal": 0.05, "specimen_stiffness": 1e6},
    },
    "model": {"spring": "elastic", "parameters": {"k": {"uniform": [1e5, 9e6]}}},
    "experiments": {"virtual": {"parameters": {"k": 1.0e6}}},
}  # fmt: skip


def refused(**changes: object) -> str:
    """The message about a study with these keys."""
    try:
        hx.load_study(hx.load_study(HERE / "study.yaml").model_dump(exclude_none=True) | changes)
    except hx.UserError as error:
        return str(error)
    return "nothing"


def cycled(effects: dict) -> float:
    """Peak force of an elastic spring with effects over a cycle."""
    model = {"spring": "elastic", "parameters": {"k": {"uniform": [1e5, 9e6]}}, "effects": effects}
    study = hx.load_study({**CYCLES, "model": model, "quantities": ["peak_force"]})
    return float(hx.simulate(study, {}, {"k": STIFFNESS}, channels=()).quantities["peak_force"])


def plastic() -> list[float]:
    """Forces of the material at its yield elongation and at twice that; none without OpenSees."""
    try:
        return Simulated("ElasticPP")({"k": 2.0e6, "F_y": 1e3}, {"elongation": [5e-4, 1e-3]})["force"].tolist()
    except hx.UserError:
        return []


def shaken(excitation: dict) -> float:
    """Peak force of an oscillator."""
    study = hx.load_study({**SHAKEN, "excitation": excitation})
    return float(hx.simulate(study, {}, {"k": 1e6}, channels=()).quantities["peak_force"])


def largest_rate(motion: Path) -> list[float]:
    """The quantity that was added, and what it is by the history."""
    study = hx.load_study({**SHAKEN, "excitation": {"recorded": {"file": str(motion)}}, "quantities": ["peak_rate"]})
    response = hx.simulate(study, {}, {"k": 1e6}, channels=("elongation_rate",))
    return [float(response.quantities["peak_rate"]), float(np.abs(response.channels["elongation_rate"]).max())]


def ran(output: Path) -> dict[str, object]:
    """A run that has a law, a laboratory, an acquisition and a sampler that were added."""
    study = hx.load_study(HERE / "study.yaml")
    run = hx.run(study, output, progress=False)
    return {
        "k": run.calibration.map["k"],
        "chosen": run.conduct.steps[0]["cube"],
        "sampler": run.calibration.fit.chains.sampler,
        "printed": str(run.calibration),
        "title": str(study),
        "report": (output / "report.html").read_text(encoding="utf-8"),
        "page": runpy.run_path(str(HERE / "docs_parts.py"))["page"](),
        "messages": [
            refused(experiments={"bench": {"stiffness": -1.0}}),
            refused(experiments={"bensh": {}}),
            refused(design={"acquisition": "midle"}),
            refused(calibration={"sampler": "rename"}),
            refused(model={"spring": "double", "parameters": {"k": 1.0}}),
        ],
    }


def coordinate() -> dict[str, object]:
    """A coordinate along a record, and whether a discovery looks at it."""
    u = np.array([0.0, 0.01, 0.02])
    motion = Motion(np.array([0.0, 0.1, 0.2]), u, np.full(3, 0.1), 1e3 * u)
    return {
        "values": values("halved", 1.0, motion, Scales(elongation=0.01)).tolist(),
        "places": sum("halved" in place.of for place in places(SLOTS, has_time=True)),
        "words": COORDINATES["halved"].words,
    }


def main() -> None:
    """Try everything."""
    time = np.arange(0.0, 4.0, 0.01)
    motion = HERE / "motion.csv"
    np.savetxt(motion, np.c_[time, np.sin(8 * time)], delimiter=",", header="time,ground_acceleration", comments="")
    channels = {
        "elongation": Channel("elongation", "1/m"),
        "force": Channel("force", "N*m"),
    }
    campaign = hx.Campaign("bending", "displacement", channels={"time": Channel("time", "s"), **channels})
    found = {
        "package": hx.__file__,
        "run": ran(Path(sys.argv[1])),
        "effect": cycled({"steadfast": {"delta": 1.0}}),
        "form": cycled({"cubic_stiffness": {"form": "fifth", "delta": 1.0}}),
        "quantity": largest_rate(motion),
        "excitation": [
            shaken({"repeated": {"file": str(motion)}}), shaken({"recorded": {"file": str(motion), "scale": 2.0}}),
        ],
        "coordinate": coordinate(),
        "material": plastic(),
        "shape": SHAPES[-1].at(jnp.asarray([2.0]), ()).tolist(),
        "pair": campaign.pair.elongation,
    }  # fmt: skip
    print(json.dumps(found))


if __name__ == "__main__":
    main()
