"""Does the proposed loading settle what a named protocol leaves open?  `python benchmarks/loadings.py [NAME ...]`

Specimens of OpenSees (`opensees_files.py`) are tested by the protocol of FEMA 461 up to 50 mm, with noise of 1.5 % of the RMS
force, and diagnosed.  Where the verdict is ambiguous and a loading is proposed, a second, nominally equal specimen is tested:
once by the same protocol again, once by the proposed loading, which has no longer path.  Both tests together are diagnosed.
Results are kept case by case in `loadings.json`; `--markdown` prints their table.
"""

import argparse
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from opensees_files import CASES, MM, NOISE, STEP, forces

import hsed_jax as hx
from hsed_jax.diagnosis.findings import Diagnosis
from hsed_jax.measurements import Campaign, Channel, Experiment, Noise, Record
from hsed_jax.physics.protocols import protocol

KEPT = Path(__file__).with_name("loadings.json")
STROKE, EACH = 50 * MM, 50  # samples from one reversal to the next
SPECIMENS = (
    *("pinched", "pinched envelope", "peak-oriented", "bilinear, degrading", "damaged"),
    *("cubic + damaged", "Bouc-Wen, weaker", "rubber", "brace", "flag"),
)


def tested(name: str, reversals: np.ndarray, seed: int) -> Record:
    """The record of a specimen: half a cosine from each reversal to the next."""
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, EACH + 1) / EACH)
    legs = [a + (b - a) * share for a, b in pairwise([0.0, *reversals])]
    elongation = np.concatenate([[0.0], *legs])
    force = forces(CASES[name], elongation)
    noise = NOISE * np.sqrt(np.mean(force**2)) * np.random.default_rng(seed).standard_normal(len(force))
    return Record(STEP * np.arange(len(force)), {"elongation": elongation, "force": force + noise})


def diagnosed(*records: Record) -> Diagnosis:
    """What the package finds in tests of nominally equal specimens."""
    size = float(np.sqrt(np.mean(records[0]["force"] ** 2)))
    channels = {
        "time": Channel("time", "s"),
        "elongation": Channel("elongation", "mm"),
        "force": Channel("force", "kN", noise=Noise(absolute=NOISE * size)),
    }
    experiments = tuple(Experiment(f"E{k}", record=record) for k, record in enumerate(records, start=1))
    law = {"A": {"lognormal": [np.log(1e7), 0.7]}, "beta": {"lognormal": [np.log(125.0), 0.7]}, "gamma": 0.0, "n": 1.0}
    content = {
        "study": "loadings",
        "model": {"parameters": law},
        "experiments": {"campaign": "."},
        "observe": "histories",
    }
    study = hx.load_study({**content, "error": {"absolute": NOISE * size, "inflate": True}})
    return hx.diagnose(hx.calibrate(study, Campaign("loadings", "displacement", {}, channels, {}, experiments)))


def case(name: str) -> dict[str, Any]:
    """The verdicts of one specimen."""
    named = np.asarray([side * STROKE * a for a in protocol("fema_461").amplitudes() for side in (1, -1)])
    first = tested(name, named, 0)
    found = diagnosed(first)
    row: dict[str, Any] = {"name": name, "named": _plain(found)}
    if found.next_loading is not None:
        proposed = found.next_loading
        row["loading"] = proposed.name
        row["again"] = _plain(diagnosed(first, tested(name, named, 1)))
        row["proposed"] = _plain(diagnosed(first, tested(name, proposed.reversals, 1)))
    return row


def _plain(found: Diagnosis) -> dict[str, Any]:
    return {"verdict": found.verdict, "effects": found.effects, "alike": found.look_alikes}


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table of results."""
    lines = ["| specimen | FEMA 461 | FEMA 461 twice | FEMA 461, then the proposed loading |", "|---|---|---|---|"]
    cell = lambda one: f"{' + '.join(one['effects']) or 'nothing'} (`{one['verdict']}`)" if one else "–"  # noqa: E731
    for row in rows:
        then = f": {row['loading']}" if "loading" in row else ""
        lines.append(
            f"| {row['name']} | {cell(row['named'])} | {cell(row.get('again'))} | {cell(row.get('proposed'))}{then} |"
        )
    both = [row for row in rows if "proposed" in row]
    counts = [sum(row[key]["verdict"] == "ambiguous" for row in both) for key in ("again", "proposed")]
    total = sum(row["named"]["verdict"] == "ambiguous" for row in rows)
    return "\n".join(
        [
            *lines,
            f"\nAmbiguous after the protocol: {total} of {len(rows)}. Of {len(both)} with a proposed loading, ambiguous after "
            f"the same protocol again: {counts[0]}; after the proposed loading: {counts[1]}.",
        ]
    )


def main() -> None:
    """Run specimens that the results lack, or print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="specimens whose name contains this (default: all)")
    parser.add_argument("--output", type=Path, default=KEPT, metavar="FILE.json", help="where results are kept")
    parser.add_argument("--markdown", action="store_true", help="print the table of the kept results")
    options = parser.parse_args()
    rows = json.loads(options.output.read_text(encoding="utf-8")) if options.output.exists() else []
    if not options.markdown:
        chosen = [n for n in SPECIMENS if not options.names or any(part in n for part in options.names)]
        for name in (n for n in chosen if n not in {row["name"] for row in rows}):
            rows.append(case(name))
            print(json.dumps(rows[-1]), flush=True)
            options.output.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(markdown(rows))


if __name__ == "__main__":
    main()
