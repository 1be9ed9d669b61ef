"""Specimens that OpenSees made, as a user hands them in: a CSV file, `hsed run FILE.csv`, defaults, nothing by hand.

Every specimen is an assembly of OpenSees materials under cyclic elongations of growing amplitude, two cycles each, with noise of
1.5 % of the RMS force.  `does` says in words what the specimen does, and `right` which names say so; none where the
catalogue has no name for it.  What is named counts as right if it is one of these names or several, and no other; where there is
none, if nothing is named.

    python benchmarks/opensees_files.py FOLDER              # runs the cases in FOLDER; those that the results have are kept
    python benchmarks/opensees_files.py FOLDER plain brace  # those whose name contains one of these
    python benchmarks/opensees_files.py --markdown          # the table of the kept results
"""

import argparse
import csv
import json
import resource
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

KEPT = Path(__file__).with_name("opensees_files.json")
NOISE, STEP = 0.015, 0.05
MM, KN, K = 1e-3, 1e3, 10e6
AMPLITUDES = np.asarray([5, 10, 15, 20, 25, 30, 40, 50]) * MM
STEEL = ("Steel02", 80 * KN, K, 0.02, 15, 0.925, 0.15)


class Case(NamedTuple):
    """A specimen.

    Attributes:
        materials: each with its arguments, in the order of their tags; the last one is the specimen.
        does: in words, beside the law.
        right: names that say so.
        dashpot: from the rate [m/s] to a force beside the materials [N].
    """

    materials: tuple[tuple[Any, ...], ...]
    does: str
    right: tuple[str, ...] = ()
    dashpot: Callable[[np.ndarray], np.ndarray] | None = None


def _sides(*values: float) -> tuple[float, ...]:
    """Points of an envelope, and the same with the other sign."""
    return (*values, *(-value for value in values))


