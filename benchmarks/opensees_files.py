"""Specimens that OpenSees made, as a user hands them in: a CSV file, `hsed run FILE.csv`, defaults, nothing by hand.

Every specimen is an assembly of OpenSees materials under a cyclic elongation, with noise of 1.5 % of the RMS force.  `does` says
in words what the specimen does, and `right` which names say so; none where the catalogue has no name for it.  What is named
counts as right if it is one of these names or several, and no other; where there is none, if nothing is named.

The specimens of `CASES` were used during development, all under two sine cycles of each amplitude.  Those of `UNSEEN` have other
materials and mostly other loadings.  What they do was written down before the first run; `README.md` says what was changed since.

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


def sines() -> np.ndarray:
    """Two sine cycles of each amplitude."""
    cycle = np.sin(np.linspace(0, 2 * np.pi, 101)[1:])
    return np.concatenate([[0.0], *(a * cycle for a in np.repeat(AMPLITUDES, 2))])


def ramps() -> np.ndarray:
    """Three cycles of each amplitude at a constant rate."""
    corners = np.concatenate([[0.0], *([a, -a] * 3 for a in AMPLITUDES[[0, 1, 2, 4, 5, 7]]), [0.0]])
    return np.interp(np.linspace(0, len(corners) - 1, 40 * (len(corners) - 1) + 1), np.arange(len(corners)), corners)


def fatigue() -> np.ndarray:
    """Two smaller cycles, then seven of the largest amplitude."""
    cycle = np.sin(np.linspace(0, 2 * np.pi, 81)[1:])
    return np.concatenate([[0.0], *(a * cycle for a in AMPLITUDES[[1, 4, *(7,) * 7]])])


def irregular() -> np.ndarray:
    """Twelve harmonics with random phases, which grow and fade."""
    time, random = STEP * np.arange(1600), np.random.default_rng(1)
    harmonics = [a * np.sin(2 * np.pi * f * time + b) for f, a, b in zip(
        np.linspace(0.05, 0.35, 12), random.standard_normal(12), random.uniform(0, 2 * np.pi, 12), strict=True)]  # fmt: skip
    sample = np.sum(harmonics, axis=0) * np.sqrt(np.sin(np.pi * time / time[-1]).clip(0))
    return 45 * MM * sample / np.abs(sample).max()


class Case(NamedTuple):
    """A specimen.

    Attributes:
        materials: each with its arguments, in the order of their tags; the last one is the specimen.
        does: in words, beside the law.
        right: names that say so.
        dashpot: from the rate [m/s] to a force beside the materials [N].
        loading: gives the elongation at the samples [m].
    """

    materials: tuple[tuple[Any, ...], ...]
    does: str
    right: tuple[str, ...] = ()
    dashpot: Callable[[np.ndarray], np.ndarray] | None = None
    loading: Callable[[], np.ndarray] = sines


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

UNSEEN = {
    "wood wall": Case(
        (("SAWS", 40 * KN, 4 * KN, 40 * MM, 3e6, 0.06, -0.1, 1.4, 0.03, 0.75, 1.1),), "pinching; stiffness and strength fall",
        ("pinching", "slip", *FALLS), None, ramps,
    ),
    "pinched, peak-oriented": Case(
        (("IMKPinching", K, *(30 * MM, 60 * MM, 0.2, 80 * KN, 1.25, 0.2) * 2, *(20,) * 4, *(1,) * 6, 0.3, 0.3),),
        "pinching; reloading aims at the largest former point", ("pinching", "slip", "peak_oriented", *FALLS), None, ramps,
    ),
    "one stop": Case(
        (STEEL, ("ElasticPPGap", 2 * K, 900 * KN, 25 * MM, 0.0), ("Parallel", 1, 2)), "a stop at 25 mm in tension",
        ("contact_stiffening",),
    ),
    "fatigue": Case(
        (("Steel02", 80 * KN, K, 0.01, 18, 0.925, 0.15), ("Fatigue", 1, "-E0", 0.16, "-m", -0.458)), "it breaks",
        ("fracture", *FALLS), None, fatigue,
    ),
    "three slopes": Case(
        (("MultiLinear", 4 * MM, 40 * KN, 10 * MM, 70 * KN, 30 * MM, 90 * KN, 200 * MM, 120 * KN),),
        "it yields in three steps", ("hardening", "loop_shape", "kinematic_hardening"), None, ramps,
    ),
    "concrete + steel": Case(
        (("Concrete02", -80 * KN, -10 * MM, -40 * KN, -60 * MM, 0.3, 8 * KN, 1e6), ("Steel02", 50 * KN, K, 0.01, 15, 0.925, 0.15),
         ("Parallel", 1, 2)), "stronger in compression, where it falls", ("asymmetry", *FALLS), None, ramps,
    ),
    "two back-stresses": Case(
        (("UVCuniaxial", 20e6, 70 * KN, 24 * KN, 20.0, 0.0, 1.0, 2, 2.5e6, 250.0, 0.17e6, 20.0),),
        "two back-stresses; strength grows", ("kinematic_hardening", "isotropic_hardening"), None, ramps,
    ),
    "spring + oil damper": Case(
        (("Elastic", 3e6),), "a dashpot that relieves at 0.02 m/s", ("power_damping", "viscous_damping"),
        lambda v: np.sign(v) * np.where(np.abs(v) < 0.02, 1e6 * np.abs(v), 20 * KN + 1e5 * (np.abs(v) - 0.02)),
    ),
    "steel, irregular": Case((STEEL,), "nothing beside its law", (), None, irregular),
    "pinched, irregular": Case(
        (("Hysteretic", *_sides(70 * KN, 7 * MM, 95 * KN, 25 * MM, 80 * KN, 60 * MM), 0.3, 0.7, 0.0, 0.03, 0.4),),
        "pinching; stiffness and strength fall", ("pinching", "slip", "peak_oriented", *FALLS), None, irregular,
    ),
    "softening": Case(
        (("Hysteretic", *_sides(70 * KN, 7 * MM, 95 * KN, 25 * MM, 40 * KN, 60 * MM), 1.0, 1.0, 0.0, 0.0, 0.0),),
        "the force falls beyond 25 mm; reloading aims at the largest former point", ("peak_oriented", *FALLS), None, ramps,
    ),
    "spring + friction": Case(
        (("Elastic", 1.5e6), ("ElasticPP", 200e6, 40 * KN / 200e6), ("Parallel", 1, 2)), "friction of 40 kN",
        ("coulomb_friction",),
    ),
    "play": Case(
        (("ElasticPPGap", K, 80 * KN, 8 * MM, 0.02), ("ElasticPPGap", K, -80 * KN, -8 * MM, 0.02), ("ElasticPP", K, 10 * KN / K),
         ("Parallel", 1, 2, 3)), "play of 8 mm, with some friction", ("gap", "contact_stiffening"), None, ramps,
    ),
    "steel, isotropic": Case(
        (("Steel02", 80 * KN, K, 0.01, 15, 0.925, 0.15, 0.4, 5.0, 0.4, 5.0),), "strength grows", ("isotropic_hardening",),
        None, ramps,
    ),
}  # fmt: skip
ALL = CASES | UNSEEN


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
    elongation = ALL[name].loading()
    force = forces(ALL[name], elongation)
    random = np.random.default_rng(list(ALL).index(name))
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
        own, right = set(diagnosis["effects"]), set(ALL[name].right)
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
    """The tables of results: of the specimens that were used during development, and of the others."""
    return "\n\n".join(_table([row for row in rows if row["name"] in cases]) for cases in (CASES, UNSEEN))


def _table(rows: list[dict[str, Any]]) -> str:
    lines = ["| specimen | it does | named (verdict) | error before | after |", "|---|---|---|---|---|"]
    for row in rows:
        named = " + ".join(f"`{effect}`" for effect in row.get("effects", [])) or "nothing"
        before, after = (f"{error:.3f}" for error in row["errors"]) if "errors" in row else ("–", "–")
        lines.append(
            f"| {row['name']} | {ALL[row['name']].does} | {named} (`{row.get('verdict', 'no end')}`) | {before} | {after} |"
        )
    firsts = [row["effects"][:1] for row in rows if "effects" in row]
    known = [set(ALL[row["name"]].right) for row in rows if "effects" in row]
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
    for name in ALL:
        if any(row["name"] == name for row in rows) or not (
            not options.names or any(own in name for own in options.names)
        ):
            continue
        rows.append(scored(name, options.folder / name.replace(" ", "_"), options.seconds))
        print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
        order = list(ALL)
        rows.sort(key=lambda row: order.index(row["name"]))
        options.output.write_text(json.dumps(rows, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
