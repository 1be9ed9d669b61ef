"""Diagnosis over the whole catalogue of effects: as the first thing a process does, and of one campaign after the other."""

import tempfile
import time
from pathlib import Path
from typing import Any

from fresh import alone, write_byte_code
from measure import line

_STUDY = Path(__file__).resolve().parents[2] / "configs" / "hidden_effect.yaml"
_HIDDEN = "stiffness_degradation"
# A diagnosis takes the measurements and the model; of the calibration before it, it needs nothing.
_CALIBRATION = "calibration={chains: 1, warmup: 20, draws: 20, starts: 2}"


def measure(quick: bool) -> list[dict[str, Any]]:
    """All lines of this row: wall seconds of `hx.diagnose`."""
    write_byte_code()
    settings = ("design.initial=3",) if quick else ()
    with tempfile.TemporaryDirectory() as folder:
        cold, again = alone(diagnosed, (0, 1), settings, cache=Path(folder))
        (filled,) = alone(diagnosed, (2,), settings, cache=Path(folder))
    # Not before: this process only starts others until now.
    from peers import native

    each = native.each()
    note = () if each is not None else (native.NOTE,)
    lines = []
    for state, found in (("compilation cache empty", cold), ("new process, cache filled", filled),
                         ("another campaign in the same process", again)):  # fmt: skip
        what = f"diagnosis of {found['experiments']} experiments, {found['candidates']} candidates, {state}"
        peers = {} if each is None else {"its simulations in C on one core": found["simulations"] * each}
        figures = {"effect not named": found["missed"], "simulations": found["simulations"]}
        lines.append(line("diagnosis", what, "s", found["seconds"], peers, {"ours": figures}, note))
    return lines


def diagnosed(seeds: tuple[int, ...], settings: tuple[str, ...]) -> list[dict[str, Any]]:
    """What the diagnosis of each campaign took [s], how many simulations it made, and whether it named the hidden effect."""
    import hsed_jax as hx
    from hsed_jax.diagnosis.batch import Batch

    simulated = [0]
    run = Batch.__call__

    def counted(self, thetas, experiments):
        simulated[0] += len(experiments)
        return run(self, thetas, experiments)

    Batch.__call__ = counted
    found = []
    for seed in seeds:
        calibration = hx.calibrate(hx.load_study(_STUDY, (f"seed={seed}", _CALIBRATION, *settings)))
        simulated[0] = 0
        begin = time.perf_counter()
        diagnosis = hx.diagnose(calibration)
        taken = time.perf_counter() - begin
        found.append(
            {
                "seconds": taken,
                "simulations": simulated[0],
                "experiments": len(calibration.campaign.train),
                "candidates": len(diagnosis.ranking),
                "missed": int(_HIDDEN not in diagnosis.effects),
            }
        )
    return found