_CUBIC = np.linspace(-60 * MM, 60 * MM, 61).tolist()
SERIES = ("Steel02", 80 * KN, 2 * K, 0.01, 15, 0.925, 0.15)
STOPS = (("ElasticPPGap", K, 400 * KN, 20 * MM, 0.0), ("ElasticPPGap", K, -400 * KN, -20 * MM, 0.0))
PINCHED = (
    *(60 * KN, 6 * MM, 90 * KN, 15 * MM, 100 * KN, 30 * MM, 40 * KN, 60 * MM, 0.5, 0.25, 0.05),
    *(1.0, 0.2, 0.3, 0.2, 0.9, 0.5, 0.5, 2.0, 2.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0, "energy"),
)
ENVELOPE = (70 * KN, 7 * MM, 95 * KN, 25 * MM, 60 * KN, 60 * MM)
BRACE = (
    90 * KN,
    9 * MM,
    100 * KN,
    30 * MM,
    105 * KN,
    80 * MM,
    -50 * KN,
    -5 * MM,
    -25 * KN,
    -20 * MM,
    -20 * KN,
    -80 * MM,
)
FALLS = ("stiffness_degradation", "strength_degradation", "peak_softening")
CASES = {
    "steel": Case((STEEL,), "nothing beside its law"),
    "linear": Case((("Steel4", 8000 * KN, 0.05 * K, "-kin", 0.01, 25.0, 0.9, 0.15),), "nothing: it is linear"),
    "steel, kinematic": Case((("Steel4", 80 * KN, K, "-kin", 0.01, 25.0, 0.9, 0.15),), "nothing beside its law"),
    "steel + friction": Case(
        (STEEL, ("ElasticPP", 500e6, 20 * KN / 500e6), ("Parallel", 1, 2)), "friction of 20 kN", ("coulomb_friction",)
    ),
    "steel + dashpot": Case(
        (STEEL,), "a dashpot of power 0.4", ("power_damping",), lambda v: 60 * KN * np.sign(v) * np.abs(v / 0.06) ** 0.4
    ),
    "steel + stops": Case((STEEL, *STOPS, ("Parallel", 1, 2, 3)), "stops at 20 mm", ("contact_stiffening",)),
    "steel in series": Case((SERIES, ("Elastic", K), ("Series", 1, 2)), "a spring in series", ("support_flexibility",)),
    "flag": Case((("SelfCentering", K, 0.05 * K, 80 * KN, 0.7),), "flags", ("self_centering", "hardening")),
    "pinched": Case((("Pinching4", *PINCHED),), "pinching; stiffness and strength fall", ("pinching", "slip", *FALLS)),
    "pinched envelope": Case(
        (("HystereticSM", "-posEnv", *ENVELOPE, "-negEnv", *(-x for x in ENVELOPE), "-pinch", 0.8, 0.3, "-damage", 0.0, 0.02),),
        "pinching; stiffness and strength fall", ("pinching", "slip", *FALLS),
    ),
    "peak-oriented": Case(
        (("IMKPeakOriented", K, *(30 * MM, 60 * MM, 0.2, 80 * KN, 1.25, 0.2) * 2, *(20,) * 4, *(1,) * 6),),
        "reloading aims at the largest former point; strength falls", ("peak_oriented", "strength_degradation", "peak_softening"),
    ),
    "bilinear, degrading": Case(
        (("IMKBilin", K, *(30 * MM, 60 * MM, 0.2, 80 * KN, 1.2, 0.2) * 2, *(3,) * 3, *(1,) * 5),),
        "stiffness and strength fall", FALLS,
    ),
    "damaged": Case(
        (("Hysteretic", *_sides(70 * KN, 7 * MM, 95 * KN, 30 * MM, 98 * KN, 80 * MM), 1.0, 1.0, 0.0, 0.03, 0.0),),
        "reloading aims at the largest former point; it falls", ("peak_oriented", *FALLS),
    ),
    "cubic + damaged": Case(
        (("Hysteretic", *_sides(70 * KN, 7 * MM, 72 * KN, 30 * MM, 75 * KN, 80 * MM), 1.0, 1.0, 0.0, 0.02, 0.3),
         ("ElasticMultiLinear", 0.0, "-strain", *_CUBIC, "-stress", *(3e8 * u**3 for u in _CUBIC)), ("Parallel", 1, 2)),
        "a cubic spring; reloading aims at the largest former point", ("cubic_stiffness", "peak_oriented", *FALLS),
    ),
    "Bouc-Wen, weaker": Case(
        (("BoucWen", 0.02, K, 1.0, 62.5, 62.5, 1.0, 0.0, 2e-4, 0.0),), "strength falls; γ = β; a share of the stiffness stays",
        ("strength_degradation", "loop_shape", "hardening"),
    ),
    "steel + oil damper": Case(
        (STEEL,), "a dashpot that relieves at 0.03 m/s", ("power_damping", "viscous_damping"),
        lambda v: np.sign(v) * np.where(np.abs(v) < 0.03, 1e6 * np.abs(v), 30 * KN + 1e5 * (np.abs(v) - 0.03)),
    ),
    "rubber": Case((("KikuchiAikenHDR", "X0.6", 0.1, 0.1),), "the first cycle to an amplitude is stiffer", ("scragging",)),
    "brace": Case((("Hysteretic", *BRACE, 0.6, 0.4, 0.0, 0.005, 0.0),), "weaker in compression each cycle", ("buckling", *FALLS)),
}  # fmt: skip


def forces(case: Case, elongation: np.ndarray) -> np.ndarray:
    """The force of a specimen at the samples of an elongation [N]."""
    from openseespy import opensees

    ops: Any = opensees
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    for tag, (name, *arguments) in enumerate(case.materials, start=1):
        ops.uniaxialMaterial(name, tag, *arguments)
    ops.testUniaxialMaterial(len(case.materials))
    found = [0.0]
    for start, end in pairwise(elongation):
        for strain in np.linspace(start, end, 21)[1:]:
            ops.setStrain(float(strain))
        found.append(ops.getStress())
    beside = case.dashpot(np.gradient(elongation, STEP)) if case.dashpot else 0.0
    return np.asarray(found) + beside


