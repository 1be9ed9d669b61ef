"""Component tests by OpenSees' own materials, where `openseespy` can be had.

`openseespy` is looked for in this interpreter, or in the one that the environment variable OPENSEES_PYTHON names (it need
not be installed beside the package).  OpenSees is first order in the step; the specimen without the effect is by OpenSees, too.
"""

import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

SUBSTEPS = 2


def interpreter() -> str:
    """The Python that has openseespy."""
    return os.environ.get("OPENSEES_PYTHON", sys.executable)


@cache
def is_available() -> bool:
    """Whether openseespy can be imported there."""
    command = [interpreter(), "-c", "import openseespy.opensees"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def pull(material: str, u, A: float, beta: float, delta, drawn: dict[str, float], scales) -> np.ndarray:
    """Force (n, lanes) [N] of a material under the elongation u (n, lanes) [m]; `delta` (lanes,) is the effect's amplitude.

    Raises:
        RuntimeError: openseespy is not there, or OpenSees failed.
    """
    if not is_available():
        raise RuntimeError(f"openseespy cannot be imported by {interpreter()}; set OPENSEES_PYTHON")
    with tempfile.TemporaryDirectory() as folder:
        asked, answer = Path(folder) / "asked.npz", Path(folder) / "answer.npy"
        values = {f"drawn_{name}": value for name, value in drawn.items()}
        np.savez(asked, material=material, u=u, A=A, beta=beta, delta=delta, scales=np.array(scales), **values)
        command = [interpreter(), str(Path(__file__).resolve()), str(asked), str(answer)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not answer.exists():
            raise RuntimeError(f"OpenSees failed: {done.stderr[-500:]}")
        return np.load(answer)


def define(ops, material: str, A: float, beta: float, delta: float, drawn: dict[str, float], scales) -> None:
    """Define material 1; the specimen itself is `BoucWen` with n = 1, γ = 0, z in metres."""
    force, elongation, _, energy = scales

    def specimen(tag: int, alpha: float = 0.0, nu: float = 0.0, eta: float = 0.0) -> None:
        ops.uniaxialMaterial("BoucWen", tag, alpha, A, 1.0, 0.0, beta, 1.0, 0.0, nu, eta)

    if material == "stiffness_degradation":
        specimen(1, eta=delta / energy)
    elif material == "strength_degradation":
        specimen(1, nu=delta / energy)
    elif material == "hardening":
        specimen(1, alpha=delta)  # α A u + (1 − α) z
    elif material == "pinching":
        arguments = [0.0, delta, drawn["p"] / energy, drawn["psi"] / beta, 0.0, 0.5, 1e-9, 200]
        ops.uniaxialMaterial("BWBN", 1, 0.0, A, 1.0, 0.0, beta, 1.0, *arguments)
    else:
        specimen(2)
        if delta == 0:
            ops.uniaxialMaterial("Parallel", 1, 2)
        elif material == "support_flexibility":
            ops.uniaxialMaterial("Elastic", 3, force / (delta * elongation))
            ops.uniaxialMaterial("Series", 1, 2, 3)
        elif material == "coulomb_friction":
            ops.uniaxialMaterial("ElasticPP", 3, delta * force / (0.01 * elongation), 0.01 * elongation)
            ops.uniaxialMaterial("Parallel", 1, 2, 3)
        elif material == "quadratic_stiffness":
            ops.uniaxialMaterial("ENT", 3, delta * force / elongation)
            ops.uniaxialMaterial("Parallel", 1, 2, 3)
        elif material == "contact_stiffening":
            stiffness, gap = delta * force / elongation, drawn["clearance"] * elongation
            ops.uniaxialMaterial("ElasticPPGap", 3, stiffness, 1e3 * force, gap)
            ops.uniaxialMaterial("ElasticPPGap", 4, stiffness, -1e3 * force, -gap)
            ops.uniaxialMaterial("Parallel", 1, 2, 3, 4)
        else:
            raise ValueError(material)


def _work(asked: str, answer: str) -> None:
    import openseespy.opensees as ops

    with np.load(asked) as given:
        case = {name: given[name] for name in given.files}
    drawn = {name.removeprefix("drawn_"): float(v) for name, v in case.items() if name.startswith("drawn_")}
    u, delta = case["u"], case["delta"]
    lanes, force = len(delta), np.empty((u.shape[0], len(delta)))
    coarse = np.arange(u.shape[0])
    fine = np.arange((u.shape[0] - 1) * SUBSTEPS + 1) / SUBSTEPS
    for lane in range(lanes):
        ops.wipe()
        scales = [float(v) for v in case["scales"]]
        define(ops, str(case["material"]), float(case["A"]), float(case["beta"]), float(delta[lane]), drawn, scales)
        ops.testUniaxialMaterial(1)
        for i, strain in enumerate(np.interp(fine, coarse, u[:, lane]).tolist()):
            ops.setStrain(strain)
            if i % SUBSTEPS == 0:
                force[i // SUBSTEPS, lane] = ops.getStress()
    np.save(answer, force)


if __name__ == "__main__":
    _work(*sys.argv[1:])
