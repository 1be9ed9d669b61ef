"""A laboratory in which OpenSees simulates the structure and the specimen.

OpenSees runs in a separate process: its model is global to a process, and a material that crashes must not end this process.
It is therefore a command laboratory whose program is `opensees_model.py`.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hsed_jax.errors import UserError
from hsed_jax.laboratories.base import Measured, noisy
from hsed_jax.laboratories.command import CommandLaboratory
from hsed_jax.measurements import Noise, Record
from hsed_jax.physics.structures import Structure
from hsed_jax.plain import is_file

INTERPRETER = "OPENSEES_PYTHON"
"""The environment variable that names a Python with openseespy, if this one does not have it."""

# By material, the arguments of OpenSees in order (forces in N, elongations in m) and their defaults; None: required.
MATERIALS: dict[str, dict[str, float | None]] = {
    "BoucWen": {
        "alpha": 0.0, "ko": None, "n": 1.0, "gamma": 0.0, "beta": None,
        "Ao": 1.0, "deltaA": 0.0, "deltaNu": 0.0, "deltaEta": 0.0,
    },
    "BWBN": {
        "alpha": 0.0, "ko": None, "n": 1.0, "gamma": 0.0, "beta": None, "Ao": 1.0, "q": 0.0, "zetas": 0.0,
        "p": 0.0, "Shi": 1.0, "deltaShi": 0.0, "lambda": 0.5, "tol": 1e-9, "maxIter": 200,
    },
    "Steel02": {
        "Fy": None, "E0": None, "b": 0.0, "R0": 20.0, "cR1": 0.925, "cR2": 0.15,
        "a1": 0.0, "a2": 1.0, "a3": 0.0, "a4": 1.0, "sigInit": 0.0,
    },
}  # fmt: skip
_WHOLE = ("maxIter",)
QUANTITIES = ("peak_force", "peak_elongation", "dissipated_energy")
"""Quantities that `opensees_model.py` computes from all its steps, which are finer than its record."""

STEPS_PER_STEP = 50
"""Steps of OpenSees to one of the study's integration, some 1200 to the shortest period.

Its materials are first order in the step; peaks of BoucWen are then good to 0.05 %, with the paper's degradation to 0.3 %
(tests/laboratories/test_opensees.py).
"""


@dataclass(frozen=True)
class OpenSeesLaboratory:
    """Shakes a structure in OpenSees, with noise on the measurements.

    Attributes:
        command: runs the model.
        noise: by channel and quantity; none where absent.
        seed: of the noise; the noise of an experiment depends on its number alone.
    """

    command: CommandLaboratory
    noise: Mapping[str, Noise]
    seed: int

    def perform(self, number: int, inputs: Mapping[str, float]) -> Measured:
        """Simulate experiment `number` (from 0) at `inputs` (SI) and add its noise.

        Raises:
            ExperimentFailed: OpenSees did not converge, crashed, or took too long.
        """
        exact = self.command.perform(number, inputs)
        random = np.random.default_rng([self.seed, number])
        quantities = {
            name: float(noisy(np.asarray(value), self.noise.get(name), random))
            for name, value in exact.quantities.items()
        }
        record = exact.record
        if record is not None:
            channels = {name: noisy(values, self.noise.get(name), random) for name, values in record.channels.items()}
            record = Record(record.time, channels)
        return Measured(quantities, record)


def interpreter() -> str:
    """The Python that has openseespy: this one, or the one that OPENSEES_PYTHON names."""
    return os.environ.get(INTERPRETER, sys.executable)


def require_openseespy() -> None:
    """Check that openseespy can be imported.

    Raises:
        UserError: it cannot; the message explains the installation.
    """
    if not _can_import(interpreter()):
        raise UserError(
            f"experiments.opensees: openseespy cannot be imported by {interpreter()}; install it with "
            f"python -m pip install 'hsed_jax[opensees]', or let {INTERPRETER} name a Python that has it"
        )


@cache
def _can_import(python: str) -> bool:
    try:
        return subprocess.run([python, "-c", "import openseespy.opensees"], capture_output=True).returncode == 0
    except OSError:
        return False


def program() -> tuple[str, ...]:
    """The template of a command that runs the model in its folder."""
    return (interpreter(), str(Path(__file__).resolve().with_name("opensees_model.py")), "{folder}")


def built_in(material: str, parameters: Mapping[str, float]) -> dict[str, Any]:
    """A material of OpenSees with its arguments in order.

    Raises:
        UserError: a parameter is unknown or missing.
    """
    known = MATERIALS[material]
    for name in parameters:
        if name not in known:
            raise UserError(f"parameters.{name}: {material} has no such parameter; it has {', '.join(known)}")
    given = {**known, **parameters}
    for name, value in given.items():
        if value is None:
            raise UserError(f"parameters.{name}: {material} needs this key; its parameters are {', '.join(known)}")
    return {"name": material, "values": [int(v) if name in _WHOLE else v for name, v in given.items()]}


def own_material(file: Path, parameters: Mapping[str, float]) -> dict[str, Any]:
    """A material of the user: a Python file with `specimen(ops, tag, **parameters)`, or a Tcl file.

    Raises:
        UserError: there is no such file, or it is neither.
    """
    if not is_file(file):
        raise UserError(f"material.file: there is no file {file}")
    if file.suffix not in (".py", ".tcl"):
        raise UserError(f"material.file: {file.name} must be a Python file (.py) or a Tcl file (.tcl)")
    return {"file": str(file.absolute()), "parameters": dict(parameters)}


def model(structure: Structure, material: Mapping[str, Any], step: float) -> dict[str, Any]:
    """The input of `opensees_model.py`, for JSON.

    Springs and the damping matrix become links between two points (0 is the ground, masses count from 1), each with a
    stiffness and a damping constant: C = Σ c (e_i − e_j)(e_i − e_j)ᵀ holds for any symmetric C, with negative c, too.

    Arguments:
        structure: masses, springs, damping and the specimen's place.
        material: of the specimen, from `built_in` or `own_material`.
        step: of the analysis [s], at most.
    """
    count = len(structure.masses)
    damping = np.asarray(structure.damping_matrix())
    links = {(i, j): [0.0, 0.0] for j in range(1, count + 1) for i in range(j)}
    for spring in structure.springs:
        links[_points(spring.ends)][0] += float(spring.stiffness)
    for i, j in links:
        links[i, j][1] = float(damping[j - 1].sum() if i == 0 else -damping[i - 1, j - 1])
    first, second = (0 if end is None else end + 1 for end in structure.specimens[0])
    return {
        "masses": [float(mass) for mass in structure.masses],
        "links": [[i, j, *values] for (i, j), values in links.items() if any(values)],
        "specimen": [first, second],
        "material": dict(material),
        "step": step,
    }


def as_json(content: Mapping[str, Any]) -> str:
    """The text of `model.json`."""
    return json.dumps(content, indent=2) + "\n"


def _points(ends: tuple[int | None, int | None]) -> tuple[int, int]:
    low, high = sorted(0 if end is None else end + 1 for end in ends)
    return low, high
