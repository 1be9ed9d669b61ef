"""A calibrated material of OpenSees: its command, and the check of its script along a test against the simulation.

The script has the command of the simulation in this package, but uses an analysis of a model. The agreement of the forces
depends on the material and on the version of OpenSees. Therefore the script is run.
"""

import json
import math
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hsed_jax.drafts import write_whole
from hsed_jax.errors import UserError
from hsed_jax.exports.calibrated import Calibrated
from hsed_jax.exports.counterparts import Command
from hsed_jax.laboratories.opensees import interpreter
from hsed_jax.models.function import FunctionModel
from hsed_jax.models.opensees.simulated import Simulated, finely
from hsed_jax.models.opensees.workers import workers
from hsed_jax.study.opensees_study import OpenSeesMechanics, OpenSeesSimulation

# Longest time of the script along one test [s].
_TIMEOUT = 600.0


@dataclass(frozen=True)
class Test:
    """A test for the check of the script.

    Attributes:
        path: elongations from zero [m], (N,), as OpenSees follows them.
        force: of the simulation [N], (N,).
    """

    path: np.ndarray
    force: np.ndarray

    @property
    def csv(self) -> str:
        """The text of `protocol.csv`."""
        rows = (f"{u!r},{f!r}" for u, f in zip(self.path.tolist(), self.force.tolist(), strict=True))
        return "\n".join(["elongation [m],simulated force [N]", *rows]) + "\n"


def parameters_of(model: Calibrated) -> dict[str, float]:
    """All parameters of the material at the MAP, SI."""
    return {**model.built.mechanics.parameters[1], **model.map}


def command_of(model: Calibrated) -> Command:
    """The command that defines the material at the MAP, as material 1."""
    mechanics = model.built.mechanics
    assert isinstance(mechanics, OpenSeesMechanics)
    words = mechanics.material.arguments(parameters_of(model))
    # Python uses inf for a far limit; no parameter of a material may be infinite.
    if not all(math.isfinite(word) for word in words if not isinstance(word, str)):
        raise UserError(f"an argument of {mechanics.material.name} is not finite; calibrate again, and export that run")
    return Command("uniaxialMaterial", (mechanics.material.name, 1, *words))


def version() -> str:
    """The version of OpenSees that simulates.

    Raises:
        UserError: openseespy cannot be imported.
    """
    return workers().version()


def test_of(model: Calibrated) -> Test:
    """The first experiment of the calibration, simulated at the MAP along all steps that OpenSees takes."""
    mechanics, simulation = model.built.mechanics, model.built.simulation
    assert isinstance(mechanics, OpenSeesMechanics) and isinstance(simulation, OpenSeesSimulation)
    simulator = simulation.simulator
    assert isinstance(simulator, FunctionModel)
    path, _ = finely(np.asarray(simulator.told(simulation.first)["elongation"], dtype=float))
    path = np.concatenate([[0.0], path])
    found = Simulated(mechanics.material.name)(parameters_of(model), {"elongation": path})
    return Test(path, found["force"])


def difference(script: str, test: Test) -> float:
    """RMS difference of the script's forces from the simulation's along a test, over the standard deviation of these.

    Raises:
        UserError: OpenSees does not run the script.
    """
    with tempfile.TemporaryDirectory(prefix="export-") as name:
        folder = Path(name)
        write_whole(folder / "specimen.py", script)
        write_whole(folder / "protocol.csv", test.csv)
        words = [interpreter(), "specimen.py", "protocol.csv"]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_TIMEOUT)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise UserError(f"OpenSees does not run the exported script along the test: {last}")
    rows = [line.split(",") for line in done.stdout.splitlines() if line.count(",") == 1]
    forces = np.asarray([float(force) for _, force in rows])
    return float(np.sqrt(np.mean((forces - test.force) ** 2)) / np.std(test.force))


def check_text(share: float, opensees: str) -> str:
    """The text of `check.json`."""
    return json.dumps({"opensees": opensees, "difference": share}, indent=2) + "\n"