def written(name: str, folder: Path) -> Path:
    """The file of a specimen."""
    cycle = np.sin(np.linspace(0, 2 * np.pi, 101)[1:])
    elongation = np.concatenate([[0.0], *(a * cycle for a in np.repeat(AMPLITUDES, 2))])
    force = forces(CASES[name], elongation)
    random = np.random.default_rng(list(CASES).index(name))
    force = force + NOISE * np.sqrt(np.mean(force**2)) * random.standard_normal(len(force))
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "specimen.csv"
    with file.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["time [s]", "displacement [mm]", "force [kN]"])
        for i, (u, f) in enumerate(zip(elongation, force, strict=True)):
            table.writerow([f"{i * STEP:.3f}", f"{1e3 * u:.5f}", f"{1e-3 * f:.5f}"])
    return file


def scored(name: str, folder: Path, seconds: float) -> dict[str, Any]:
    """What a run of a specimen says."""
    file = written(name, folder)
    before = _spent()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "hsed_jax", "run", file.name], cwd=folder, capture_output=True, timeout=seconds
        )
        status = done.returncode
    except subprocess.TimeoutExpired:
        status = -1
    found: dict[str, Any] = {"name": name, "status": status, "cpu_seconds": round(_spent() - before, 1)}
    summaries = sorted(folder.glob("runs/*/summary.json"))
    if status == 0 and summaries:
        summary = json.loads(summaries[0].read_text(encoding="utf-8"))
        diagnosis, steps = summary["diagnosis"], summary["improvement"]["steps"]
        own, right = set(diagnosis["effects"]), set(CASES[name].right)
        found |= {
            "verdict": diagnosis["verdict"],
            "effects": diagnosis["effects"],
            "errors": [steps[0]["error_test"], steps[-1]["error_test"]],
            "sentence": diagnosis["behaviour_sentence"],
            "right": own <= right and bool(own) == bool(right),
        }
    return found


def _spent() -> float:
    """CPU seconds of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table of results."""
    lines = ["| specimen | it does | named (verdict) | error before | after |", "|---|---|---|---|---|"]
    for row in rows:
        named = " + ".join(f"`{effect}`" for effect in row.get("effects", [])) or "nothing"
        before, after = (f"{error:.3f}" for error in row["errors"]) if "errors" in row else ("–", "–")
        lines.append(
            f"| {row['name']} | {CASES[row['name']].does} | {named} (`{row.get('verdict', 'no end')}`) | {before} | {after} |"
        )
    firsts = [row["effects"][:1] for row in rows if "effects" in row]
    known = [set(CASES[row["name"]].right) for row in rows if "effects" in row]
    first = sum(bool(own) == bool(right) and set(own) <= right for own, right in zip(firsts, known, strict=True))
    exact = sum(row.get("right", False) for row in rows)
    lines.append(f"\nAll that is named is right in {exact} of {len(rows)} specimens, what is named first in {first}.")
    return "\n".join(lines)


def main() -> None:
    """Run cases, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, help="where the runs are")
    parser.add_argument("names", nargs="*", help="cases whose name contains one of these (default: all)")
    parser.add_argument("--output", type=Path, default=KEPT)
    parser.add_argument("--seconds", type=float, default=400.0, help="time limit of a case")
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args()
    rows = json.loads(options.output.read_text(encoding="utf-8")) if options.output.exists() else []
    if options.markdown or options.folder is None:
        print(markdown(rows))
        return
    for name in CASES:
        if any(row["name"] == name for row in rows) or not (
            not options.names or any(own in name for own in options.names)
        ):
            continue
        rows.append(scored(name, options.folder / name.replace(" ", "_"), options.seconds))
        print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
        order = list(CASES)
        rows.sort(key=lambda row: order.index(row["name"]))
        options.output.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
